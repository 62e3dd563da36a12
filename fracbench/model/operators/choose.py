"""Choice of the gradient operator by boundary rule and order.

==========  =========================================  =====================================  ============
boundary    u outside the image                        derivatives (pairs)                    basis
==========  =========================================  =====================================  ============
`zero`      0 (the paper's Dirichlet condition)        left                                   eigenvectors
`reflect`   mirrored about the edges                   left and right, each weighing 1/2      DCT-II
`natural`   no flux (alpha = 1 only; Algorithm 3)      forward differences                    DCT-II
==========  =========================================  =====================================  ============

The adjoint under `zero` is the right derivative: the discrete form of the paper's integration by parts.

Orders are those of the paper, at most 2, under `zero`, and at most 4 under `reflect`. There the multipliers and
eigenvalues hold for every order, and the u-step is as exact as for the paper's: the eigenvalues, at most
``2^(2 alpha)``, are within the reach of single precision.
"""

from __future__ import annotations

import numpy as np

from fracbench.errors import InputError, unknown_name
from fracbench.model.operators.base import GradientOperator
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.operators.reflect import ReflectGradient
from fracbench.model.operators.zero import ZeroGradient


def make_operator(
    boundary: str, alpha: float, shape: tuple[int, int], dtype: np.dtype | type = np.float64, pad: int = 0
) -> GradientOperator:
    """Return the gradient operator for a boundary rule.

    Parameters
    ----------
    boundary : {'zero', 'reflect', 'natural'}
        Boundary rule; see the table above.
    alpha : float
        Order in [0, 2], under `reflect` in [0, 4].
    shape : tuple of int
        ``(H, W)``.
    dtype : dtype-like, optional
        float32 or float64.
    pad : int, optional
        Padding in pixels; `zero` only.

    Raises
    ------
    InputError
        Unknown boundary, `alpha` outside its range, or a combination that is not defined.
    """
    largest = 4.0 if boundary == "reflect" else 2.0
    if not 0.0 <= alpha <= largest:
        raise InputError(f"`alpha` must lie in [0, {largest:g}] under boundary={boundary}, got {alpha:g}")
    if pad and boundary != "zero":
        raise InputError(f"`pad` belongs to boundary=zero, got pad={pad} with boundary={boundary}")
    if boundary == "zero":
        return ZeroGradient(alpha, shape, dtype, pad)
    if boundary == "reflect":
        return ReflectGradient(alpha, shape, dtype)
    if boundary == "natural":
        if alpha != 1.0:
            raise InputError(f"boundary=natural is defined for alpha = 1, got alpha = {alpha:g}")
        return ForwardDifferences(alpha, shape, dtype)
    raise unknown_name("boundary", boundary, ("zero", "reflect", "natural"))
