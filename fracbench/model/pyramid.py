"""The coarse-to-fine pyramid (Algorithm 1): sizes, images, and the flow carried to the next finer scale."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from fracbench.model.kernels.arrays import Array, aligned
from fracbench.model.kernels.jit import jit
from fracbench.model.kernels.threads import parallel_map
from fracbench.model.params import FlowParams
from fracbench.model.resampling import resample
from fracbench.model.warping import resize

#: sigma_0 of section 3.4: standard deviation of the blur at unit scale, from which sigma(eta) follows.
SIGMA_ZERO = 0.6
#: A scale is worth computing while the image's diagonal is at least this long, pixels (IPOL's rule)...
MIN_DIAGONAL = 16
#: ...and each side holds the bicubic stencil.
MIN_SIDE = 4
#: Contrast of the noise, gray levels: `normalise` does not raise it to full size where nothing else is seen.
NOISE = 10.0
#: Gaussian kernels end here, in standard deviations.
TRUNCATE = 5.0


def scale_shapes(shape: tuple[int, int], eta: float, n_scales: int | None) -> list[tuple[int, int]]:
    """Return the image sizes ``(H, W)`` from finest to coarsest.

    There are at most `n_scales`, or as many as the image allows (None), but at least one. `eta`, in (0, 1), is the
    downsampling factor.
    """
    allowed = 1 + max(0, math.floor(math.log(math.hypot(*shape) / MIN_DIAGONAL) / math.log(1.0 / eta)))
    wanted = allowed if n_scales is None else min(n_scales, allowed)
    shapes = [shape]
    while len(shapes) < wanted:
        height, width = (int(n * eta + 0.5) for n in shapes[-1])
        if min(height, width) < MIN_SIDE or (height, width) == shapes[-1]:
            break
        shapes.append((height, width))
    return shapes


def stretch(frame0: Array, frame1: Array, dtype: np.dtype, intensity: str = "joint") -> tuple[Array, Array]:
    """Return copies of both frames (H, W), stretched together to 0..255 (Algorithm 1); equal constants stay.

    Other values of `intensity`: ``each`` stretches each frame by itself, ``unit`` both to 0..1, ``given`` none.
    """
    pairs = ((frame0, frame0), (frame1, frame1)) if intensity == "each" else ((frame0, frame1),) * 2
    scalings = [scaling(*pair, intensity) for pair in pairs]
    first, second = (
        ((frame.astype(np.float64) - offset) * gain).astype(dtype)
        for frame, (offset, gain) in zip((frame0, frame1), scalings, strict=True)
    )
    return first, second


def scaling(frame0: Array, frame1: Array, intensity: str = "joint") -> tuple[float, float]:
    """Return the offset that `stretch` subtracts from both frames, and its gain."""
    if intensity == "given":
        return 0.0, 1.0
    brightest = 1.0 if intensity == "unit" else 255.0
    low = min(float(frame0.min()), float(frame1.min()))
    high = max(float(frame0.max()), float(frame1.max()))
    return (low, brightest / (high - low)) if high > low else (0.0, 1.0)


def normalise(frame0: Array, frame1: Array, sigma: float, dtype: np.dtype) -> tuple[Array, Array]:
    """Return both frames (H, W) without their local mean, over their local contrast, stretched together.

    ``(I - m) / sqrt(s^2 + NOISE^2)``, m and s^2 the mean and the variance of I, in gray levels of 0..255, under a
    Gaussian of standard deviation `sigma` pixels. A light whose strength changes slowly over the image, and from
    frame to frame, drops out.
    """
    first, second = stretch(frame0, frame1, dtype)
    for frame in (first, second):
        frame -= smooth(frame, sigma)
        frame /= np.sqrt(smooth(frame * frame, sigma) + dtype.type(NOISE**2))
    return stretch(first, second, dtype)


def smooth(image: Array, sigma: float) -> Array:
    """Return an image (H, W) convolved with a Gaussian of standard deviation `sigma` pixels, borders mirrored.

    The result has the precision of `image`; with ``sigma = 0`` it is `image` itself.
    """
    if sigma == 0.0:
        return image
    x = np.arange(int(TRUNCATE * sigma + 0.5) + 1)
    half = np.exp(-0.5 * (x / sigma) ** 2)
    half /= half[0] + 2.0 * half[1:].sum()
    out = np.empty_like(image)
    _smooth(image, half.astype(image.dtype), out)
    return out


@jit
def _mirrored(k: int, n: int) -> int:
    """Return the index of the sample at position `k` of the periodic mirror extension of `n` samples."""
    k %= 2 * n
    return k if k < n else 2 * n - 1 - k


@jit
def _smooth(image: Array, half: Array, out: Array) -> None:
    """Convolve columns and rows with the symmetric kernel whose right half is `half`.

    SciPy's filter computes line by line in float64 and takes ten times as long.
    """
    height, width = image.shape
    radius = half.size - 1
    line = np.empty(width + 2 * radius, image.dtype)
    for i in range(height):
        inner, smoothed = line[radius:][:width], out[i]
        for j in range(width):
            inner[j] = half[0] * image[i, j]
        for k in range(1, radius + 1):
            above, below = image[_mirrored(i - k, height)], image[_mirrored(i + k, height)]
            for j in range(width):
                inner[j] += half[k] * (above[j] + below[j])
        for k in range(radius):
            line[radius - 1 - k] = inner[_mirrored(-1 - k, width)]
            line[radius + width + k] = inner[_mirrored(width + k, width)]
        for j in range(width):
            smoothed[j] = half[0] * inner[j]
        for k in range(1, radius + 1):
            left, right = line[radius - k :], line[radius + k :]
            for j in range(width):
                smoothed[j] += half[k] * (left[j] + right[j])


def scales(frame: Array, shapes: list[tuple[int, int]], params: FlowParams) -> list[Array]:
    """Return the pyramid of a stretched frame, smoothed before or after it is built (`smoothing_at`)."""
    sigma, eta, way = params.presmoothing, params.eta, params.downsampling
    if params.smoothing_at == "scales":
        return [smooth(level, sigma) for level in build(frame, shapes, eta, way)]
    return build(smooth(frame, sigma), shapes, eta, way)


def build(image: Array, shapes: list[tuple[int, int]], eta: float, way: str = "gaussian") -> list[Array]:
    """Return the pyramid of an image from finest to coarsest, with the sizes `shapes` (`scale_shapes`).

    Each scale is the one before it, smoothed by ``sigma(eta) = sigma_0 sqrt(eta^-2 - 1)`` and resampled. The other
    ways are those of the switch `downsampling`.
    """
    sigma = SIGMA_ZERO * math.sqrt(eta**-2 - 1.0) if way.startswith("gaussian") else 0.0
    levels = [image]
    for shape in shapes[1:]:
        smoothed = smooth(levels[-1], sigma)
        by_weights = {"area": "area", "imresize": "imresize", "gaussian_imresize": "imresize"}.get(way)
        levels.append(resample(smoothed, shape, by_weights) if by_weights else resize(smoothed, shape))
    return levels


def downsample_flow(flow: Array, shapes: list[tuple[int, int]], eta: float) -> Array:
    """Return a flow (2, H, W) of the frames as the flow of the coarsest of the sizes `shapes`, in its pixels.

    It goes down the scales as the images do (`build`); the components are multiplied by the ratios of the sizes.
    """
    (height, width), (h, w) = shapes[0], shapes[-1]
    coarse = np.stack([build(np.ascontiguousarray(component), shapes, eta)[-1] for component in flow])
    coarse *= np.array([[[w / width]], [[h / height]]], flow.dtype)
    return coarse


def upsample_flow(flow: Array, shape: tuple[int, int], gain: float | None = None, way: str = "bicubic") -> Array:
    """Return a flow (2, h, w), in pixels of its scale, as the flow (2, H, W) of a finer scale of size `shape`.

    It is sampled bicubically, or in another `way` of `resampling.resample`, and both components are multiplied by
    `gain`: by default the ratios of the sizes, ``W/w`` and ``H/h`` (errata, item 6).
    """
    ratios = (shape[1] / flow.shape[2], shape[0] / flow.shape[1]) if gain is None else (gain, gain)
    fine = aligned((2, *shape), flow.dtype)
    sampled = resize if way == "bicubic" else partial(resample, kind=way)
    parallel_map(lambda c: np.multiply(sampled(flow[c], shape), flow.dtype.type(ratios[c]), out=fine[c]), range(2))
    return fine
