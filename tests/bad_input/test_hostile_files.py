"""Hostile files: a reader soon returns a valid flow or picture, or raises the project's own error."""

from __future__ import annotations

import io
import resource
import struct
import subprocess
import sys
import textwrap
import time
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from fracbench.data import files
from fracbench.errors import InputError

#: A reader that takes more than two seconds for some bytes hangs.
SETTINGS = settings(max_examples=60, deadline=2000)
FORMATS = ("PNG", "JPEG", "PPM", "BMP", "TIFF", "GIF", "WEBP")


def sound(form: str) -> bytes:
    """A small picture in one of the formats."""
    values = np.random.default_rng(3).integers(0, 256, (9, 11, 3), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(values).save(file, form)
    return file.getvalue()


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, depth: int, colour: int, data: bytes) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + data + chunk(b"IEND", b"")


def decode_kitti(data: bytes, path) -> np.ndarray:
    path.write_bytes(data)
    return files.read_flow(path)


def is_flow(flow: np.ndarray) -> bool:
    return (
        flow.dtype == np.float32
        and flow.ndim == 3
        and flow.shape[0] == 2
        and flow.size > 0
        and bool((np.isnan(flow[0]) == np.isnan(flow[1])).all())
        and not bool((np.abs(flow) > files.UNKNOWN_ABOVE).any())
    )


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_is_read(form):
    assert files.decode_image(sound(form), "a").shape == (9, 11, 3)


@pytest.mark.parametrize("form", ["EPS", "PDF", "ICO", "PCX", "SGI", "TGA"])
def test_no_other_format_reaches_a_decoder(form):
    """Pillow, for example, hands PostScript to another program."""
    with pytest.raises(InputError, match="unknown format"):
        files.decode_image(sound(form), "a")


@SETTINGS
@given(st.data(), st.sampled_from(FORMATS))
def test_pictures_with_bit_rot(data, form):
    content = bytearray(sound(form))
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        image = files.decode_image(bytes(content[: data.draw(st.integers(1, len(content)))]), "rot")
    except InputError as exc:
        assert "\n" not in str(exc)
    else:
        assert image.dtype in (np.uint8, np.uint16) and image.ndim in (2, 3)


@SETTINGS
@given(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1), st.binary(max_size=80))
def test_flo_headers_of_any_size(width, height, body):
    data = files.FLO_TAG + struct.pack("<ii", width, height) + body
    try:
        assert is_flow(files.decode_flo(data, "any"))
    except InputError as exc:
        assert "\n" not in str(exc)


@SETTINGS
@given(st.integers(1, 6), st.integers(1, 6), st.data())
def test_flo_files_of_any_content(width, height, data):
    body = data.draw(st.binary(min_size=8 * width * height, max_size=8 * width * height))
    flow = files.decode_flo(files.FLO_TAG + struct.pack("<ii", width, height) + body, "any")
    assert is_flow(flow) and flow.shape == (2, height, width)


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.binary(max_size=60), st.booleans())
def test_kitti_headers_of_any_size(tmp_path_factory, width, height, body, packed):
    data = png(width, height, 16, 2, chunk(b"IDAT", zlib.compress(body) if packed else body))
    try:
        assert is_flow(decode_kitti(data, tmp_path_factory.getbasetemp() / "any.png"))
    except InputError as exc:
        assert "\n" not in str(exc)


KINDS = st.sampled_from([b"IHDR", b"IDAT", b"IEND", b"PLTE", b"tRNS", b"gAMA", b"zTXt"])
CHUNK = st.tuples(KINDS, st.binary(max_size=30))


@SETTINGS
@given(st.lists(CHUNK, max_size=5), st.integers(1, 5), st.integers(1, 5))
def test_kitti_files_of_any_chunks(tmp_path_factory, chunks, width, height):
    """A second header must not undo what was checked in the first."""
    data = png(width, height, 16, 2, b"".join(chunk(*one) for one in chunks))
    try:
        assert is_flow(decode_kitti(data, tmp_path_factory.getbasetemp() / "any.png"))
    except InputError as exc:
        assert "\n" not in str(exc)


@pytest.mark.parametrize("name", ["a.flo", "a.png"])
@SETTINGS
@given(body=st.binary(max_size=200))
def test_random_bytes_through_the_front_door(tmp_path_factory, name, body):
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(body)
    with pytest.raises(InputError) as caught:
        files.read_flow(path)
    assert "\n" not in str(caught.value)


HEADERS = {
    "a.flo": files.FLO_TAG + struct.pack("<ii", 99_999, 99_999),
    "half.flo": files.FLO_TAG + struct.pack("<ii", 99_999, 1_000),
    "kitti.png": png(99_999, 99_999, 16, 2, chunk(b"IDAT", zlib.compress(b"\0"))),
    "kitti_allowed.png": png(9_400, 9_400, 16, 2, chunk(b"IDAT", zlib.compress(b"\0"))),
    "picture.png": png(99_999, 99_999, 8, 2, chunk(b"IDAT", zlib.compress(b"\0"))),
    "picture_allowed.png": png(9_400, 9_400, 8, 2, chunk(b"IDAT", zlib.compress(b"\0"))),
    "gray_allowed.png": png(9_400, 9_400, 16, 0, chunk(b"IDAT", zlib.compress(b"\0"))),
    "picture.ppm": b"P6 9400 9400 255\n",
    "picture.gif": b"GIF89a" + struct.pack("<HH", 9_400, 9_400) + b"\0\0\0,\0\0\0\0"
    + struct.pack("<HH", 9_400, 9_400) + b"\x80\0\0\0\xff\xff\xff\2\2D\1\0;",
    "picture.bmp": b"BM" + struct.pack("<IHHI", 60, 0, 0, 54)
    + struct.pack("<IiiHHIIiiII", 40, 9_400, 9_400, 1, 24, 0, 0, 0, 0, 0, 0) + b"\0" * 6,
}  # fmt: skip


