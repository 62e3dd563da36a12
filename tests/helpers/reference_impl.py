"""Literal, slow reference implementations of every optimised loop, and a texture of exactly known motion.

Written from the paper's formulas with plain Python loops; nothing here imports the package. Arrays are
``[y, x]``, while the paper's pixel ``(i, j)`` has x first. N is the index of the last sample.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter

# -- section 3.2: fractional derivatives ---------------------------------------------------------


def gl_weights(alpha, n):
    """w_0 = 1, w_k = (1 - (alpha + 1) / k) w_{k-1}: the recurrence of section 3.2."""
    w = [1.0]
    for k in range(1, n):
        w.append((1.0 - (alpha + 1.0) / k) * w[-1])
    return w[:n]


def left_derivative(line, alpha, pad=0):
    """D_- u(i) = sum_{k=0}^{i} w_k u(i - k), the first discretisation of section 3.2; u = 0 on the padding."""
    n = len(line)
    w = gl_weights(alpha, n + pad)
    u = [*line, *([0.0] * pad)]
    return [sum(w[k] * u[i - k] for k in range(i + 1)) for i in range(n + pad)]


def right_derivative(line, alpha):
    """D_+ u(i) = sum_{k=0}^{N-i} w_k u(i + k), the second discretisation of section 3.2."""
    n = len(line)
    w = gl_weights(alpha, n)
    return [sum(w[k] * line[i + k] for k in range(n - i)) for i in range(n)]


def composition(line, alpha):
    """D_+ D_- u(i) = sum_{k=i}^{N} w_{k-i} sum_{p=0}^{k} w_p u(k - p), the double sum of section 3.2."""
    n = len(line)
    w = gl_weights(alpha, n)
    return [sum(w[k - i] * sum(w[p] * line[k - p] for p in range(k + 1)) for k in range(i, n)) for i in range(n)]


def reflect_kernel(alpha, period):
    """Inverse DFT of (1 - e^{-iw})^alpha: the Gruenwald-Letnikov weights wrapped around a period."""
    frequency = 2.0 * np.pi * np.arange(period) / period
    kernel = np.fft.ifft((1.0 - np.exp(-1j * frequency)) ** alpha)
    return kernel.real


def derivative_matrices(boundary, alpha, n, pad=0):
    """The derivatives of one line of n samples as dense matrices, one a pair."""
    unit = np.eye(n)
    if boundary == "zero":
        return [np.array([left_derivative(unit[j], alpha, pad) for j in range(n)]).T]
    if boundary == "natural":
        forward = np.zeros((n, n))
        for i in range(n - 1):
            forward[i, i], forward[i, i + 1] = -1.0, 1.0
        return [forward]
    extension = np.concatenate([unit, unit[::-1]])
    kernel = reflect_kernel(alpha, 2 * n)
    circulant = np.array([[kernel[(i - j) % (2 * n)] for j in range(2 * n)] for i in range(n)])
    left = circulant @ extension
    return [left, left[::-1, ::-1]]


def dense_gradient(boundary, alpha, shape, pad=0):
    """The whole gradient as pairs of dense matrices (Dx, Dy) that act on images in raster order."""
    height, width = shape
    rows = derivative_matrices(boundary, alpha, height, pad)
    columns = derivative_matrices(boundary, alpha, width, pad)
    return [
        (np.kron(np.eye(height + pad, height), tx), np.kron(ty, np.eye(width + pad, width)))
        for ty, tx in zip(rows, columns, strict=True)
    ]


def denoising_bounds(pairs, limits, v, theta, iterations=1500):
    """Bracket the minimum of sum_p limit_p |D_p u| + |u - v|^2 / (2 theta) by FISTA on the dense dual.

    max over |p| <= limit of (|v|^2 - |v - theta K^T p|^2) / (2 theta): the value at any feasible p is a
    lower bound, the primal energy at u = v - theta K^T p an upper one. `limits` has one entry a pair, a
    number or one for each pixel.
    """
    k = np.concatenate([m for pair in pairs for m in pair])
    limits = np.stack([np.broadcast_to(limit, len(pairs[0][0])) for limit in limits])[:, None]
    slope = theta * np.linalg.norm(k, 2) ** 2
    v = v.ravel()

    def norms(p):
        return np.linalg.norm(p.reshape(len(pairs), 2, -1), axis=1, keepdims=True)

    p, q, t = np.zeros(len(k)), np.zeros(len(k)), 1.0
    for _ in range(iterations):
        ascended = q + k @ (v - theta * k.T @ q) / slope
        inside = np.minimum(1.0, limits / np.maximum(norms(ascended), 1e-300))
        new = (ascended.reshape(len(pairs), 2, -1) * inside).ravel()
        t_new = (1.0 + math.sqrt(1.0 + 4.0 * t * t)) / 2.0
        p, q, t = new, new + (t - 1.0) / t_new * (new - p), t_new
    u = v - theta * k.T @ p
    lower = (v @ v - u @ u) / (2.0 * theta)
    upper = (limits * norms(k @ u)).sum() + (u - v) @ (u - v) / (2.0 * theta)
    return lower, upper


def infimal_bounds(first, second, limits, v, theta, mu=5.0, iterations=4000):
    """Bracket min over p, q of limit_1 |D_1 p| + limit_2 |D_2 q| + |p + q - v|^2 / (2 theta) by dense ADMM.

    `first` and `second` are the pairs of both parts, `limits` their weights. The dual variables must meet
    K_1^T y_1 = K_2^T y_2 and |y| <= limit: projected and scaled down they do, which gives the lower bound.
    """
    k1, k2 = (np.concatenate([m for pair in pairs for m in pair]) for pairs in (first, second))
    v, n, pairs = v.ravel(), v.size, len(first) + len(second)
    k = np.block([[k1, np.zeros((len(k1), n))], [np.zeros((len(k2), n)), k2]])
    both = np.hstack([np.eye(n), np.eye(n)])
    inverse = np.linalg.pinv(both.T @ both / theta + mu * k.T @ k)
    limit = np.repeat(limits, [len(first), len(second)])[:, None, None]

    def norms(y):
        return np.linalg.norm(y.reshape(pairs, 2, -1), axis=1, keepdims=True)

    d, b = np.zeros(len(k)), np.zeros(len(k))
    for _ in range(iterations):
        x = inverse @ (both.T @ v / theta + mu * k.T @ (d - b))
        z = k @ x + b
        inside = np.minimum(1.0, limit / mu / np.maximum(norms(z), 1e-300))
        b = (z.reshape(pairs, 2, -1) * inside).ravel()
        d = z - b
    upper = (limit * norms(k @ x)).sum() + (both @ x - v) @ (both @ x - v) / (2.0 * theta)
    equal = np.hstack([k1.T, -k2.T])
    y = mu * b
    y -= np.linalg.pinv(equal) @ (equal @ y)
    y /= max(1.0, (norms(y) / limit).max())
    s = k1.T @ y[: len(k1)]
    return s @ v - theta / 2.0 * s @ s, upper


def dense_normal(boundary, alpha, shape, pad=0):
    """weight * sum_pairs (Dx^T Dx + Dy^T Dy), dense; each of two pairs weighs 1/2."""
    pairs = dense_gradient(boundary, alpha, shape, pad)
    return sum(dx.T @ dx + dy.T @ dy for dx, dy in pairs) / len(pairs)


# -- the u-step ----------------------------------------------------------------------------------


def right_hand_side(v, g, alpha, theta, mu):
    """v / theta + mu (D_x+ g_1 + D_y+ g_2) with g = d - b: the right-hand side of equation (elfrac)."""
    height, width = v.shape
    rhs = v / theta
    for y in range(height):
        rhs[y] += mu * np.array(right_derivative(g[0, y], alpha)[:width])
    for x in range(width):
        rhs[:, x] += mu * np.array(right_derivative(g[1, :, x], alpha)[:height])
    return rhs


def _other_terms(line, i, w, last):
    """sum_{p=i}^{N} w_{p-i} sum_{l=0, p-l != i}^{p} w_l u(p - l); u = 0 past the line's end (errata, item 2)."""
    total = 0.0
    for p in range(i, last + 1):
        inner = 0.0
        for l in range(p + 1):  # noqa: E741 - the paper's letter
            if p - l != i and p - l < len(line):
                inner += w[l] * line[p - l]
        total += w[p - i] * inner
    return total


