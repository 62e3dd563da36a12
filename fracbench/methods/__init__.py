"""The methods by name: the paper's, those beyond it, and the peers they are compared with.

Imports `fracbench.model`, `fracbench.entry_points` and `fracbench.errors`.
"""
