"""Oracle bounds: maps of orders chosen by the true flow, which limit the gain of any order that follows the image.

No method may use them. They are computed from the flows of single orders, kept beside the store, and kept
themselves in the folder ``oracles``, one file a sequence, so that nothing is computed twice.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fracbench.data.files import atomic_path, read_flow
from fracbench.errors import FracbenchError
from fracbench.evaluation.metrics import endpoint_error, flow_errors
from fracbench.harness.run.compute_point import point_arrays
from fracbench.harness.run.flows import flow_file, keep_flow
from fracbench.harness.run.point import Point
from fracbench.harness.run.store import canonical_json
from fracbench.model.params import FlowParams
from fracbench.model.structure import CLASSES, structure_classes

#: Scopes of a choice by the truth: all pixels of a class, the neighbourhood of a pixel, the pixel.
SCOPES = ("class", "window", "pixel")

_VERSION = 1

Map = NDArray[np.uint8]


def best_orders(errors: NDArray[np.float64], classes: Map, window: int) -> dict[str, Map]:
    """Choose for each pixel the order with the least end-point error about it.

    Parameters
    ----------
    errors : ndarray, shape (K, H, W)
        End-point errors of K orders, pixels; NaN where the true flow is unknown.
    classes : ndarray of uint8, shape (H, W)
        From `structure_classes`.
    window : int
        Side of a neighbourhood, pixels.

    Returns
    -------
    dict of str to ndarray of uint8, (H, W)
        Indices of orders, by scope: the least mean error over all pixels of the pixel's class in this image, over
        the window about the pixel, at the pixel. Where nothing is known, the order best on the whole image.
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


def oracle_file(points: Sequence[Point], window: int, folder: Path) -> Path:
    """Return where the oracle of a sequence is kept: the name changes with everything that it depends on."""
    content = {"points": [point.key for point in points], "window": window, "version": _VERSION}
    return folder / f"{hashlib.sha256(canonical_json(content).encode()).hexdigest()}.json"


def load_oracle(points: Sequence[Point], window: int, folder: Path) -> dict[str, Any] | None:
    """Return the oracle of a sequence if it has been computed; see `compute_oracle`."""
    path = oracle_file(points, window, folder)
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as exc:
        raise _unreadable(path) from exc
    return found


def _unreadable(path: Path) -> FracbenchError:
    return FracbenchError(f"{path}: cannot be read; delete the folder {path.parent}, and it is computed again")


def load_maps(points: Sequence[Point], window: int, folder: Path) -> Mapping[str, Map]:
    """Return the classes of frame 0 (``classes``) and the orders by scope of an oracle that has been computed."""
    path = oracle_file(points, window, folder).with_suffix(".npz")
    try:
        with np.load(path, allow_pickle=False) as maps:
            return {name: maps[name] for name in ("classes", *SCOPES)}
    except (OSError, ValueError, KeyError, BadZipFile) as exc:
        raise _unreadable(path) from exc


def compute_oracle(points: Sequence[Point], data: Path | None, flows: Path, window: int, folder: Path) -> None:
    """Compute the orders that the truth chooses on one sequence, and their errors.

    Parameters
    ----------
    points : sequence of Point
        The sequence with each single order, whole frames.
    data : Path or None
        Where the Middlebury data are.
    flows, folder : Path
        Where flows by key, and oracles, are kept.
    window : int
        Side of a neighbourhood, pixels.

    Notes
    -----
    The file holds for each scope ``run``, the errors (AAE [rad], AEPE [px]) of the mapped method with that map of
    orders, and ``least``, those of the single flows put together by it; and for each class the number of its
    pixels with known truth, the sum of their end-point errors by order, and how many of them have which best
    order by ``window`` and ``pixel``.
    """
    from threadpoolctl import threadpool_limits

    frame0, frame1, truth, _ = point_arrays(points[0], data)
    classes = structure_classes(frame0)
    with threadpool_limits(1):  # as for every stored number
        single = np.stack([_kept_flow(point, data, flows) for point in points])
        errors = np.stack([endpoint_error(flow, truth) for flow in single])
        maps = best_orders(errors, classes, window)
        params = points[0].params
        alphas = [point.params.alpha for point in points]
        found = {
            scope: {
                "run": _scores(_mapped(frame0, frame1, params, alphas, orders), truth),
                "least": _scores(composed(single, orders), truth),
            }
            for scope, orders in maps.items()
        }
    content = {"alphas": alphas, "scopes": found, "classes": _by_class(errors, classes, maps)}
    path = oracle_file(points, window, folder)
    with atomic_path(path.with_suffix(".npz")) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, classes=classes, **maps)
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _kept_flow(point: Point, data: Path | None, flows: Path) -> NDArray[np.float32]:
    """Return the flow of a point, which is computed now unless it was before."""
    path = flow_file(point, flows)
    keep_flow(point, data, path)
    return read_flow(path)


def _mapped(frame0: Any, frame1: Any, params: FlowParams, alphas: Sequence[float], orders: Map) -> Any:
    from fracbench.methods.alpha_map import flow_with_orders

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