def _algorithm_4_pixel(u, rhs, y, x, alpha, theta, mu, pad, sign):
    height, width = u.shape
    last_x, last_y = width - 1 + pad, height - 1 + pad
    w = gl_weights(alpha, max(last_x, last_y) + 1)
    others = _other_terms(u[y], x, w, last_x) + _other_terms(u[:, x], y, w, last_y)
    squares = sum(w[p - x] ** 2 for p in range(x, last_x + 1)) + sum(w[p - y] ** 2 for p in range(y, last_y + 1))
    return (rhs[y, x] + sign * mu * others) / (1.0 / theta + mu * squares)


def gauss_seidel_alpha(u, rhs, alpha, theta, mu, pad=0):
    """Algorithm 4's update of u in raster order, each pixel used as soon as it is known; signs corrected."""
    u = u.copy()
    for y in range(u.shape[0]):
        for x in range(u.shape[1]):
            u[y, x] = _algorithm_4_pixel(u, rhs, y, x, alpha, theta, mu, pad, sign=-1)
    return u


def jacobi_alpha(u, rhs, alpha, theta, mu, sign):
    """Algorithm 4's update of u from u^k alone; ``sign=+1`` as printed, ``sign=-1`` corrected (errata, item 1)."""
    new = np.empty_like(u)
    for y in range(u.shape[0]):
        for x in range(u.shape[1]):
            new[y, x] = _algorithm_4_pixel(u, rhs, y, x, alpha, theta, mu, 0, sign)
    return new


