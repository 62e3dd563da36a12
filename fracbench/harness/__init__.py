"""The experiment harness: configuration, plan, execution, store, regression check.

Imports `fracbench.data`, `fracbench.methods`, `fracbench.evaluation` and the rooms that these may import.
"""
