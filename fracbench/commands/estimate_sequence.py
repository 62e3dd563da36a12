"""Flows of a clip, from each frame to the next: in several processes, resumable, drawn on one colour scale."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from fracbench.commands import console
from fracbench.commands.field_output import SequenceFields
from fracbench.commands.warmup import compile_for
from fracbench.data import clip as files
from fracbench.data.manifest import Entry, Manifest, add_entry, file_digest
from fracbench.errors import FracbenchError, InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fracbench.methods.method import Method

SHEET, VIDEO, FRAMES = "contact_sheet.png", "flow.mp4", "frames"
#: Full colour is for a speed that this share of the pixels keeps below, in this share of the flows: some wild
#: pixels, or a cut between two scenes, shall not make the whole clip pale. Of up to ten flows it is the fastest.
_PIXELS, _FLOWS = 0.999, 0.9
_TRIAL = 32  # pixels a side
_KEPT = "the flows that are finished are kept"


class Frame(NamedTuple):
    """A picture of the clip: its file's digest, its height and width, or the reason why it cannot be used."""

    path: Path
    digest: str = ""
    shape: tuple[int, ...] = ()
    error: str = ""


class Settings(NamedTuple):
    """Arguments of `estimate_flow`, the method and parameters that they stand for, the digest of both, a name."""

    given: dict[str, Any]
    method: Method
    params: Any
    digest: str
    name: str


class Mask(NamedTuple):
    """Pixels that do not count, (H, W) bool, and the digest of their file."""

    pixels: NDArray[Any]
    digest: str


class Outcome(NamedTuple):
    """The entry of a flow in the manifest, or the reason why there is none."""

    entry: Entry | None
    error: str = ""
    notices: Sequence[str] = ()


def estimate_sequence(
    words: Sequence[str],
    output: Path,
    *,
    overrides: Sequence[str] = (),
    method: str | None = None,
    jobs: int = 2,
    max_motion: float | None = None,
    paired: bool = False,
    mask: Path | None = None,
    fields: SequenceFields = SequenceFields(),  # noqa: B008 - a tuple
) -> bool:
    """Compute and draw the flows of a clip into a folder; return whether none is missing.

    `words` name pictures, folders, globs or one video; `max_motion` is the speed of the full colours in pixels.
    There is a flow from each frame to the next, or if the frames are `paired`, from each first one to its second.
    """
    from fracbench.commands.run import require_workers

    require_workers(jobs)
    if max_motion is not None and not 0.0 < max_motion < float("inf"):
        raise InputError(f"--max-motion must be a positive number of pixels, got {max_motion:g}")
    fields.require()
    settings = _settings(overrides, method)
    paths, rate, fault = files.find_frames(words), files.RATE, ""
    manifest = Manifest(output)
    _require_apart(words, paths, manifest, fields)
    if paths[0].suffix.lower() in files.VIDEOS:
        paths, rate, fault = _frames_of(paths[0], manifest)
    elif len(paths) < 2:
        raise InputError(f"{paths[0]}: a clip has two or more frames, got one")
    if paired and len(paths) % 2:
        raise InputError(f"--pairs takes an even number of frames, got {len(paths)}; the last is {paths[-1]}")
    frames = _look(paths, jobs)
    neighbours = [*itertools.pairwise(frames)][:: 2 if paired else 1]
    pairs = [(a, b) for a, b in neighbours if not a.error and not b.error]
    errors = [frame.error for frame in frames if frame.error]
    if not pairs:
        raise InputError(f"no two frames in a row can be used: {errors[0]}")
    hidden = None if mask is None else _mask(mask, pairs[0][0].shape)
    if fields.suffixes:
        fields.units.step(pairs[0][0].shape)
    names = _compute(pairs, settings, manifest, jobs, [fault, *errors] if fault else errors, hidden)
    if names:
        title = "Flow of each pair" if paired else "Flow from each frame to the next"
        scale = _draw(frames, names, manifest, jobs, max_motion, rate, title)
        _write_fields(names, manifest, jobs, fields, hidden, scale, settings)
    missing = len(neighbours) - len(names)
    if missing:
        console.complain(f"missing flows: {missing} of {len(neighbours)}; the same command tries them again")
    return not missing and not fault


# -- before anything is computed -----------------------------------------------------------------


def _settings(overrides: Sequence[str], method: str | None) -> Settings:
    from fracbench.commands.estimate import read_settings
    from fracbench.model import SOLVER_VERSION

    given, chosen, params, name = read_settings("estimate-sequence", overrides, method)
    known = json.dumps([SOLVER_VERSION, chosen.name, chosen.stamp, chosen.values(params)])
    digest = hashlib.sha256(known.encode()).hexdigest()
    return Settings(given, chosen, params, digest, name)


