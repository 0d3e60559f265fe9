"""Pictures in files: read, and written whole or not at all."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, TypedDict, get_args

import numpy as np

from ._files import require_path, require_suffix, require_writable, written_whole
from ._threads import for_each
from ._validation import require_choice, require_whole

BitDepth = Literal["8", "16", "half", "float"]
"""How numbers are kept: sRGB in 8 or 16 bits, or linear in floats of 16 or 32 bits."""

BIT_DEPTHS: dict[str, tuple[BitDepth, ...]] = {
    ".exr": ("float", "half"),
    ".png": ("8", "16"),
    ".tif": ("16", "8", "float"),
    ".tiff": ("16", "8", "float"),
    ".jpg": ("8",),
    ".jpeg": ("8",),
}
"""Those of the files that :func:`write_picture` writes, by their suffixes; the default first.

There is no TIFF of halves: few programs read them.
"""

PICTURES = tuple(BIT_DEPTHS)
"""Suffixes of the files that :func:`write_picture` writes."""

LOSSY = (".jpg", ".jpeg")
"""Those of files that have a quality, and no alpha."""

TYPES = {"8": "uint8", "16": "uint16", "half": "half", "float": "float"}
"""What OpenImageIO calls them."""

ROWS = 64
"""Rows that a thread encodes at once."""

LARGEST_HALF = float(np.finfo(np.float16).max)
"""What is larger in a picture of halves becomes this, and not infinite."""


class PictureForm(TypedDict, total=False):
    """How the numbers of pictures are kept: see :func:`write_picture`."""

    bit_depth: BitDepth
    quality: int


OIIO_NAMES = {"aperture": "FNumber"}
"""Attributes of OpenEXR that OpenImageIO calls otherwise."""

EXIF_TEXTS = ("Software", "ImageDescription")
"""What may be said of a picture that files without room for more have a place for."""

DESCRIPTION = "ImageDescription"
"""Where a TIFF has all that is said of it, as JSON: it has no attributes of one's own."""

OWN_LENS = "potmesil:lens"
"""What is always said of the pictures of this package: the lens, as JSON."""

LARGEST_WHOLE = (1 << 31) - 1
"""The largest whole number that an attribute of OpenEXR may be."""

WINDOWS = {"dataWindow", "displayWindow"}
"""What may be said of where a picture is in the whole: left, top, width, height."""

JPEG_QUALITY = 90
"""Quality of JPEG files, 1 to 100, unless it is said."""

FULL_COLOR = 95
"""Quality of JPEG files from which on they have a colour for each pixel, and not for four."""


def read_luminance(path: str | os.PathLike[str]) -> np.ndarray:
    """The linear luminance of a picture that Mitsuba can read, float64 (H, W), rows from the top.

    Raises ``FileNotFoundError`` where there is none, ``ValueError`` for what is no picture.
    """
    import mitsuba as mi

    shown = f"filename={os.fspath(require_path(path, 'filename'))!r}"
    if not os.path.exists(path):
        raise FileNotFoundError(f"{shown}: there is no such file")
    try:
        bitmap = mi.Bitmap(os.fspath(path))
    except RuntimeError as error:
        raise ValueError(f"{shown}: is no picture that can be read: {error}") from error
    bitmap = bitmap.convert(mi.Bitmap.PixelFormat.Y, mi.Struct.Type.Float32, srgb_gamma=False)
    values = np.array(bitmap, dtype=np.float64)  # Its size has a type that needs a variant.
    return values.reshape(values.shape[:2])


def read_srgb(path: str | os.PathLike[str]) -> np.ndarray:
    """A picture that :func:`write_picture` wrote, in 8-bit sRGB without alpha: uint8 (H, W, 3).

    Raises ``OSError`` where it cannot be read.
    """
    import OpenImageIO as oiio

    how = oiio.ImageSpec()
    how.attribute("oiio:UnassociatedAlpha", 1)  # Leave the numbers as they are.
    opened = oiio.ImageInput.open(str(path), how)
    values = None if opened is None else opened.read_image(0, 0, 0, 3, opened.spec().format)
    if values is None:
        raise OSError(f"{path}: cannot be read: {(opened or oiio).geterror()}")
    if values.dtype == np.uint8:
        return np.asarray(values)
    if values.dtype == np.uint16:
        return ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return in_srgb(values.astype(np.float32), "8")


def require_format(
    paths: Iterable[str | os.PathLike[str]],
    bit_depth: BitDepth | None = None,
    quality: int | None = None,
) -> None:
    """Raise ``ValueError`` or ``TypeError`` unless pictures can be written so.

    ``bit_depth`` must be one of ``BIT_DEPTHS`` for the suffix of each of the ``paths``, of which
    one must be a JPEG where there is a ``quality``, 1 to 100. By default both are as they may be.
    """
    suffixes = [require_suffix(Path(path), PICTURES).suffix.lower() for path in paths]
    if bit_depth is not None:
        require_choice("bit_depth", bit_depth, get_args(BitDepth))
        for suffix in suffixes:
            if bit_depth not in BIT_DEPTHS[suffix]:
                raise ValueError(
                    f"bit_depth={bit_depth!r}: must be one of {', '.join(BIT_DEPTHS[suffix])} for "
                    f"a picture whose name ends in {suffix}"
                )
    if quality is not None:
        require_whole("quality", quality, 1, 100)
        if not set(suffixes) & set(LOSSY):
            raise ValueError(
                f"quality={quality}: must be left out, for it is of JPEG, and no picture's name "
                f"ends in {' or '.join(LOSSY)}"
            )


