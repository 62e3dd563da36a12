"""Compiled loops and transforms over plain arrays, which know nothing of optical flow.

Imports NumPy, SciPy, numba and its own modules alone.
"""
