"""Pictures and flow fields on disk: 8- and 16-bit images, Middlebury ``.flo``, KITTI ``.png``.

A flow in memory is float32 ``(2, H, W)``, ``flow[0]`` to the right and ``flow[1]`` down, in pixels; an
unknown pixel is NaN in both components. Readers trust no header: what it promises is compared with the bytes
there are before any memory is taken, and a small file that unpacks into a large one is refused by its size.
"""

from __future__ import annotations

import io
import os
import secrets
import stat
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fracbench.data.read_once import MAX_BYTES
from fracbench.errors import InputError, unknown_name

FLO_TAG = b"PIEH"  # the float32 202021.25, little endian
FLO_UNKNOWN = 1666666752.0
UNKNOWN_ABOVE = 1e9
MAX_FLO_SIDE = 99_999
#: Pillow's own limit for a picture, which another program in the process may have lifted.
MAX_PIXELS = 89_478_485
#: A progressive JPEG of the largest size may have this many scans; each of them goes through all pixels.
MAX_SCANS = 100

_KITTI_ZERO = 2**15
_KITTI_STEP = 64.0
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_DEFLATE_MAX_RATIO = 1032  # no deflate stream expands by more
# Those that a decoder reads by itself: Pillow hands PostScript, for one, to another program.
_PICTURES = ("PNG", "JPEG", "PPM", "BMP", "TIFF", "GIF", "WEBP")

Pathish = str | os.PathLike[str]
T = TypeVar("T")


@contextmanager
def atomic_path(path: Pathish) -> Iterator[Path]:
    """Yield a new path beside `path`, with its suffix, that takes its place once the block has ended well.

    If the block raises, the temporary file is removed and `path` is left as it was. The folder must exist.
    """
    path = Path(path)
    folder = path.parent
    if not os.path.isdir(folder):  # noqa: PTH112 - Path.is_dir raises where a parent may not be entered
        raise InputError(f"cannot write {path.name!r}: {str(folder)!r} is not an existing folder")
    temporary = path.with_name(f".{path.stem}-{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)  # noqa: PTH105
    except OSError as exc:
        raise InputError(f"cannot write {path.name!r} in folder {str(folder)!r}: {_reason(exc)}") from exc
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def read_bytes(path: Pathish, most: int = MAX_BYTES) -> bytes:
    """Return the content of a regular file; anything that prevents it is an InputError naming the file."""
    path = Path(path)
    try:
        found = path.stat()
        if stat.S_ISREG(found.st_mode) and found.st_size <= most:  # a pipe or a device could go on for ever
            return path.read_bytes()
    except (OSError, ValueError) as exc:  # ValueError: a NUL in the name
        raise InputError(f"{path}: cannot be read: {_reason(exc)}") from exc
    if stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: {found.st_size} bytes, more than the {most} that it may have")
    raise InputError(f"{path}: not a regular file")


def _reason(exc: BaseException) -> str:
    """Return why something failed, in one line."""
    text = exc.strerror if isinstance(exc, OSError) and exc.strerror else str(exc)
    return " ".join(text.split()) or type(exc).__name__


def read_image(path: Pathish) -> NDArray[Any]:
    """Read a picture (PNG, JPEG, PPM/PGM, BMP, TIFF, GIF or WebP) as uint8 or uint16, (H, W) or (H, W, 3).

    Palettes are resolved and alpha is dropped; 16-bit *colour* is read with 8 bits, and refused in a TIFF. So is a
    TIFF of several pages, unless all but the first are reduced copies.
    """
    return decode_image(read_bytes(path), str(path))


def decode_image(data: bytes, where: str) -> NDArray[Any]:
    """Decode the bytes of a picture; see `read_image`. `where` is what messages call it."""
    return _with_image(data, where, _pixels)


def image_shape(data: bytes, where: str) -> tuple[int, int]:
    """Return the height and width in the head of a picture."""
    return _with_image(data, where, lambda image: (image.height, image.width))


def mask_shape(data: bytes, where: str) -> tuple[int, int]:
    """Return the height and width of a mask, an 8-bit gray picture; InputError for other pictures."""
    mode, shape = _with_image(data, where, lambda image: (image.mode, (image.height, image.width)))
    if mode not in ("1", "L"):
        raise InputError(f"{where}: not a mask, which is an 8-bit gray picture (the mode of this one is {mode})")
    return shape


def _with_image(data: bytes, where: str, read: Callable[[Any], T]) -> T:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on what is damaged: it is read, or it is not
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=_PICTURES) as image:
                _require_plausible(image.size, data)
                if image.format == "TIFF":
                    _require_one_frame(image)
                return read(image)
    except Exception as exc:  # Pillow's decoders let nearly any exception through on damaged files
        why = "unknown format" if isinstance(exc, UnidentifiedImageError) else _reason(exc)
        raise InputError(f"{where}: not a picture that can be read ({why})") from exc


