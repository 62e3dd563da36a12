"""Datasets of files: the layouts of folder, Sintel, KITTI and piv, on small folders that are written here."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates

from fracbench.data import read_once
from fracbench.data.datasets import base
from fracbench.data.datasets.registry import digest_of, find_folder, get_dataset, list_sequences, load_sequence
from fracbench.data.files import decode_flow, write_flow, write_image
from fracbench.errors import DataError, InputError
from fracbench.harness.run import compute_point
from fracbench.harness.run.plan import make_plan
from fracbench.methods.method import Method
from fracbench.model.coarse_to_fine import FlowResult

H, W = 24, 32
ANGLE_5, ANGLE_1 = math.atan(5.0), math.pi / 4.0  # of (3, 4, 1) and of (0, 1, 1) with (0, 0, 1)


def frame(seed: int, shape=(H, W, 3)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def put(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, image)
    return path


def put_flow(path: Path, flow: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_flow(path, flow)
    return path


def true_flow() -> np.ndarray:
    """(3, 4) in the upper 16 rows, (0, 1) in the lower 8."""
    flow = np.zeros((2, H, W), np.float32)
    flow[:, :16] = np.float32([[[3]], [[4]]])
    flow[1, 16:] = 1.0
    return flow


def gray_of(image: np.ndarray) -> np.ndarray:
    return (image.astype(int) @ [299, 587, 114]) // 1000


@pytest.fixture
def folder(tmp_path) -> Path:
    for i, name in enumerate(("b", "a")):
        for k in range(2):
            put(tmp_path / name / f"frame{k}.png", frame(2 * i + k))
        put_flow(tmp_path / name / "flow.flo", true_flow())
    return tmp_path


@pytest.fixture
def sintel(tmp_path) -> Path:
    training = tmp_path / "training"
    for kind in ("clean", "final"):
        for number in (1, 2, 3):
            put(training / kind / "alley_1" / f"frame_{number:04d}.png", frame(number))
    invalid, occluded = np.zeros((2, H, W), np.uint8)
    invalid[:, :8] = 255
    occluded[16:] = 255
    for number in (1, 2):
        put_flow(training / "flow" / "alley_1" / f"frame_{number:04d}.flo", true_flow())
        put(training / "invalid" / "alley_1" / f"frame_{number:04d}.png", invalid)
        put(training / "occlusions" / "alley_1" / f"frame_{number:04d}.png", occluded)
    return tmp_path


@pytest.fixture(params=["colored_0", "image_0", "image_2"])
def kitti(request, tmp_path) -> tuple[str, Path]:
    training = tmp_path / "training"
    shape = (H, W) if request.param == "image_0" else (H, W, 3)
    for number in (0, 193):
        for k in (10, 11):
            put(training / request.param / f"{number:06d}_{k}.png", frame(number + k, shape))
        everywhere, visible = true_flow(), true_flow()
        everywhere[:, :, :8] = np.nan
        visible[:, :, :8] = np.nan
        visible[:, 16:] = np.nan
        put_flow(training / "flow_occ" / f"{number:06d}_10.png", everywhere)
        put_flow(training / "flow_noc" / f"{number:06d}_10.png", visible)
    return "kitti2015" if request.param == "image_2" else "kitti2012", tmp_path


@pytest.fixture
def piv(tmp_path) -> Path:
    """Two pairs: `b_2` with a true flow, `a_1` without."""
    there = tmp_path / "particles"
    there.mkdir()
    for i, name in enumerate(("b_2", "a_1")):
        for k in range(2):
            Image.fromarray(frame(2 * i + k, (H, W))).save(there / f"{name}_img{k + 1}.tif")
    put_flow(there / "b_2_flow.flo", np.broadcast_to(np.reshape([3.0, 4.0], (2, 1, 1)), (2, H, W)))
    (there / "README.md").write_text("particles")
    return there


@pytest.fixture
def elsewhere(work, monkeypatch) -> Path:
    """A working folder, below which there is `here`, and no checkout where data could be."""
    monkeypatch.setattr(base, "__file__", str(work / "fracbench/data/datasets/base.py"))
    (work / "here").mkdir()
    monkeypatch.chdir(work / "here")
    return work


@pytest.fixture
def flow_of_zeros(monkeypatch):
    """Every method returns the flow 0, whose errors are known by hand."""

    def estimate(frame0, frame1, params):
        return FlowResult(np.zeros((2, *frame0.shape), np.float32), "none", params)

    zero = Method("zero", "zero", "no motion", estimate)
    monkeypatch.setattr(compute_point, "get_method", lambda name: zero)
    monkeypatch.setattr(compute_point, "energy_growth", lambda *_, **__: None)


def result_of(dataset: str, folder: Path, sequence: str, *tokens: str) -> dict:
    plan = make_plan(
        [f"dataset={dataset}", f"paths.data={folder}", f"sequence={sequence}", "method=tvl1", *tokens]
    )
    outcome = compute_point.run_point(plan.points[0].point, plan.folder)
    assert (outcome.status, outcome.error) == ("done", None)
    return outcome.result


# -- folder --------------------------------------------------------------------------------------


def test_a_folder_gives_its_pairs(folder):
    assert list_sequences("folder", folder) == ("a", "b")
    pair = load_sequence("a", "folder", folder)
    assert (pair.name, pair.dataset, pair.shape, pair.matched) == ("a", "folder", (H, W), None)
    np.testing.assert_array_equal(pair.frame1, gray_of(frame(3)))
    np.testing.assert_array_equal(pair.frame0_color, frame(2))
    np.testing.assert_array_equal(pair.truth, true_flow())
    assert pair.digest == digest_of("a", "folder", folder) != digest_of("b", "folder", folder)


def test_hidden_files_and_other_files_are_no_pairs(folder):
    put(folder / ".trash" / "frame0.png", frame(0))
    put(folder / "notes" / "figure.png", frame(0))
    put(folder / "a" / ".frame0.tif", frame(0))
    (folder / "README.txt").write_text("mine")
    assert list_sequences("folder", folder) == ("a", "b")
    assert load_sequence("a", "folder", folder).shape == (H, W)


@pytest.mark.parametrize("flow", ["flow.flo", "flow10.flo"])
def test_frames_may_be_named_as_middleburys(folder, flow):
    for k in range(2):
        (folder / "a" / f"frame{k}.png").rename(folder / "a" / f"frame1{k}.png")
    (folder / "a" / "flow.flo").rename(folder / "a" / flow)
    pair = load_sequence("a", "folder", folder)
    assert pair.truth is not None
    np.testing.assert_array_equal(pair.frame0, gray_of(frame(2)))


def test_levels_of_16_bits_are_divided_by_257_and_not_rounded(folder):
    levels = np.random.default_rng(1).integers(0, 65536, (H, W)).astype(np.uint16)
    for k in range(2):
        (folder / "a" / f"frame{k}.png").unlink()
        Image.fromarray(levels).save(folder / "a" / f"frame{k}.tif")
    pair = load_sequence("a", "folder", folder)
    np.testing.assert_array_equal(pair.frame0, levels / 257.0)
    assert pair.frame0_color is None


def test_a_mask_leaves_pixels_out(folder, flow_of_zeros):
    assert result_of("folder", folder, "a")["aepe"] == pytest.approx((16 * 5 + 8 * 1) / 24, rel=1e-12)
    mask = np.full((H, W), 255, np.uint8)
    mask[16:] = 0
    put(folder / "a" / "mask.png", mask)
    found = result_of("folder", folder, "a")
    assert (found["aepe"], found["n_pixels"], found["n_unknown"]) == (5.0, 16 * W, 8 * W)
    assert found["fl_all"] == 100.0
    assert "masks" not in found


def test_without_a_true_flow_there_are_no_errors(folder):
    (folder / "a" / "flow.flo").unlink()
    found = result_of("folder", folder, "a", "n_scales=1", "n_warps=1", "max_iter=2")
    assert (found["n_pixels"], found["n_unknown"], found["n_nonfinite"]) == (0, H * W, 0)
    assert not {"aae", "aepe", "sdae", "fl_all", "masks"} & set(found)


# -- Sintel and KITTI, with errors known by hand ---------------------------------------------------


def test_sintel_has_both_passes_and_its_masks(sintel):
    assert list_sequences("sintel", sintel) == (
        "clean_alley_1_0001", "clean_alley_1_0002", "final_alley_1_0001", "final_alley_1_0002",
    )  # fmt: skip
    pair = load_sequence("final_alley_1_0002", "sintel", sintel)
    np.testing.assert_array_equal(pair.frame0_color, frame(2))
    np.testing.assert_array_equal(pair.frame1, gray_of(frame(3)))
    np.testing.assert_array_equal(np.isnan(pair.truth[0]), np.arange(W) < np.full((H, 1), 8))
    np.testing.assert_array_equal(pair.matched, np.arange(H)[:, None] < np.full(W, 16))


def test_the_errors_of_sintel_over_all_matched_and_unmatched_pixels(sintel, flow_of_zeros):
    assert_errors_by_hand(result_of("sintel", sintel, "clean_alley_1_0001"))


def test_the_errors_of_kitti_over_all_matched_and_unmatched_pixels(kitti, flow_of_zeros):
    dataset, folder = kitti
    assert list_sequences(dataset, folder) == ("scene_000000", "scene_000193")
    assert_errors_by_hand(result_of(dataset, folder, "scene_000193"))


def assert_errors_by_hand(found: dict) -> None:
    """24 columns are known: 16 rows of (3, 4), matched, and 8 rows of (0, 1), unmatched; the estimate is 0."""
    n = W - 8
    assert (found["n_pixels"], found["n_unknown"]) == (24 * n, 24 * 8)
    assert found["aepe"] == pytest.approx((16 * 5 + 8) / 24, rel=1e-12)
    assert found["aae"] == pytest.approx((16 * ANGLE_5 + 8 * ANGLE_1) / 24, rel=1e-12)
    assert found["fl_all"] == pytest.approx(100 * 16 / 24, rel=1e-12)  # an error of 1 px is no outlier
    matched, unmatched = found["masks"]["matched"], found["masks"]["unmatched"]
    assert (matched["aepe"], unmatched["aepe"]) == (5.0, 1.0)
    assert matched["aae"] == pytest.approx(ANGLE_5, rel=1e-12)
    assert unmatched["aae"] == pytest.approx(ANGLE_1, rel=1e-12)
    assert (matched["n_pixels"], unmatched["n_pixels"]) == (16 * n, 8 * n)


def test_a_margin_cuts_the_masks_as_well(sintel, flow_of_zeros):
    found = result_of("sintel", sintel, "clean_alley_1_0001", "margin=4")
    # rows 4..19 and columns 4..27, of which 8..27 are known: 12 rows are matched and 4 are not
    assert found["masks"]["matched"]["n_pixels"] == 12 * 20
    assert found["masks"]["unmatched"]["n_pixels"] == 4 * 20


def test_sintel_and_kitti_are_found_in_the_usual_place(sintel, monkeypatch, tmp_path_factory):
    work = tmp_path_factory.mktemp("work")
    monkeypatch.chdir(work)
    with pytest.raises(DataError, match=r"sintel: give paths\.data=FOLDER, or put it at data/sintel; MPI Sintel"):
        find_folder("sintel")
    (work / "data").mkdir()
    (work / "data" / "sintel").symlink_to(sintel)
    assert find_folder("sintel") == sintel.resolve()
    assert len(list_sequences("sintel", find_folder("sintel"))) == 4


# -- particle images -----------------------------------------------------------------------------


def test_particle_images_are_pairs_by_name(piv, flow_of_zeros):
    assert list_sequences("piv", piv) == ("a_1", "b_2")
    pair = load_sequence("b_2", "piv", piv)
    np.testing.assert_array_equal([pair.frame0, pair.frame1], [frame(0, (H, W)), frame(1, (H, W))])
    # of the particles that leave the frame before the middle the displacement is not known
    assert np.isnan(pair.truth[:, -2:]).all() and np.isnan(pair.truth[:, :, -1:]).all()
    np.testing.assert_allclose(
        pair.truth[:, :-2, :-2], np.broadcast_to([[[3.0]], [[4.0]]], (2, H - 2, W - 2)), atol=1e-5
    )
    assert (pair.frame0_color, pair.matched) == (None, None)
    assert load_sequence("a_1", "piv", piv).truth is None
    assert result_of("piv", piv, "b_2")["aepe"] == pytest.approx(5.0, rel=1e-6)


def test_the_look_up_of_particle_images(piv, elsewhere, monkeypatch):
    """paths.data, then the variable, then ../shared/piv, then data/piv."""
    with pytest.raises(
        DataError, match=r"piv: give paths\.data=FOLDER, set FRACBENCH_PIV=FOLDER, or put it at data"
    ):
        find_folder("piv")
    for place in ("data/piv", "../shared/piv"):
        Path(place).mkdir(parents=True)
        assert find_folder("piv") == Path(place).resolve()
    monkeypatch.setenv("FRACBENCH_PIV", "../nowhere")
    with pytest.raises(DataError, match=r"FRACBENCH_PIV=\.\./nowhere: is not a folder; piv: particle images"):
        find_folder("piv")
    monkeypatch.setenv("FRACBENCH_PIV", str(piv))
    assert find_folder("piv") == piv
    assert find_folder("piv", "data/piv") == Path("data/piv").resolve()


def test_the_public_particle_images():
    try:
        there = find_folder("piv")
        names = list_sequences("piv", there)
    except DataError as exc:
        pytest.skip(str(exc))
    for name in names:
        pair = load_sequence(name, "piv", there)
        assert pair.shape == pair.truth.shape[1:]
        assert np.isfinite(pair.truth).mean() > 0.95 and 1.0 < np.nanmax(np.abs(pair.truth)) < 20.0
        assert 0.0 <= pair.frame0.min() < pair.frame0.max() <= 255.0
        # the true flow, of the right sign and order of components, explains most of the change
        change = pair.frame1 - pair.frame0
        y, x = np.mgrid[: pair.shape[0], : pair.shape[1]]
        inner = (slice(16, -16), slice(16, -16))
        truth = np.nan_to_num(pair.truth)
        back = map_coordinates(pair.frame1, [y + truth[1], x + truth[0]], order=3, mode="nearest")
        assert np.std((back - pair.frame0)[inner]) < 0.5 * np.std(change[inner])
        # the flow of the file is that of the middle: the frames agree best where each moves by half of it
        path = there / f"{name}_flow.flo"
        given = decode_flow(path.read_bytes(), str(path))
        left = []
        for share in (0.0, 0.5, 1.0):
            at = [[y + part * given[1], x + part * given[0]] for part in (share - 1.0, share)]
            moved = [map_coordinates(f, a, order=3) for f, a in zip((pair.frame0, pair.frame1), at, strict=True)]
            left.append(np.abs(moved[0] - moved[1])[inner].mean())
        assert left[1] < 1.01 * min(left)  # the flow over the step is too smooth to tell
        kept = np.abs(map_coordinates(pair.frame1, [y + given[1], x + given[0]], order=3) - pair.frame0)[inner]
        assert np.abs(back - pair.frame0)[inner].mean() < 1.01 * kept.mean()


# -- files and workers ---------------------------------------------------------------------------


def test_a_file_is_read_once_as_long_as_it_does_not_change(folder, monkeypatch):
    reads, read_bytes = [], Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: reads.append(path.name) or read_bytes(path))
    first = digest_of("a", "folder", folder)
    pair = load_sequence("a", "folder", folder)
    assert first == digest_of("a", "folder", folder) == pair.digest
    assert sorted(reads) == ["flow.flo", "frame0.png", "frame1.png"]
    path = put(folder / "a" / "frame1.png", frame(99))
    os.utime(path, ns=(0, 1))
    changed = load_sequence("a", "folder", folder)
    np.testing.assert_array_equal(changed.frame1, gray_of(frame(99)))
    assert changed.digest != first
    assert reads.count("frame1.png") == 2


def test_large_files_are_not_kept(folder, monkeypatch):
    monkeypatch.setattr(read_once, "_MAX_KEPT", 10)
    read_once._read.cache_clear()
    load_sequence("a", "folder", folder)
    assert read_once._read.cache_info().currsize == 0


@pytest.mark.parametrize("dataset", ["folder", "sintel", "piv"])
def test_the_files_of_a_pair_are_all_that_a_worker_needs(dataset, request, tmp_path_factory):
    source = request.getfixturevalue(dataset)
    name = list_sequences(dataset, source)[0]
    there = tmp_path_factory.mktemp("worker")
    for path, data in get_dataset(dataset).contents(name, source).items():
        (there / path).parent.mkdir(parents=True, exist_ok=True)
        (there / path).write_bytes(data)
    assert load_sequence(name, dataset, there).digest == digest_of(name, dataset, source)


# -- commands ------------------------------------------------------------------------------------

TINY = ["n_scales=1", "n_warps=1", "max_iter=2", "--jobs", "1"]


def sweep_table(work: Path) -> pd.DataFrame:
    return pd.read_csv(max((work / "results/sweeps").glob("*.csv"), key=lambda path: path.stat().st_mtime_ns))


def test_a_changed_file_is_computed_again_and_says_why(folder, cli, work):
    words = ["sweep", "dataset=folder", f"paths.data={folder}", "method=tvl1", *TINY]
    assert "2 points computed (2 new)" in cli(*words).err
    assert "nothing to compute: all 2 points are in the store" in cli(*words).err
    put(folder / "a" / "frame1.png", frame(99))
    assert "1 points computed (1 data changed), 1 taken from the store" in cli(*words).err


def test_columns_of_masks_are_in_the_tables_of_datasets_that_have_them(sintel, cli, work):
    done = cli("sweep", "dataset=sintel", f"paths.data={sintel}", "sequence=clean_*", "method=tvl1", *TINY)
    assert done.code == 0
    table = sweep_table(work)
    assert table["sequence"].tolist() == ["clean_alley_1_0001", "clean_alley_1_0002"]
    for column in ("aepe_matched", "aae_matched", "sdae_matched", "aepe_unmatched", "fl_all"):
        assert table[column].notna().all()
    assert cli("sweep", "sequence=synthetic_flat", "method=tvl1", *TINY).code == 0
    assert not [c for c in sweep_table(work).columns if "matched" in c or c == "fl_all"]


def test_flows_without_truth_are_computed_and_drawn(folder, cli, work):
    for name in ("a", "b"):
        (folder / name / "flow.flo").unlink()
    done = cli("sweep", "dataset=folder", f"paths.data={folder}", "alpha=1,1.2", *TINY)
    assert (done.code, "no errors: the true flow is not known" in done.out) == (0, True)
    table = sweep_table(work)
    assert set(table["status"]) == {"done"} and table["aepe"].isna().all()
    assert len(list((work / "results/runs/flows").glob("*.flo"))) == 4
    assert len(list((work / "results/sweeps").glob("*__flows.png"))) == 1
    done = cli("compare", "results", "results")
    assert (done.code, "points: agree" in done.out) == (0, True)


def test_an_experiment_takes_all_pairs_and_its_files_say_so(folder, cli, work):
    experiments = work / "experiments"
    experiments.mkdir()
    (experiments / "mine.yaml").write_text(
        "title: mine\nartefact: table2\ngrid:\n"
        "  - sequence=grove2,venus\n  - method=tvl1,tvl1_sb\n  - n_scales=1\n  - n_warps=1\n  - max_iter=2\n"
    )
    words = ["dataset=folder", f"paths.data={folder}", "--jobs", "1"]
    assert cli("experiment", "mine", *words).code == 0
    table = pd.read_csv(work / "results/tables/mine__folder.csv")
    assert table["sequence"].unique().tolist() == ["a", "b"]
    assert table["published"].isna().all() and table["ours"].notna().all()


def test_numbers_as_names_of_pairs(folder):
    (folder / "a").rename(folder / "0010")
    made = make_plan(["dataset=folder", f"paths.data={folder}", "sequence=0010", "method=tvl1"])
    assert [planned.labels["sequence"] for planned in made.points] == ["0010"]
    with pytest.raises(InputError, match=r"unknown sequence 'c' of dataset folder \(2 pairs, from 0010 to b\)"):
        make_plan(["dataset=folder", f"paths.data={folder}", "sequence=c"])
    (folder / "b").rename(folder / "010")
    with pytest.raises(InputError, match="unknown sequence '10' of dataset folder"):  # which of the two?
        make_plan(["dataset=folder", f"paths.data={folder}", "sequence=10"])


def test_parameters_are_the_protocols(folder):
    made = make_plan(["dataset=folder", f"paths.data={folder}", "protocol=accurate", "sequence=a"])
    point = made.points[0].point
    assert (point.method, point.canonical["lambda"]) == ("tvl1_sb_alpha_ic", "0.25")


def test_the_data_command_tells_a_folder(folder, cli, work):
    assert cli("data", "dataset=folder", f"paths.data={folder}").out == f"folder: {folder}: 2 pairs: a, b\n"


def test_every_dataset_is_listed_with_its_state(cli, work, no_middlebury, sintel, piv, monkeypatch):
    monkeypatch.setenv("FRACBENCH_PIV", str(piv))
    (work / "data").mkdir()
    (work / "data" / "sintel").symlink_to(sintel)
    done = cli("data")
    assert done.code == 2 and "the Middlebury data were not found" in done.err
    assert "synthetic: 16 rendered scenes with exact flow\n" in done.out
    assert f"sintel: found at {sintel.resolve()}\n" in done.out
    assert f"piv: found at {piv}\n" in done.out
    for name in ("folder", "kitti2012", "kitti2015"):
        assert f"{name}: missing: give paths.data=FOLDER, or put it at data/{name}; " in done.out


@pytest.mark.middlebury
def test_copies_of_middlebury_have_middleburys_errors_to_the_last_digit(middlebury, cli, work):
    for name in ("RubberWhale", "Venus"):
        (work / "pairs" / name).mkdir(parents=True)
        for file in ("frame10.png", "frame11.png", "flow10.flo"):
            (work / "pairs" / name / file).write_bytes((middlebury / name / file).read_bytes())
    same = ["method=tvl1,tvl1_sb_alpha", "lambda=0.3", "theta=0.3", "lambda_sb=10", "n_scales=3", "n_warps=1",
            "max_iter=3", "--jobs", "1"]  # fmt: skip
    tables = []
    for words in (
        ["dataset=folder", "paths.data=pairs", "sequence=all"],
        ["dataset=middlebury", f"paths.data={middlebury}", "sequence=rubberwhale,venus"],
    ):
        assert cli("sweep", *words, *same).code == 0
        tables.append(sweep_table(work)[["aae", "aepe", "sdae", "n_pixels", "n_unknown", "iterations"]])
    pd.testing.assert_frame_equal(*tables, check_exact=True)
