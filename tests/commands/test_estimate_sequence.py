"""`fracbench estimate-sequence` as a user sees it: files, messages, exit codes, what is computed again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import fracbench
from fracbench import estimate_flow
from fracbench.commands import estimate_sequence as command
from fracbench.commands.cli import EXIT_DONE, EXIT_FAILED
from fracbench.data import clip as clips
from fracbench.data.files import read_flow, read_image, write_image
from fracbench.data.manifest import MANIFEST
from fracbench.errors import RESUME, InputError
from fracbench.figures import fields as figures
from fracbench.figures.flowcolor import flow_to_color

QUICK = ("n_scales=1", "n_warps=1", "max_iter=2", "--jobs", "1")
NAMES = [f"f{i}" for i in range(8, 12)]  # f10 and f11 come last, though not by the alphabet


def frame(i: int, shape: tuple[int, int] = (24, 32)) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.round(127 + 60 * np.cos(0.5 * (x - 0.8 * i)) * np.cos(0.4 * y)).astype(np.uint8)


@pytest.fixture
def clip(work, monkeypatch) -> Path:
    """A working folder with a clip of five frames in the folder `clip`; no video can be written."""
    monkeypatch.setattr(clips, "has_video", lambda: False)
    (work / "clip").mkdir()
    for i in range(8, 13):
        write_image(work / f"clip/f{i}.png", frame(i))
    return work


@pytest.fixture
def computed(monkeypatch) -> list[str]:
    """The names of the flows that are computed, as they are."""
    names: list[str] = []
    estimate = command._estimate

    def noted(*call):
        names.append(call[2].stem)
        return estimate(*call)

    monkeypatch.setattr(command, "_estimate", noted)
    return names


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_folder_becomes_flows_pictures_and_a_contact_sheet(cli, clip):
    done = cli("estimate-sequence", "clip", "-o", "out/flows", "alpha=0.8", *QUICK)
    assert done.code == EXIT_DONE
    preset = "preset recommended with alpha=0.8 n_scales=1 n_warps=1 max_iter=2"
    assert done.out.startswith(f"tvl1_sb_alpha ({preset}), flows: 4 computed (4 new), 0 kept\n")
    assert "wrote out/flows/contact_sheet.png" in done.out and "pip install 'fracbench[video]'" in done.err
    written = {f"{name}{suffix}" for name in NAMES for suffix in (".flo", ".png")}
    assert {*files(clip / "out/flows")} == written | {MANIFEST, command.SHEET}
    flows = [read_flow(f"out/flows/{name}.flo") for name in NAMES]
    for i, flow in enumerate(flows, start=8):
        expected = estimate_flow(frame(i), frame(i + 1), alpha=0.8, n_scales=1, n_warps=1, max_iter=2)
        np.testing.assert_array_equal(flow, expected.flow)
    scale = max(float(np.quantile(np.hypot(*flow), 0.999)) for flow in flows)
    assert f"colours: full at {scale:.3g} px a frame" in done.out
    for name, flow in zip(NAMES, flows, strict=True):
        np.testing.assert_array_equal(read_image(f"out/flows/{name}.png"), flow_to_color(flow, scale))
    assert read_image("out/flows/contact_sheet.png").shape[1] == 1280


def test_processes_globs_and_lists_give_the_same_files(cli, clip, monkeypatch):
    assert cli("estimate-sequence", "clip", "-o", "one", *QUICK).code == EXIT_DONE
    two = ("n_scales=1", "n_warps=1", "max_iter=2", "--jobs", "2")
    assert cli("estimate-sequence", "clip/f*.png", "-o", "two", *two).code == EXIT_DONE
    listed = sorted(map(str, Path("clip").iterdir()))
    assert listed[0].endswith("f10.png")
    assert cli("estimate-sequence", *listed, "n_scales=1", "-o", "three", *QUICK[1:]).code == EXIT_DONE
    monkeypatch.chdir("clip")  # the processes were started in the folder above
    assert cli("estimate-sequence", "../clip", "-o", "../four", *two).code == EXIT_DONE
    kept = files(clip / "one")
    del kept[MANIFEST]
    for folder in ("two", "three", "four"):
        found = files(clip / folder)
        del found[MANIFEST]
        assert found == kept


def test_a_protocol_and_a_method_may_be_chosen(cli, clip):
    done = cli("estimate-sequence", "clip", "-o", "out", "protocol=reference", *QUICK)
    assert done.out.startswith("tvl1_sb_alpha (preset reference with n_scales=1 n_warps=1 max_iter=2), flows: 4 ")
    done = cli("estimate-sequence", "clip", "-o", "out", "--method", "tvl1", *QUICK)
    assert done.out.startswith("tvl1 (preset recommended with n_scales=1 n_warps=1 max_iter=2), flows: 4 computed")
    assert "(4 settings changed)" in done.out
    expected = estimate_flow(frame(8), frame(9), method="tvl1", n_scales=1, n_warps=1, max_iter=2)
    np.testing.assert_array_equal(read_flow("out/f8.flo"), expected.flow)


def test_a_clip_without_motion_is_drawn_too(cli, clip):
    for i in range(8, 13):
        write_image(clip / f"clip/f{i}.png", frame(8))
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_DONE and "colours: full at 1 px a frame" in done.out
    assert (read_image("out/f8.png") == 255).all()


# -- resuming ------------------------------------------------------------------------------------


def test_finished_files_are_kept_to_the_byte(cli, clip, computed):
    cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in (clip / "out").glob("f*")}
    del computed[:]
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_DONE and ", flows: 0 computed, 4 kept\n" in done.out
    assert computed == []
    assert before == {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in (clip / "out").glob("f*")}


@pytest.mark.parametrize(
    ("change", "again", "why"),
    [
        (lambda: write_image("clip/f9.png", frame(3)), ["f8", "f9"], "2 frames changed"),
        (lambda: write_image("clip/f13.png", frame(13)), ["f12"], "1 new"),
        (lambda: Path("out/f10.flo").unlink(), ["f10"], "1 file missing"),
        (lambda: Path("out/f10.flo").write_bytes(b"PIEH"), ["f10"], "1 file changed"),
        (lambda: Path("out", MANIFEST).write_text("[[[\n{}\n7\n"), NAMES, "4 new"),
        (lambda: Path("out", MANIFEST).write_bytes(Path("out", MANIFEST).read_bytes()[:-60]), [], ""),
    ],
)
def test_a_change_is_computed_again_and_told(cli, clip, computed, change, again, why):
    cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    expected = files(clip / "out")
    del computed[:]
    change()
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_DONE and computed == again
    assert f", flows: {len(again)} computed{f' ({why})' if why else ''}, " in done.out
    if not why.startswith(("2 frames", "1 new")):
        found = files(clip / "out")
        assert {name: found[name] for name in expected if name != MANIFEST} == {
            name: content for name, content in expected.items() if name != MANIFEST
        }


def test_another_setting_computes_all_again_another_scale_only_draws(cli, clip, computed):
    cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    del computed[:]
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK, "--max-motion", "4")
    assert computed == [] and "colours: full at 4 px" in done.out
    np.testing.assert_array_equal(read_image("out/f8.png"), flow_to_color(read_flow("out/f8.flo"), 4.0))
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK, "alpha=0.5")
    assert computed == NAMES and "(4 settings changed)" in done.out


def test_another_version_of_the_solver_or_of_the_method_computes_all_again(cli, clip, computed, monkeypatch):
    cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    for place, value in (("model.SOLVER_VERSION", 99), ("methods.method.Method.stamp", "package 2")):
        del computed[:]
        monkeypatch.setattr(f"fracbench.{place}", value)
        done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
        assert computed == NAMES and "(4 settings changed)" in done.out


def test_the_solver_is_compiled_before_there_are_processes(cli, clip, computed, monkeypatch):
    monkeypatch.setattr(
        command, "compile_for", lambda settings, **_: computed.extend(name for name, _ in settings)
    )
    cli("estimate-sequence", "clip", "-o", "out", "--method", "tvl1", *QUICK)
    assert computed == ["tvl1", *NAMES]


def test_a_number_that_is_gone_from_the_manifest_is_no_crash(cli, clip, computed):
    cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    lines = [json.loads(line) for line in Path("out", MANIFEST).read_text().splitlines()]
    Path("out", MANIFEST).write_text("".join(f"{json.dumps({**line, 'speed': 'fast'})}\n" for line in lines))
    del computed[:]
    assert cli("estimate-sequence", "clip", "-o", "out", *QUICK).code == EXIT_DONE
    assert computed == NAMES


@pytest.mark.parametrize("number", ["fast", None, float("nan"), -7, 10**30])
def test_frames_of_a_video_with_an_entry_that_was_changed_are_read_again(cli, video, number):
    cli("estimate-sequence", "v.mp4", "-o", "out", *QUICK)
    for key in ("count", "rate"):
        path = Path("out/frames", MANIFEST)
        path.write_text(json.dumps({**json.loads(path.read_text().splitlines()[-1]), key: number}))
        done = cli("estimate-sequence", "v.mp4", "-o", "out", *QUICK)
        assert done.code == EXIT_DONE and "flows: 0 computed, 3 kept" in done.out


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished(work):
    (work / "clip").mkdir()
    for i in range(40):
        write_image(work / f"clip/f{i}.png", frame(i, (128, 160)))
    words = [sys.executable, "-m", "fracbench", "estimate-sequence", "clip", "-o", "out", "n_warps=40"]
    environment = {**os.environ, "PYTHONPATH": str(Path(fracbench.__file__).parents[1])}
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background ignores it
    running = subprocess.Popen(
        [*words, "epsilon=0"], cwd=work, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    signal.signal(signal.SIGINT, before)
    deadline = time.monotonic() + 120
    while len([*work.glob("out/f*.flo")]) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does, to all processes
    _, said = running.communicate(timeout=60)
    assert (running.returncode, said) == (130, f"fracbench: interrupted; {RESUME}\n")
    kept = {path.name: path.read_bytes() for path in work.glob("out/f*.flo")}
    noted = {json.loads(line)["file"] for line in (work / "out" / MANIFEST).read_text().splitlines()}
    assert 3 <= len(kept) < 39 and len({*kept} - noted) <= 2  # of a worker that was stopped between the two
    assert not [*work.glob("out/.f*")]


# -- frames that cannot be used ------------------------------------------------------------------


def test_a_bad_frame_costs_its_two_flows_and_is_named_once(cli, clip):
    whole = (clip / "clip/f9.png").read_bytes()
    (clip / "clip/f9.png").write_bytes(whole[: len(whole) // 2])
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_FAILED
    lines = [line for line in done.err.splitlines() if line.startswith("fracbench: ")]
    assert lines[0].startswith("fracbench: clip/f9.png: not a picture that can be read (")
    assert lines[1:] == ["fracbench: missing flows: 2 of 4; the same command tries them again"]
    assert "flows: 2 computed (2 new), 0 kept" in done.out
    assert {path.name for path in Path("out").glob("*.flo")} == {"f10.flo", "f11.flo"}
    (clip / "clip/f9.png").write_bytes(whole)
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_DONE and "flows: 2 computed (2 new), 2 kept" in done.out


def test_a_frame_of_another_size_is_named_once(cli, clip):
    write_image(clip / "clip/f12.png", frame(12)[:-1])
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_FAILED
    assert "clip/f12.png: 32 x 23 pixels (width x height), but most frames have 32 x 24\n" in done.err
    assert "fracbench: missing flows: 1 of 4;" in done.err and "flows: 3 computed" in done.out


def test_a_flow_that_fails_costs_no_other(cli, clip, monkeypatch):
    from fracbench import api

    estimate = api.estimate_flow

    def fails_on_f10(first, second, **settings):
        if np.array_equal(first, frame(10)):
            raise MemoryError("too much")
        return estimate(first, second, **settings)

    monkeypatch.setattr(api, "estimate_flow", fails_on_f10)
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_FAILED and "flows: 3 computed" in done.out
    assert "fracbench: no flow from f10: MemoryError: too much (" in done.err


def test_a_diverged_flow_is_no_flow(cli, clip, monkeypatch):
    from fracbench import api

    estimate = api.estimate_flow

    def diverges(first, second, **settings):
        result = estimate(first, second, **settings)
        result.flow[:] = np.nan
        return result

    monkeypatch.setattr(api, "estimate_flow", diverges)
    done = cli("estimate-sequence", "clip", "-o", "out", *QUICK)
    assert done.code == EXIT_FAILED and "flows: 0 computed" in done.out
    assert "fracbench: no flow from f8, f9, f10, f11: the computation diverged" in done.err
    assert not [*Path("out").glob("f*")]


def test_sixteen_bits_and_colour_are_frames_too(cli, clip):
    from PIL import Image

    for i in range(8, 13):
        Image.fromarray(frame(i).astype(np.uint16) * 257).save(f"clip/f{i}.png")
    write_image("clip/f8.png", np.repeat(frame(8)[..., None], 3, axis=2))
    assert cli("estimate-sequence", "clip", "-o", "out", *QUICK).code == EXIT_DONE


# -- videos --------------------------------------------------------------------------------------


@pytest.fixture
def video(clip, monkeypatch) -> Path:
    pytest.importorskip("av", reason="needs the extra `video`")
    monkeypatch.undo()
    monkeypatch.chdir(clip)
    clips.write_video("v.mp4", (np.repeat(frame(i, (23, 33))[..., None], 3, axis=2) for i in range(4)), 12.5)
    return clip


def test_a_video_becomes_flows_and_a_video_of_their_colours(cli, video):
    done = cli("estimate-sequence", "v.mp4", "-o", "out", *QUICK)
    assert done.code == EXIT_DONE and "flows: 3 computed (3 new), 0 kept" in done.out
    assert "wrote out/flow.mp4" in done.out
    assert {path.name for path in Path("out").glob("*.flo")} == {f"v_{i:06d}.flo" for i in range(3)}
    shown = [*clips.read_video("out/flow.mp4")]
    assert len(shown) == 3 and {rate for _, rate in shown} == {12.5}
    for i, (picture, _) in enumerate(shown):
        drawn = read_image(f"out/v_{i:06d}.png")
        assert picture.shape == (24, 34, 3) == drawn.shape  # odd sides were padded twice
        assert np.abs(picture.astype(float) - drawn).mean() < 12
    done = cli("estimate-sequence", "v.mp4", "-o", "out", *QUICK)
    assert "flows: 0 computed, 3 kept" in done.out and "reading the frames" not in done.err


def test_another_video_of_the_name_is_read_again(cli, video):
    cli("estimate-sequence", "v.mp4", "-o", "out", *QUICK)
    clips.write_video("v.mp4", (np.repeat(frame(2 * i)[..., None], 3, axis=2) for i in range(3)), 25)
    done = cli("estimate-sequence", "v.mp4", "-o", "out", *QUICK)
    assert done.code == EXIT_DONE and "flows: 2 computed (2 frames changed), 0 kept" in done.out


def test_the_frames_before_a_fault_in_a_video_are_used(cli, video, monkeypatch):
    whole = [*clips.read_video("v.mp4")]

    def cut(path):
        yield from whole[:3]
        raise InputError(f"{path}: not a video that can be read (cut off)")

    monkeypatch.setattr(clips, "read_video", cut)
    for _ in range(2):
        done = cli("estimate-sequence", "v.mp4", "-o", "out", *QUICK)
        assert done.code == EXIT_FAILED
        assert "v.mp4: not a video that can be read (cut off); the 3 frames before the fault are used" in done.err
        assert len([*Path("out").glob("*.flo")]) == 2


def test_the_help_names_every_option(cli):
    said = cli("estimate-sequence", "--help").out
    for word in ("FRAMES", "--output", "--jobs", "--method", "--max-motion", "protocol=accurate"):
        assert word in said


# -- velocity fields -----------------------------------------------------------------------------

FIELDS = ("--arrows", "--vorticity", "--csv", "--netcdf", "--grid", "8", "--scale", "0.5", "--dt", "0.1")


def test_every_flow_has_the_files_of_its_field_on_one_colour_scale(cli, clip, monkeypatch):
    xarray = pytest.importorskip("xarray")
    drawn = []
    draw = figures.arrow_figure, figures.vorticity_figure
    for i, name in enumerate(("arrow_figure", "vorticity_figure")):
        monkeypatch.setattr(figures, name, lambda *args, i=i: drawn.append((i, args[-1])) or draw[i](*args))
    mask = np.zeros((24, 32), np.uint8)
    mask[:5, :7] = 255
    write_image("mask.png", mask)
    done = cli("estimate-sequence", "clip", "-o", "out", "--mask", "mask.png", *FIELDS, *QUICK)
    assert done.code == EXIT_DONE
    told = "wrote the velocity fields (NAME.arrows.png, NAME.vorticity.png, NAME.csv, NAME.nc) to out"
    assert told in done.out
    assert len(drawn) == 8
    assert [top for i, top in drawn if i == 0] == pytest.approx([5 * max_speed(clip / "out")] * 4)
    tops = [top for i, top in drawn if i == 1]
    turning = []
    for i, name in enumerate(NAMES, start=8):
        expected = estimate_flow(frame(i), frame(i + 1), mask=mask > 0, n_scales=1, n_warps=1, max_iter=2)
        np.testing.assert_array_equal(read_flow(f"out/{name}.flo"), expected.flow)
        with xarray.open_dataset(f"out/{name}.nc") as read:
            np.testing.assert_array_equal(read.mask[::-1], mask > 0)
            np.testing.assert_allclose(read.v[::-1].values[mask == 0], -5 * expected.flow[1][mask == 0], rtol=1e-6)
            turning.append(float(np.nanquantile(abs(read.vorticity), 0.999)))
        table = np.loadtxt(f"out/{name}.csv", delimiter=",", skiprows=1)
        assert table.shape == (12, 6)
    assert tops == pytest.approx([max(turning)] * 4, rel=1e-5)


def max_speed(folder: Path) -> float:
    """The largest of the speeds that 99.9 % of the pixels of a flow keep below, pixels."""
    return max(float(np.quantile(np.hypot(*read_flow(path)), 0.999)) for path in folder.glob("*.flo"))


def test_fields_are_kept_and_made_again_where_something_changed(cli, clip):
    words = ("estimate-sequence", "clip", "-o", "out", *QUICK)
    fields = ("--csv", "--arrows", "--grid", "8")
    assert cli(*words).code == EXIT_DONE
    without = files(clip / "out")
    done = cli(*words, *fields)
    assert ", flows: 0 computed, 4 kept\n" in done.out
    before = {path.name: path.stat().st_mtime_ns for path in (clip / "out").glob("f*")}
    assert {name for name in before if name not in without} == {
        f"{name}{suffix}" for name in NAMES for suffix in (".csv", ".arrows.png")
    }
    cli(*words, *fields)
    assert before == {path.name: path.stat().st_mtime_ns for path in (clip / "out").glob("f*")}
    (clip / "out/f9.csv").unlink()
    cli(*words, *fields)
    changed = {path.name for path in (clip / "out").glob("f*") if before[path.name] != path.stat().st_mtime_ns}
    assert changed == {"f9.csv"}
    cli(*words, *fields, "--dt", "0.5")
    first = np.loadtxt("out/f8.csv", delimiter=",", skiprows=1)
    flow = read_flow("out/f8.flo")
    assert tuple(first[0, 2:4]) == (pytest.approx(2 * flow[0, 4, 4]), pytest.approx(-2 * flow[1, 4, 4]))


def test_another_mask_is_another_flow(cli, clip, computed):
    words = ("estimate-sequence", "clip", "-o", "out", *QUICK)
    for name, side in (("one", 5), ("two", 9)):
        mask = np.zeros((24, 32), np.uint8)
        mask[:side, :side] = 255
        write_image(f"{name}.png", mask)
    cli(*words, "--mask", "one.png")
    assert computed == NAMES
    assert "(4 mask changed)" in cli(*words, "--mask", "two.png").out
    assert ", flows: 0 computed, 4 kept" in cli(*words, "--mask", "two.png").out
    assert "(4 mask changed)" in cli(*words).out


def test_pairs_have_a_flow_from_each_first_frame_to_its_second(cli, clip):
    Path("clip/f12.png").unlink()
    done = cli("estimate-sequence", "clip", "-o", "out", "--pairs", *QUICK)
    assert done.code == EXIT_DONE and ", flows: 2 computed (2 new), 0 kept\n" in done.out
    assert {path.stem for path in Path("out").glob("*.flo")} == {"f8", "f10"}
    expected = estimate_flow(frame(10), frame(11), n_scales=1, n_warps=1, max_iter=2)
    np.testing.assert_array_equal(read_flow("out/f10.flo"), expected.flow)
    Path("clip/f9.png").write_bytes(b"")
    done = cli("estimate-sequence", "clip", "-o", "other", "--pairs", *QUICK)
    assert done.code == EXIT_FAILED and "missing flows: 1 of 2;" in done.err
