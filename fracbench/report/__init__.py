"""The paper answered: a verdict on each of its claims, and one HTML page with everything that was found.

Imports `fracbench.studies` and what it may import.
"""
