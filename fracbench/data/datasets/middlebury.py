"""The Middlebury optical-flow sequences with public ground truth: find, verify, load, download.

Source: S. Baker, D. Scharstein, J. P. Lewis, S. Roth, M. J. Black, R. Szeliski, A Database and Evaluation
Methodology for Optical Flow, International Journal of Computer Vision 92(1):1-31, 2011.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fracbench.data.datasets.base import Dataset, usual_places
from fracbench.data.read_once import read_once, sha256
from fracbench.errors import DataError, InputError, match_name

if TYPE_CHECKING:
    from fracbench.data.pair import FramePair

SEQUENCES = ("Grove2", "Grove3", "Urban2", "Urban3", "RubberWhale", "Hydrangea", "Dimetrodon", "Venus")
SIZES = {  # height, width
    **dict.fromkeys(("Grove2", "Grove3", "Urban2", "Urban3"), (480, 640)),
    **dict.fromkeys(("RubberWhale", "Hydrangea", "Dimetrodon"), (388, 584)),
    "Venus": (380, 420),
}
REGISTRY: dict[str, str] = {  # file: SHA-256
    "Grove2/frame10.png": "91f8ceefe5fe477e654a40603431145754fee477c7537fd37c5f0690a60ed648",
    "Grove2/frame11.png": "deba56fc09462ac644977054a9ff60b8ee726e18f7e6b0d6cab72ab7c5624385",
    "Grove2/flow10.flo": "3fffc1ac8e4d1f9676d4d4b3feab4b3f7d71b9e3bd6a3bcc625a22ee599fd589",
    "Grove3/frame10.png": "77db3739fa6a62159cd8b45e724f5958e467614bd8ac38e1bf2e0e321b41cac1",
    "Grove3/frame11.png": "3fb7f98c1a6b7fcf7e47fb7e772131137b634953d8e0080ba8880241275ecc7f",
    "Grove3/flow10.flo": "eec18eca326416dd17fbf40f48aba4e565f59b946dca2e5414fc994fe60f6f3d",
    "Urban2/frame10.png": "de02215cc095995a56fbb8c332f59e0de87fa78ea06a2eb105e170877287796a",
    "Urban2/frame11.png": "ecf1231725ac87f4c7e6d29e6e4f860828f3fc2d38ca5af9c628da254bcbefbb",
    "Urban2/flow10.flo": "06a642571e8f5018c93005eac6b35a08694b696387cca220a95ad588cabddf3d",
    "Urban3/frame10.png": "c579ba980fcf3703ffcb18616cdfeadcd9b6cc42564169b67fd27192498fd419",
    "Urban3/frame11.png": "6c03cc8375f15d0f29f6b2f66e55c56dfbdf9393f956293962e0b5fa5e044be4",
    "Urban3/flow10.flo": "d3abf61f21ad1b29337384dc1ce3875f32635a9b3cfac04af15dccfab52c0b50",
    "RubberWhale/frame10.png": "eb312435369dac9efcc92f7e098edbd9ed8d7e6dfede8b3b4d8e3702cd80b796",
    "RubberWhale/frame11.png": "ee309a00d47b837b322ea5d9128775e0c46869b8014376286ba316a073d293ac",
    "RubberWhale/flow10.flo": "f57359dd1a35907322f7a890a5e61bd0dd421aac89fd51ba0c71bf3a7e0a8890",
    "Hydrangea/frame10.png": "4d43fa82b077f2ea85851ccba2c1ffe9205ab5982f18307a637529482bc1e310",
    "Hydrangea/frame11.png": "483511b0469f7f92232c958cadea36ea616fe0105ccfd20ae88e74644b1e793c",
    "Hydrangea/flow10.flo": "14ca2e46be8483ffe8e47f0e283d797674b5ce4537974665c7a300eef4f1dd66",
    "Dimetrodon/frame10.png": "5ce0af3e00b80c5fb8a9b85ceae2e51b454839a2a89a47633f0f3885982c505f",
    "Dimetrodon/frame11.png": "7174b407aee61b6eec3d83c5111ea2f77eea41e58bbd48592e6d87600ad8e49b",
    "Dimetrodon/flow10.flo": "3b231e26f2a82513aac45c2cfc4af5df64857c126b9201b7abedb841e3a037b0",
    "Venus/frame10.png": "f36d77900848c4d5bf6f31898e43d3db4c912f474f273b331d7a96113ea5a637",
    "Venus/frame11.png": "45860656c48fec7fff1ed3528bd2d72f4f6dbf71c6d621fb2e0f48a531e617d0",
    "Venus/flow10.flo": "4f5e58609d02d8198f838de8b3f34a952cfaebf284938daa255066c535610f34",
}
BASE_URL = "https://vision.middlebury.edu/flow/data/comp/zip"

State = Literal["ok", "missing", "corrupt", "unreadable"]

_FRAMES_AND_TRUTH = ("frame10.png", "frame11.png", "flow10.flo")
_ARCHIVES = {  # archive: (folder inside it, suffix of the files taken from it)
    "other-color-twoframes.zip": ("other-data", ".png"),
    "other-gt-flow.zip": ("other-gt-flow", ".flo"),
}
_WAYS = (
    "to provide it set FRACBENCH_DATA=FOLDER, give paths.data=FOLDER, put it at data/middlebury, "
    "or run `fracbench data --download`"
)


@dataclass(frozen=True)
class Location:
    """A folder that holds Middlebury files, which setting led to it, and how many of the 24 are there."""

    folder: Path
    source: str
    n_files: int


@dataclass(frozen=True)
class FileState:
    """One file against its registered SHA-256; `actual` is None where it could not be read."""

    path: Path
    state: State
    expected: str
    actual: str | None = None
    reason: str = ""

    @property
    def message(self) -> str:
        """The defect of the file, in one line."""
        if self.state == "missing":
            return f"{self.path} is missing; {_WAYS}"
        if self.state == "corrupt":
            return (
                f"{self.path} is corrupt: its SHA-256 is {self.actual}, not {self.expected}; "
                "`fracbench data --download` replaces it"
            )
        return f"{self.path} is unreadable: {self.reason}" if self.reason else f"{self.path} is ok"


@dataclass(frozen=True)
class SequenceState:
    """The worst state of a sequence's files (missing < corrupt < unreadable), and each file's own."""

    sequence: str
    state: State
    files: tuple[FileState, ...]


@dataclass(frozen=True)
class Resolved:
    """The data set to use, where its files are (None for synthetic), and what the user must be told."""

    dataset: str
    folder: Path | None = None
    notice: str | None = None


def find(explicit: str | Path | None = None) -> Location:
    """Find the folder that holds the sequences, without reading the files.

    `explicit` is the setting ``paths.data``. It and the variable FRACBENCH_DATA, where given, must hold files:
    they are never passed over. Then come ``data/middlebury`` and ``../shared/middlebury``, relative to the working
    folder and to the checkout, and the user's cache; of these the first of the fullest is taken.
    """
    found = _look_up(explicit)
    if found is None:
        raise DataError(f"the Middlebury data were not found; {_WAYS}")
    return found


def _look_up(explicit: str | Path | None) -> Location | None:
    for source, given in (("paths.data", explicit), ("FRACBENCH_DATA", os.environ.get("FRACBENCH_DATA"))):
        if given:
            location = _locate(Path(os.path.expanduser(given)), source)  # noqa: PTH111 - never raises
            if not location.n_files:
                raise DataError(f"{source}={given}: holds none of the {len(REGISTRY)} Middlebury files")
            return location
    best = None
    for source, folder in _usual_places():
        location = _locate(folder, source)
        if location.n_files == len(REGISTRY):
            return location
        if location.n_files > (best.n_files if best else 0):
            best = location
    return best


def _usual_places() -> Iterator[tuple[str, Path]]:
    yield from usual_places("data/middlebury", "../shared/middlebury")
    yield "the user cache", cache_folder()  # last: it needs pooch, which is slow to import


def cache_folder() -> Path:
    """Return the user's cache, where `download` puts the files by default."""
    import pooch

    return Path(pooch.os_cache("fracbench")) / "middlebury"


