"""How fast solvers of the u-step and of a linearised problem converge.

Imports what `fracbench.studies` may.
"""
