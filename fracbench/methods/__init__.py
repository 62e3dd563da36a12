"""The methods by name: the paper's, those beyond it, and the peers they are compared with.

Imports `fracbench.model` and `fracbench.errors`.
"""
