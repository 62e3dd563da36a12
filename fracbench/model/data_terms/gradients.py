"""Data beyond brightness: derivatives of both frames, and gradients, which light changes least."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.pointwise import GRADIENT_IS_ZERO
from fracbench.model.kernels.threads import share
from fracbench.model.params import FlowParams
from fracbench.model.single_level import Brightness, MultiplierStep
from fracbench.model.warping import Linearization, central_gradient

#: Rounds over the channels in a v-step; it starts where the last one ended.
ROUNDS = 2


class TwoSided(Brightness):
    """The difference of brightness, linearised with the mean of both frames' five-point derivatives.

    Where the flow is right, ``grad I0(x) = grad I1(x + u)``, and the mean of the two has less noise than either.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The frames at a scale.
    params : FlowParams
        Factor on the image gradient.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        super().__init__(frame0, frame1, params)
        self._gradient0 = self.differentiate(frame0, params.gradient_scale)

    def differentiate(self, frame: Array, scale: float) -> Array:
        """Return the derivatives of a frame; see `Brightness`."""
        return five_point_gradient(frame, scale)

    def at(self, u0: Array) -> Linearization:
        """Average the gradients of both frames; see `fracbench.model.single_level.Residual`."""
        linear = super().at(u0)
        share(lambda a, b: average_gradients(self._gradient0, u0, *linear, a, b), u0.shape[1])
        return linear


def five_point_gradient(image: Array, scale: float = 1.0) -> Array:
    """Return derivatives by the stencil (1, -8, 0, 8, -1) / 12, of fourth order, borders repeated.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Image.
    scale : float, optional
        Factor on the result.

    Returns
    -------
    ndarray, shape (2, H, W)
        x and y derivative, in the precision of `image`.
    """
    stencil = scale * np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
    return np.stack([scipy.ndimage.correlate1d(image, stencil, axis, mode="nearest") for axis in (1, 0)])


@jit
def average_gradients(gradient0: Array, u0: Array, rho_c: Array, gradient: Array, start: int, stop: int) -> None:
    """Replace a linearisation's gradient by its mean with that of frame 0; the residual at `u0` stays.

    Parameters
    ----------
    gradient0 : ndarray, shape (2, H, W)
        Gradient of frame 0.
    u0 : ndarray, shape (2, H, W)
        The flow that the residual was linearised at.
    rho_c, gradient : ndarray, shapes (H, W) and (2, H, W)
        From `fracbench.model.warping.linearize`, overwritten where there is data: it has set both parts of the
        gradient to 0 elsewhere.
    start, stop : int
        The rows of the image to take.
    """
    for i in range(start, stop):
        for j in range(rho_c.shape[1]):
            if gradient[0, i, j] == 0.0 and gradient[1, i, j] == 0.0:
                continue
            for c in range(2):
                change = 0.5 * (gradient0[c, i, j] - gradient[c, i, j])
                gradient[c, i, j] += change
                rho_c[i, j] -= change * u0[c, i, j]


class ImageAndGradient:
    """The residuals of the image and of its two derivatives; see `fracbench.model.single_level.Residual`.

    Parameters
    ----------
    frame0, frame1 : ndarray, shape (H, W)
        The frames at a scale.
    params : FlowParams
        Whose derivatives, and the factor on them.
    """

    def __init__(self, frame0: Array, frame1: Array, params: FlowParams) -> None:
        derivatives = zip(central_gradient(frame0), central_gradient(frame1), strict=True)
        channel = TwoSided if params.derivatives == "both" else Brightness
        self._channels = [channel(*pair, params) for pair in [(frame0, frame1), *derivatives]]
        shape = len(self._channels), *frame0.shape
        rho_c, gradient = np.empty(shape, frame0.dtype), np.empty((shape[0], 2, *frame0.shape), frame0.dtype)
        self._linear = Linearization(rho_c, gradient)

    def at(self, u0: Array) -> Linearization:
        """Return arrays with the channels first."""
        for k, channel in enumerate(self._channels):
            self._linear.rho_c[k], self._linear.gradient[k] = channel.at(u0)
        return self._linear


