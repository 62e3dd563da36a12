"""From a plan to stored results: points and their keys, the sweep over them, worker processes and the store.

Imports `fracbench.harness.config`, `fracbench.evaluation` and the rooms that these may import.
"""