def _require_plausible(size: tuple[int, int], data: bytes) -> None:
    """Refuse a header that promises more than any picture of so many bytes holds, 8 pixels in a byte."""
    (width, height), n_scans = size, data.count(b"\xff\xda") if data.startswith(b"\xff\xd8") else 1
    if width * height > MAX_PIXELS:
        raise ValueError(f"{width} x {height} pixels are more than the {MAX_PIXELS} allowed")
    if width * height > 8 * _DEFLATE_MAX_RATIO * len(data):
        raise ValueError(f"{len(data)} bytes cannot hold {width} x {height} pixels")
    if n_scans * width * height > MAX_SCANS * MAX_PIXELS:
        raise ValueError(f"{n_scans} scans of {width} x {height} pixels would take minutes")


def _require_one_frame(image: Any) -> None:
    """Refuse a TIFF that is no single frame, or whose colours would lose bits."""
    subfile, bits = 254, 258  # tags: bit 0 of the first one marks a reduced copy
    if image.mode == "RGB" and max(image.tag_v2.get(bits, (8,))) > 8:
        raise ValueError("16-bit colour; convert it to 16-bit gray")
    pages = 1
    for page in range(1, image.n_frames):
        image.seek(page)
        pages += not image.tag_v2.get(subfile, 0) & 1
    image.seek(0)
    if pages > 1:
        raise ValueError(f"a TIFF of {pages} pages; save each frame as a file of its own")


def _pixels(image: Any) -> NDArray[Any]:
    mode = image.mode
    if mode.startswith("I;16") or mode == "I":
        values = np.asarray(image)
        if values.min() < 0 or values.max() > 65535:
            raise ValueError("values outside 0..65535")
        return values.astype(np.uint16)
    if mode in ("1", "L", "LA", "La"):
        return np.array(image.convert("L"), dtype=np.uint8)
    if mode == "F":
        raise ValueError("its pixels are floating-point; 8 or 16 bits are supported")
    return np.array(image.convert("RGB"), dtype=np.uint8)


def write_image(path: Pathish, image: NDArray[np.uint8]) -> None:
    """Write a picture, uint8 of shape (H, W) or (H, W, 3), atomically, in the format of the suffix."""
    from PIL import Image

    image = np.asarray(image)
    colour_or_gray = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not colour_or_gray or image.size == 0:
        raise InputError(f"{path}: a picture is uint8 (H, W) or (H, W, 3), not {image.dtype} {image.shape}")
    known = {ext for ext, name in Image.registered_extensions().items() if name in Image.SAVE}
    if Path(path).suffix.lower() not in known:
        raise InputError(f"{path}: no picture format has the suffix {Path(path).suffix!r}; use .png")
    with atomic_path(path) as temporary:
        Image.fromarray(np.ascontiguousarray(image)).save(temporary)


def read_flow(path: Pathish) -> NDArray[np.float32]:
    """Read a flow field: ``.flo`` (Middlebury) or ``.png`` (KITTI, 16-bit RGB).

    Parameters
    ----------
    path : str or path
        The file; its suffix decides the format.

    Returns
    -------
    ndarray of float32, (2, H, W)
        Pixels, x to the right then y down; NaN in both components where unknown.
    """
    _flow_suffix(path)
    return decode_flow(read_bytes(path), str(path))


def decode_flow(data: bytes, where: str) -> NDArray[np.float32]:
    """Decode the bytes of a flow field; `where` is its path, whose suffix decides the format; see `read_flow`."""
    return (decode_flo if _flow_suffix(where) == ".flo" else decode_kitti_png)(data, where)


def flow_shape(data: bytes, where: str) -> tuple[int, int]:
    """Return the height and width in the head of a flow field; see `decode_flow`."""
    return (_check_flo_header if _flow_suffix(where) == ".flo" else _check_kitti_header)(data, where)


def write_flow(path: Pathish, flow: NDArray[Any]) -> None:
    """Write a flow field atomically: ``.flo`` (Middlebury) or ``.png`` (KITTI, 16-bit RGB).

    Parameters
    ----------
    path : str or path
        The file; its suffix decides the format.
    flow : ndarray, (2, H, W)
        Pixels; a pixel with NaN in a component is written as unknown.
    """
    (write_flo if _flow_suffix(path) == ".flo" else write_kitti_png)(path, flow)


