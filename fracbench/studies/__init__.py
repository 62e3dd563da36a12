"""The experiments of the paper and beyond: each turns its points into tables, figures and sentences.

Imports `fracbench.harness`, `fracbench.figures` and what these may import.
"""
