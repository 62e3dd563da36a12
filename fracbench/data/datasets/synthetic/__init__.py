"""Rendered scenes whose true flow is known exactly.

Imports `fracbench.errors` and the rest of `fracbench.data`.
"""
