"""The points of grids, made when they are asked for, and their keys, made without the points.

A grid of a million points has a few frames: the choices of its bound axes, which decide on anything but
parameters. Its free axes change parameters alone. What the key of a point hashes is a text, in which only the
parameters differ within a frame.
"""

from __future__ import annotations

import hashlib
import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import accumulate, chain, product
from operator import itemgetter
from typing import Any, overload

from fracbench.harness.run.point import Point, canonical_value
from fracbench.harness.run.store import canonical_json
from fracbench.methods.registry import get_method
from fracbench.model.params import FlowParams, public_name

#: The texts of some parameters, as they stand in what is hashed.
Texts = tuple[str, ...]


@dataclass(frozen=True)
class PlannedPoint:
    """A point and the names it goes by in tables: protocol and region are labels, not part of the key."""

    point: Point
    labels: Mapping[str, str]


@dataclass(frozen=True)
class Axis:
    """An axis of a grid: its length, and if it is free, the checked fields that each row changes, by method."""

    length: int
    changes: Mapping[str, Sequence[Mapping[str, Any]]] | None = None


class Family:
    """Points that differ in some parameters of `FlowParams` only.

    `names` are the public names of these parameters, those that the method uses, sorted. ValueError: no parameter
    is the same for all.
    """

    def __init__(self, point: Point, names: Iterable[str]) -> None:
        self.point = point
        params = point.spec["params"]
        self.names = tuple(sorted(point.canonical.keys() & set(names)))
        same = params.keys() - set(self.names)
        self.first_same = min(same)
        self._younger = {name: canonical_value(value) for name, value in get_method(point.method).younger.items()}
        slots = (
            "%s" if name in self.names else _escaped(self._entry(name, params[name]))
            for name in sorted(same.union(self.names))
        )
        entries = "{" + "".join(slots) + "}"
        spec = {**point.spec, "params": _MARK}
        self.hashed = _with(entries, point.hashed(spec))
        self._hashed_identity = _with(entries, {name: value for name, value in spec.items() if name != "version"})

    def _entry(self, name: str, value: str) -> str:
        """Return the text of a parameter with its comma, which the first one that is the same for all has not."""
        entry = f"{canonical_json(name)}:{canonical_json(value)}"
        if name == self.first_same:
            return entry
        return f"{entry}," if name < self.first_same else f",{entry}"

    def text(self, name: str, value: Any) -> str:
        """Return what stands for a parameter in what is hashed: nothing if the key leaves the value out."""
        canonical = canonical_value(value)
        return "" if self._younger.get(name) == canonical else self._entry(name, canonical)

    def keys(self, texts: Iterable[Texts]) -> Iterator[str]:
        """Yield the keys of points by the texts of `names`."""
        hashed, sha256 = self.hashed, hashlib.sha256
        return (sha256((hashed % each).encode()).hexdigest() for each in texts)

    def identity(self, texts: Texts) -> str:
        """Return the identity of a point; see `Point.identity`."""
        return hashlib.sha256((self._hashed_identity % texts).encode()).hexdigest()


_MARK = "\0params"
_FIELDS = tuple(each.name for each in fields(Point))


def _escaped(text: str) -> str:
    return text.replace("%", "%%")


def _with(entries: str, value: Any) -> str:
    head, tail = canonical_json(value).split(canonical_json(_MARK))
    return f"{_escaped(head)}{entries}{_escaped(tail)}"


def _changed(point: Point, plain: Mapping[str, Any], changes: Mapping[str, Any]) -> Point:
    """Return a point with other values of `FlowParams`, which are not checked: that takes longer than a key.

    `plain` holds the fields of the point.
    """
    params, made = object.__new__(FlowParams), object.__new__(Point)
    vars(params).update(vars(point.params), **changes)
    vars(made).update(plain, params=params)
    return made


class _Frame:
    """The points of one choice of the bound axes: their family, and the texts of each row of the free axes."""

    def __init__(self, family: Family, names: Sequence[str], rows: Sequence[Sequence[Texts]]) -> None:
        self.family, self.rows = family, rows
        places = [names.index(name) for name in family.names]
        self._pick = itemgetter(*places) if places != sorted(places) else None

    def texts(self, rows: Sequence[Sequence[Texts]]) -> Iterator[Texts]:
        """Yield the texts of the points of a product of rows."""
        found = map(tuple, map(chain.from_iterable, product(*rows)))
        return found if self._pick is None else map(self._pick, found)

    def __len__(self) -> int:
        return math.prod(len(set(rows)) for rows in self.rows)


