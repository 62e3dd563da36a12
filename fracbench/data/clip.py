"""Clips on disk: pictures in the order of their numbers, and videos (by PyAV, the extra `video`)."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.data.files import Pathish, atomic_path
from fracbench.errors import InputError

VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm", ".wmv")
PICTURES = (".bmp", ".gif", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
# Containers that hold their own data: a playlist could name any file or address.
_CONTAINERS = "asf,avi,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,mpeg,mpegvideo"
#: Pictures a second of a clip of pictures, and of a video that does not say its rate or one outside `_RATES`.
RATE = 25.0
_RATES = 0.01, 1000.0


def natural_order(path: Pathish) -> tuple[list[int | str], str]:
    """Return a key to sort paths by the numbers in them: ``frame2`` is before ``frame10``."""
    parts = re.split(r"([0-9]+)", str(path))
    return [int(part) if i % 2 else part.casefold() for i, part in enumerate(parts)], str(path)


def find_frames(words: Sequence[str]) -> list[Path]:
    """Return the pictures that files, folders and globs stand for, each once, in natural order; or one video."""
    found = {os.path.realpath(path): path for word in words for path in _files(word)}
    videos = [path for path in found.values() if path.suffix.lower() in VIDEOS]
    if videos and len(found) > 1:
        raise InputError(f"{videos[0]}: a video is a clip of its own; give no other frames with it")
    return sorted(found.values(), key=natural_order)


def _files(word: str) -> list[Path]:
    if os.path.isdir(word):  # noqa: PTH112 - Path.is_dir raises where a parent may not be entered
        try:
            names = [path.name for path in Path(word).iterdir()]
        except OSError as exc:
            raise InputError(f"{word}: cannot be read: {exc.strerror}") from exc
        shown = [name for name in names if name.lower().endswith(PICTURES) and not name.startswith(".")]
        if not shown:
            raise InputError(f"{word}: the folder holds no pictures ({', '.join(PICTURES)})")
        return [Path(word, name) for name in shown]
    if os.path.lexists(word):
        return [Path(word)]
    if not glob.has_magic(word):
        raise InputError(f"{word}: no such file or folder")
    matches = [Path(name) for name in glob.glob(word, recursive=True) if os.path.isfile(name)]  # noqa: PTH113, PTH207
    if not matches:
        raise InputError(f"no file matches {word!r}")
    return matches


def has_video() -> bool:
    """Return whether videos can be read and written."""
    try:
        import av  # noqa: F401
    except ImportError:
        return False
    return True


def require_video(where: Pathish) -> Any:
    """Return PyAV, or raise `InputError` that says how to install it."""
    if not has_video():
        raise InputError(f"{where}: videos need PyAV: pip install 'fracbench[video]'")
    import av

    return av


def read_video(path: Pathish) -> Iterator[tuple[NDArray[np.uint8], float]]:
    """Yield the frames of a video, (H, W, 3) uint8, each with the video's rate in frames a second."""
    av = require_video(path)
    try:
        with (
            Path(path).open("rb") as file,  # never an address, whatever the name looks like
            av.open(file, options={"format_whitelist": _CONTAINERS}) as container,
        ):
            if not container.streams.video:
                raise InputError(f"{path}: holds no pictures")
            stream = container.streams.video[0]
            rate = float(stream.average_rate or RATE)
            for frame in container.decode(stream):
                yield frame.to_ndarray(format="rgb24"), rate
    except (av.error.FFmpegError, OSError) as exc:
        raise InputError(f"{path}: not a video that can be read ({exc.strerror or exc})") from exc


def write_video(path: Pathish, pictures: Iterable[NDArray[np.uint8]], rate: float) -> None:
    """Write pictures of one size, (H, W, 3), as an MP4 (H.264) atomically; `rate` is in pictures a second."""
    av = require_video(path)
    try:
        with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
            plausible = rate if _RATES[0] <= rate <= _RATES[1] else RATE
            stream = container.add_stream("libx264", rate=Fraction(plausible).limit_denominator(1001))
            stream.pix_fmt, stream.options = "yuv420p", {"crf": "18"}
            for i, picture in enumerate(pictures):
                height, width = picture.shape[:2]
                # H.264 halves the resolution of colours
                even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
                if i == 0:
                    stream.height, stream.width = even.shape[:2]
                container.mux(stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")))
            container.mux(stream.encode())
    except av.error.FFmpegError as exc:
        raise InputError(f"{path}: the video cannot be written ({exc.strerror or exc})") from exc