def _mask(path: Path, size: tuple[int, ...]) -> Mask:
    from fracbench.commands.estimate import not_black, of_size
    from fracbench.data.files import read_image

    return Mask(of_size(size, path, "mask", not_black(read_image(path))), file_digest(path))


def _require_apart(
    words: Sequence[str], paths: Sequence[Path], manifest: Manifest, fields: SequenceFields
) -> None:
    """Refuse an output folder where flows would meet frames, each other, or files that somebody else wrote."""
    folder = manifest.folder
    stems: dict[str, Path] = {}
    for path in paths:
        if Path(os.path.realpath(path)).parent == Path(os.path.realpath(folder)):
            raise InputError(f"{path}: this file lies in the output folder {str(folder)!r}; choose another")
        if path.stem in stems:
            raise InputError(f"{stems[path.stem]} and {path}: both flows would be {path.stem}.flo; rename one")
        if f"{path.stem}.png" == SHEET:
            raise InputError(f"{path}: its flow would be drawn in {SHEET}, which is the contact sheet; rename it")
        stems[path.stem] = path
    suffixes = (".flo", ".png", *fields.suffixes)
    written = [*(f"{stem}{suffix}" for stem in stems for suffix in suffixes), SHEET, VIDEO]
    for name, count in Counter(written).items():
        if count > 1:
            raise InputError(f"{folder / name}: two frames would write this file; rename one of them")
    for word in words:
        if not os.path.lexists(word) and any(_matches(folder / name, word) for name in written):
            raise InputError(f"{folder}: {word!r} would match the pictures in this output folder too")
    for name in [] if manifest.exists else written:
        if os.path.lexists(folder / name):
            raise InputError(f"{folder / name}: not from an earlier run; choose another output folder")


def _matches(path: Path, pattern: str) -> bool:
    """Return whether a glob matches a path, part by part; ``**`` is any number of parts."""
    parts, patterns = path.absolute().parts, Path(pattern).absolute().parts

    def match(i: int, j: int) -> bool:
        if j == len(patterns):
            return i == len(parts)
        if patterns[j] == "**":
            return any(match(k, j + 1) for k in range(i, len(parts) + 1))
        return i < len(parts) and fnmatchcase(parts[i], patterns[j]) and match(i + 1, j + 1)

    return match(0, 0)


def _frames_of(video: Path, manifest: Manifest) -> tuple[list[Path], float, str]:
    """Return the frames of a video as pictures in the output folder, its rate, and how it is damaged, if it is."""
    from fracbench.data.files import write_image

    made_from = {"video": file_digest(video)}
    folder = manifest.folder / FRAMES

    def paths(count: int) -> Iterable[Path]:
        return (folder / f"{video.stem}_{i:06d}.png" for i in range(count))

    known = Manifest(folder)
    name = f"{video.stem}_000000.png"
    if not known.why(name, made_from, "count", "rate"):
        entry = known.entries[name]
        found = [*itertools.takewhile(Path.is_file, paths(int(entry["count"])))]
        if len(found) == entry["count"] >= 2:
            return found, float(entry["rate"]), str(entry.get("fault", ""))
    if not known.exists and os.path.lexists(folder / name):
        raise InputError(f"{folder / name}: not from an earlier run; choose another output folder")
    begun = list(itertools.islice(files.read_video(video), 2))
    if len(begun) < 2:
        raise InputError(f"{video}: a clip has two or more frames, got {len(begun)}")
    console.note(f"reading the frames of {video}")
    manifest.begin()
    known.begin()
    count, fault = 0, ""
    try:
        for picture, _ in files.read_video(video):
            write_image(folder / f"{video.stem}_{count:06d}.png", picture)
            count += 1
    except InputError as exc:
        fault = f"{exc}; the {count} frames before the fault are used"
    rate = begun[0][1]
    add_entry(folder / name, made_from, count=count, rate=rate, fault=fault)
    return [*paths(count)], rate, fault


def _look(paths: Sequence[Path], jobs: int) -> list[Frame]:
    """Read all frames; those that cannot be read, or are of another size than most, have an error."""
    calls = [(path.absolute(), str(path)) for path in paths]
    frames: list[Frame] = list(_in_processes(_read, calls, jobs, "frames"))
    shapes = Counter(frame.shape for frame in frames if not frame.error)
    for i, frame in enumerate(frames):
        if not frame.error and frame.shape != (usual := shapes.most_common(1)[0][0]):
            found, most = (f"{width} x {height}" for height, width in (frame.shape, usual))
            error = f"{paths[i]}: {found} pixels (width x height), but most frames have {most}"
            frames[i] = frame._replace(error=error)
    return frames