class GridPoints:
    """The points of one grid, in order. `frames` are those of the bound axes, with the first row of the others."""

    def __init__(self, frames: Sequence[PlannedPoint], axes: Sequence[Axis]) -> None:
        self.frames, self._axes = frames, axes
        self._free = [i for i, axis in enumerate(axes) if axis.changes is not None]
        self._made: dict[int, _Frame] = {}
        self._plain: dict[int, dict[str, Any]] = {}
        self._rows: dict[tuple[str, str], list[list[Texts]]] = {}

    def labelled(self, labels: Mapping[str, str]) -> GridPoints:
        """Return the same points with further labels in front."""
        frames = [replace(planned, labels={**labels, **planned.labels}) for planned in self.frames]
        return GridPoints(frames, self._axes)

    def __len__(self) -> int:
        return math.prod(axis.length for axis in self._axes)

    def __iter__(self) -> Iterator[PlannedPoint]:
        if not self._free:
            yield from self.frames
            return
        for index, key in enumerate(self.keys()):
            planned = self[index]
            _keep_key(planned.point, key)
            yield planned

    def __getitem__(self, index: int) -> PlannedPoint:
        number, rows = self._place(index)
        planned = self.frames[number]
        if not self._free:
            return planned
        changes: dict[str, Any] = {}
        for i, row in zip(self._free, rows, strict=True):
            changes |= self._changes(i, planned.point.method)[row]
        if number not in self._plain:
            self._plain[number] = {name: getattr(planned.point, name) for name in _FIELDS}
        return PlannedPoint(_changed(planned.point, self._plain[number], changes), planned.labels)

    def _changes(self, axis: int, method: str) -> Sequence[Mapping[str, Any]]:
        changes = self._axes[axis].changes
        assert changes is not None
        return changes[method]

    def _place(self, index: int) -> tuple[int, list[int]]:
        """Return the number of a point's frame, and its row on each free axis."""
        number, size, rows = 0, 1, []
        for axis in reversed(self._axes):
            index, row = divmod(index, axis.length)
            if axis.changes is None:
                number += size * row
                size *= axis.length
            else:
                rows.append(row)
        return number, rows[::-1]

    def frame_of(self, index: int) -> int:
        """Return the number of a point's frame."""
        return self._place(index)[0]

    def _frame(self, number: int) -> _Frame:
        if number not in self._made:
            method = self.frames[number].point.method
            fields_of = [dict.fromkeys(chain.from_iterable(self._changes(i, method))) for i in self._free]
            family = Family(self.frames[number].point, map(public_name, chain.from_iterable(fields_of)))
            used = [[name for name in found if public_name(name) in family.names] for found in fields_of]
            kind = method, family.first_same  # frames of one kind share the texts
            if kind not in self._rows:
                self._rows[kind] = [
                    [tuple(family.text(public_name(name), row[name]) for name in names) for row in changes]
                    for names, changes in zip(used, (self._changes(i, method) for i in self._free), strict=True)
                ]
            names = [public_name(name) for name in chain.from_iterable(used)]
            self._made[number] = _Frame(family, names, self._rows[kind])
        return self._made[number]

    def keys(self) -> Iterator[str]:
        """Yield the key of each point, in order."""
        if not self._free:
            yield from (planned.point.key for planned in self.frames)
            return
        inner = len(self._axes)
        while inner and self._axes[inner - 1].changes is not None:
            inner -= 1
        step = math.prod(axis.length for axis in self._axes[inner:])
        for start in range(0, len(self), step):
            number, rows = self._place(start)
            frame = self._frame(number)
            texts = [
                [all_rows[row]] if i < inner else all_rows
                for i, row, all_rows in zip(self._free, rows, frame.rows, strict=True)
            ]
            yield from frame.family.keys(frame.texts(texts))

    def groups(self) -> Iterator[tuple[Point, int, Iterator[str]]]:
        """Yield a point of each distinct frame, how many distinct points the frame has, and their keys."""
        seen = set()
        for number, planned in enumerate(self.frames):
            if not self._free:
                mark, count, keys = planned.point.key, 1, iter([planned.point.key])
            else:
                frame = self._frame(number)
                mark, count = frame.family.hashed, len(frame)
                keys = frame.family.keys(frame.texts(frame.rows))
            if mark not in seen:
                seen.add(mark)
                yield planned.point, count, keys

    def identity(self, index: int) -> str:
        """Return the identity of a point."""
        number, rows = self._place(index)
        if not self._free:
            return self.frames[number].point.identity
        frame = self._frame(number)
        (texts,) = frame.texts([[all_rows[row]] for row, all_rows in zip(rows, frame.rows, strict=True)])
        return frame.family.identity(texts)

    def values(self, name: str) -> set[str]:
        """Return the canonical values that a parameter has, of the methods that use it."""
        found = set()
        for point in {planned.point.method: planned.point for planned in self.frames}.values():
            rows = [row for i in self._free for row in self._changes(i, point.method)]
            if name in point.canonical:
                pairs = chain.from_iterable(row.items() for row in rows)
                found |= {canonical_value(value) for field, value in pairs if public_name(field) == name}
        points = (planned.point for planned in self.frames)
        return found or {point.canonical[name] for point in points if name in point.canonical}


