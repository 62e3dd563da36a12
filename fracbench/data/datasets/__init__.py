"""The datasets: where their files are looked up, how they are verified, loaded or rendered.

Imports `fracbench.errors` and the rest of `fracbench.data`.
"""