class ChannelStep(MultiplierStep):
    """The v-step of several channels with a multiplier: `MultiplierStep` for a data term that is a sum.

    Parameters
    ----------
    like : ndarray, shape (2, H, W)
        A flow of the scale.
    params : FlowParams
        Data attachment weights, tightness, step and relaxation.
    """

    def __init__(self, like: Array, params: FlowParams) -> None:
        super().__init__(like, params)
        self._lambdas = np.array([params.lambda_, params.lambda_gradient, params.lambda_gradient], like.dtype)
        self._duals = np.zeros((len(self._lambdas), *like.shape[1:]), like.dtype)

    def target(self, u: Array, linear: Linearization) -> Array:
        """Return ``w - c``; see `fracbench.model.single_level.VStep`."""
        data = u, *linear, self._lambdas
        settings = self._params.theta, self._params.coupling_step, self._relaxation()
        state = self._duals, self._c, self._target
        share(lambda a, b: coupled_thresholds(*data, *settings, *state, ROUNDS, a, b), u.shape[1])
        return self._target


@jit
def coupled_thresholds(
    u: Array,
    rho_c: Array,
    gradient: Array,
    lambdas: Array,
    theta: float,
    step: float,
    relaxation: float,
    duals: Array,
    c: Array,
    target: Array,
    rounds: int,
    start: int,
    stop: int,
) -> None:
    """Take the v-step for ``F(w) = min_v |w - v|^2 / (2 theta) + sum_k lambda_k |rho_k(v)|``.

    As `kernels.pointwise.coupled_threshold`, but v is found by its duals: ``v = z - (theta + step) sum_k
    p_k grad_k`` with ``|p_k| <= lambda_k``, one after the other the best p_k for the others. For one channel one
    round is the thresholding operator TH.

    Parameters
    ----------
    u : ndarray, shape (2, H, W)
        Flow.
    rho_c, gradient : ndarray, shapes (K, H, W) and (K, 2, H, W)
        The residuals.
    lambdas : ndarray, shape (K,)
        Data attachment weights.
    theta, step, relaxation
        See `fracbench.model.kernels.pointwise.coupled_threshold`.
    duals : ndarray, shape (K, H, W)
        ``p_k``, overwritten by the next.
    c, target : ndarray, shape (2, H, W)
        See `fracbench.model.kernels.pointwise.coupled_threshold`.
    rounds : int
        How often each dual is renewed.
    start, stop : int
        The rows of the image to take.
    """
    part = step / (step + theta)
    tau = theta + step
    width = u.shape[2]
    for i in range(start, stop):
        for j in range(width):
            c1, c2 = c[0, i, j], c[1, i, j]
            z1 = c1 + relaxation * u[0, i, j] + (1.0 - relaxation) * (target[0, i, j] + c1)
            z2 = c2 + relaxation * u[1, i, j] + (1.0 - relaxation) * (target[1, i, j] + c2)
            move1, move2 = 0.0, 0.0
            for k in range(lambdas.size):
                move1 -= tau * duals[k, i, j] * gradient[k, 0, i, j]
                move2 -= tau * duals[k, i, j] * gradient[k, 1, i, j]
            for _ in range(rounds):
                for k in range(lambdas.size):
                    gx, gy, old, new = gradient[k, 0, i, j], gradient[k, 1, i, j], duals[k, i, j], 0.0
                    g2 = gx * gx + gy * gy
                    if g2 >= GRADIENT_IS_ZERO:
                        rho = rho_c[k, i, j] + gx * (z1 + move1) + gy * (z2 + move2)
                        new = min(max(old + rho / (tau * g2), -lambdas[k]), lambdas[k])
                    move1 -= tau * (new - old) * gx
                    move2 -= tau * (new - old) * gy
                    duals[k, i, j] = new
            move1 *= part
            move2 *= part
            c[0, i, j], c[1, i, j] = -move1, -move2
            target[0, i, j] = z1 + 2.0 * move1
            target[1, i, j] = z2 + 2.0 * move2