class PlannedPoints(Sequence[PlannedPoint]):
    """The points of grids, one grid after another; a part may be a list of points as well."""

    def __init__(self, *parts: GridPoints | Sequence[PlannedPoint]) -> None:
        self._grids = tuple(chain.from_iterable(map(_grids_of, parts)))
        self._starts = [0, *accumulate(map(len, self._grids))]
        self.frames = tuple(chain.from_iterable(grid.frames for grid in self._grids))
        self._first_frames = [0, *accumulate(len(grid.frames) for grid in self._grids)]

    def labelled(self, labels: Mapping[str, str]) -> PlannedPoints:
        """Return the same points with further labels in front."""
        return PlannedPoints(*(grid.labelled(labels) for grid in self._grids))

    def __len__(self) -> int:
        return self._starts[-1]

    def __iter__(self) -> Iterator[PlannedPoint]:
        return chain.from_iterable(self._grids)

    @overload
    def __getitem__(self, index: int) -> PlannedPoint: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[PlannedPoint]: ...

    def __getitem__(self, index: int | slice) -> PlannedPoint | Sequence[PlannedPoint]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        number, place = self._place(range(len(self))[index])
        return self._grids[number][place]

    def _place(self, index: int) -> tuple[int, int]:
        """Return the number of a point's grid, and its index there."""
        number = bisect_right(self._starts, index) - 1
        return number, index - self._starts[number]

    def frame_of(self, index: int) -> int:
        """Return the number of a point's frame."""
        number, place = self._place(index)
        return self._first_frames[number] + self._grids[number].frame_of(place)

    def keys(self) -> Iterator[str]:
        """Yield the key of each point, in order."""
        return chain.from_iterable(grid.keys() for grid in self._grids)

    def groups(self) -> Iterator[tuple[Point, int, Iterable[str]]]:
        """Yield a point for all that cost the same, how many distinct points these are, and their keys."""
        if len(self._grids) == 1:
            yield from self._grids[0].groups()
            return
        seen = set[str]()
        for point, _, keys in chain.from_iterable(grid.groups() for grid in self._grids):
            new = set(keys) - seen
            seen |= new
            if new:
                yield point, len(new), new

    def identity(self, index: int) -> str:
        """Return the identity of a point."""
        number, place = self._place(index)
        return self._grids[number].identity(place)

    def values(self, name: str) -> set[str]:
        """Return the canonical values that a parameter has, of the methods that use it."""
        return set().union(*(grid.values(name) for grid in self._grids))


def _grids_of(part: GridPoints | Sequence[PlannedPoint]) -> Sequence[GridPoints]:
    if isinstance(part, PlannedPoints):
        return part._grids
    if isinstance(part, GridPoints):
        return (part,)
    return (GridPoints(part, [Axis(len(part))]),) if part else ()


def _keep_key(point: Point, key: str) -> None:
    vars(point)["key"] = key  # where `Point.key` would keep it


class UniquePoints(Mapping[str, Point]):
    """Distinct points of a plan by key, in order, made when they are asked for."""

    def __init__(self, points: PlannedPoints, indices: dict[str, int]) -> None:
        self.planned, self._indices = points, indices

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[str]:
        return iter(self._indices)

    def __contains__(self, key: object) -> bool:
        return key in self._indices

    def __getitem__(self, key: str) -> Point:
        point = self.planned[self._indices[key]].point
        _keep_key(point, key)
        return point

    def only(self, keys: Iterable[str]) -> UniquePoints:
        """Return some of the points."""
        return UniquePoints(self.planned, {key: self._indices[key] for key in keys})

    def frame_of(self, key: str) -> int:
        """Return the number of a point's frame."""
        return self.planned.frame_of(self._indices[key])

    def identity(self, key: str) -> str:
        """Return the identity of a point."""
        return self.planned.identity(self._indices[key])
