"""The command that lists the datasets: which there are, and where their files are."""

from __future__ import annotations

from collections.abc import Sequence

from fracbench.commands import console
from fracbench.errors import InputError, unknown_name
from fracbench.harness.config.grid import parse_overrides

_SHOWN = 6


def show(tokens: Sequence[str] = (), *, download: bool = False) -> bool:
    """List all datasets, or ``dataset=NAME`` alone; tell whether Middlebury's files, if shown, are whole."""
    given = parse_overrides(tokens).fixed
    for key in given:
        if key not in (allowed := ("dataset", "paths.data")):
            raise unknown_name("key", key, allowed)
    chosen, folder = given.get("dataset"), given.get("paths.data")
    if chosen is None and folder is not None:
        raise InputError(f"data: paths.data={folder} needs dataset=NAME")
    if chosen is not None and chosen != "middlebury":
        _show_one(chosen, folder)
        return True
    try:
        return _show_middlebury(folder, download=download)
    finally:
        if chosen is None:
            _show_others()


def _show_middlebury(folder: str | None, *, download: bool) -> bool:
    from fracbench.data.datasets import middlebury

    if download:
        middlebury.download(middlebury.download_folder())
    location = middlebury.find(folder)
    console.say(f"Middlebury: {location.folder} (from {location.source})")
    whole = True
    for name in middlebury.SEQUENCES:
        state = middlebury.state(name, location.folder)
        console.say(f"  {name:12s} {state.state}")
        for file in state.files:
            if file.state != "ok":
                console.say(f"    {file.message}")
        whole = whole and state.state == "ok"
    return whole


def _show_others() -> None:
    """Print a line for each dataset: its summary or, if it has files, their folder or a way to provide them."""
    from fracbench.data.datasets.registry import all_datasets, find_folder

    datasets, unusable = all_datasets()
    for dataset in datasets:
        if dataset.name == "middlebury":
            continue
        try:
            folder = find_folder(dataset.name)
        except InputError as exc:
            state = f"missing: {str(exc).removeprefix(f'{dataset.name}: ')}"
        else:
            state = dataset.summary if folder is None else f"found at {folder}"
        console.say(f"{dataset.name}: {state}")
    for line in unusable:
        console.say(f"cannot be used: {line}")


def _show_one(name: str, given: str | None) -> None:
    """Say where the files of a dataset are and which pairs they make, after a look at the head of every file."""
    from fracbench.data.datasets.registry import find_folder, get_dataset, list_sequences, shape_of

    found = get_dataset(name)
    folder = find_folder(found.name, given)
    names = list_sequences(found.name, folder)
    for pair in names:
        shape_of(pair, found.name, folder)
    shown = ", ".join(names if len(names) <= _SHOWN else [*names[: _SHOWN - 1], "...", names[-1]])
    console.say(f"{found.name}: {'no files' if folder is None else folder}: {len(names)} pairs: {shown}")
