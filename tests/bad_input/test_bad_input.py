"""Bad input of every kind gives one line that names it and exit code 2, and changes no file."""

from __future__ import annotations

import hashlib
import io
import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fracbench import estimate_flow
from fracbench.commands.cli import main
from fracbench.data.datasets import middlebury as middlebury_data
from fracbench.data.files import write_flo, write_image
from fracbench.errors import InputError

FLAT = ("sequence=synthetic_flat", "n_scales=1", "n_warps=1", "max_iter=1")


def png_bytes(width: int, height: int, depth: int, colour: int, raw: bytes) -> bytes:
    """A PNG assembled by hand, whose header may promise any size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")


def tiff_of_floats() -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.zeros((24, 32), np.float32)).save(file, "TIFF")
    return file.getvalue()


def tiff_of_deep_colour() -> bytes:
    """A TIFF of 32 x 24 pixels with 16 bits a colour, which Pillow does not write."""
    pixels = bytes(6 * 32 * 24)
    bits = 8 + len(pixels)
    tags = [  # number, type (3: 16 bits, 4: 32 bits), count, value
        (256, 3, 1, 32), (257, 3, 1, 24), (258, 3, 3, bits), (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, 1, 8),
        (277, 3, 1, 3), (278, 3, 1, 24), (279, 4, 1, len(pixels)),
    ]  # fmt: skip
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    return b"II*\0" + struct.pack("<I", bits + 6) + pixels + struct.pack("<HHH", 16, 16, 16) + directory


def bmp_of(frame: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(frame).save(file, "BMP")
    return file.getvalue()


@pytest.fixture
def files(images) -> Path:
    """Good files and bad ones of every kind."""
    frame = np.full((24, 32), 90, np.uint8)
    write_image(images / "small.png", frame[:-1])
    write_image(images / "thin.png", frame[:, :1])
    write_image(images / "tiny.png", frame[:3, :3])
    (images / "text.png").write_text("not a picture")
    (images / "empty.png").touch()
    whole = (images / "a.png").read_bytes()
    (images / "cut.png").write_bytes(whole[: len(whole) // 2])
    (images / "folder").mkdir()
    (images / "folder.png").mkdir()
    flow = (images / "t.flo").read_bytes()
    (images / "empty.flo").touch()
    (images / "cut.flo").write_bytes(flow[:-1])
    (images / "long.flo").write_bytes(flow + b"\0")
    (images / "huge.flo").write_bytes(b"PIEH" + struct.pack("<ii", 31_623, 31_623) + b"\0" * 64)
    (images / "negative.flo").write_bytes(b"PIEH" + struct.pack("<ii", -1, 24) + b"\0" * 64)
    (images / "tag.flo").write_bytes(b"HEIP" + flow[4:])
    kitti = png_bytes(32, 24, 16, 2, b"".join(b"\0" + bytes(6 * 32) for _ in range(24)))
    (images / "kitti_cut.png").write_bytes(kitti[:-30])
    (images / "kitti_short.png").write_bytes(png_bytes(32, 24, 16, 2, b"\0" * 100))
    (images / "kitti_huge.png").write_bytes(png_bytes(99_999, 99_999, 16, 2, b"\0"))
    (images / "kitti_wide.png").write_bytes(png_bytes(9_400, 9_400, 16, 2, b"\0"))
    (images / "kitti_crc.png").write_bytes(kitti[:40] + bytes([kitti[40] ^ 255]) + kitti[41:])
    (images / "bomb.png").write_bytes(png_bytes(99_999, 99_999, 8, 2, b"\0"))
    (images / "wide.png").write_bytes(png_bytes(9_000, 9_000, 8, 2, b"\0"))
    (images / "deep.tiff").write_bytes(tiff_of_floats())
    (images / "script.eps").write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 32 24\nshowpage\n%%EOF\n")
    (images / "drawing.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="32" height="24"/>')
    (images / "deep_colour.tif").write_bytes(tiff_of_deep_colour())
    pages = [Image.fromarray(frame), Image.fromarray(frame)]
    pages[0].save(images / "pages.tif", save_all=True, append_images=pages[1:])
    (images / "empty.tif").touch()
    (images / "cut.bmp").write_bytes(bmp_of(frame)[:-200])
    write_flo(images / "other.flo", np.zeros((2, 24, 31), np.float32))
    write_flo(images / "taken.flo", np.zeros((2, 24, 32), np.float32))
    return images


# -- files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame0", "frame1", "named"),
    [
        ("a.png", "small.png", ("frames differ in size: 32 x 24 and 32 x 23",)),
        ("thin.png", "thin.png", ("24 x 1 pixels are too few",)),
        ("tiny.png", "tiny.png", ("frames of 3 x 3 pixels are too small",)),
        ("text.png", "b.png", ("text.png: not a picture that can be read",)),
        ("a.png", "text.png", ("text.png: not a picture that can be read",)),
        ("empty.png", "b.png", ("empty.png: not a picture",)),
        ("cut.png", "b.png", ("cut.png: not a picture",)),
        ("folder.png", "b.png", ("folder.png: not a regular file",)),
        ("missing.png", "b.png", ("missing.png: cannot be read: No such file",)),
        ("a.png", "a.png/b.png", ("a.png/b.png: cannot be read",)),
        ("t.flo", "b.png", ("t.flo: not a picture",)),
        ("bomb.png", "b.png", ("bomb.png: not a picture", "decompression bomb")),
        ("wide.png", "b.png", ("wide.png: not a picture", "bytes cannot hold 9000 x 9000 pixels")),
        ("deep.tiff", "b.png", ("deep.tiff: not a picture", "floating-point; 8 or 16 bits")),
        (
            "deep_colour.tif",
            "b.png",
            ("deep_colour.tif: not a picture", "16-bit colour; convert it to 16-bit gray"),
        ),
        ("a.png", "pages.tif", ("pages.tif: not a picture", "a TIFF of 2 pages; save each frame as a file")),
        ("empty.tif", "b.png", ("empty.tif: not a picture",)),
        ("cut.bmp", "b.png", ("cut.bmp: not a picture",)),
        ("script.eps", "b.png", ("script.eps: not a picture", "unknown format")),
        ("drawing.svg", "b.png", ("drawing.svg: not a picture", "unknown format")),
        ("a.png\nb.png", "b.png", ("a.png b.png: cannot be read",)),
    ],
)
def test_images_that_cannot_be_used(files, refused, frame0, frame1, named):
    refused(files, ["estimate", frame0, frame1, "-o", "out.flo"], *named)


def test_the_log_of_pillow_is_no_second_line(files, refused, caplog):
    shutil.copy(Path(__file__).parents[1] / "fuzz" / "corpus" / "picture" / "tiff_samples", files)
    refused(files, ["estimate", "a.png", "tiff_samples", "-o", "out.flo"], "tiff_samples: not a picture")
    assert not caplog.records


@pytest.mark.parametrize(
    ("truth", "named"),
    [
        ("empty.flo", "empty.flo: the file is empty"),
        ("cut.flo", "cut.flo: cut off: 32 x 24 needs 6156 bytes, found 6155"),
        ("long.flo", "long.flo: followed by something else: 32 x 24 needs 6156 bytes, found 6157"),
        ("huge.flo", "huge.flo: cut off: 31623 x 31623 needs"),
        ("negative.flo", "negative.flo: width -1 x height 24 is not within"),
        ("tag.flo", "tag.flo: not a .flo file (it starts with b'HEIP'"),
        ("other.flo", "other.flo: the true flow is 31 x 24, the frames are 32 x 24"),
        ("missing.flo", "missing.flo: cannot be read"),
        ("a.png", "a.png: "),
        ("text.png", "text.png: not a PNG file"),
        ("a.txt", "a.txt: unknown flow format '.txt'"),
        ("kitti_cut.png", "kitti_cut.png: damaged PNG"),
        ("kitti_short.png", "kitti_short.png: damaged PNG"),
        ("kitti_crc.png", "kitti_crc.png: damaged PNG"),
        ("kitti_huge.png", "kitti_huge.png: width 99999 x height 99999 is not within"),
        ("kitti_wide.png", "bytes cannot hold 9400 x 9400 pixels"),
        ("folder.png", "folder.png: not a regular file"),
    ],
)
def test_truths_that_cannot_be_used(files, refused, truth, named):
    refused(files, ["estimate", "a.png", "b.png", "-o", "out.flo", "--truth", truth], named)


@pytest.mark.parametrize(
    ("extra", "named"),
    [
        (["--mask", "small.png"], "small.png: the mask is 32 x 23, the frames are 32 x 24 (width x height)"),
        (["--mask", "text.png"], "text.png: "),
        (["--mask", "none.png"], "none.png: cannot be read"),
        (["--mask", "white.png"], "`mask`: all 768 pixels of frame0 are masked; no data are left"),
        (["--mask"], "--mask: expected one argument"),
        (["--initial-flow", "other.flo"], "other.flo: the initial flow is 31 x 24, the frames are 32 x 24"),
        (["--initial-flow", "cut.flo"], "cut.flo: cut off"),
        (["--initial-flow", "a.txt"], "a.txt: unknown flow format '.txt'"),
        (["--initial-flow", "unknown.flo"], "`initial_flow`: 1 of 768 pixels are NaN, infinite or unknown"),
        (["--method", "opencv_dis", "--mask", "black.png"], "method 'opencv_dis' takes no `mask`"),
        (["--method", "opencv_dis", "--initial-flow", "t.flo"], "method 'opencv_dis' takes no `initial_flow`"),
        (["finest_scale=-1"], "`finest_scale` must be at least 0, got -1"),
        (["finest_scale=0.5"], "`finest_scale` must be a whole number"),
        (["protocol=quick"], "unknown protocol 'quick'"),
        (["method=tvl2"], "unknown method 'tvl2': did you mean 'tvl1'?"),
        (["--method", "tvl1", "method=tvl1_sb"], "--method tvl1 and method=tvl1_sb: give one of them"),
    ],
)
def test_masks_and_initial_flows_that_cannot_be_used(files, refused, extra, named):
    if "opencv_dis" in extra:
        pytest.importorskip("cv2")
    write_image(files / "white.png", np.full((24, 32), 255, np.uint8))
    write_image(files / "black.png", np.zeros((24, 32), np.uint8))
    flow = np.zeros((2, 24, 32), np.float32)
    flow[:, 4, 5] = np.nan
    write_flo(files / "unknown.flo", flow)
    (files / "a.txt").touch()
    refused(files, ["estimate", "a.png", "b.png", "-o", "out.flo", *extra], named)


@pytest.mark.parametrize(
    ("output", "extra", "named"),
    [
        ("nowhere/out.flo", [], "nowhere/out.flo: 'nowhere' is not a folder that can be written to"),
        ("a.png/out.flo", [], "a.png/out.flo: 'a.png' is not a folder that can be written to"),
        ("out.xyz", [], "out.xyz: a flow is written as .flo or as .png"),
        ("out", [], "out: a flow is written as .flo or as .png (KITTI), not as ''"),
        ("out.flo", ["--color", "c.xyz"], "c.xyz: no picture format has the suffix '.xyz'"),
        ("out.flo", ["--color", "nowhere/c.png"], "nowhere/c.png: 'nowhere' is not a folder"),
        ("a.png", [], "a.png: the command names this file twice"),
        ("./b.png", [], "b.png: the command names this file twice"),
        ("out.png", ["--color", "out.png"], "out.png: the command names this file twice"),
        ("taken.flo", ["--truth", "taken.flo"], "taken.flo: the command names this file twice"),
        ("out.flo", ["--color", "a.png"], "a.png: the command names this file twice"),
        ("out.flo", ["--confidence", "c.xyz"], "c.xyz: no picture format has the suffix '.xyz'"),
        ("out.flo", ["--confidence", "nowhere/c.png"], "nowhere/c.png: 'nowhere' is not a folder"),
        ("out.flo", ["--confidence", "out.color.png"], "out.color.png: the command names this file twice"),
        ("out.flo", ["--mask", "a.png", "--confidence", "b.png"], "b.png: the command names this file twice"),
        ("taken.flo", ["--initial-flow", "taken.flo"], "taken.flo: the command names this file twice"),
    ],
)
def test_outputs_that_cannot_be_written(files, refused, output, extra, named):
    refused(files, ["estimate", "a.png", "b.png", "-o", output, *extra], named)


@pytest.mark.parametrize(
    ("extra", "named"),
    [
        (["--arrows", "f.jpg"], "f.jpg: a picture of a field is written as .png or .pdf, not as '.jpg'"),
        (["--vorticity", "f"], "f: a picture of a field is written as .png or .pdf, not as ''"),
        (
            ["--csv", "f.xlsx"],
            "f.xlsx: a table is written as .csv (commas) or .txt (as OpenPIV writes it), not as",
        ),
        (["--netcdf", "f.hdf"], "f.hdf: NetCDF is written as .nc, not as '.hdf'"),
        (["--csv", "nowhere/f.csv"], "nowhere/f.csv: 'nowhere' is not a folder that can be written to"),
        (["--csv", "a.png"], "a.png: a table is written as .csv"),
        (["--csv", "f.csv", "--arrows", "b.png"], "b.png: the command names this file twice"),
        (["--arrows", "f.png", "--vorticity", "f.png"], "f.png: the command names this file twice"),
        (["--arrows", "out.color.png"], "out.color.png: the command names this file twice"),
        (["--csv", "f.csv", "--scale", "0"], "--scale must be a positive number of mm a pixel, got 0"),
        (["--csv", "f.csv", "--scale", "-0.5"], "--scale must be a positive number of mm a pixel, got -0.5"),
        (["--csv", "f.csv", "--scale", "nan"], "--scale must be a positive number of mm a pixel, got nan"),
        (["--csv", "f.csv", "--scale", "inf"], "--scale must be a positive number of mm a pixel, got inf"),
        (["--csv", "f.csv", "--scale", "1mm"], "argument --scale: invalid float value: '1mm'"),
        (["--csv", "f.csv", "--dt", "0"], "--dt must be a positive number of seconds, got 0"),
        (["--csv", "f.csv", "--dt", "nan"], "--dt must be a positive number of seconds, got nan"),
        (["--csv", "f.csv", "--grid", "0"], "--grid must be at least 1 pixel, got 0"),
        (["--csv", "f.csv", "--grid", "-16"], "--grid must be at least 1 pixel, got -16"),
        (["--csv", "f.csv", "--grid", "8.5"], "argument --grid: invalid int value: '8.5'"),
        (["--arrows", "f.png", "--grid", "48"], "--grid 48: no vector of it is within frames of 32 x 24 pixels"),
        (["--scale", "0.1"], "--scale belongs to --arrows, --vorticity, --csv and --netcdf: give one of them"),
        (["--dt", "0.1"], "--dt belongs to --arrows, --vorticity, --csv and --netcdf"),
        (["--grid", "8"], "--grid belongs to --arrows, --vorticity, --csv and --netcdf"),
        (["--csv", "f.csv", "--mask", "small.png"], "small.png: the mask is 32 x 23, the frames are 32 x 24"),
        (
            ["--csv", "f.csv", "--mask", "pages.tif"],
            "pages.tif: not a picture that can be read (a TIFF of 2 pages",
        ),
        (["--arows", "f.png"], "unexpected argument '--arows': did you mean --arrows?"),
    ],
)
def test_fields_that_cannot_be_written(files, refused, extra, named):
    refused(files, ["estimate", "a.png", "b.png", "-o", "out.flo", *extra], named)


def test_netcdf_without_its_package(files, refused, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    refused(
        files, ["estimate", "a.png", "b.png", "-o", "out.flo", "--netcdf", "f.nc"],
        "f.nc: NetCDF needs xarray: pip install 'fracbench[piv]'",
    )  # fmt: skip


def test_a_flow_that_the_format_cannot_hold(files, refused, monkeypatch):
    from fracbench import api

    class Result:
        flow = np.full((2, 24, 32), 600.0, np.float32)
        notices, stop_reason, iterations, seconds, method, ending = (), "converged", [[1]], {}, "far", "converged"

    monkeypatch.setattr(api, "estimate_flow", lambda *_, **__: Result())
    refused(files, ["estimate", "a.png", "b.png", "-o", "out.png"], "out.png", "768 flow vectors are outside -512")


def test_a_flow_that_is_not_finite(files, refused, monkeypatch):
    from fracbench import api

    class Result:
        flow = np.full((2, 24, 32), np.nan, np.float32)
        notices, stop_reason = (), "diverged"

    monkeypatch.setattr(api, "estimate_flow", lambda *_, **__: Result())
    refused(files, ["estimate", "a.png", "b.png", "-o", "out.flo"], "the computation diverged")


@pytest.mark.parametrize("bad", [np.inf, -np.inf])
def test_pixels_that_are_infinite(bad):
    frame = np.zeros((9, 9))
    frame[4, 5] = bad
    with pytest.raises(InputError, match="frame1: 1 of 81 pixels are infinite, the first at row 4, column 5"):
        estimate_flow(np.zeros((9, 9)), frame)


@pytest.mark.parametrize("name", ["protocol", "method"])
def test_names_that_are_no_text(name):
    with pytest.raises(InputError, match=f"unknown {name} 3 "):
        estimate_flow(np.zeros((9, 9)), np.zeros((9, 9)), **{name: 3})


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["alpha=2.5"], "`alpha` must be in [0, 2], got 2.5"),
        (["alpha=0:2:1"], "estimate takes one value a parameter (alpha=0:2:1); use sweep"),
        (["region=grove2_A"], "unknown parameter 'region'"),
        (["protocol=acurate"], "unknown protocol 'acurate': did you mean 'accurate'?"),
        (["protocl=fast"], "unknown argument 'protocl': did you mean 'protocol'?"),
        (["frame0=1"], "unknown parameter 'frame0'"),
        (["trace=true"], "unknown parameter 'trace'"),
        (["--method", "tvl2"], "unknown method 'tvl2': did you mean 'tvl1'?"),
        (["pad=3"], "`pad` belongs to boundary=zero"),
        (["--colour", "c.png"], "unexpected argument '--colour': did you mean --color?"),
    ],
)
def test_parameters_of_an_estimate(files, refused, words, named):
    refused(files, ["estimate", "a.png", "b.png", "-o", "out.flo", *words], named)


# -- overrides -----------------------------------------------------------------------------------

OVERRIDES = [
    ("region=grove2_a", "unknown region 'grove2_a': did you mean 'grove2_A'?"),
    ("region=moon_*", "no region matches 'moon_*'"),
    ("method=tvl1-sb", "unknown method 'tvl1-sb': did you mean 'tvl1_sb'?"),
    ("protocol=refrence", "unknown protocol 'refrence': did you mean 'reference'?"),
    ("sequence=grove2x", "unknown sequence 'grove2x': did you mean 'grove2'?"),
    ("parallel=dsk", "unknown parallel 'dsk'"),
    ("dataset=middelbury", "unknown dataset 'middelbury': did you mean 'middlebury'?"),
    ("alhpa=1", "unknown key 'alhpa': did you mean 'alpha'?"),
    ("Alpha=1", "unknown key 'Alpha': did you mean 'alpha'?"),
    ("params.alhpa=1", "unknown key 'params.alhpa'"),
    ("paths.output=x", "unknown key 'paths.output'"),
    ("alpha=0:2:0", "'alpha=0:2:0': the step is 0"),
    ("alpha=2:0:0.1", "counts up but stop is below start; use 2:0:-0.1 or 0:2:0.1"),
    ("alpha=0:2:1e-9", "'alpha=0:2:1e-9': asks for 2000000001 points, more than the 1000000 allowed"),
    ("alpha=0:2", "write a range as a:b:step"),
    ("alpha=abc", "`alpha` must be a number, got 'abc'"),
    ("alpha=2.5", "`alpha` must be in [0, 2], got 2.5"),
    ("alpha=-0.1", "`alpha` must be in [0, 4], got -0.1"),
    ("alpha=nan", "'nan' is not a finite number"),
    ("alpha=1e999", "'1e999' is not a finite number"),
    ("alpha=", "nothing follows '='"),
    ("alpha=1,,2", "a value is empty: is there a comma too many?"),
    ("alpha=[1,2]", "lists are written without brackets: 1,2,5"),
    ("=1", "'' is not a key"),
    ("alpha", "write KEY=VALUE"),
    ("n_scales=0", "`n_scales` must be at least 1, got 0"),
    ("n_warps=1.5", "`n_warps` must be a whole number, got '1.5'"),
    ("lambda=0", "`lambda` must be greater than 0, got 0"),
    ("boundary=zer", "unknown value of `boundary` 'zer': did you mean 'zero'?"),
    ("dtype=float16", "unknown value of `dtype` 'float16'"),
    ("relinearise=maybe", "`relinearise` must be true or false, got 'maybe'"),
    ("zip(lambda,theta)=(0.3,0.3,0.3)", "has 3 value(s) for 2 key(s)"),
    ("zip(lambda,theta)=0.3,0.3", "is not a tuple: write zip(a,b)=(1,2),(3,4)"),
    ("zap(lambda,theta)=(0.3,0.3)", "unknown way to combine keys 'zap': did you mean 'zip'?"),
    ("lambda=log(0:1:3)", "the ends of log(a:b:n) must be positive and differ"),
    ("alpha=lg(1:2:3)", "unknown grid function 'lg': did you mean 'log'?"),
    ("parallel.jobs=0", "parallel.jobs must be at least 1, got 0"),
    ("parallel.jobs=1,2", "'parallel.jobs' takes one value"),
    ("context=-1", "context must be at least 0 pixels, got -1"),
    ("context=8", "context=8 needs a region"),
    ("shift=99", "shift must be in 0..24, got 99"),
    ("parallel.address=head", "parallel.address must be like tcp://HOST:8786, got 'head'"),
    ("parallel.address=head:8786", "like tcp://HOST:8786, got 'head:8786': did you mean tcp://head:8786?"),
    ("parallel.address=10.0.0.1:8786", "did you mean tcp://10.0.0.1:8786?"),
    ("parallel.address=[fe80::1]:8786", "did you mean tcp://[fe80::1]:8786?"),
    ("parallel.address=tcp://head", "parallel.address must be like tcp://HOST:8786"),
    ("parallel.address=http://head:80", "parallel.address must be like tcp://HOST:8786"),
    ("parallel.address=tcp://head:8786", "parallel.address=tcp://head:8786 needs parallel=dask"),
    ("_target_=os.system", "unknown key '_target_'"),
    ("method._target_=os.system", "unknown key 'method._target_'"),
    ("hydra.searchpath=pkg://os", "unknown key 'hydra.searchpath'"),
    ("+alpha=1", "'+alpha' is not a key"),
    ("~method=tvl1", "'~method' is not a key"),
    ("sequence=../conf/sequence/grove2", "unknown sequence '../conf/sequence/grove2'"),
    ("upsample_gain=1e300", "`upsample_gain` must be in [0, 10], got 1e+300"),
    ("pad=1e9", "`pad` must be in [0, 1000], got 1e+09"),
    ("alpha=${oc.env:HOME}", "`alpha` must be a number"),
]


@pytest.mark.parametrize(("token", "named"), OVERRIDES)
def test_overrides_that_cannot_be_used(work, refused, token, named):
    others = [word for word in FLAT if word.partition("=")[0] != token.partition("=")[0]]
    if token.startswith("region="):
        others.remove("sequence=synthetic_flat")
    refused(work, ["sweep", token, *others], named)
    refused(work, ["sweep", token, *others, "--dry-run"], named)


def test_a_key_given_twice(work, refused):
    refused(work, ["sweep", "alpha=1", "alpha=2", *FLAT], "'alpha=2': the key 'alpha' is given twice")
    refused(work, ["sweep", "zip(alpha,alpha)=(1,2)", *FLAT], "the key 'alpha' is given twice")
    refused(work, ["sweep", "alpha=1", "params.alpha=1", *FLAT], "'alpha' and 'params.alpha' are the same key")


@pytest.mark.parametrize("command", ["sweep", "run"])
def test_a_region_of_another_sequence(work, refused, command):
    refused(work, [command, "region=grove2_A", "sequence=urban3"], "region=grove2_A belongs to sequence=grove2")


@pytest.mark.parametrize("jobs", ["0", "-2"])
def test_no_workers(work, refused, jobs):
    refused(work, ["sweep", "alpha=1", *FLAT, "--jobs", jobs], f"--jobs must be at least 1, got {jobs}")


# -- data ----------------------------------------------------------------------------------------


@pytest.fixture
def fake_middlebury(work, monkeypatch) -> Path:
    """Small files in the place of Middlebury's, registered under their own hashes."""
    folder = work / "mb"
    registry = {}
    for name in middlebury_data.REGISTRY:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".png":
            write_image(path, np.full((12, 14), len(registry), np.uint8))
        else:
            write_flo(path, np.full((2, 12, 14), 0.5, np.float32))
        registry[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    monkeypatch.setattr(middlebury_data, "REGISTRY", registry)
    monkeypatch.setenv("FRACBENCH_DATA", str(folder))
    return folder


def test_the_fake_data_are_good_enough_to_plan_with(fake_middlebury, capsys):
    assert main(["sweep", "sequence=venus", "alpha=1", "--dry-run"]) == 0
    assert "1 points, 0 stored" in capsys.readouterr().out


def test_a_corrupt_file_is_named_with_both_hashes(fake_middlebury, work, refused):
    path = fake_middlebury / "Venus" / "flow10.flo"
    path.write_bytes(path.read_bytes()[:-4] + b"\0\0\0\1")
    actual = hashlib.sha256(path.read_bytes()).hexdigest()
    expected = middlebury_data.REGISTRY["Venus/flow10.flo"]
    for command in ("sweep", "run"):
        refused(work, [command, "sequence=venus", "alpha=1"], "Venus/flow10.flo is corrupt", actual, expected)


def test_a_missing_file_is_named(fake_middlebury, work, refused):
    (fake_middlebury / "Urban2" / "frame11.png").unlink()
    refused(work, ["sweep", "sequence=urban2", "alpha=1"], "Urban2/frame11.png is missing")


def test_a_file_that_is_a_folder_is_named(fake_middlebury, work, refused):
    (fake_middlebury / "Urban2" / "frame11.png").unlink()
    (fake_middlebury / "Urban2" / "frame11.png").mkdir()
    refused(work, ["sweep", "sequence=urban2", "alpha=1"], "Urban2/frame11.png is unreadable")


def test_missing_data_list_the_ways_to_provide_them(work, refused, no_middlebury):
    ways = ("FRACBENCH_DATA=FOLDER", "paths.data=FOLDER", "data/middlebury", "fracbench data --download")
    refused(work, ["sweep", "sequence=grove2", "alpha=1", "dataset=middlebury", "--dry-run"], "not found", *ways)
    refused(work, ["data"], "the Middlebury data were not found", *ways)
    refused(work, ["sweep", "sequence=grove2", "alpha=1", "dataset=middlebury"], "the server cannot be reached")


@pytest.mark.parametrize("command", ["sweep", "run"])
def test_a_folder_that_holds_no_data(work, refused, monkeypatch, command):
    (work / "bare").mkdir()
    words = [command, "sequence=grove2", "alpha=1"]
    refused(work, [*words, "paths.data=bare"], "paths.data=bare: holds none of the 24")
    refused(work, [*words, "paths.data=nowhere"], "paths.data=nowhere: holds none of the 24")
    monkeypatch.setenv("FRACBENCH_DATA", "nowhere")
    refused(work, words, "FRACBENCH_DATA=nowhere: holds none of the 24")
    refused(work, ["data"], "FRACBENCH_DATA=nowhere")


@pytest.mark.parametrize("given", ["file", "file/inside", "a" * 300, "~nobody/x"])
def test_a_place_that_is_no_folder_of_data(work, refused, monkeypatch, given):
    (work / "file").write_text("x")
    refused(work, ["sweep", "sequence=grove2", "alpha=1", f"paths.data={given}"], "holds none of the 24")
    monkeypatch.setenv("FRACBENCH_DATA", given)
    refused(work, ["data"], f"FRACBENCH_DATA={given}: holds none of the 24")


# -- results -------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["sweep", "run"])
def test_a_results_folder_under_a_file(work, refused, command):
    (work / "file").write_text("x")
    refused(
        work,
        [command, "alpha=1", *FLAT, "paths.results=file/results"],
        "results folder file/results/runs",
        "set paths",
    )


# -- other commands ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("argv", "named"),
    [
        (["experiment", "tabel2"], "unknown experiment 'tabel2': did you mean 'table2'?"),
        (["experiment", "table2", "alpha=1"], "table2: an experiment fixes its own grid"),
        (["table", "two"], "there is no table 'two'"),
        (["figure", "99"], "there is no figure '99'"),
        (["check", "nothing_of_the_kind"], "unknown stored table 'nothing_of_the_kind'"),
        (["check", "table2", "--update"], 'check --update needs --reason "why'),
        (["check", "--jobs", "0"], "--jobs must be at least 1"),
        (["check", "--spread"], "--spread has moved: python tools/spread.py"),
        (["status", "tabel2"], "unknown experiment 'tabel2': did you mean 'table2'?"),
        (["status", "alpha=1"], "status: an experiment fixes its own grid"),
        (["status", "paths.reslts=x"], "unknown key 'paths.reslts'"),
        (["compare", "nothing", "HEAD"], "'nothing' is neither a store nor a commit"),
        (["compare", "nothing"], "the following arguments are required: second"),
        (["compare", "--", "--all", "HEAD"], "'--all' is neither a store nor a commit"),
        (["sweep"], "sweep: name the keys to sweep, e.g. fracbench sweep alpha="),
        (["data", "paths.data=x"], "data: paths.data=x needs dataset=NAME"),
        (["bench", "--repeats", "0"], "--repeats and --threads must be at least 1"),
        (["run", "alpha=1,2", *FLAT], "run takes one point, not a grid"),
        (["run", "sequence=synthetic_*"], "run takes one point, sequence=synthetic_* stands for 16"),
    ],
)
def test_names_and_numbers_of_other_commands(work, refused, argv, named):
    refused(work, argv, named)


def test_the_check_for_files_left_behind_sees_them(files, contents):
    before = contents(files)
    shutil.copy("a.png", "folder/new.png")
    assert contents(files) != before
    (files / "folder" / "new.png").unlink()
    assert contents(files) == before
    (files / "t.flo").write_bytes(b"x")
    assert contents(files) != before
