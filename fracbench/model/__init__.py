"""The mathematics: fractional gradients, data terms, the single-level solver and the coarse-to-fine driver.

Imports `fracbench.errors` alone; it knows arrays, and neither files nor configuration.
"""

#: Raised by hand whenever numbers may change: it is part of every stored result's key.
SOLVER_VERSION = 2
