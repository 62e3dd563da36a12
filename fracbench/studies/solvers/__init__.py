"""Convergence of the solvers of the u-step and of one linearised problem.

Imports the rooms that `fracbench.studies` may import.
"""
