"""Point samples as deep EXR files.

One deep pixel holds the samples of one pixel, nearest first. ``R``, ``G``, ``B``, ``A`` and ``Z``
mean what the OpenEXR standard says: colours are multiplied by ``A``, which is chosen so that
flattening a pixel (each sample over those behind it) gives the weighted mean of its samples, the
pinhole picture. Beside them stand ``id``, with its names in the ``idManifest``, and what the
standard has no name for: ``potmesil.x`` and ``potmesil.y``, the position in pixels of the whole
film, ``potmesil.weight`` and ``potmesil.alpha``. Camera and lens are JSON in attributes of the
header. The data window is the window that was sampled: with overscan it goes beyond the crop
window, and may go beyond the film, the display window.

What is hidden from the pinhole would spoil the flattened picture. It is in a second part of the
file, named ``hidden``, which is there only if there are such samples; readers that know one part
take the first, ``visible``. Its channels are the same and ``potmesil.layer``.

Version 1 had neither hidden samples nor overscan, and positions relative to the pixel.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from .._image import require_writable, written_whole
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from .point_samples import PointSamples

VERSION = 2

_OWN = ("potmesil.x", "potmesil.y", "potmesil.weight", "potmesil.alpha")
_LAYER = "potmesil.layer"


def save(samples: PointSamples, path: str | os.PathLike[str]) -> None:
    """Write ``samples`` to a deep EXR, whose name must end in ``.exr``.

    Raises ``ValueError`` for another name and ``OSError`` where it cannot be written; then
    nothing is left behind.
    """
    path = require_writable(path, [".exr"])
    header = _header(samples)
    hidden = samples.layer > 0
    parts = [OpenEXR.Part(header, _channels(samples, ~hidden), name="visible")]
    if hidden.any():
        parts.append(OpenEXR.Part(dict(header), _channels(samples, hidden), name="hidden"))
    with written_whole(path) as temporary, OpenEXR.File(parts) as file:
        file.write(str(temporary))


def load(path: str | os.PathLike[str]) -> PointSamples:
    """Read a deep EXR that :func:`save` wrote.

    Raises ``FileNotFoundError`` or ``IsADirectoryError`` where there is none, and ``ValueError``
    for a file that is not EXR, is truncated, or does not hold the samples of this package.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder, not a file")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    if not OpenEXR.isOpenExrFile(str(path)):
        raise ValueError(f"{path}: is not an EXR file")
    try:
        with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            header, parts = dict(file.header()), len(file.parts)
        missing = {"potmesil:samples", "potmesil:camera", "potmesil:lens"} - set(header)
        if header.get("type") != OpenEXR.deepscanline or missing:
            raise ValueError(
                f"{path}: does not hold point samples; it must be a deep EXR that "
                "PointSamples.save wrote"
            )
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if len(file.parts) < parts:  # parts that cannot be read are left out
                raise ValueError(f"{path}: is truncated or damaged")
            return _samples(header, [part.channels for part in file.parts])
    except (RuntimeError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: is damaged or not of this version: {error}") from error


def _header(samples: PointSamples) -> dict[str, Any]:
    camera, lens = samples.camera, samples.lens
    parameters = lens.to_dict()

    def window(x: int, y: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        return (
            np.array([x, y], dtype=np.int32),
            np.array([x + width - 1, y + height - 1], dtype=np.int32),
        )

    manifest = OpenEXR.IDManifest()
    group = manifest.add({"id"})
    group.setComponent("name")
    group.setHashScheme(OpenEXR.ID_MANIFEST_NOTHASHED)
    group.setEncodingScheme(OpenEXR.ID_MANIFEST_ID_SCHEME)
    group.setLifetime(OpenEXR.LIFETIME_STABLE)
    for surface, name in samples.surfaces.items():
        group.insert(surface, name)
    return {
        "type": OpenEXR.deepscanline,
        "compression": OpenEXR.ZIPS_COMPRESSION,
        "displayWindow": window(0, 0, *camera.film_size),
        "dataWindow": window(*samples.window),
        "idManifest": manifest,
        "aperture": lens.plain().f_number,
        "focus": parameters["focus_distance"] * parameters["millimeters_per_unit"] / 1000,
        "nominalFocalLength": parameters["focal_length"],
        "potmesil:camera": json.dumps(camera.to_dict()),
        "potmesil:lens": json.dumps(parameters),
        "potmesil:samples": json.dumps({"version": VERSION, "lattice": samples.lattice}),
    }


def _channels(samples: PointSamples, chosen: np.ndarray) -> dict[str, np.ndarray]:
    """The deep channels of the ``chosen`` samples."""
    width, height = samples.window[2:]
    pixel = samples.pixel()[chosen]
    order = np.lexsort([samples.z[chosen], pixel])
    counts = np.bincount(pixel, minlength=width * height)
    order = np.flatnonzero(chosen)[order]
    weight, alpha = samples.weight[order], samples.alpha[order]
    share = _share(weight, alpha, counts)
    columns = {
        "A": (alpha * share).astype(np.float32),
        "Z": samples.z[order],
        "id": samples.surface[order],
        "potmesil.x": samples.x[order],
        "potmesil.y": samples.y[order],
        "potmesil.weight": weight,
        "potmesil.alpha": alpha,
    }
    for i, name in enumerate("RGB"):
        columns[name] = (samples.rgb[order, i] * share).astype(np.float32)
    layer = samples.layer[order].astype(np.uint32)
    if layer.any():
        columns[_LAYER] = layer
    return {
        name: _per_pixel(values, counts).reshape(height, width) for name, values in columns.items()
    }


def _samples(header: dict[str, Any], parts: list[dict[str, Any]]) -> PointSamples:
    about = json.loads(header["potmesil:samples"])
    version = about["version"]
    if version not in (1, VERSION):
        raise ValueError(f"version {version}: must be 1 or {VERSION}")
    (left, top), (right, bottom) = (
        tuple(int(n) for n in corner) for corner in header["dataWindow"]
    )
    window = (left, top, right - left + 1, bottom - top + 1)
    columns = [_columns(channels, window, version) for channels in parts]
    columns = [part for part in columns if part]
    if not columns:
        raise ValueError("there are no samples in it")
    return PointSamples(
        **{name: np.concatenate([part[name] for part in columns]) for name in columns[0]},
        camera=Camera.from_dict(json.loads(header["potmesil:camera"])),
        lens=ThinLens.from_dict(json.loads(header["potmesil:lens"])),
        surfaces={e.id(): e.text()[0] for e in header["idManifest"][0]},
        lattice=about["lattice"],
        window=window,
    )


def _columns(
    channels: dict[str, Any], window: tuple[int, int, int, int], version: int
) -> dict[str, np.ndarray]:
    """The columns of one part of a file; none where it has no samples."""
    names = ["R", "G", "B", "Z", "id", *_OWN]
    names += [_LAYER] if _LAYER in channels else []
    pixels = {name: channels[name].pixels.ravel() for name in names}
    counts = np.array([0 if values is None else len(values) for values in pixels["Z"]])
    if not counts.any():
        return {}
    flat = {
        name: np.concatenate([values for values in column if values is not None])
        for name, column in pixels.items()
    }
    weight, alpha = flat["potmesil.weight"], flat["potmesil.alpha"]
    x, y = flat["potmesil.x"], flat["potmesil.y"]
    if version == 1:
        left, top, width, _ = window
        pixel = np.repeat(np.arange(len(counts)), counts)
        x = x + (pixel % width + left).astype(np.float32)
        y = y + (pixel // width + top).astype(np.float32)
    rgb = np.stack([flat[name] for name in "RGB"], axis=1)
    return {
        "x": x,
        "y": y,
        "rgb": rgb / _share(weight, alpha, counts)[:, None],
        "alpha": alpha,
        "z": flat["Z"],
        "surface": flat["id"],
        "weight": weight,
        "layer": flat.get(_LAYER, np.zeros(len(x))).astype(np.uint8),
    }


def _share(weight: np.ndarray, alpha: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The part of a pixel's remaining transparency that each of its samples takes up, (0, 1].

    With A_i = alpha_i share_i the samples in front let through 1 - sum_j<i w_j alpha_j / sum w,
    so colours times their share add up to the weighted mean.
    """
    weight = weight.astype(np.float64)
    starts = (np.cumsum(counts) - counts)[counts > 0]
    counts = counts[counts > 0]
    blocked = np.cumsum(weight * alpha) - weight * alpha
    blocked -= np.repeat(blocked[starts], counts)
    remaining = np.repeat(np.add.reduceat(weight, starts), counts) - blocked
    return np.minimum(weight / np.maximum(remaining, weight), 1.0)


def _per_pixel(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """An array of objects: the consecutive ``counts`` of ``values``, as views of them."""
    pixels = np.empty(len(counts), dtype=object)
    starts = np.cumsum(counts) - counts
    for count in np.unique(counts):
        same = np.flatnonzero(counts == count)
        if count == 0:
            pixels[same] = [np.empty(0, dtype=values.dtype)] * len(same)
            continue
        block = values[starts[same][:, None] + np.arange(count)]
        for i, row in zip(same, block, strict=True):
            pixels[i] = row
    return pixels