def gauss_seidel_natural(u, rhs, theta, mu):
    """Algorithm 3's update: (rhs + mu U) / (1/theta + 4 mu), no flux: a ghost equals the pixel it touches."""
    u = u.copy()
    height, width = u.shape
    for y in range(height):
        for x in range(width):
            inside = [
                (r, c)
                for r, c in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1))
                if 0 <= r < height and 0 <= c < width
            ]
            ghosts = 4 - len(inside)
            neighbours = sum(u[r, c] for r, c in inside)
            u[y, x] = (rhs[y, x] + mu * neighbours) / (1.0 / theta + 4.0 * mu - ghosts * mu)
    return u


def u_energy(u, v, g, pairs, theta, mu):
    """|u - v|^2 / (2 theta) + mu/2 |d - D u - b|^2, equation (step1alpha), with g = d - b and one dense pair."""
    (dx, dy), flat = pairs[0], u.ravel()
    penalty = np.sum((g[0].ravel() - dx @ flat) ** 2) + np.sum((g[1].ravel() - dy @ flat) ** 2)
    return np.sum((u - v) ** 2) / (2.0 * theta) + mu / 2.0 * penalty


# -- d-, b- and v-step ---------------------------------------------------------------------------


def shrink(z, gamma):
    """z / |z| max(|z| - gamma, 0), below equation (shrink); shrink(0) = 0."""
    norm = math.sqrt(sum(c * c for c in z))
    return [0.0 if norm == 0.0 else c / norm * max(norm - gamma, 0.0) for c in z]