# -- flows and pictures --------------------------------------------------------------------------


def _compute(
    pairs: Sequence[tuple[Frame, Frame]],
    settings: Settings,
    manifest: Manifest,
    jobs: int,
    errors: Sequence[str],
    mask: Mask | None,
) -> list[str]:
    """Compute the flows that are missing, print their number and the failures, and return all names."""
    from fracbench.api import estimate_flow

    folder = manifest.folder.absolute()
    same = {"settings": settings.digest, "mask": mask.digest if mask else None}
    made_from = {a.path.stem: {"frames": [a.digest, b.digest], **same} for a, b in pairs}
    given = {**settings.given, **({"mask": mask.pixels} if mask else {})}
    why = {name: manifest.why(f"{name}.flo", made, "speed") for name, made in made_from.items()}
    calls = [
        (a.path, b.path, folder / f"{a.path.stem}.flo", given, made_from[a.path.stem])
        for a, b in pairs
        if why[a.path.stem]
    ]
    if calls and not (settings.method.package or settings.method.requires):  # these may need more than a blank
        import numpy as np

        compile_for([(settings.method.name, settings.params)], errors=False)
        # Refuses settings and sizes that no flow can have.
        blank = np.zeros([min(n, _TRIAL) for n in pairs[0][0].shape])
        estimate_flow(blank, blank, mask=(blank > 0) if mask else None, **settings.given)
    manifest.begin()
    for error in errors:
        console.complain(error)
    failed: dict[str, list[str]] = {}
    notices: dict[str, None] = {}
    for call, outcome in zip(calls, _in_processes(_estimate, calls, jobs, "flows"), strict=True):
        name = call[2].stem
        notices |= dict.fromkeys(outcome.notices)
        if outcome.entry is None:
            failed.setdefault(outcome.error, []).append(name)
        else:
            manifest.entries[f"{name}.flo"] = outcome.entry
    for notice in notices:
        console.note(f"note: {notice}")
    for error, names in failed.items():
        console.complain(f"no flow from {', '.join(names)}: {error}")
    without = set(itertools.chain(*failed.values()))
    reasons = Counter(why[call[2].stem] for call in calls if call[2].stem not in without)
    told = ", ".join(f"{count} {reason}" for reason, count in sorted(reasons.items()))
    console.say(
        f"{settings.name}, flows: {reasons.total()} computed{f' ({told})' if told else ''}, "
        f"{len(pairs) - len(calls)} kept"
    )
    return [name for name in made_from if name not in without]


def _draw(
    frames: Sequence[Frame],
    names: Sequence[str],
    manifest: Manifest,
    jobs: int,
    max_motion: float | None,
    rate: float,
    title: str,
) -> float:
    """Draw all flows on one colour scale, the contact sheet and, with the extra `video`, the video.

    Return the scale, the speed of the full colours in pixels.
    """
    import numpy as np

    from fracbench.data.files import atomic_path, read_image
    from fracbench.figures.contact_sheet import chosen, contact_sheet
    from fracbench.figures.style import render

    folder = manifest.folder
    flows = {name: manifest.entries[f"{name}.flo"] for name in names}
    speeds = [float(entry["speed"]) for entry in flows.values()]
    scale = max_motion or float(np.quantile(speeds, _FLOWS, method="higher")) or 1.0
    made_from = {name: {"flow": entry["digest"], "colour scale": scale} for name, entry in flows.items()}
    todo = [name for name in names if manifest.why(f"{name}.png", made_from[name])]
    calls = [(folder.absolute() / name, made_from[name], scale) for name in todo]
    for _ in _in_processes(_paint, calls, jobs, "pictures"):
        pass
    console.say(f"wrote the flows (NAME.flo) and their pictures (NAME.png) to {folder}")
    console.say(f"colours: full at {scale:.3g} px a frame")

    def picture(name: str) -> Any:
        return read_image(folder / f"{name}.png")

    shown = [(name, picture(name)) for name in chosen(names)]
    first = next(frame.path for frame in frames if frame.path.stem == names[0])
    with atomic_path(folder / SHEET) as temporary:
        temporary.write_bytes(
            render(contact_sheet(read_image(first), shown, scale, f"{title}, {len(names)} in all"), "png")
        )
    console.say(f"wrote {folder / SHEET}")
    if files.has_video():
        files.write_video(folder / VIDEO, map(picture, names), rate)
        console.say(f"wrote {folder / VIDEO}")
    else:
        console.note("note: no video of the colours is written: pip install 'fracbench[video]'")
    return scale