def _flow_suffix(path: Pathish) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in (".flo", ".png"):
        raise unknown_name("flow format", suffix, (".flo", ".png"), where=str(path))
    return suffix


def decode_flo(data: bytes, where: str) -> NDArray[np.float32]:
    """Decode the bytes of a ``.flo`` file; `where` is what messages call it."""
    height, width = _check_flo_header(data, where)
    pairs = np.frombuffer(data, dtype="<f4", offset=12).reshape(height, width, 2)
    return mark_unknown(np.moveaxis(pairs, 2, 0))


def _check_flo_header(data: bytes, where: str) -> tuple[int, int]:
    """Return (height, width) of a ``.flo`` file that is as long as its header promises."""
    if not data:
        raise InputError(f"{where}: the file is empty")
    if len(data) < 12 or data[:4] != FLO_TAG:
        raise InputError(f"{where}: not a .flo file (it starts with {data[:4]!r}, not {FLO_TAG!r})")
    width, height = struct.unpack("<ii", data[4:12])
    if not (1 <= width <= MAX_FLO_SIDE and 1 <= height <= MAX_FLO_SIDE):
        raise InputError(f"{where}: width {width} x height {height} is not within 1..{MAX_FLO_SIDE}")
    expected = 12 + 8 * width * height
    if len(data) != expected:
        fault = "cut off" if len(data) < expected else "followed by something else"
        raise InputError(f"{where}: {fault}: {width} x {height} needs {expected} bytes, found {len(data)}")
    return height, width


def mark_unknown(flow: NDArray[Any]) -> NDArray[np.float32]:
    """Return a float32 copy of `flow` (2, H, W) with NaN in both components wherever it is unknown.

    Unknown is a component that is NaN or larger than 1e9 in absolute value, as Middlebury defines it.
    """
    with np.errstate(over="ignore"):
        marked = np.array(flow, dtype=np.float32, order="C")
    known = (np.abs(marked) <= UNKNOWN_ABOVE).all(axis=0)
    marked[:, ~known] = np.nan
    return marked


def write_flo(path: Pathish, flow: NDArray[Any]) -> None:
    """Write a Middlebury ``.flo`` file; see `write_flow`. Unknown pixels are stored as 1666666752."""
    array, unknown = _flow_to_write(path, flow)
    height, width = unknown.shape
    if max(height, width) > MAX_FLO_SIDE:
        raise InputError(f"{path}: {width} x {height} is too large for .flo (at most {MAX_FLO_SIDE} a side)")
    _require_range(path, array, unknown, -UNKNOWN_ABOVE, UNKNOWN_ABOVE)
    pairs = np.moveaxis(array, 0, 2).astype("<f4")
    pairs[unknown] = FLO_UNKNOWN
    with atomic_path(path) as temporary:
        temporary.write_bytes(FLO_TAG + struct.pack("<ii", width, height) + pairs.tobytes())


def decode_kitti_png(data: bytes, where: str) -> NDArray[np.float32]:
    """Decode a KITTI flow: 16-bit RGB png, ``u = (R - 2^15) / 64``, ``v = (G - 2^15) / 64``, known where B > 0."""
    import png

    height, width = _check_kitti_header(data, where)
    flow = np.empty((2, height, width), np.float32)  # holds all multiples of 1/64 below 512 exactly
    try:
        # A row has a byte more, also in each pass of an interlaced picture.
        _require_bounded_data(data, 6 * width * height + 2 * height + 8)
        n_rows = 0
        for n_rows, row in enumerate(png.Reader(bytes=data).read()[2], 1):
            values = np.asarray(row, dtype=np.float32).reshape(width, 3)
            flow[:, n_rows - 1] = (values[:, :2].T - _KITTI_ZERO) / _KITTI_STEP
            flow[:, n_rows - 1, values[:, 2] == 0] = np.nan
        if n_rows != height:
            raise ValueError(f"{n_rows} rows of {height}")
    except Exception as exc:  # pypng lets zlib, struct and index errors through on damaged files
        raise InputError(f"{where}: damaged PNG ({_reason(exc)})") from exc
    return flow


