"""Compiled loops and transforms over plain arrays, without any knowledge of optical flow.

May import `fracbench.errors`; besides, NumPy, SciPy and numba.
"""