def write_picture(
    image: Any,
    path: str | os.PathLike[str],
    said: Mapping[str, Any] | None = None,
    maps: Mapping[str, np.ndarray] | None = None,
    *,
    bit_depth: BitDepth | None = None,
    quality: int = JPEG_QUALITY,
) -> None:
    """Write a picture in the format that the ending of its name stands for.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``image``                     (H, W, 3 or 4), linear RGB and alpha, which colours are
                                  multiplied by
    ``path``                      ends in one of ``PICTURES``
    ``said``                      what is said of it: numbers, pairs of them, matrices (4, 4) and
                                  text. Attributes of an EXR, text in a PNG, JSON in the
                                  ``ImageDescription`` of a TIFF; a JPEG has ``EXIF_TEXTS`` of it
    ``maps``                      (H, W), by their names: further channels of an EXR, in float32
    ``bit_depth``                 one of ``BIT_DEPTHS``, by default the first: ``8`` and ``16``
                                  bits are sRGB, clipped to [0, 1]; ``float`` is linear, and so is
                                  ``half``, clipped to +-65504
    ``quality``                   of a JPEG, 1 to 100 (default 90), from 95 on with a colour for
                                  each pixel; the others lose nothing
    ============================  ==========================================================

    Raises ``ValueError`` for another suffix and what it cannot have, and ``OSError`` where it
    cannot be written; then nothing is left behind.
    """
    path = require_writable(path, PICTURES)
    ending = path.suffix.lower()
    require_format([path], bit_depth)
    require_whole("quality", quality, 1, 100)
    depth = bit_depth or BIT_DEPTHS[ending][0]
    # OpenImageIO takes no array that is not aligned, as one from another process may be.
    values = np.require(image, np.float32, ["C_CONTIGUOUS", "ALIGNED"])
    if ending in LOSSY:
        values = values[..., :3]
    if depth in ("8", "16"):
        values = in_srgb(values, depth)
    elif depth == "half":
        values = np.clip(values, -LARGEST_HALF, LARGEST_HALF)
    spec = _spec_of(values, ending, depth, said or {})
    if ending in LOSSY:
        _set_quality(spec, quality, full_color=quality >= FULL_COLOR)
    if maps and ending == ".exr":
        # What is far, and the number of a surface, may be more than a half can be.
        spec.channelformats = (*(TYPES[depth],) * spec.nchannels, *("float",) * len(maps))
        spec.channelnames = (*spec.channelnames, *maps)
        spec.nchannels += len(maps)
        planes = [np.asarray(plane, np.float32)[..., None] for plane in maps.values()]
        values = np.concatenate([values, *planes], axis=2)
    with written_whole(path) as temporary:
        _write(values, spec, temporary)


def encoded_picture(image: Any, suffix: str, quality: int = JPEG_QUALITY) -> bytes:
    """What a file of that ``suffix`` has that :func:`write_picture` writes, in 8 bits.

    The other parameters are its own, and so is what is raised.
    """
    # OpenImageIO writes to memory for programs in C++ only.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"picture{suffix}"
        write_picture(image, path, bit_depth="8", quality=quality)
        return path.read_bytes()


