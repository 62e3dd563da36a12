"""The experiment harness: configuration, plan, execution, store, regression check.

Imports `fracbench.data`, `fracbench.methods`, `fracbench.evaluation` and what these may import.
"""