def bomb(n_bytes: int) -> bytes:
    """A deflate stream of about a thousandth of the zeros that it unpacks into."""
    packer = zlib.compressobj(9)
    return b"".join(packer.compress(bytes(2**20)) for _ in range(n_bytes // 2**20)) + packer.flush()


def progressive(n_scans: int) -> bytes:
    """A black progressive JPEG of 4000 x 4000 pixels whose last scan is repeated."""
    file = io.BytesIO()
    Image.fromarray(np.zeros((4000, 4000), np.uint8)).save(file, "JPEG", progressive=True)
    data = file.getvalue()[:-2]
    last = data[data.rfind(b"\xff\xda") :]
    return data + last * (n_scans - data.count(b"\xff\xda")) + b"\xff\xd9"


#: A head of an interlaced gray picture, which pypng makes room for.
TALL = struct.pack(">IIBBBBB", 696, 1_769_481, 8, 0, 0, 0, 1)
#: Files of at most 3 MB that their decoders would unpack into gigabytes, or for minutes.
BOMBS = {
    "kitti.png": (lambda: png(10, 10, 16, 2, chunk(b"IDAT", bomb(2**30))), "more than the 628 bytes"),
    "kitti_wide.png": (lambda: png(16_384, 16_384, 16, 2, chunk(b"IDAT", bomb(2**31))), "is not within"),
    "kitti_heads.png": (
        lambda: png(2, 2, 16, 2, chunk(b"IHDR", TALL) + chunk(b"IDAT", zlib.compress(bytes(26)))),
        "it has a second head",
    ),
    "kitti_end.png": (
        lambda: png(
            2, 2, 16, 2, chunk(b"IEND", b"") + chunk(b"IHDR", TALL) + chunk(b"IDAT", zlib.compress(bytes(26)))
        ),
        "or no pixels",
    ),
    "scans.jpg": (lambda: progressive(600), "600 scans of 4000 x 4000 pixels"),
    "text.png": (lambda: png(9, 9, 8, 0, chunk(b"zTXt", b"a\0\0" + bomb(2**28))), "too large"),
    "profile.png": (lambda: png(9, 9, 8, 0, chunk(b"iCCP", b"a\0\0" + bomb(2**28))), "too large"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_unpacks_into_a_large_one_is_refused_by_its_size(tmp_path, name):
    make, why = BOMBS[name]
    (tmp_path / name).write_bytes(make())
    start, taken = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=why) as caught:
        (files.read_flow if name.startswith("kitti") else files.read_image)(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert time.perf_counter() - start < 5.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - taken < 200 * 2**10


def test_the_limit_does_not_depend_on_pillows(monkeypatch):
    """Other programs in the same process set Pillow's limit to None."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", None)
    monkeypatch.setattr(files, "MAX_PIXELS", 98)
    with pytest.raises(InputError, match="11 x 9 pixels are more than the 98 allowed"):
        files.decode_image(sound("PNG"), "a")


@pytest.mark.parametrize("read", [files.read_flow, files.read_image])
def test_a_file_larger_than_memory_is_not_read(tmp_path, read):
    with (tmp_path / "a.png").open("wb") as file:
        file.truncate(2**40)  # holes take no place on the disk
    with pytest.raises(InputError, match="1099511627776 bytes, more than the 1073741824 that it may have"):
        read(tmp_path / "a.png")


def test_no_header_takes_memory_by_its_word_alone(tmp_path):
    """Each header promises at least 180 MB; the process may use 150 MB, and that is enough."""
    pytest.importorskip("resource", reason="memory cannot be limited on this system")
    for name, data in HEADERS.items():
        (tmp_path / name).write_bytes(data)
    code = """
    import resource, sys
    from pathlib import Path
    import numpy, png
    from PIL import Image
    from fracbench.data import files
    from fracbench.errors import InputError

    Image.init()
    Path("warm.png").write_bytes(Path("kitti.png").read_bytes())
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 150 * 2**20,) * 2)
    try:
        numpy.ones(180 * 2**20, numpy.uint8)
        sys.exit("the limit does not work")
    except MemoryError:
        pass
    for name in sys.argv[1:]:
        read = files.read_flow if name.startswith(("a.", "half", "kitti")) else files.read_image
        try:
            read(name)
            print(name, "was read")
        except InputError as exc:
            cause = exc
            while cause is not None:
                assert not isinstance(cause, MemoryError), name
                cause = cause.__cause__ or cause.__context__
            assert str(exc).startswith(f"{name}: "), exc
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *HEADERS], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