def download_folder() -> Path:
    """Return the folder that a download completes: FRACBENCH_DATA, else the one found, else the user's cache."""
    given = os.environ.get("FRACBENCH_DATA")
    if given:
        return Path(os.path.expanduser(given))  # noqa: PTH111 - never raises
    found = _look_up(None)
    return found.folder if found else cache_folder()


def _locate(folder: Path, source: str) -> Location:
    # Path.is_file raises where a folder may not be entered
    n_files = sum(os.path.isfile(folder / name) for name in REGISTRY)  # noqa: PTH113
    return Location(folder.resolve(), source, n_files)


def state(sequence: str, folder: str | Path) -> SequenceState:
    """Compare the three files of a sequence with their SHA-256."""
    sequence = match_name(sequence, SEQUENCES, "Middlebury sequence")
    files = tuple(_inspect(f"{sequence}/{file}", folder) for file in _FRAMES_AND_TRUTH)
    severity: tuple[State, ...] = ("ok", "missing", "corrupt", "unreadable")
    return SequenceState(sequence, max((f.state for f in files), key=severity.index), files)


def _inspect(name: str, folder: str | Path, hashed: Callable[[Path], str] = sha256) -> FileState:
    """Return the state of a registered file."""
    path, expected = Path(folder) / name, REGISTRY[name]
    try:
        actual = hashed(path)
    except (FileNotFoundError, NotADirectoryError):
        return FileState(path, "missing", expected)
    except OSError as exc:
        return FileState(path, "unreadable", expected, reason=exc.strerror or str(exc))
    return FileState(path, "ok" if actual == expected else "corrupt", expected, actual)


