"""Clips that cannot be used give one line and exit code 2, and change no file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fracbench.data import clip as clips
from fracbench.data.files import write_image


@pytest.fixture
def files(images) -> Path:
    """Two good frames in ``clip``, and what is none."""
    for folder in ("clip", "other", "empty", "done", "broken", "alone", "sheet", "tiny", "thin", "names"):
        (images / folder).mkdir()
    for i in (1, 2):
        frame = np.full((24, 32), 90 + i, np.uint8)
        write_image(images / f"clip/f{i}.png", frame)
        write_image(images / f"other/f{i}.png", frame)
        write_image(images / f"sheet/{['', 'a', 'contact_sheet'][i]}.png", frame)
        write_image(images / f"tiny/f{i}.png", frame[:3, :3])
        write_image(images / f"thin/f{i}.png", frame[:, :1])
        (images / f"broken/f{i}.png").write_text("not a picture")
    write_image(images / "alone/f1.png", frame)
    write_image(images / "small.png", frame[:-1])
    for name in ("f", "f.arrows"):
        write_image(images / f"names/{name}.png", frame)
    (images / "empty/notes.txt").write_text("no picture")
    (images / "done/f1.flo").write_text("somebody's truth")
    (images / "file").write_text("a file")
    (images / "broken.mp4").write_bytes(b"\0" * 100)
    (images / "list.mp4").write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n")
    (images / "empty.mp4").touch()
    return images


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["nowhere"], "nowhere: no such file or folder"),
        (["clip/f1.png", "clip/f3.png"], "clip/f3.png: no such file or folder"),
        (["clip/g*.png"], "no file matches 'clip/g*.png'"),
        (["empty"], "empty: the folder holds no pictures (.bmp, "),
        (["alone"], "alone/f1.png: a clip has two or more frames, got one"),
        (["clip/f1.png"], "clip/f1.png: a clip has two or more frames, got one"),
        (["clip/f1.png", "clip/../clip/f1.png"], "a clip has two or more frames, got one"),
        (["clip", "other"], "clip/f1.png and other/f1.png: both flows would be f1.flo; rename one"),
        (["sheet"], "sheet/contact_sheet.png: its flow would be drawn in contact_sheet.png"),
        (["broken"], "no two frames in a row can be used: broken/f1.png: not a picture that can be read"),
        (["tiny"], "frames of 3 x 3 pixels are too small: at least 4 x 4 are needed"),
        (["thin"], "24 x 1 pixels are too few"),
        (["clip", "broken.mp4"], "broken.mp4: a video is a clip of its own; give no other frames with it"),
        (["clip", "alpha=3"], "`alpha` must be in [0, 2], got 3"),
        (["clip", "alpha=0:1:0.5"], "estimate-sequence takes one value a parameter (alpha=0:1:0.5)"),
        (["clip", "alhpa=1"], "unknown parameter 'alhpa': did you mean 'alpha'?"),
        (["clip", "protocol=acurate"], "unknown protocol 'acurate': did you mean 'accurate'?"),
        (["clip", "pad=3"], "`pad` belongs to boundary=zero"),
        (["clip", "--method", "tvl2"], "unknown method 'tvl2': did you mean 'tvl1'?"),
        (["clip", "--jobs", "0"], "--jobs must be at least 1, got 0"),
        (["clip", "--max-motion", "0"], "--max-motion must be a positive number of pixels, got 0"),
        (["clip", "--max-motion", "nan"], "--max-motion must be a positive number of pixels, got nan"),
        (["clip", "--max-motion", "fast"], "argument --max-motion: invalid float value: 'fast'"),
        (
            ["clip", "small.png", "--pairs"],
            "--pairs takes an even number of frames, got 3; the last is small.png",
        ),
        (
            ["clip", "--mask", "small.png"],
            "small.png: the mask is 32 x 23, the frames are 32 x 24 (width x height)",
        ),
        (["clip", "--mask", "broken/f1.png"], "broken/f1.png: not a picture that can be read"),
        (["clip", "--mask"], "argument --mask: expected one argument"),
        (["clip", "--csv", "--scale", "0"], "--scale must be a positive number of mm a pixel, got 0"),
        (["clip", "--csv", "--dt", "-1"], "--dt must be a positive number of seconds, got -1"),
        (["clip", "--arrows", "--grid", "48"], "--grid 48: no vector of it is within frames of 32 x 24 pixels"),
        (["clip", "--grid", "8"], "--grid belongs to --arrows, --vorticity, --csv and --netcdf: give one of them"),
        (["names", "--arrows"], "out/f.arrows.png: two frames would write this file; rename one of them"),
        (["clip", "--threads", "2"], "unexpected argument '--threads'"),
    ],
)
def test_clips_that_cannot_be_used(files, refused, words, named):
    refused(files, ["estimate-sequence", "--jobs", "1", "-o", "out", *words], named)


@pytest.mark.parametrize(
    ("words", "output", "named"),
    [
        (["clip"], "clip", "clip/f1.png: this file lies in the output folder 'clip'; choose another"),
        (["clip"], "other/../clip", "clip/f1.png: this file lies in the output folder"),
        (["clip/*.png"], "clip", "clip/f1.png: this file lies in the output folder 'clip'"),
        (["*/f?.png"], "new", "both flows would be f1.flo"),
        (["cli[p]/f?.png", "new*/f*"], "new", "no file matches 'new*/f*'"),
        (
            ["**/clip/*.png"],
            "new/clip",
            "new/clip: '**/clip/*.png' would match the pictures in this output folder",
        ),
        (["[cn]*/f?.png"], "new", "new: '[cn]*/f?.png' would match the pictures in this output folder too"),
        (["clip"], "file", "file: the folder cannot be created: File exists"),
        (["clip"], "file/out", "file/out"),
        (["clip"], "done", "done/f1.flo: not from an earlier run; choose another output folder"),
    ],
)
def test_output_folders_that_cannot_be_used(files, refused, words, output, named):
    refused(files, ["estimate-sequence", *words, "-o", output, "--jobs", "1"], named)


def test_fields_without_xarray(files, refused, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    named = "--netcdf: NetCDF needs xarray: pip install 'fracbench[piv]'"
    refused(files, ["estimate-sequence", "clip", "-o", "out", "--netcdf"], named)


def test_a_manifest_that_is_a_folder(files, refused):
    (files / "out/manifest.jsonl").mkdir(parents=True)
    refused(
        files, ["estimate-sequence", "clip", "-o", "out", "--jobs", "1"], "out/manifest.jsonl: not a regular file"
    )


@pytest.mark.parametrize("name", ["broken.mp4", "list.mp4", "empty.mp4"])
def test_videos_that_cannot_be_read(files, refused, name):
    pytest.importorskip("av", reason="needs the extra `video`")
    refused(files, ["estimate-sequence", name, "-o", "out"], f"{name}: not a video that can be read (")


def test_a_video_of_one_frame(files, refused):
    pytest.importorskip("av", reason="needs the extra `video`")
    clips.write_video(files / "one.mp4", [np.zeros((24, 32, 3), np.uint8)], 25)
    refused(files, ["estimate-sequence", "one.mp4", "-o", "out"], "one.mp4: a clip has two or more frames, got 1")


def test_frames_of_somebody_else(files, refused):
    pytest.importorskip("av", reason="needs the extra `video`")
    clips.write_video(files / "v.mp4", [np.zeros((24, 32, 3), np.uint8)] * 2, 25)
    (files / "out/frames").mkdir(parents=True)
    (files / "out/frames/v_000000.png").write_text("precious")
    named = "out/frames/v_000000.png: not from an earlier run; choose another output folder"
    refused(files, ["estimate-sequence", "v.mp4", "-o", "out"], named)


def test_a_video_without_the_extra(files, refused, monkeypatch):
    monkeypatch.setattr(clips, "has_video", lambda: False)
    refused(
        files, ["estimate-sequence", "broken.mp4", "-o", "out"],
        "broken.mp4: videos need PyAV: pip install 'fracbench[video]'",
    )  # fmt: skip
