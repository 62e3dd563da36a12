"""Figures: one style, curves, panels, pictures of flow and fields, and files that are drawn when they change.

Imports `fracbench.errors`, `fracbench.data.files` and `fracbench.data.field`.
"""
