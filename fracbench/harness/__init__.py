"""From configuration to stored results: grid, plan, execution, store, regression."""