def shrink_and_update(du, b, gamma, relaxation=1.0, last_d=None):
    """Equation (shrinkalpha), d = shrink(D u + b, 1/mu), then equation (csbalpha), b + D u - d.

    Over-relaxed, ``relaxation D u + (1 - relaxation) d`` stands for D u in both, with the last d.
    """
    if last_d is not None:
        du = relaxation * du + (1.0 - relaxation) * last_d
    d, new_b = np.empty_like(du), np.empty_like(b)
    pairs, _, height, width = du.shape
    for p in range(pairs):
        for y in range(height):
            for x in range(width):
                d[p, :, y, x] = shrink(du[p, :, y, x] + b[p, :, y, x], gamma)
                new_b[p, :, y, x] = b[p, :, y, x] + du[p, :, y, x] - d[p, :, y, x]
    return d, new_b


def threshold(u, rho_c, gradient, lambda_, theta):
    """Equations (iterv) and (thresholding), case by case; the third with |rho| (errata, item 4)."""
    v = np.empty_like(u)
    _, height, width = u.shape
    for y in range(height):
        for x in range(width):
            g = gradient[:, y, x]
            g2 = g[0] ** 2 + g[1] ** 2
            rho = rho_c[y, x] + g[0] * u[0, y, x] + g[1] * u[1, y, x]
            if rho < -lambda_ * theta * g2:
                step = lambda_ * theta * g
            elif rho > lambda_ * theta * g2:
                step = -lambda_ * theta * g
            elif g2 == 0.0:
                step = 0.0 * g
            else:
                step = -rho * g / g2
            v[:, y, x] = u[:, y, x] + step
    return v


def multiplier_step(u, w, c, rho_c, gradient, lambda_, theta, step, relaxation):
    """ADMM on R(u) + F(w) with u = w and F(w) = min_v |w - v|^2 / (2 theta) + lambda |rho(v)|.

    w = argmin F(w) + |w - u - c|^2 / (2 step) is the proximal map of a Moreau envelope; then c + u - w.
    """
    u = relaxation * u + (1.0 - relaxation) * w
    v = threshold(u + c, rho_c, gradient, lambda_, theta + step)
    w = u + c + step / (theta + step) * (v - u - c)
    return w, c + u - w


def mean_squared_change(a, b):
    """1 / (N_x N_y) sum (a_1 - b_1)^2 + (a_2 - b_2)^2: the stopping measure of section 3.4."""
    total = 0.0
    components, height, width = a.shape
    for y in range(height):
        for x in range(width):
            for c in range(components):
                total += (a[c, y, x] - b[c, y, x]) ** 2
    return total / (height * width)


# -- TV-L1's dual step ---------------------------------------------------------------------------


def forward_gradient(u):
    """Forward differences, 0 across the border (Chambolle 2004, section 3)."""
    height, width = u.shape
    g = np.zeros((2, height, width))
    for y in range(height):
        for x in range(width):
            if x < width - 1:
                g[0, y, x] = u[y, x + 1] - u[y, x]
            if y < height - 1:
                g[1, y, x] = u[y + 1, x] - u[y, x]
    return g


def divergence(p):
    """Backward differences, with the three cases of Chambolle 2004 for first, inner and last pixels."""
    _, height, width = p.shape
    div = np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            for field, here, before, last in (
                (p[0], (y, x), (y, x - 1), x == width - 1),
                (p[1], (y, x), (y - 1, x), y == height - 1),
            ):
                first = min(before) < 0
                if first and last:
                    continue
                if first:
                    div[y, x] += field[here]
                elif last:
                    div[y, x] -= field[before]
                else:
                    div[y, x] += field[here] - field[before]
    return div


def dual_step(v, p, theta, tau):
    """u = v + theta div p; p = (p + tau/theta grad u) / (1 + tau/theta |grad u|) (Zach et al. 2007)."""
    u = v + theta * divergence(p)
    g = forward_gradient(u)
    norm = np.sqrt(g[0] ** 2 + g[1] ** 2)
    return u, (p + tau / theta * g) / (1.0 + tau / theta * norm)


# -- images --------------------------------------------------------------------------------------


