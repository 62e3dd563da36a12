from __future__ import annotations

import os
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from fracbench.data import files
from fracbench.errors import InputError

SMALL_SHAPES = st.tuples(st.just(2), st.integers(1, 7), st.integers(1, 7))
SETTINGS = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
RNG = np.random.default_rng(5)


def png_bytes(width: int, height: int, depth: int, colour: int, raw: bytes) -> bytes:
    """A PNG assembled by hand; `raw` holds the rows, each with its filter byte."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")


def kitti_bytes(values: np.ndarray) -> bytes:
    raw = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    return png_bytes(values.shape[1], values.shape[0], 16, 2, raw)


def flo_bytes(width: int, height: int, body: bytes, tag: float = 202021.25) -> bytes:
    return struct.pack("<fii", tag, width, height) + body


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def one_line(caught) -> str:
    message = str(caught.value)
    assert "\n" not in message
    return message


class TestAtomicPath:
    def test_the_file_appears_only_at_the_end(self, tmp_path):
        target = tmp_path / "table.csv"
        with files.atomic_path(target) as temporary:
            assert (temporary.parent, temporary.suffix) == (tmp_path, ".csv")
            temporary.write_text("new")
            assert not target.exists()
        assert target.read_text() == "new"
        assert names(tmp_path) == ["table.csv"]

    def test_a_failure_leaves_the_old_file_and_nothing_else(self, tmp_path):
        target = tmp_path / "table.csv"
        target.write_text("old")
        with pytest.raises(ZeroDivisionError), files.atomic_path(str(target)) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError
        assert target.read_text() == "old"
        assert names(tmp_path) == ["table.csv"]

    def test_a_missing_folder_is_named_before_the_work_is_done(self, tmp_path):
        gone = tmp_path / "gone"
        with (
            pytest.raises(InputError, match=r"cannot write 'x\.csv': '.*gone' is not an existing folder"),
            files.atomic_path(gone / "x.csv"),
        ):
            pytest.fail("the block must not run")

    def test_a_target_that_cannot_be_replaced_is_an_input_error(self, tmp_path):
        (tmp_path / "x.csv").mkdir()
        with (
            pytest.raises(InputError, match=r"cannot write 'x\.csv' in folder"),
            files.atomic_path(tmp_path / "x.csv") as temporary,
        ):
            temporary.write_text("data")
        assert names(tmp_path) == ["x.csv"]


class TestImages:
    @pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
    def test_round_trip(self, tmp_path, shape):
        image = RNG.integers(0, 256, shape, dtype=np.uint8)
        files.write_image(tmp_path / "a.png", image)
        back = files.read_image(tmp_path / "a.png")
        assert back.dtype == np.uint8
        np.testing.assert_array_equal(back, image)

    def test_modes_become_gray_or_rgb(self, tmp_path):
        rgb = Image.fromarray(RNG.integers(0, 256, (4, 6, 3), dtype=np.uint8))
        shapes = {}
        for mode in ("1", "L", "LA", "P", "RGB", "RGBA"):
            rgb.convert(mode).save(tmp_path / f"{mode}.png")
            shapes[mode] = files.read_image(tmp_path / f"{mode}.png").shape
        gray, colour = (4, 6), (4, 6, 3)
        assert shapes == {"1": gray, "L": gray, "LA": gray, "P": colour, "RGB": colour, "RGBA": colour}

    def test_alpha_is_dropped_not_blended(self, tmp_path):
        rgba = RNG.integers(0, 256, (4, 6, 4), dtype=np.uint8)
        Image.fromarray(rgba).save(tmp_path / "a.png")
        np.testing.assert_array_equal(files.read_image(tmp_path / "a.png"), rgba[..., :3])

    def test_sixteen_bit_gray_keeps_its_values(self, tmp_path):
        values = RNG.integers(0, 65536, (4, 6), dtype=np.uint16)
        raw = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
        (tmp_path / "a.png").write_bytes(png_bytes(6, 4, 16, 0, raw))
        image = files.read_image(tmp_path / "a.png")
        assert image.dtype == np.uint16
        np.testing.assert_array_equal(image, values)

    @pytest.mark.parametrize(
        "data",
        [b"", b"just some text\n", b"\x89PNG\r\n\x1a\n"],
        ids=["empty", "text", "signature only"],
    )
    def test_what_is_no_picture_is_refused(self, tmp_path, data):
        path = tmp_path / "a.png"
        path.write_bytes(data)
        with pytest.raises(InputError, match="not a picture that can be read") as caught:
            files.read_image(path)
        assert str(path) in one_line(caught)

    @pytest.mark.parametrize("side", [10_000, 30_000])
    def test_decompression_bombs_are_not_opened(self, side):
        with pytest.raises(InputError, match="decompression bomb") as caught:
            files.decode_image(png_bytes(side, side, 8, 2, b""), "a.png")
        one_line(caught)

    def test_floating_point_pictures_are_refused(self, tmp_path):
        Image.fromarray(np.zeros((4, 4), dtype=np.float32)).save(tmp_path / "a.tiff")
        with pytest.raises(InputError, match="floating-point"):
            files.read_image(tmp_path / "a.tiff")

    def test_a_truncated_picture_is_refused_wherever_it_is_cut(self, tmp_path):
        files.write_image(tmp_path / "a.png", RNG.integers(0, 256, (9, 9, 3), dtype=np.uint8))
        data = (tmp_path / "a.png").read_bytes()
        for length in range(0, len(data) - 20, 7):
            with pytest.raises(InputError):
                files.decode_image(data[:length], "a.png")

    @SETTINGS
    @given(st.binary(max_size=200), st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"BM", b"\xff\xd8\xff", b"P6 "]))
    def test_random_bytes_never_escape_as_another_error(self, data, start):
        try:
            image = files.decode_image(start + data, "noise")
        except InputError as exc:
            assert "\n" not in str(exc)
        else:
            assert image.dtype in (np.uint8, np.uint16)

    @pytest.mark.parametrize("name", ["none.png", ".", "a\0b.png"])
    def test_paths_that_are_no_file(self, tmp_path, name):
        with pytest.raises(InputError) as caught:
            files.read_image(f"{tmp_path}/{name}")
        assert str(tmp_path) in one_line(caught)

    def test_a_pipe_is_not_waited_for(self, tmp_path):
        os.mkfifo(tmp_path / "a.png")
        with pytest.raises(InputError, match="not a regular file"):
            files.read_image(tmp_path / "a.png")

    @pytest.mark.parametrize(
        ("name", "image", "message"),
        [
            ("a.png", np.zeros((4, 4)), "float64"),
            ("a.png", np.zeros((4, 4, 2), dtype=np.uint8), r"\(4, 4, 2\)"),
            ("a.png", np.zeros((0, 4), dtype=np.uint8), r"\(0, 4\)"),
            ("a.xyz", np.zeros((4, 4), dtype=np.uint8), r"suffix '\.xyz'"),
            ("gone/a.png", np.zeros((4, 4), dtype=np.uint8), "not an existing folder"),
        ],
    )
    def test_what_cannot_be_written_is_refused(self, tmp_path, name, image, message):
        with pytest.raises(InputError, match=message):
            files.write_image(tmp_path / name, image)
        assert names(tmp_path) == []


class TestFlo:
    def test_a_file_made_by_hand(self, tmp_path):
        pairs = [(1.5, -2.0), (0.0, 0.25), (3.0, 4.0), (-1.0, 1.0), (7.0, 8.0), (9.0, 10.0)]
        body = b"".join(struct.pack("<ff", *pair) for pair in pairs)
        (tmp_path / "a.flo").write_bytes(flo_bytes(3, 2, body))
        flow = files.read_flow(tmp_path / "a.flo")
        assert flow.dtype == np.float32 and flow.flags.c_contiguous and flow.flags.writeable
        np.testing.assert_array_equal(flow[0], [[1.5, 0.0, 3.0], [-1.0, 7.0, 9.0]])
        np.testing.assert_array_equal(flow[1], [[-2.0, 0.25, 4.0], [1.0, 8.0, 10.0]])
        files.write_flow(tmp_path / "b.flo", flow)
        assert (tmp_path / "b.flo").read_bytes() == (tmp_path / "a.flo").read_bytes()

    @pytest.mark.parametrize("mark", [1666666752.0, -1.1e9, np.inf, np.nan])
    @pytest.mark.parametrize("component", [0, 1])
    def test_an_unknown_component_makes_both_nan(self, mark, component):
        pair = [1.0, 2.0]
        pair[component] = mark
        flow = files.decode_flo(flo_bytes(2, 1, struct.pack("<ffff", *pair, 3.0, 1e9)), "a.flo")
        assert np.isnan(flow[:, 0, 0]).all()
        np.testing.assert_array_equal(flow[:, 0, 1], np.float32([3.0, 1e9]))

    def test_unknown_pixels_are_written_as_middlebury_marks_them(self, tmp_path):
        flow = np.ones((2, 1, 2))
        flow[1, 0, 0] = np.nan
        files.write_flo(tmp_path / "a.flo", flow)
        assert struct.unpack("<ffff", (tmp_path / "a.flo").read_bytes()[12:]) == (1666666752.0,) * 2 + (1, 1)

    @SETTINGS
    @given(arrays(np.float32, SMALL_SHAPES, elements=st.floats(-1e9, 1e9, width=32) | st.just(np.nan)))
    def test_round_trip(self, tmp_path, flow):
        before = flow.copy()
        files.write_flow(tmp_path / "a.flo", flow)
        np.testing.assert_array_equal(flow, before)
        expected = np.where(np.isnan(flow).any(axis=0), np.float32(np.nan), flow)
        np.testing.assert_array_equal(files.read_flow(tmp_path / "a.flo"), expected)

    @pytest.mark.parametrize(
        ("data", "message"),
        [
            (b"", "empty"),
            (b"PIEH\1\0\0", "not a .flo file"),
            (flo_bytes(1, 1, bytes(8), tag=1.0), "not a .flo file"),
            (flo_bytes(2, 2, bytes(31)), "cut off: 2 x 2 needs 44 bytes, found 43"),
            (flo_bytes(2, 2, bytes(33)), "followed by something else: 2 x 2 needs 44 bytes, found 45"),
            (flo_bytes(0, 2, b""), "width 0 x height 2"),
            (flo_bytes(-2, -2, bytes(32)), "width -2 x height -2"),
            (flo_bytes(100000, 1, bytes(800000)), "width 100000"),
        ],
    )
    def test_damaged_files_are_refused(self, tmp_path, data, message):
        (tmp_path / "a.flo").write_bytes(data)
        with pytest.raises(InputError, match=message) as caught:
            files.read_flow(tmp_path / "a.flo")
        assert "a.flo" in one_line(caught)

    def test_a_header_takes_no_memory_by_its_word_alone(self):
        tracemalloc.start()
        try:
            with pytest.raises(InputError, match="cut off"):
                files.decode_flo(flo_bytes(99999, 99999, bytes(64)), "a.flo")
            assert tracemalloc.get_traced_memory()[1] < 1e6
        finally:
            tracemalloc.stop()

    @SETTINGS
    @given(st.binary(max_size=64), st.booleans(), st.integers(0, 3), st.integers(0, 3))
    def test_random_bytes_give_a_flow_or_an_input_error(self, body, headed, width, height):
        data = flo_bytes(width, height, body) if headed else body
        try:
            flow = files.decode_flo(data, "noise")
        except InputError as exc:
            assert "\n" not in str(exc)
        else:
            assert flow.shape == (2, height, width)
            np.testing.assert_array_equal(np.isnan(flow[0]), np.isnan(flow[1]))


class TestKitti:
    def test_a_file_made_by_hand(self, tmp_path):
        values = np.array([[[32768, 32768, 1], [32769, 32704, 1]], [[65535, 0, 1], [5, 6, 0]]], dtype=np.uint16)
        (tmp_path / "a.png").write_bytes(kitti_bytes(values))
        flow = files.read_flow(tmp_path / "a.png")
        assert flow.dtype == np.float32 and flow.flags.c_contiguous
        np.testing.assert_array_equal(flow[0], np.float32([[0.0, 1 / 64], [32767 / 64, np.nan]]))
        np.testing.assert_array_equal(flow[1], np.float32([[0.0, -1.0], [-512.0, np.nan]]))

    def test_what_is_written_decodes_by_hand(self, tmp_path):
        flow = np.array([[[1.0, -0.5, np.nan]], [[2.25, 511.984375, 3.0]]])
        files.write_flow(tmp_path / "a.png", flow)
        data = (tmp_path / "a.png").read_bytes()
        assert struct.unpack(">IIBB", data[16:26]) == (3, 1, 16, 2)
        length = struct.unpack(">I", data[33:37])[0]
        assert data[37:41] == b"IDAT"
        raw = zlib.decompress(data[41 : 41 + length])
        assert raw[0] == 0  # the filter "none"
        codes = struct.unpack(">9H", raw[1:])
        assert codes == (32832, 32912, 1, 32736, 65535, 1, 0, 0, 0)

    @SETTINGS
    @given(arrays(np.int32, SMALL_SHAPES, elements=st.integers(-32768, 32767)), st.data())
    def test_round_trip_of_multiples_of_a_64th(self, tmp_path, codes, data):
        flow = codes / 64.0
        unknown = data.draw(arrays(bool, flow.shape[1:]))
        flow[:, unknown] = np.nan
        files.write_flow(tmp_path / "a.png", flow)
        np.testing.assert_array_equal(files.read_flow(tmp_path / "a.png"), flow)

    def test_other_values_are_rounded_to_the_nearest_64th(self, tmp_path):
        flow = RNG.uniform(-500, 500, (2, 5, 6))
        files.write_kitti_png(tmp_path / "a.png", flow)
        assert np.abs(files.read_flow(tmp_path / "a.png") - flow).max() <= 0.5 / 64 + 1e-4

    @pytest.mark.parametrize(
        ("data", "message"),
        [
            (b"", "not a PNG file"),
            (b"text" * 20, "not a PNG file"),
            (png_bytes(1, 1, 8, 2, b"\0\1\2\3"), "16-bit RGB PNG"),
            (png_bytes(1, 1, 16, 0, b"\0\1\2"), "16-bit RGB PNG"),
            (png_bytes(0, 1, 16, 2, b""), "width 0 x height 1"),
            (png_bytes(2**31, 2**31, 16, 2, b""), "is not within"),
            (png_bytes(9400, 9400, 16, 2, bytes(9)), "cannot hold 9400 x 9400 pixels"),
            (png_bytes(2, 2, 16, 2, b"\0" * 13), "damaged PNG"),
            (kitti_bytes(np.zeros((2, 2, 3)))[:-30], "damaged PNG"),
        ],
    )
    def test_damaged_files_are_refused(self, tmp_path, data, message):
        (tmp_path / "a.png").write_bytes(data)
        with pytest.raises(InputError, match=message) as caught:
            files.read_flow(tmp_path / "a.png")
        assert "a.png" in one_line(caught)

    @SETTINGS
    @given(st.data())
    def test_bit_rot_gives_a_flow_or_an_input_error(self, tmp_path, data):
        sound = bytearray(kitti_bytes(RNG.integers(0, 65536, (3, 4, 3))))
        for _ in range(data.draw(st.integers(1, 4))):
            sound[data.draw(st.integers(0, len(sound) - 1))] = data.draw(st.integers(0, 255))
        (tmp_path / "a.png").write_bytes(bytes(sound[: data.draw(st.integers(1, len(sound)))]))
        try:
            flow = files.read_flow(tmp_path / "a.png")
        except InputError as exc:
            assert "\n" not in str(exc)
        else:
            assert flow.shape[0] == 2 and flow.dtype == np.float32

    @pytest.mark.parametrize("value", [512.0, -512.1, np.inf, 1e30])
    def test_values_the_format_cannot_hold_are_refused(self, tmp_path, value):
        flow = np.zeros((2, 3, 4))
        flow[1, 2, 1] = value
        with pytest.raises(InputError, match=r"1 flow vectors .* at row 2, column 1"):
            files.write_flow(tmp_path / "a.png", flow)
        assert names(tmp_path) == []


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1.7e9])
def test_flo_refuses_values_that_would_be_read_as_unknown(tmp_path, value):
    flow = np.zeros((2, 3, 4))
    flow[0, 1, 2] = value
    with pytest.raises(InputError, match=r"1 flow vectors .* at row 1, column 2"):
        files.write_flow(tmp_path / "a.flo", flow)


@pytest.mark.parametrize("flow", [np.zeros((3, 4)), np.zeros((3, 4, 2)), np.zeros((2, 0, 4))])
@pytest.mark.parametrize("name", ["a.flo", "a.png"])
def test_a_flow_of_another_shape_is_refused(tmp_path, flow, name):
    with pytest.raises(InputError, match=r"shape \(2, H, W\)"):
        files.write_flow(tmp_path / name, flow)


def test_a_complex_flow_is_refused(tmp_path):
    with pytest.raises(InputError, match="complex128"):
        files.write_flow(tmp_path / "a.flo", np.zeros((2, 3, 4), dtype=complex))


def test_the_suffix_decides_the_format(tmp_path):
    files.write_flow(tmp_path / "A.FLO", np.zeros((2, 3, 4)))
    assert files.read_flow(tmp_path / "A.FLO").shape == (2, 3, 4)
    for act in (files.read_flow, lambda path: files.write_flow(path, np.zeros((2, 3, 4)))):
        with pytest.raises(InputError, match=r"unknown flow format '\.fl'.*'\.flo'"):
            act(tmp_path / "a.fl")


def test_a_tiff_with_a_reduced_copy_is_one_frame(tmp_path):
    """Pages that are marked as reduced copies, such as previews, do not count."""
    frame = np.random.default_rng(0).integers(0, 65536, (12, 16)).astype(np.uint16)
    page, preview = Image.fromarray(frame), Image.fromarray(frame[::4, ::4])
    preview.encoderinfo = {"tiffinfo": {254: 1}}
    page.save(tmp_path / "a.tif", save_all=True, append_images=[preview])
    with Image.open(tmp_path / "a.tif") as written:
        assert written.n_frames == 2
    np.testing.assert_array_equal(files.read_image(tmp_path / "a.tif"), frame)
