"""Oracle bounds: maps of orders chosen by the true flow, which limit the gain of any order that follows the image.

No method may use them.
"""

from __future__ import annotations

import zlib
from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import FracbenchError
from fracbench.evaluation.metrics import endpoint_error, flow_errors
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.point import Point
from fracbench.methods.alpha_map import flow_with_orders
from fracbench.methods.registry import get_method
from fracbench.model.params import FlowParams
from fracbench.model.structure import CLASSES, structure_classes

#: Scopes of a choice by the truth: all pixels of a class, the neighbourhood of a pixel, the pixel.
SCOPES = ("class", "window", "pixel")

Map = NDArray[np.uint8]


def best_orders(errors: NDArray[np.float64], classes: Map, window: int) -> dict[str, Map]:
    """Choose for each pixel the order with the least end-point error about it; return indices of orders by scope.

    `errors` (K, H, W) are of K orders, NaN where the true flow is unknown. Scopes: the least mean error over all
    pixels of the class in this image, over the window about the pixel, at the pixel. Where nothing is known, the
    order is that best on the whole image.
    """
    from scipy.ndimage import uniform_filter

    known = ~np.isnan(errors[0])
    filled = np.where(known, errors, 0.0)
    usual = filled.sum(axis=(1, 2)).argmin()
    about = np.stack([uniform_filter(plane, window, mode="constant") for plane in filled])
    seen = uniform_filter(known.astype(np.float64), window, mode="constant") > 0.5 / window**2
    by_class = [filled[:, classes == k].sum(axis=1).argmin() for k in range(len(CLASSES))]
    found = {
        "class": np.asarray(by_class)[classes],
        "window": np.where(seen, about.argmin(axis=0), usual),
        "pixel": np.where(known, filled.argmin(axis=0), usual),
    }
    return {scope: orders.astype(np.uint8) for scope, orders in found.items()}


def composed(flows: NDArray[Any], orders: Map) -> NDArray[Any]:
    """Return the flow that is at each pixel that of its order: ``(2, H, W)`` out of ``(K, 2, H, W)``."""
    return np.asarray(np.take_along_axis(flows, orders[None, None].astype(np.intp), axis=0)[0])


def bounds(point: Point, folder: Path | None) -> dict[str, Any]:
    """Compute the orders that the truth chooses on one sequence, whole frames, and their errors.

    The point's options are `alphas`, the single orders, and `window`, the side of a neighbourhood in pixels. The
    result holds for each scope ``run``, the errors (AAE [rad], AEPE [px]) of the mapped method with that map of
    orders, and ``least``, those of the single flows put together by it; for each class the number of its pixels
    with known truth, the sum of their end-point errors by order, and how many of them have which best order by
    ``window`` and ``pixel``; and these two maps, packed.
    """
    options = dict(point.options)
    alphas, params = options["alphas"], point.params
    frame0, frame1, truth, _ = point_arrays(point, folder)
    classes = structure_classes(frame0)
    estimate = get_method(point.method).estimate
    single = np.stack([estimate(frame0, frame1, params.replace({"alpha": alpha})).flow for alpha in alphas])
    if not np.isfinite(single).all():
        raise FracbenchError("no bounds: a flow of a single order is not finite")
    errors = np.stack([endpoint_error(flow, truth) for flow in single])
    maps = best_orders(errors, classes, options["window"])
    scopes = {
        scope: {
            "run": _scores(_mapped(frame0, frame1, params, alphas, orders), truth),
            "least": _scores(composed(single, orders), truth),
        }
        for scope, orders in maps.items()
    }
    packed = {scope: pack(maps[scope]) for scope in ("window", "pixel")}
    return {"alphas": alphas, "scopes": scopes, "classes": _by_class(errors, classes, maps), "maps": packed}


def pack(orders: Map) -> str:
    """Return a map as compressed text, which a row can hold."""
    return b64encode(zlib.compress(orders.tobytes(), 9)).decode()


def unpack(text: str, shape: tuple[int, ...]) -> Map:
    """Return the map that `pack` made text of."""
    return np.frombuffer(zlib.decompress(b64decode(text)), np.uint8).reshape(shape)


def _mapped(frame0: Any, frame1: Any, params: FlowParams, alphas: Sequence[float], orders: Map) -> Any:
    used = np.unique(orders)  # an order that no pixel has would cost its share of the time
    weights = np.equal.outer(used, orders).astype(params.dtype)
    return flow_with_orders(frame0, frame1, params, [alphas[k] for k in used], weights).flow


def _scores(flow: Any, truth: Any) -> dict[str, float]:
    found = flow_errors(flow, truth)
    return {"aae": found.aae, "aepe": found.aepe}


def _by_class(errors: NDArray[np.float64], classes: Map, maps: Mapping[str, Map]) -> dict[str, Any]:
    known = ~np.isnan(errors[0])
    found = {}
    for index, name in enumerate(CLASSES):
        mask = known & (classes == index)
        counts = {
            scope: np.bincount(maps[scope][mask], minlength=len(errors)).tolist() for scope in ("window", "pixel")
        }
        found[name] = {"pixels": int(mask.sum()), "sums": errors[:, mask].sum(axis=1).tolist(), **counts}
    return found
