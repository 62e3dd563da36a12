"""A weight of the data that grows towards the coarse scales, where an order above 1 smooths more."""

from __future__ import annotations

import math
from collections.abc import Callable

from fracbench.model.data_terms.brightness import Residual
from fracbench.model.kernels.arrays import Array
from fracbench.model.params import FlowParams
from fracbench.model.warping import Linearization

ResidualFactory = Callable[[Array, Array, FlowParams], Residual]


class Weighted(Residual):
    """A data term with one weight for all pixels, ``lambda |w rho|``; the v-steps need not know w."""

    def __init__(self, data: Residual, weight: float) -> None:
        self._data, self._weight = data, weight

    def at(self, u0: Array) -> Linearization:
        """Multiply the residual and its gradient by the weight; see `Residual`."""
        linear = self._data.at(u0)
        weight = linear.rho_c.dtype.type(self._weight)
        linear.rho_c[...] *= weight
        linear.gradient[...] *= weight
        return linear


def grown(make: ResidualFactory, shape: tuple[int, ...], growth: float) -> ResidualFactory:
    """Return the function that makes the data term of a scale with the weight ``r^growth``.

    The sides of a scale are 1/r of those of the frames, which have the `shape` (H, W). The flow there is u/r, in
    its own pixels, with the derivatives ``r^(alpha - 1) D^alpha u``, and the residual is what it was. On a coarse
    scale the regulariser of order alpha is therefore ``r^(alpha - 1)`` times as strong beside the data. With a
    growth of ``alpha - 1`` all scales minimise the same energy.
    """

    def at_scale(frame0: Array, frame1: Array, params: FlowParams) -> Residual:
        data = make(frame0, frame1, params)
        ratio = math.sqrt(math.prod(shape) / math.prod(frame0.shape))
        return data if ratio == 1.0 else Weighted(data, ratio**growth)

    return at_scale