def encoded_jpeg(picture: np.ndarray, quality: int) -> tuple[bytes, np.ndarray]:
    """A picture, uint8 (H, W, 3) in sRGB, as a JPEG of that ``quality``, and what this shows.

    Colours are not kept for four pixels at once, as JPEG mostly does: edges of lamps would suffer.
    """
    spec = _spec_of(picture, ".jpg", "8", {})
    _set_quality(spec, quality, full_color=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.jpg"
        _write(np.ascontiguousarray(picture), spec, path)
        return path.read_bytes(), read_srgb(path)


def _set_quality(spec: Any, quality: int, *, full_color: bool) -> None:
    """Let a JPEG have a ``quality``, and with ``full_color`` a colour for each pixel."""
    spec.attribute("CompressionQuality", quality)
    if full_color:
        spec.attribute("jpeg:subsampling", "4:4:4")


def write_maps(
    maps: Mapping[str, np.ndarray],
    path: str | os.PathLike[str],
    said: Mapping[str, Any] | None = None,
    *,
    half: bool = False,
) -> None:
    """Write ``maps`` alone, (H, W) each, as the channels of an EXR, in float32 or ``half``.

    ``said`` and what is raised are those of :func:`write_picture`.
    """
    path = require_writable(path, (".exr",))
    values = np.stack([np.asarray(plane, np.float32) for plane in maps.values()], axis=2)
    spec = _spec_of(values, ".exr", "half" if half else "float", said or {})
    spec.channelnames = tuple(maps)
    with written_whole(path) as temporary:
        _write(values, spec, temporary)


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """The sRGB encoding of linear values from 0 to 1 (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """The inverse of :func:`srgb_from_linear`."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def in_srgb(linear: np.ndarray, depth: BitDepth) -> np.ndarray:
    """Linear colours, clipped to [0, 1], in sRGB of so many bits; alpha stays linear."""
    kind = np.dtype(TYPES[depth])
    encoded = np.empty(linear.shape, kind)

    def encode(top: int) -> None:
        rows = slice(top, top + ROWS)
        values = np.clip(np.nan_to_num(linear[rows]), 0, 1)
        if values.shape[2] == 4:  # What is kept so has colours that are not multiplied by alpha.
            alpha = np.maximum(values[..., 3:], np.float32(1e-6))
            values[..., :3] = np.clip(np.nan_to_num(linear[rows, :, :3]) / alpha, 0, 1)
        values[..., :3] = srgb_from_linear(values[..., :3])
        encoded[rows] = values * np.float32(np.iinfo(kind).max) + np.float32(0.5)

    for_each(encode, range(0, len(linear), ROWS))
    return encoded


def _spec_of(values: np.ndarray, ending: str, depth: BitDepth, said: Mapping[str, Any]) -> Any:
    """What OpenImageIO is to know of a picture in a file of that ``ending``."""
    import OpenImageIO as oiio

    height, width, channels = values.shape
    spec = oiio.ImageSpec(width, height, channels, TYPES[depth])
    texts = {name: value for name, value in said.items() if name not in WINDOWS}
    if depth in ("8", "16"):
        spec.attribute("oiio:UnassociatedAlpha", 1)  # Leave the numbers as they are.
        spec.attribute("oiio:ColorSpace", "sRGB")
    if ending not in LOSSY:
        spec.attribute("compression", "zip")
    if ending == ".exr":
        if said.keys() >= WINDOWS:
            _place(spec, said["dataWindow"], said["displayWindow"])
        for name, value in texts.items():
            _put(spec, OIIO_NAMES.get(name, name), value)
    elif ending == ".png":
        for name, value in texts.items():
            if isinstance(value, np.ndarray):
                value = " ".join(f"{number:.9g}" for number in value.ravel())
            spec.attribute(name, str(value))
    else:
        for name in EXIF_TEXTS:
            if name in texts:
                spec.attribute(name, str(texts[name]))
        if texts and ending not in LOSSY:
            spec.attribute(DESCRIPTION, _described(texts))
    return spec


def _put(spec: Any, name: str, value: Any) -> None:
    """Make something an attribute of OpenEXR."""
    import OpenImageIO as oiio

    if isinstance(value, np.ndarray):
        spec.attribute(name, oiio.TypeDesc("matrix"), tuple(map(float, value.ravel())))
    elif isinstance(value, tuple):
        spec.attribute(name, oiio.TypeDesc("float[2]"), value)
    elif isinstance(value, int) and abs(value) > LARGEST_WHOLE:
        spec.attribute(name, str(value))
    else:
        spec.attribute(name, value)


def _described(texts: Mapping[str, Any]) -> str:
    """What is said of a picture as JSON, in which what is not finite is text."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.ravel().tolist()
        return str(value) if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps({name: plain(value) for name, value in texts.items()})


def attributes_described(text: Any) -> dict[str, Any]:
    """What the description of a TIFF says that :func:`write_picture` wrote; else nothing.

    It is not trusted: there are numbers, texts and lists of numbers in what is returned.
    """
    if not isinstance(text, str) or not text.startswith("{"):
        return {}
    try:
        values = json.loads(text, parse_int=float)  # A whole number may be too large for one.
    except (ValueError, RecursionError):
        return {}
    if not isinstance(values, dict) or OWN_LENS not in values:
        return {}

    def is_plain(value: Any) -> bool:
        if isinstance(value, list):
            return all(isinstance(of, float) for of in value)
        return isinstance(value, (str, float))

    return {name: value for name, value in values.items() if is_plain(value)}


def _place(spec: Any, box: tuple[int, ...], film: tuple[int, ...]) -> None:
    """Say where in the whole picture one is: left, top, width and height of both.

    A picture of another size, as a film with a border makes it, is one of its own.
    """
    if tuple(box[2:]) == (spec.width, spec.height):
        spec.x, spec.y = box[:2]
        spec.full_x, spec.full_y, spec.full_width, spec.full_height = film


def _write(values: np.ndarray, spec: Any, path: Path) -> None:
    import OpenImageIO as oiio

    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise OSError(f"{path}: {oiio.geterror()}")
    written = output.open(str(path), spec) and output.write_image(values)
    closed = output.close()
    if not (written and closed):
        raise OSError(f"{path}: could not be written: {output.geterror()}")
