"""Pointwise steps: thresholding TH (v-step), shrinkage (d- and b-step), and the u-step in its basis."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from fracbench.model.kernels.arrays import Array
from fracbench.model.kernels.jit import jit

#: Below this squared image gradient (gray levels per pixel, squared) there is no data term: TH is 0.
GRADIENT_IS_ZERO = 1e-10


@jit
def threshold(u: Array, rho_c: Array, gradient: Array, lambda_theta: float, v: Array) -> None:
    """Write ``v = u + TH(u, u0)``, equations (iterv) and (thresholding), for a flow `u`, (2, H, W).

    For each pixel `v` minimises ``|u - v|^2 / (2 theta) + lambda |rho(v)|`` with
    ``rho(v) = rho_c + gradient . v`` and ``rho_c = I1w - grad I1w . u0 - I0``. The third case of TH is read as
    ``|rho| <= ...`` (errata, item 4).
    """
    _, height, width = u.shape
    real = u.dtype.type  # or all would be computed in float64
    longest, zero, flat = real(lambda_theta), real(0.0), real(GRADIENT_IS_ZERO)
    for i in range(height):
        for j in range(width):
            gx, gy = gradient[0, i, j], gradient[1, i, j]
            u1, u2 = u[0, i, j], u[1, i, j]
            g2 = gx * gx + gy * gy
            rho = rho_c[i, j] + gx * u1 + gy * u2
            bound = longest * g2
            if rho < -bound:
                step = longest
            elif rho > bound:
                step = -longest
            elif g2 < flat:
                step = zero
            else:
                step = -rho / g2
            v[0, i, j] = u1 + step * gx
            v[1, i, j] = u2 + step * gy


@jit
def coupled_threshold(
    u: Array, rho_c: Array, gradient: Array, lambda_: float, theta: float, step: float, relaxation: float,
    c: Array, target: Array, start: int, stop: int,
) -> None:  # fmt: skip
    """Take the v-step with a multiplier `c` on the constraint that the data term and R see one flow (ADMM).

    The data term ``F(w) = min_v |w - v|^2 / (2 theta) + lambda |rho(v)|`` is given a flow ``w`` of its own.
    With ``z = u + c``: ``v = z + TH(z)`` for the tightness ``theta + step``, ``w = z + step / (step + theta)
    (v - z)``, ``c <- z - w``; the u-step then regularises ``target = w - c`` with the tightness `step`. The
    minimiser is that of E(u, v); the paper's alternation is ``c = 0``, ``w = v``, ``step = theta``. In place of u
    the step takes ``relaxation u + (1 - relaxation) w``, with the last w. The rows ``start..stop-1`` of `c` and
    `target` are overwritten.
    """
    real = u.dtype.type  # or all would be computed in float64
    share, longest = real(step / (step + theta)), real(lambda_ * (theta + step))
    new, old = real(relaxation), real(1.0 - relaxation)
    zero, two, flat = real(0.0), real(2.0), real(GRADIENT_IS_ZERO)
    width = u.shape[2]
    for i in range(start, stop):
        for j in range(width):
            gx, gy = gradient[0, i, j], gradient[1, i, j]
            c1, c2 = c[0, i, j], c[1, i, j]
            z1 = c1 + new * u[0, i, j] + old * (target[0, i, j] + c1)
            z2 = c2 + new * u[1, i, j] + old * (target[1, i, j] + c2)
            g2 = gx * gx + gy * gy
            rho = rho_c[i, j] + gx * z1 + gy * z2
            bound = longest * g2
            if rho < -bound:
                move = longest
            elif rho > bound:
                move = -longest
            elif g2 < flat:
                move = zero
            else:
                move = -rho / g2
            move *= share  # w - z, which is also -c
            c[0, i, j] = -move * gx
            c[1, i, j] = -move * gy
            target[0, i, j] = z1 + two * move * gx
            target[1, i, j] = z2 + two * move * gy


def weight_at(weights: Any, pair: int, pairs: int, i: int, j: int) -> Any:
    """Return the weight of a pair of derivatives at a pixel: one for all, or `weights` of shape (K, h, w).

    Each plane serves ``pairs / K`` consecutive pairs.
    """
    return weights[pair * len(weights) // pairs, i, j] if isinstance(weights, np.ndarray) else weights


@overload(weight_at, strict=False)
def _compile_weight_at(weights: Any, pair: Any, pairs: Any, i: Any, j: Any) -> Any:
    if isinstance(weights, types.Array):
        return lambda weights, pair, pairs, i, j: weights[pair * len(weights) // pairs, i, j]
    return lambda weights, pair, pairs, i, j: weights


@jit
def shrink_difference(z: Array, threshold: Any, w: Array, start: int, stop: int) -> None:
    """Write ``d - b``, the input of the u-step: ``d = shrink(z, threshold)``, ``b = z - d`` and ``z = D u + b``.

    The shrinkage is isotropic: each (x, y) pair by its euclidean norm, shrink(0) = 0; equation (shrinkalpha).
    b, equation (csbalpha), is the projection of z on the ball of radius `threshold`, which is ``1 / mu`` or an
    array of them (`weight_at`). Arrays are (pairs, 2, h, w); the rows ``start..stop-1`` are taken.
    """
    pairs, _, _, width = z.shape
    real = z.dtype.type  # or all would be computed in float64
    one, two = real(1.0), real(2.0)
    for p in range(pairs):
        for i in range(start, stop):
            for j in range(width):
                zx, zy = z[p, 0, i, j], z[p, 1, i, j]
                norm = np.sqrt(zx * zx + zy * zy)
                limit = real(weight_at(threshold, p, pairs, i, j))
                kept = one if norm <= limit else limit / norm
                w[p, 0, i, j] = (one - two * kept) * zx
                w[p, 1, i, j] = (one - two * kept) * zy


@jit
def bregman_update(du: Array, threshold: Any, relaxation: float, z: Array, start: int, stop: int) -> None:
    """Update ``z <- D u + b``, the state of split Bregman: d and b follow from it (`shrink_difference`).

    In place of D u the update takes ``relaxation D u + (1 - relaxation) d``, with the last d. A state of 0 means
    that d = b = 0.
    """
    pairs, _, _, width = z.shape
    real = z.dtype.type  # or all would be computed in float64
    one, new, old = real(1.0), real(relaxation), real(1.0 - relaxation)
    for p in range(pairs):
        for i in range(start, stop):
            for j in range(width):
                zx, zy = z[p, 0, i, j], z[p, 1, i, j]
                norm = np.sqrt(zx * zx + zy * zy)
                limit = real(weight_at(threshold, p, pairs, i, j))
                kept = one if norm <= limit else limit / norm
                share = kept + old * (one - kept)  # b is kept z and d the rest of z
                z[p, 0, i, j] = new * du[p, 0, i, j] + share * zx
                z[p, 1, i, j] = new * du[p, 1, i, j] + share * zy


@jit
def shrink_each(z: Array, threshold: Any, w: Array, start: int, stop: int) -> None:
    """Write ``d - b`` as `shrink_difference` does, with each derivative shrunk by itself (anisotropic)."""
    pairs, _, _, width = z.shape
    for p in range(pairs):
        for c in range(2):
            for i in range(start, stop):
                for j in range(width):
                    limit = z.dtype.type(weight_at(threshold, p, pairs, i, j))
                    w[p, c, i, j] = z[p, c, i, j] - (min(max(z[p, c, i, j], -limit), limit) * z.dtype.type(2.0))


@jit
def update_each(du: Array, threshold: Any, relaxation: float, z: Array, start: int, stop: int) -> None:
    """Update ``z <- D u + b`` as `bregman_update` does, with each derivative shrunk by itself (anisotropic)."""
    pairs, _, _, width = z.shape
    real = z.dtype.type
    new, old = real(relaxation), real(1.0 - relaxation)
    for p in range(pairs):
        for c in range(2):
            for i in range(start, stop):
                for j in range(width):
                    limit = real(weight_at(threshold, p, pairs, i, j))
                    b = min(max(z[p, c, i, j], -limit), limit)
                    z[p, c, i, j] = new * du[p, c, i, j] + old * (z[p, c, i, j] - b) + b


@jit
def divide_by_sum(x: Array, along_y: Array, along_x: Array) -> None:
    """Replace `x` by ``x / (along_y(i) + along_x(j))``: the u-step in the basis of the gradient."""
    ys, xs = along_y.astype(x.dtype), along_x.astype(x.dtype)  # or all would be computed in float64
    for i in range(len(x)):
        for j in range(x.shape[1]):
            x[i, j] /= ys[i] + xs[j]


@jit
def add_and_divide(x: Array, y: Array, along_y: Array, along_x: Array, start: int, stop: int) -> None:
    """Write ``(x + y) / (along_y(i) + along_x(j))`` to `x`, rows ``start..stop-1``; see `divide_by_sum`."""
    ys, xs = along_y.astype(x.dtype), along_x.astype(x.dtype)  # or all would be computed in float64
    for i in range(start, stop):
        for j in range(x.shape[1]):
            x[i, j] = (x[i, j] + y[i, j]) / (ys[i] + xs[j])


@jit
def mean_squared_change(a: Array, b: Array) -> float:
    """Return the mean over pixels of ``|a - b|^2``, summed over components, in float64 (section 3.4)."""
    total, zero = np.float64(0.0), a.dtype.type(0.0)
    components, height, width = a.shape
    for c in range(components):
        for i in range(height):
            row = zero  # a row's sum in the precision of the flow, which is enough for it
            for j in range(width):
                change = a[c, i, j] - b[c, i, j]
                row += change * change
            total += row
    return total / (height * width)
