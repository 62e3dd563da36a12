"""Particle images of analytic flows, whose displacement is known exactly.

Imports `fracbench.errors` and the rest of `fracbench.data`.
"""