def _write_fields(
    names: Sequence[str],
    manifest: Manifest,
    jobs: int,
    fields: SequenceFields,
    mask: Mask | None,
    scale: float,
    settings: Settings,
) -> None:
    """Write the files of the velocity fields, their pictures on one colour scale."""
    import numpy as np

    if not fields.suffixes:
        return
    hidden = mask.pixels if mask else None
    folder = manifest.folder.absolute()
    flows = [folder / f"{name}.flo" for name in names]
    top_vorticity = None
    if fields.vorticity:
        calls = [(flow, fields, hidden) for flow in flows]
        tops = [*_in_processes(_top_vorticity, calls, jobs, "vorticity")]
        top_vorticity = float(np.quantile(tops, _FLOWS, method="higher"))
    source = f"fracbench, {settings.name}"
    shown = {"units": [*fields.units], "source": source, "mask": mask.digest if mask else None}
    tops_of = {".arrows.png": scale, ".vorticity.png": top_vorticity}
    todo = []
    for name in names:
        made_from = {
            suffix: {"flow": manifest.entries[f"{name}.flo"]["digest"], "top": tops_of.get(suffix), **shown}
            for suffix in fields.suffixes
        }
        new = {each: made for each, made in made_from.items() if manifest.why(f"{name}{each}", made)}
        if new:
            todo.append((folder / name, new, fields, hidden, source))
    for _ in _in_processes(_write_field, todo, jobs, "fields"):
        pass
    told = ", ".join(f"NAME{suffix}" for suffix in fields.suffixes)
    console.say(f"wrote the velocity fields ({told}) to {manifest.folder}")


def _in_processes(function: Any, calls: Sequence[tuple[Any, ...]], jobs: int, label: str) -> Iterable[Any]:
    """Yield the results of calls in order, with a progress bar."""
    from fracbench.harness.run.pool import parallel_map

    if not calls:
        return
    with console.progress(len(calls), label) as advance:
        for result in parallel_map(function, calls, jobs, _KEPT):
            advance()
            yield result


# -- in a worker process -------------------------------------------------------------------------


def _read(path: Path, shown: str) -> Frame:
    """Read a frame; messages call it as the user does."""
    from fracbench.data.files import decode_image, read_bytes

    try:
        data = read_bytes(path)
        shape = decode_image(data, shown).shape[:2]
    except InputError as exc:
        return Frame(path, error=str(exc).replace(str(path), shown))
    return Frame(path, hashlib.sha256(data).hexdigest(), shape)


def _estimate(
    frame0: Path, frame1: Path, output: Path, given: dict[str, Any], made_from: dict[str, Any]
) -> Outcome:
    import numpy as np

    from fracbench.api import estimate_flow
    from fracbench.data.files import read_image, write_flow
    from fracbench.entry_points import described

    try:
        result = estimate_flow(read_image(frame0), read_image(frame1), **given)
    except Exception as exc:  # a peer may raise anything, and the other flows go on
        return Outcome(None, str(exc) if isinstance(exc, FracbenchError) else described(exc))
    if result.stop_reason == "diverged":
        return Outcome(None, "the computation diverged; smaller lambda or theta may help", result.notices)
    write_flow(output, result.flow)
    speed = float(np.quantile(np.hypot(*result.flow), _PIXELS))
    return Outcome(add_entry(output, made_from, speed=speed), notices=result.notices)


def _paint(stem: Path, made_from: dict[str, Any], scale: float) -> None:
    from fracbench.data.files import read_flow, write_image
    from fracbench.figures.flowcolor import flow_to_color

    picture = stem.with_name(f"{stem.name}.png")
    write_image(picture, flow_to_color(read_flow(stem.with_name(f"{stem.name}.flo")), scale))
    add_entry(picture, made_from)


def _top_vorticity(flow: Path, fields: SequenceFields, mask: NDArray[Any] | None) -> float:
    from fracbench.commands.field_output import to_field
    from fracbench.data.files import read_flow
    from fracbench.figures.fields import top_vorticity

    return top_vorticity(to_field(read_flow(flow), fields.units, mask))


def _write_field(
    stem: Path,
    made_from: dict[str, dict[str, Any]],
    fields: SequenceFields,
    mask: NDArray[Any] | None,
    source: str,
) -> None:
    """Write the files of the suffixes in `made_from`."""
    from fracbench.commands.field_output import to_field
    from fracbench.data.files import read_flow

    field = to_field(read_flow(stem.with_name(f"{stem.name}.flo")), fields.units, mask)
    tops = {suffix: made["top"] for suffix, made in made_from.items()}
    for path in fields.write(stem, field, tops, source):
        add_entry(path, made_from[path.name.removeprefix(stem.name)])