def keys_kernel(s):
    """Keys' cubic convolution kernel with a = -1/2 (Keys 1981, equation 15)."""
    s = abs(s)
    if s <= 1.0:
        return 1.5 * s**3 - 2.5 * s**2 + 1.0
    if s < 2.0:
        return -0.5 * s**3 + 2.5 * s**2 - 4.0 * s + 2.0
    return 0.0


def keys_sample(image, x, y):
    """Bicubic sample at one point from its 4 x 4 neighbours; borders are repeated (section 3.4)."""
    height, width = image.shape
    left, top = math.floor(x), math.floor(y)
    total = 0.0
    for r in range(top - 1, top + 3):
        for c in range(left - 1, left + 3):
            pixel = image[min(max(r, 0), height - 1), min(max(c, 0), width - 1)]
            total += keys_kernel(y - r) * keys_kernel(x - c) * pixel
    return total


def central_gradient(image):
    """Central differences with Neumann borders (section 3.3): the ghost pixel repeats the border."""
    height, width = image.shape
    g = np.empty((2, height, width))
    for y in range(height):
        for x in range(width):
            g[0, y, x] = (image[y, min(x + 1, width - 1)] - image[y, max(x - 1, 0)]) / 2.0
            g[1, y, x] = (image[min(y + 1, height - 1), x] - image[max(y - 1, 0), x]) / 2.0
    return g


def linearize(frame0, frame1, gradient1, u0):
    """rho(v) = I1(x + u0) + grad I1(x + u0) . (v - u0) - I0 as (constant part, gradient), section 3.3.

    Where the 4 x 4 stencil leaves the image, frame and gradient count as 0.
    """
    height, width = frame0.shape
    rho_c, gradient = np.empty((height, width)), np.empty((2, height, width))
    for i in range(height):
        for j in range(width):
            x, y = j + u0[0, i, j], i + u0[1, i, j]
            rho_c[i, j], gradient[:, i, j] = -frame0[i, j], 0.0
            if not (math.isfinite(x) and math.isfinite(y)):
                continue
            if math.floor(x) - 1 < 0 or math.floor(x) + 2 > width - 1:
                continue
            if math.floor(y) - 1 < 0 or math.floor(y) + 2 > height - 1:
                continue
            g = [keys_sample(gradient1[c], x, y) for c in range(2)]
            gradient[:, i, j] = g
            rho_c[i, j] = keys_sample(frame1, x, y) - g[0] * u0[0, i, j] - g[1] * u0[1, i, j] - frame0[i, j]
    return rho_c, gradient


def resize(image, shape):
    """Pixel (i, j) of the result is the image at (i H / h, j W / w); pixel (0, 0) stays (section 3.4)."""
    height, width = image.shape
    return np.array(
        [
            [keys_sample(image, j * width / shape[1], i * height / shape[0]) for j in range(shape[1])]
            for i in range(shape[0])
        ]
    )


def texture(x, y, seed=0, waves=24, highest=0.4):
    """A sum of plane waves of at most `highest` radians per pixel, at any real coordinates."""
    rng = np.random.default_rng(seed)
    total = np.zeros(np.broadcast(x, y).shape)
    for _ in range(waves):
        wave_number, direction, phase = rng.uniform(0.1, highest), *rng.uniform(0.0, 2.0 * np.pi, 2)
        total += np.cos(wave_number * (np.cos(direction) * x + np.sin(direction) * y) + phase)
    return total


def translated_pair(shape, motion, seed=0):
    """Two frames, both evaluated from the formula: frame0(x) = frame1(x + motion)."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return texture(x, y, seed), texture(x - motion[0], y - motion[1], seed)


def moving_square():
    """Two frames, (48, 56): a square that moves by a pixel before a texture that does not."""
    frame0 = 100.0 + 300.0 * gaussian_filter(np.random.default_rng(3).normal(size=(48, 56)), 2.0)
    frame1 = frame0.copy()
    frame0[12:30, 15:40] += 80.0
    frame1[12:30, 16:41] += 80.0
    return frame0, frame1
