"""Point samples as deep EXR files.

One deep pixel holds the samples of one pixel, nearest first. ``R``, ``G``, ``B``, ``A`` and ``Z``
mean what the OpenEXR standard says: colours are multiplied by ``A``, which is chosen so that
flattening a pixel (each sample over those behind it) gives the weighted mean of its samples, the
pinhole picture. Beside them stand ``id``, with its names in the ``idManifest``, and what the
standard has no name for: ``potmesil.x`` and ``potmesil.y``, the position in the pixel,
``potmesil.weight`` and ``potmesil.alpha``. Camera and lens are JSON in attributes of the header.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from .camera import Camera
from .files import require_writable, written_whole
from .lens import ThinLens
from .samples import PointSamples

VERSION = 1

_OWN = ("potmesil.x", "potmesil.y", "potmesil.weight", "potmesil.alpha")


def save(samples: PointSamples, path: str | os.PathLike[str]) -> None:
    """Write ``samples`` to a deep EXR, whose name must end in ``.exr``.

    Raises ``ValueError`` for another name and ``OSError`` where it cannot be written; then
    nothing is left behind.
    """
    path = require_writable(path, [".exr"])
    width, height = samples.camera.crop_size
    pixel = samples.pixel()
    order = np.lexsort([samples.z, pixel])
    pixel = pixel[order]
    counts = np.bincount(pixel, minlength=width * height)
    share = _share(samples.weight[order], samples.alpha[order], counts)

    def column(values: np.ndarray) -> np.ndarray:
        return _per_pixel(values, counts).reshape(height, width)

    offset_x = samples.x[order] - (pixel % width + samples.camera.crop_offset[0])
    offset_y = samples.y[order] - (pixel // width + samples.camera.crop_offset[1])
    channels = {
        "A": column((samples.alpha[order] * share).astype(np.float32)),
        "Z": column(samples.z[order]),
        "id": column(samples.surface[order]),
        "potmesil.x": column(offset_x.astype(np.float32)),
        "potmesil.y": column(offset_y.astype(np.float32)),
        "potmesil.weight": column(samples.weight[order]),
        "potmesil.alpha": column(samples.alpha[order]),
    }
    for i, name in enumerate("RGB"):
        channels[name] = column((samples.rgb[order, i] * share).astype(np.float32))
    with written_whole(path) as temporary, OpenEXR.File(_header(samples), channels) as file:
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
            header = dict(file.header())
        missing = {"potmesil:samples", "potmesil:camera", "potmesil:lens"} - set(header)
        if header.get("type") != OpenEXR.deepscanline or missing:
            raise ValueError(
                f"{path}: does not hold point samples; it must be a deep EXR that "
                "PointSamples.save wrote"
            )
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if not file.parts:
                raise ValueError(f"{path}: is truncated or damaged")
            return _samples(dict(file.header()), file.channels())
    except (RuntimeError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: is damaged or not of this version: {error}") from error


def _header(samples: PointSamples) -> dict[str, Any]:
    camera, lens = samples.camera, samples.lens
    parameters = lens.to_dict()
    left, top = camera.crop_offset

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
        "dataWindow": window(left, top, *camera.crop_size),
        "idManifest": manifest,
        "aperture": float(ThinLens(**parameters).f_number),
        "focus": parameters["focus_distance"] * parameters["millimeters_per_unit"] / 1000,
        "nominalFocalLength": parameters["focal_length"],
        "potmesil:camera": json.dumps(camera.to_dict()),
        "potmesil:lens": json.dumps(parameters),
        "potmesil:samples": json.dumps({"version": VERSION, "lattice": samples.lattice}),
    }


def _samples(header: dict[str, Any], channels: dict[str, Any]) -> PointSamples:
    camera = Camera.from_dict(json.loads(header["potmesil:camera"]))
    about = json.loads(header["potmesil:samples"])
    if about["version"] != VERSION:
        raise ValueError(f"version {about['version']}: must be {VERSION}")
    columns = {name: channels[name].pixels.ravel() for name in ("R", "G", "B", "Z", "id", *_OWN)}
    counts = np.array([0 if values is None else len(values) for values in columns["Z"]])
    if not counts.any():
        raise ValueError("there are no samples in it")
    flat = {
        name: np.concatenate([values for values in pixels if values is not None])
        for name, pixels in columns.items()
    }
    width = camera.crop_size[0]
    pixel = np.repeat(np.arange(len(counts)), counts)
    weight, alpha = flat["potmesil.weight"], flat["potmesil.alpha"]
    rgb = np.stack([flat[name] for name in "RGB"], axis=1)
    return PointSamples(
        x=flat["potmesil.x"] + (pixel % width + camera.crop_offset[0]).astype(np.float32),
        y=flat["potmesil.y"] + (pixel // width + camera.crop_offset[1]).astype(np.float32),
        rgb=rgb / _share(weight, alpha, counts)[:, None],
        alpha=alpha,
        z=flat["Z"],
        surface=flat["id"],
        weight=weight,
        camera=camera,
        lens=ThinLens(**json.loads(header["potmesil:lens"])),
        surfaces={e.id(): e.text()[0] for e in header["idManifest"][0]},
        lattice=about["lattice"],
    )


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
