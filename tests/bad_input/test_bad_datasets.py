"""Datasets that cannot be used: layouts, files of a pair that do not belong together, packages of others."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import fracbench
from fracbench.commands.cli import main
from fracbench.data.files import write_flo, write_flow, write_image
from fracbench.data.read_once import MAX_BYTES

H, W = 12, 14
FRAME = np.random.default_rng(0).integers(0, 256, (H, W), dtype=np.uint8)
FLOW = np.zeros((2, H, W), np.float32)


def png_that_promises(width: int, height: int) -> bytes:
    """An 8-bit gray PNG, whose head promises a size and which holds one byte."""
    chunks = (
        b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0),
        b"IDAT" + zlib.compress(b"\0"),
        b"IEND",
    )
    parts = (struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.fixture
def pairs(work) -> Path:
    """One pair ``a`` with its true flow, in ``pairs``."""
    folder = work / "pairs" / "a"
    folder.mkdir(parents=True)
    for k in range(2):
        write_image(folder / f"frame{k}.png", FRAME)
    write_flo(folder / "flow.flo", FLOW)
    return work / "pairs"


def no_second(a: Path) -> None:
    (a / "frame1.png").unlink()


def no_first(a: Path) -> None:
    (a / "frame0.png").unlink()


def two_firsts(a: Path) -> None:
    write_image(a / "frame0.bmp", FRAME)


def two_truths(a: Path) -> None:
    write_flow(a / "flow.png", FLOW)


def empty(a: Path) -> None:
    for path in a.iterdir():
        path.unlink()


def other_size(a: Path) -> None:
    write_image(a / "frame1.png", FRAME[1:])


def truth_of_other_size(a: Path) -> None:
    write_flo(a / "flow.flo", FLOW[:, :, 1:])


def truth_cut(a: Path) -> None:
    (a / "flow.flo").write_bytes((a / "flow.flo").read_bytes()[:-4])


def truth_of_8_bits(a: Path) -> None:
    (a / "flow.flo").unlink()
    write_image(a / "flow.png", np.dstack([FRAME] * 3))


def mask_of_other_size(a: Path) -> None:
    write_image(a / "mask.png", FRAME[:, 1:])


def mask_in_colour(a: Path) -> None:
    write_image(a / "mask.png", np.dstack([FRAME] * 3))


def mask_of_16_bits(a: Path) -> None:
    Image.fromarray(FRAME.astype(np.uint16)).save(a / "mask.png")


def no_picture(a: Path) -> None:
    (a / "frame1.png").write_text("not a picture")


def empty_picture(a: Path) -> None:
    (a / "frame1.png").write_bytes(b"")


def folder_as_frame(a: Path) -> None:
    (a / "frame1.png").unlink()
    (a / "frame1.png").mkdir()


def broken_link(a: Path) -> None:
    (a / "frame1.png").unlink()
    (a / "frame1.png").symlink_to(a / "gone.png")


def bomb(a: Path) -> None:
    (a / "frame1.png").write_bytes(png_that_promises(99_999, 99_999))


def huge(a: Path) -> None:
    with (a / "flow.flo").open("r+b") as file:
        file.truncate(MAX_BYTES + 1)  # no bytes are written: the file is sparse


def name_with_spaces(a: Path) -> None:
    a.rename(a.with_name("my pair"))


FOLDERS = [
    (no_second, "pairs/a: has no frame1.*; a pair is one frame0.* and one frame1.*"),
    (no_first, "pairs/a: has no frame0.*; a pair is one frame0.* and one frame1.*"),
    (two_firsts, "pairs/a: has frame0.bmp and frame0.png; a pair is one frame0.*"),
    (two_truths, "pairs/a: has flow.flo and flow.png; a pair has one true flow"),
    (empty, "pairs: no pairs in it; dataset=folder reads one sub-folder a pair with frame0.*"),
    (other_size, "frame1.png: 14 x 11 pixels, but frame0.png of the pair has 14 x 12 (width x height)"),
    (truth_of_other_size, "flow.flo: 13 x 12 pixels, but frame0.png of the pair has 14 x 12"),
    (truth_cut, "flow.flo: cut off: 14 x 12 needs 1356 bytes, found 1352"),
    (truth_of_8_bits, "flow.png: not a KITTI flow, which is a 16-bit RGB PNG"),
    (mask_of_other_size, "mask.png: 13 x 12 pixels, but frame0.png of the pair has 14 x 12"),
    (mask_in_colour, "mask.png: not a mask, which is an 8-bit gray picture (the mode of this one is RGB)"),
    (mask_of_16_bits, "mask.png: not a mask, which is an 8-bit gray picture (the mode of this one is I;16)"),
    (no_picture, "frame1.png: not a picture that can be read (unknown format)"),
    (empty_picture, "frame1.png: not a picture that can be read"),
    (folder_as_frame, "frame1.png: cannot be read: a directory"),
    (broken_link, "frame1.png: cannot be read: No such file"),
    (bomb, "frame1.png: not a picture that can be read", "decompression bomb"),
    (huge, f"flow.flo: cannot be read: {MAX_BYTES + 1} bytes, more than the {MAX_BYTES}"),
    (name_with_spaces, "the name of a pair must be a name of letters, digits", "'my pair'"),
]


@pytest.mark.parametrize("case", FOLDERS, ids=lambda case: case[0].__name__)
def test_folders_of_pairs_that_cannot_be_used(pairs, work, capsys, case):
    spoil, *named = case
    spoil(pairs / "a")
    for words in (["sweep", "alpha=1"], ["run"], ["table", "2"], ["bench"], ["data"]):
        if words == ["data"] and spoil is name_with_spaces:
            continue
        capsys.readouterr()
        code = main([*words, "dataset=folder", "paths.data=pairs"])
        out, err = capsys.readouterr()
        assert code == 2, out
        assert err.startswith("fracbench: ") and err.count("\n") == 1
        for word in named:
            assert word in err
    assert not (work / "results").exists()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["dataset=folder"], "folder: give paths.data=FOLDER, or put it at data/folder"),
        (
            ["dataset=folder", "paths.data=nowhere"],
            "paths.data=nowhere: is not a folder; folder: pairs of your own",
        ),
        (["dataset=folder", "paths.data=pairs/a/flow.flo"], "paths.data=pairs/a/flow.flo: is not a folder"),
        (
            ["dataset=sintel", "paths.data=pairs"],
            "pairs: no pairs in it; dataset=sintel reads training/clean/SCENE",
        ),
        (["dataset=kitti2012", "paths.data=pairs"], "no pairs in it; dataset=kitti2012 reads training/colored_0/"),
        (["dataset=kitti2015", "paths.data=pairs"], "no pairs in it; dataset=kitti2015 reads training/image_2/"),
        (["dataset=kiti2015", "paths.data=pairs"], "unknown dataset 'kiti2015': did you mean 'kitti2015'?"),
        (["dataset=folder", "paths.data=pairs", "sequence=b"], "unknown sequence 'b' of dataset folder"),
        (["dataset=folder", "paths.data=pairs", "sequence=x_*"], "no sequence matches 'x_*' (allowed: a)"),
        (
            ["dataset=folder", "paths.data=pairs", "region=grove2_A"],
            "region=grove2_A: regions belong to Middlebury",
        ),
        (["dataset=folder", "paths.data=pairs", "context=8"], "context=8 needs a region"),
        (["dataset=folder", "paths.data=pairs", "noise=3"], "noise=3 needs a rendered scene, sequence=a is none"),
        (["dataset=folder", "paths.data=pairs", "margin=6"], "margin=6 leaves nothing of a side of 12 pixels"),
        (["dataset=folder,sintel", "paths.data=pairs"], "'dataset' takes one value, which holds for all points"),
    ],
)
def test_overrides_that_the_pairs_do_not_have(pairs, work, refused, words, named):
    refused(work, ["sweep", "alpha=1", *words], named)
    refused(work, ["sweep", "alpha=1", *words, "--dry-run"], named)


@pytest.mark.parametrize("command", [["table", "1"], ["figure", "5"], ["figure", "6"], ["experiment", "regions"]])
def test_experiments_on_regions(pairs, work, refused, command):
    if command == ["table", "1"]:  # which shows parameters alone
        assert main([*command, "dataset=folder", "paths.data=pairs"]) == 0
    else:
        named = "regions belong to Middlebury; dataset=folder has none"
        refused(work, [*command, "dataset=folder", "paths.data=pairs"], named)


def test_the_whole_report_needs_regions(pairs, work, refused):
    words = ["dataset=folder", "paths.data=pairs"]
    refused(work, ["report", *words], "most of the paper is about regions", "--only table2")
    refused(work, ["report", *words, "--only", "table3"], "unknown experiment 'table3': did you mean 'table")


# -- Sintel and KITTI ------------------------------------------------------------------------------


def put(path: Path, image: np.ndarray = FRAME) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, image)


def test_layouts_of_sintel_that_cannot_be_used(work, refused):
    scene, flows = work / "s/training/clean/alley_1", work / "s/training/flow/alley_1"
    words = ["sweep", "alpha=1", "dataset=sintel", "paths.data=s"]
    put(scene / "frame_0001.png")
    refused(work, words, "clean/alley_1: 1 frames, but a pair is two frames in succession")
    put(scene / "frame_0003.png")
    refused(work, words, "s: no pairs in it; dataset=sintel reads")
    put(scene / "frame_0004.png")
    flows.mkdir(parents=True)
    write_flo(flows / "frame_0001.flo", FLOW)
    refused(work, words, "frame_0001.flo belongs to frames 1 and 2, of which one is missing in")
    (flows / "frame_0001.flo").rename(flows / "frame_0003.flo")
    put(work / "s/training/occlusions/alley_1/frame_0003.png", np.dstack([FRAME] * 3))
    refused(work, words, "occlusions/alley_1/frame_0003.png: not a mask, which is an 8-bit gray picture")
    put(work / "s/training/occlusions/alley_1/frame_0003.png", FRAME[2:])
    refused(work, words, "occlusions/alley_1/frame_0003.png: 14 x 10 pixels, but frame_0003.png of the pair has")


def test_layouts_of_kitti_that_cannot_be_used(work, refused):
    training = work / "k/training"
    words = ["sweep", "alpha=1", "dataset=kitti2015", "paths.data=k"]
    put(training / "image_2/000007_10.png")
    refused(work, words, "image_2/000007_11.png: cannot be read: No such file")
    put(training / "image_2/000007_11.png")
    put(training / "flow_noc/000007_10.png")
    refused(work, words, "flow_noc/000007_10.png: there is no training/flow_occ/000007_10.png beside it")
    put(training / "flow_occ/000007_10.png", np.dstack([FRAME] * 3))
    refused(work, words, "flow_occ/000007_10.png: not a KITTI flow, which is a 16-bit RGB PNG (8-bit ones are")


def test_layouts_of_particle_images_that_cannot_be_used(work, refused):
    there = work / "p"
    there.mkdir()
    words = ["sweep", "alpha=1", "dataset=piv", "paths.data=p"]
    put(there / "a_img1.png")
    refused(work, words, "p: no pairs in it; dataset=piv reads NAME_img1.tif, NAME_img2.tif and NAME_flow.flo")
    put(there / "a_img1.tif")
    refused(work, words, "p/a_img2.tif: cannot be read: No such file")
    put(there / "a_img2.tif", FRAME[2:])
    refused(work, words, "p/a_img2.tif: 14 x 10 pixels, but a_img1.tif of the pair has 14 x 12")
    put(there / "a_img2.tif")
    write_flo(there / "a_flow.flo", FLOW[:, 2:])
    refused(work, words, "p/a_flow.flo: 14 x 10 pixels, but a_img1.tif of the pair has 14 x 12")
    write_flo(there / "b_flow.flo", FLOW)
    (there / "a_flow.flo").unlink()
    refused(work, words, "p/b_img1.tif: cannot be read: No such file")


# -- packages ------------------------------------------------------------------------------------

GOOD = """
import numpy as np

