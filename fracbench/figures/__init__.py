"""Figures: one style, curves, panels, pictures of flow, and files that are drawn only when they change.

Imports `fracbench.errors` and `fracbench.data.files`.
"""
