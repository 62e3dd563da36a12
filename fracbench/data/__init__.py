"""Frames and true flows: pairs, regions, files, and the datasets they come from.

Imports `fracbench.errors`.
"""
