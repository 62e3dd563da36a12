"""The paper: fractional gradients, solvers, the coarse-to-fine estimator. Knows arrays only."""

#: Raised by hand whenever numbers may change: it is part of every stored result's key.
SOLVER_VERSION = 2