def _require_bounded_data(data: bytes, most: int) -> None:
    """Refuse a PNG of more than `most` bytes of pixels, and a second head: pypng makes room for both at once."""
    import png

    unpacker, size, heads, pixels = zlib.decompressobj(), 0, 0, 0
    for kind, packed in png.Reader(bytes=data).chunks():
        heads += kind == b"IHDR"
        pixels += kind == b"IDAT"
        while kind == b"IDAT" and packed and not unpacker.eof:
            size += len(unpacker.decompress(packed, 2**20))
            packed = unpacker.unconsumed_tail
            if size > most:
                raise ValueError(f"its data unpack into more than the {most} bytes that its size needs")
    if heads > 1 or not pixels:  # pypng goes on after the end until there are pixels
        raise ValueError("it has a second head, or no pixels")


def _check_kitti_header(data: bytes, where: str) -> tuple[int, int]:
    """Return (height, width) of a 16-bit RGB PNG whose data can be as much as its header promises."""
    if len(data) < 33 or data[:8] != _PNG_SIGNATURE or data[12:16] != b"IHDR":
        raise InputError(f"{where}: not a PNG file")
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    if (depth, colour) != (16, 2):
        raise InputError(f"{where}: not a KITTI flow, which is a 16-bit RGB PNG (8-bit ones are pictures)")
    if not 1 <= width * height <= MAX_PIXELS:
        raise InputError(f"{where}: width {width} x height {height} is not within 1..{MAX_PIXELS} pixels")
    if 6 * width * height > _DEFLATE_MAX_RATIO * len(data):
        raise InputError(f"{where}: cut off: {len(data)} bytes cannot hold {width} x {height} pixels")
    return height, width


def write_kitti_png(path: Pathish, flow: NDArray[Any]) -> None:
    """Write a KITTI flow, rounded to 1/64 pixel and within -512 .. 511.984; see `decode_kitti_png`."""
    import png

    array, unknown = _flow_to_write(path, flow)
    _require_range(path, array, unknown, -_KITTI_ZERO / _KITTI_STEP, (_KITTI_ZERO - 1) / _KITTI_STEP)
    height, width = unknown.shape
    values = np.zeros((height, width, 3), dtype=">u2")
    codes = np.rint(np.where(unknown, 0.0, array) * _KITTI_STEP) + _KITTI_ZERO
    values[..., :2] = np.moveaxis(codes, 0, 2)
    values[..., 2] = 1
    values[unknown] = 0
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        writer = png.Writer(width, height, greyscale=False, bitdepth=16)
        writer.write_packed(file, (row.tobytes() for row in values))


def _flow_to_write(path: Pathish, flow: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the flow in float64 and the mask of its unknown pixels."""
    flow = np.asarray(flow)
    if flow.ndim != 3 or flow.shape[0] != 2 or flow.size == 0:
        raise InputError(f"{path}: a flow has the shape (2, H, W), not {flow.shape}")
    if flow.dtype.kind not in "fiu":
        raise InputError(f"{path}: a flow is made of real numbers, not {flow.dtype}")
    array = flow.astype(np.float64)
    return array, np.isnan(array[0]) | np.isnan(array[1])


def _require_range(
    path: Pathish, flow: NDArray[np.float64], unknown: NDArray[np.bool_], low: float, high: float
) -> None:
    bad = ((flow < low) | (flow > high)).any(axis=0) & ~unknown
    if bad.any():
        row, col = np.argwhere(bad)[0]
        raise InputError(
            f"{path}: {int(bad.sum())} flow vectors are outside {low:g} .. {high:.6g} pixels, which the "
            f"format cannot hold; the first is {flow[:, row, col].tolist()} at row {row}, column {col}"
        )


def ensure_folder(folder: Path) -> Path:
    """Create a folder of results, and its parents, unless it is there; return it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise InputError(
            f"results folder {folder}: cannot be created ({exc.strerror}); set paths.results"
        ) from exc
    if not os.access(folder, os.W_OK):
        raise InputError(f"results folder {folder}: cannot be written; set paths.results")
    return folder


def refuse_links_out(results: Path) -> None:
    """Refuse a results folder of which a folder or file, or one in ``runs``, is a link that leads out of it.

    The folder itself may be a link, and may be anywhere.
    """
    home = results.resolve()
    for path in (*results.glob("*"), *results.glob("runs/*")):
        if path.is_symlink() and not path.resolve().is_relative_to(home):
            raise InputError(f"{path}: is a link that leads out of the results folder; set paths.results instead")


def write_text(text: str, path: Path) -> Path:
    """Write a text file atomically and return its path; the folder must exist."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path
