"""Fractional gradients, one boundary rule a file, each with its adjoint and the exact u-step.

Imports `fracbench.errors` and `fracbench.model.kernels`.
"""
