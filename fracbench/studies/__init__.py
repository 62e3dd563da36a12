"""The experiments of the paper and beyond: what each makes of its points, as tables, figures and sentences.

Imports `fracbench.harness`, `fracbench.figures` and what these may import.
"""