def contents(sequence: str, folder: str | Path) -> dict[str, bytes]:
    """Return the three files of a sequence by path below the folder, each as it was verified."""
    content: dict[str, bytes] = {}

    def hashed(path: Path) -> str:
        data, actual = read_once(path)
        content[f"{path.parent.name}/{path.name}"] = data
        return actual

    digest(sequence, folder, hashed)
    return content


def digest(sequence: str, folder: str | Path, hashed: Callable[[Path], str] = sha256) -> str:
    """Verify the files of a sequence and return its digest, without decoding anything."""
    sequence, lines = match_name(sequence, SEQUENCES, "Middlebury sequence"), []
    for file in _FRAMES_AND_TRUTH:
        found = _inspect(f"{sequence}/{file}", folder, hashed)
        if found.state != "ok":
            raise DataError(f"Middlebury file {found.message}")
        lines.append(f"{file} {found.expected}")
    return hashlib.sha256("\n".join(("middlebury", sequence, *lines)).encode()).hexdigest()


def load(sequence: str, folder: str | Path) -> FramePair:
    """Load frames 10 and 11 and the true flow of a sequence; each file is verified as it is read."""
    from fracbench.data.files import decode_flo, decode_image
    from fracbench.data.gray import to_gray
    from fracbench.data.pair import FramePair

    sequence = match_name(sequence, SEQUENCES, "Middlebury sequence")
    content = {Path(path).name: data for path, data in contents(sequence, folder).items()}
    frame0, frame1 = (decode_image(content[file], f"{sequence}/{file}") for file in _FRAMES_AND_TRUTH[:2])
    return FramePair(
        name=sequence,
        dataset="middlebury",
        frame0=to_gray(frame0).astype(float),
        frame1=to_gray(frame1).astype(float),
        truth=decode_flo(content["flow10.flo"], f"{sequence}/flow10.flo"),
        digest=digest(sequence, folder),
        frame0_color=frame0,
    )


def download(folder: str | Path, base_url: str = BASE_URL, timeout: float = 5.0) -> None:
    """Download what is missing or damaged in `folder` from Middlebury's own archives.

    `timeout` is the seconds the server has to give its first answer; it is asked once.
    """
    for archive, (inside, suffix) in _ARCHIVES.items():
        members = {
            f"{inside}/{name}": (Path(folder) / name, sha256)
            for name, sha256 in REGISTRY.items()
            if name.endswith(suffix) and _inspect(name, folder).state != "ok"
        }
        if members:
            from fracbench.data.download import fetch_members

            try:
                fetch_members(f"{base_url.rstrip('/')}/{archive}", members, timeout)
            except InputError as exc:
                raise DataError(f"the Middlebury data could not be downloaded: {exc}; {_WAYS}") from exc


def resolve(dataset: str, explicit: str | Path | None = None, allow_download: bool = True) -> Resolved:
    """Decide which data set a run uses; `explicit` is the setting ``paths.data``.

    ``"auto"`` takes Middlebury where it is found or can be downloaded into the user's cache, else the synthetic
    scenes, with a notice.
    """
    dataset = match_name(dataset, ("auto", "middlebury", "synthetic"), "dataset")
    if dataset == "synthetic":
        return Resolved("synthetic")
    found = _look_up(explicit)
    if found is not None:
        return Resolved("middlebury", found.folder)
    try:
        if not allow_download:
            raise DataError(f"the Middlebury data were not found and downloading is off; {_WAYS}")
        download(cache_folder())
    except DataError as exc:
        if dataset == "middlebury":
            raise
        return Resolved("synthetic", notice=f"using the synthetic scenes in place of Middlebury: {exc}")
    return Resolved("middlebury", cache_folder())


def _folder(given: Path | None) -> Path:
    return find().folder if given is None else given


DATASET = Dataset(
    name="middlebury",
    summary="the 8 sequences with public ground truth, frames 10 and 11",
    names=lambda folder: SEQUENCES,
    shape=lambda name, folder: SIZES[name],
    load=lambda name, folder, *, noise, seed: load(name, _folder(folder)),
    digest=lambda name, folder, *, noise, seed: digest(name, _folder(folder)),
    find=lambda given: find(given).folder,
    contents=lambda name, folder: contents(name, _folder(folder)),
    outliers=False,  # no column of the paper's tables
)