from fracbench import Dataset, FramePair

def load(name, folder, *, noise, seed):
    return FramePair(name, "good", np.eye(16), np.eye(16), np.zeros((2, 16, 16)), "digest")

def make(**changes):
    fields = dict(name="good", summary="", names=lambda folder: ["one"], shape=lambda name, folder: (16, 16),
                  load=load, digest=lambda name, folder, *, noise, seed: "digest")
    return Dataset(**{**fields, **changes})

def fail(*_, **__):
    raise KeyError("a bug")

GOOD, TAKEN, OTHER = make(), make(name="synthetic"), {"name": "other"}
MISNAMED = make(name="good")
NO_PAIRS, NO_NAMES = make(name="no_pairs", names=lambda folder: []), make(name="no_names", names=fail)
NO_SHAPE, NO_DIGEST = make(name="no_shape", shape=fail), make(name="no_digest", digest=lambda *_, **__: None)
"""

ENTRIES = """
[fracbench.datasets]
good = good_package:GOOD
twice = good_package:GOOD
other = good_package:OTHER
misnamed = good_package:MISNAMED
missing = good_package:MISSING
no_module = nowhere_to_be_found:DATASET
raises = bad_package:DATASET
leaves = leaving_package:DATASET
no_pairs = good_package:NO_PAIRS
no_names = good_package:NO_NAMES
no_shape = good_package:NO_SHAPE
no_digest = good_package:NO_DIGEST
"""


@pytest.fixture
def packages(tmp_path_factory, work, monkeypatch) -> Path:
    """The folder of an installed package with a dataset that works and others that do not."""
    site = tmp_path_factory.mktemp("site")
    (site / "good_package.py").write_text(GOOD)
    (site / "bad_package.py").write_text("raise RuntimeError('a bug\\nin two lines')")
    (site / "leaving_package.py").write_text("raise SystemExit(3)")
    info = site / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRIES)
    info = site / "ours-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: ours\nVersion: 2.0\n")
    (info / "entry_points.txt").write_text("[fracbench.datasets]\ntwice = good_package:OTHER\n")
    monkeypatch.syspath_prepend(site)
    yield site
    sys.modules.pop("good_package", None)


PACKAGES = [
    ("other", "entry point 'other' of theirs 1.0: good_package:OTHER is of type dict, not a fracbench.Dataset"),
    ("misnamed", "entry point 'misnamed' of theirs 1.0: the dataset is called 'good'; give the entry point"),
    ("missing", "good_package:MISSING cannot be loaded: AttributeError"),
    ("no_module", "nowhere_to_be_found:DATASET cannot be loaded: ModuleNotFoundError"),
    ("raises", "bad_package:DATASET cannot be loaded: RuntimeError: a bug in two lines"),
    ("leaves", "leaving_package:DATASET cannot be loaded: SystemExit: 3"),
    ("twice", "entry point 'twice': ours 2.0 and theirs 1.0 offer the same name; uninstall one"),
    ("no_pairs", "dataset no_pairs: has no pairs"),
    ("no_names", "dataset no_names: `names` failed: KeyError: 'a bug'"),
    ("no_shape", "dataset no_shape: `shape` failed: KeyError: 'a bug'"),
    ("no_digest", "dataset no_digest: the digest of 'one' is no text but NoneType"),
]


@pytest.mark.parametrize(("dataset", "named"), PACKAGES)
def test_packages_that_cannot_be_used(packages, work, refused, dataset, named):
    refused(work, ["sweep", "alpha=1", f"dataset={dataset}"], named)
    refused(work, ["run", f"dataset={dataset}"], named)


def test_the_others_go_on(packages, work, cli, refused, no_middlebury):
    words = [sys.executable, "-m", "fracbench", "sweep", "alpha=1", "n_scales=1", "dataset=good", "--jobs", "1"]
    path = os.pathsep.join([str(packages), str(Path(fracbench.__file__).parents[1])])
    done = subprocess.run(words, env={**os.environ, "PYTHONPATH": path}, cwd=work, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    listed = cli("data").out
    assert "\ngood: \n" in listed
    for name, named in PACKAGES[:7]:
        assert [line for line in listed.splitlines() if named in line], name


def test_a_name_of_ours_is_kept_and_said_once(packages, work, cli):
    (packages / "theirs-1.0.dist-info/entry_points.txt").write_text(
        "[fracbench.datasets]\nsynthetic = good_package:TAKEN\n"
    )
    sys.path.insert(0, str(packages))  # undone by the fixture
    line = "entry point 'synthetic' of theirs 1.0: fracbench has a dataset of this name, which is used; "
    line += "choose another"
    done = cli("sweep", "alpha=1,2", "dataset=synthetic", "sequence=synthetic_flat", "--dry-run")
    assert (done.code, done.err) == (0, f"note: {line}\n")
    assert f"cannot be used: {line}\n" in cli("data").out


def test_entry_points_that_cannot_be_read_leave_our_datasets_alone(packages, pairs, work, cli):
    (packages / "ours-2.0.dist-info/entry_points.txt").write_text("[fracbench.datasets]\ntwice\n")
    done = cli("data", "dataset=folder", "paths.data=pairs")
    assert (done.code, done.err) == (0, "")
    done = cli("sweep", "alpha=1", "dataset=folder", "paths.data=pairs", "--dry-run")
    assert done.code == 0, done.err
    assert done.err.startswith("note: other packages are left out: their entry points cannot be read: ")
