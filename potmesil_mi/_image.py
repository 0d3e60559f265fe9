"""Pictures in files: read, and written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ._files import require_path, require_writable, written_whole

PICTURES = (".exr", ".png", ".jpg", ".jpeg")
"""Suffixes of the files that :func:`write_picture` writes."""

OIIO_NAMES = {"aperture": "FNumber"}
"""Attributes of OpenEXR that OpenImageIO calls otherwise."""

EXIF_TEXTS = ("Software", "ImageDescription")
"""What may be said of a picture that files without room for more have a place for."""

LARGEST_WHOLE = (1 << 31) - 1
"""The largest whole number that an attribute of OpenEXR may be."""

WINDOWS = {"dataWindow", "displayWindow"}
"""What may be said of where a picture is in the whole: left, top, width, height."""

JPEG_QUALITY = 90
"""Quality of JPEG files, 1 to 100."""


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
    """A picture that :func:`write_picture` wrote, in 8-bit sRGB without alpha: uint8 (H, W, 3)."""
    import mitsuba as mi

    bitmap = mi.Bitmap(os.fspath(path))
    if bitmap.component_format() != mi.Struct.Type.UInt8:  # Clipped, see write_picture.
        bitmap = mi.Bitmap(np.clip(np.array(bitmap, dtype=np.float32), 0, 1))
    return np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True))


def write_picture(
    image: Any,
    path: str | os.PathLike[str],
    said: Mapping[str, Any] | None = None,
    maps: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write linear RGB (A), (H, W, 3 or 4): ``.exr`` in float32, else in 8-bit sRGB.

    What is ``said`` of it, numbers, pairs of them, matrices (4, 4) and text, becomes attributes of
    an EXR, and text in a PNG; a JPEG has ``EXIF_TEXTS`` of it. ``maps``,
    (H, W), become further channels of an EXR. Raises ``ValueError`` for another suffix and
    ``OSError`` where it cannot be written; then nothing is left behind.
    """
    path = require_writable(path, PICTURES)
    values = np.ascontiguousarray(image, dtype=np.float32)
    ending = path.suffix.lower()
    if ending != ".exr":
        values = _in_srgb(values if ending == ".png" else values[..., :3])
        maps = None
    spec = _spec_of(values, ending, said or {})
    if maps:
        spec.channelnames = (*spec.channelnames, *maps)
        spec.nchannels += len(maps)
        planes = [np.asarray(plane, np.float32)[..., None] for plane in maps.values()]
        values = np.concatenate([values, *planes], axis=2)
    with written_whole(path) as temporary:
        _write(values, spec, temporary)


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
    spec = _spec_of(values, ".exr", said or {})
    spec.channelnames = tuple(maps)
    if half:
        spec.set_format("half")
    with written_whole(path) as temporary:
        _write(values, spec, temporary)


def write_tiff(image: Any, path: str | os.PathLike[str]) -> None:
    """Write linear RGB, (H, W, 3 or more), as a TIFF in 8-bit sRGB without alpha.

    Raises what :func:`write_picture` does.
    """
    path = require_writable(path, (".tif",))
    values = _in_srgb(np.ascontiguousarray(np.asarray(image)[..., :3], dtype=np.float32))
    with written_whole(path) as temporary:
        _write(values, _spec_of(values, ".tif", {}), temporary)


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """The sRGB encoding of linear values from 0 to 1 (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """The inverse of :func:`srgb_from_linear`."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _in_srgb(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear colours, which are clipped to [0, 1]; alpha stays linear."""
    values = np.clip(np.nan_to_num(linear), 0, 1)
    if values.shape[2] == 4:  # PNG has colours that are not multiplied by alpha.
        alpha = np.maximum(values[..., 3:], np.float32(1e-6))
        values[..., :3] = np.clip(np.nan_to_num(linear[..., :3]) / alpha, 0, 1)
    values[..., :3] = srgb_from_linear(values[..., :3])
    return (values * 255 + np.float32(0.5)).astype(np.uint8)


def _spec_of(values: np.ndarray, ending: str, said: Mapping[str, Any]) -> Any:
    """What OpenImageIO is to know of a picture in a file of that ``ending``."""
    import OpenImageIO as oiio

    height, width, channels = values.shape
    spec = oiio.ImageSpec(width, height, channels, "float" if ending == ".exr" else "uint8")
    spec.attribute("oiio:UnassociatedAlpha", 1)  # Leave the numbers as they are.
    texts = {name: value for name, value in said.items() if name not in WINDOWS}
    if ending == ".exr":
        spec.attribute("compression", "zip")
        if said.keys() >= WINDOWS:
            _place(spec, said["dataWindow"], said["displayWindow"])
        for name, value in texts.items():
            name = OIIO_NAMES.get(name, name)
            if isinstance(value, np.ndarray):
                spec.attribute(name, oiio.TypeDesc("matrix"), tuple(map(float, value.ravel())))
            elif isinstance(value, tuple):
                spec.attribute(name, oiio.TypeDesc("float[2]"), value)
            elif isinstance(value, int) and abs(value) > LARGEST_WHOLE:
                spec.attribute(name, str(value))
            else:
                spec.attribute(name, value)
        return spec
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("CompressionQuality", JPEG_QUALITY)
    for name, value in texts.items():
        if ending != ".png" and name not in EXIF_TEXTS:
            continue
        if isinstance(value, np.ndarray):
            value = " ".join(f"{number:.9g}" for number in value.ravel())
        spec.attribute(name, str(value))
    return spec


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
