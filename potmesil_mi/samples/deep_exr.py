"""Point samples as deep EXR files.

One deep pixel holds the samples of one pixel, nearest first. ``R``, ``G``, ``B``, ``A`` and ``Z``
mean what the OpenEXR standard says: colours are multiplied by ``A``, which is chosen so that
flattening a pixel (each sample over those behind it) gives the weighted mean of its samples, the
pinhole picture. Beside them stand ``id``, with its names in the ``idManifest``, and what the
standard has no name for: ``potmesil.x`` and ``potmesil.y``, the position in pixels of the whole
film, ``potmesil.weight`` and ``potmesil.alpha``. Camera and lens are JSON in attributes of the
header; a telecentric lens has a ``type`` there. The data window is the window that was sampled:
with overscan it goes beyond the crop window, and may go beyond the film, the display window.

What is hidden from the pinhole would spoil the flattened picture. It is in a second part of the
file, named ``hidden``, which is there only if there are such samples; readers that know one part
take the first, ``visible``. Its channels are the same and ``potmesil.layer``.

Where things are seen through mirrors and panes there are ``potmesil.through``, the depth of the
mirror or pane, ``Z`` being that of the image; and ``potmesil.visibility0`` and
``potmesil.visibility1``, whole numbers of 32 bits, of which bit i of the first is set where point i
of the lens sees the sample, and bit i of the second for point 32 + i. The points are those of H.
Vogel's sunflower: in units of the half-widths ``visibility_radius`` of ``potmesil:samples`` point i
is sqrt((i + 1/2)/64) from the middle, i (3 - sqrt(5)) pi radians from the right, as the camera
looks, on downwards.

Samples with features for a denoiser have ``albedo.R``, ``.G`` and ``.B``, and the shading normal in
the world, ``N.X``, ``N.Y`` and ``N.Z``, none of them multiplied by ``A``.

Samples of an exposure during which something moves have ``time``, the part of the exposure that is
over, 0 to 1, and ``motion.X``, ``motion.Y`` and ``motion.Z``: by how much their place changes
during the part of the exposure that they stand for, in pixels to the right and downwards, and their
depth in scene units away from the camera.

AOVs of samples have channels named after them, such as ``aov.dd.T``, not multiplied by ``A``
either; ``aov_names`` of ``potmesil:samples`` has their order.

Version 1 had neither hidden samples nor overscan, and positions relative to the pixel. Versions
1 and 2 call the lens's ``film`` ``image_distance``.

What is in a file is not trusted: its header is data of a known form, names no other file, and
memory is taken only as its size justifies.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from .columns import Columns
from .exr_layout import require_bounded
from .header import TEXTS, Header
from .raster import Window
from .standard import standard_attributes

VERSION = 3
"""Of the files that are written; earlier ones are read as well."""

ATTRIBUTE = "potmesil:{}"
"""Names of the attributes that are JSON."""

_OWN = ("potmesil.x", "potmesil.y", "potmesil.weight", "potmesil.alpha")
_LAYER = "potmesil.layer"
_THROUGH = "potmesil.through"
_VISIBILITY = ("potmesil.visibility0", "potmesil.visibility1")
_TIME = "time"
_AOV = "aov.{}"
_VECTORS = {
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("N.X", "N.Y", "N.Z"),
    "motion": ("motion.X", "motion.Y", "motion.Z"),
}
"""Channels of columns of three numbers; those for denoisers have the names that renderers commonly
give them."""


def write(path: Path, header: Header, columns: Columns) -> None:
    """Write samples to a deep EXR."""
    attributes = _attributes(header)
    hidden = columns.layer > 0
    parts = [OpenEXR.Part(attributes, _channels(columns, header, ~hidden), name="visible")]
    if hidden.any():
        channels = _channels(columns, header, hidden)
        parts.append(OpenEXR.Part(dict(attributes), channels, name="hidden"))
    with OpenEXR.File(parts) as file:
        file.write(str(path))


def read(path: Path) -> tuple[Header, Columns]:
    """What :func:`write` wrote. See ``files.read``; errors do not name the file.

    Raises ``ValueError`` for a file that is not EXR, is truncated or damaged, needs more memory
    than its size justifies (see ``exr_layout.require_bounded``), or does not hold the samples of
    this package, and whatever OpenEXR makes of it.
    """
    if not OpenEXR.isOpenExrFile(str(path)):
        raise ValueError("is not an EXR file")
    require_bounded(path)  # OpenEXR unpacks attributes also where it reads the header alone.
    with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
        attributes, parts = dict(file.header()), len(file.parts)
    missing = {ATTRIBUTE.format(name) for name in TEXTS} - set(attributes)
    if attributes.get("type") != OpenEXR.deepscanline or missing:
        raise ValueError(
            "does not hold point samples; it must be a deep EXR that PointSamples.save wrote"
        )
    header, version = _parsed(attributes)
    del attributes
    with OpenEXR.File(str(path), separate_channels=True) as file:
        if len(file.parts) < parts:  # parts that cannot be read are left out
            raise ValueError("is truncated or damaged")
        read = [_columns(part.channels, header, version) for part in file.parts]
    columns = [part for part in read if part is not None]
    if not columns:
        raise ValueError("there are no samples in it")
    return header, Columns.joined(columns)


def _attributes(header: Header) -> dict[str, Any]:
    """The header as attributes of OpenEXR."""
    width, height = header.camera.film_size
    manifest = OpenEXR.IDManifest()
    group = manifest.add({"id"})
    group.setComponent("name")
    group.setHashScheme(OpenEXR.ID_MANIFEST_NOTHASHED)
    group.setEncodingScheme(OpenEXR.ID_MANIFEST_ID_SCHEME)
    group.setLifetime(OpenEXR.LIFETIME_STABLE)
    for surface, name in header.surfaces.items():
        group.insert(surface, name)
    standard = {
        name: np.asarray(value, np.float32) if isinstance(value, (tuple, np.ndarray)) else value
        for name, value in standard_attributes(header.camera, header.lens).items()
        if not name.endswith("Window")
    }
    return {
        "type": OpenEXR.deepscanline,
        "compression": OpenEXR.ZIPS_COMPRESSION,
        "displayWindow": _corners(Window(0, 0, width, height)),
        "dataWindow": _corners(header.window),
        "idManifest": manifest,
        **standard,
        **{ATTRIBUTE.format(name): text for name, text in header.texts(VERSION).items()},
    }


def _corners(window: Window) -> tuple[np.ndarray, np.ndarray]:
    """First and last pixel, both of the window, as OpenEXR has them."""
    return (
        np.array([window.left, window.top], dtype=np.int32),
        np.array([window.right - 1, window.bottom - 1], dtype=np.int32),
    )


def _parsed(attributes: dict[str, Any]) -> tuple[Header, int]:
    """The header that attributes stand for, and the version of the file."""
    (left, top), (right, bottom) = (
        tuple(int(n) for n in corner) for corner in attributes["dataWindow"]
    )
    window = Window.of((left, top, right - left + 1, bottom - top + 1), "dataWindow")
    surfaces = {entry.id(): entry.text()[0] for entry in attributes["idManifest"][0]}
    texts = {name: attributes[ATTRIBUTE.format(name)] for name in TEXTS}
    return Header.parse(texts, ATTRIBUTE, VERSION, window, surfaces)


def _channels(columns: Columns, header: Header, chosen: np.ndarray) -> dict[str, np.ndarray]:
    """The deep channels of the ``chosen`` samples."""
    window = header.window
    which = np.flatnonzero(chosen)
    pixel = window.pixel_of(columns.x[which], columns.y[which])
    counts = np.bincount(pixel, minlength=window.size)
    # By pixel and depth, in one key: the bits of numbers > 0 are in the order of these.
    depth = columns.z[which].view(np.uint32)
    key = pixel.astype(np.uint64) << np.uint64(32) | depth
    order = which[np.argsort(key, kind="stable")]
    weight, alpha = columns.weight[order], columns.alpha[order]
    share = _share(weight, alpha, counts)
    channels = {
        "A": (alpha * share).astype(np.float32),
        "Z": columns.z[order],
        "id": columns.surface[order],
        "potmesil.x": columns.x[order],
        "potmesil.y": columns.y[order],
        "potmesil.weight": weight,
        "potmesil.alpha": alpha,
    }
    for i, name in enumerate("RGB"):
        channels[name] = (columns.rgb[order, i] * share).astype(np.float32)
    layer = columns.layer[order].astype(np.uint32)
    if layer.any():
        channels[_LAYER] = layer
    if columns.through is not None:
        channels[_THROUGH] = columns.through[order]
    if columns.visibility is not None:
        halves = columns.visibility[order].astype("<u8").view("<u4").reshape(-1, 2)
        channels |= dict(zip(_VISIBILITY, np.ascontiguousarray(halves.T), strict=True))
    if columns.time is not None:
        channels[_TIME] = columns.time[order]
    several = {**_VECTORS, "aovs": _aov_channels(header)}
    for column, names in several.items():
        values = getattr(columns, column)
        if values is not None:
            channels |= dict(zip(names, np.ascontiguousarray(values[order].T), strict=True))
    return {name: _per_pixel(values, counts, window) for name, values in channels.items()}


def _per_pixel(values: np.ndarray, counts: np.ndarray, window: Window) -> np.ndarray:
    """An array of objects, one for each pixel: the consecutive ``counts`` of ``values``."""
    pixels = np.empty(window.size, dtype=object)
    pixels.fill(values[:0])
    full = np.flatnonzero(counts)
    ends = np.cumsum(counts[full])
    rows = map(slice, (ends - counts[full]).tolist(), ends.tolist())
    pixels[full] = np.fromiter(map(values.__getitem__, rows), object, len(full))
    return pixels.reshape(window.shape)


def _aov_channels(header: Header) -> list[str]:
    """The names of the channels of AOVs."""
    return [_AOV.format(name) for name in header.aov_names]


def _columns(channels: dict[str, Any], header: Header, version: int) -> Columns | None:
    """The samples of one part of a file; none where it has no samples."""
    window, of_aovs = header.window, _aov_channels(header)
    names = ["R", "G", "B", "Z", "id", *_OWN, *of_aovs]
    optional = _LAYER, _THROUGH, _TIME, *_VISIBILITY, *itertools.chain(*_VECTORS.values())
    names += [name for name in optional if name in channels]
    absent = [name for name in names if name not in channels]
    if absent:
        raise ValueError(f"is damaged or not of this version: it has no channel {absent[0]}")
    counts, flat = flattened({name: channels[name].pixels for name in names})
    if not flat:
        return None
    weight, alpha = flat["potmesil.weight"], flat["potmesil.alpha"]
    x, y = flat["potmesil.x"], flat["potmesil.y"]
    if version == 1:
        pixel = np.repeat(np.arange(len(counts)), counts)
        x = x + (pixel % window.width + window.left).astype(np.float32)
        y = y + (pixel // window.width + window.top).astype(np.float32)
    rgb = np.stack([flat[name] for name in "RGB"], axis=1)
    visibility = None
    if all(name in flat for name in _VISIBILITY):
        halves = np.stack([flat[name].astype("<u4") for name in _VISIBILITY], axis=1)
        visibility = halves.view("<u8").ravel()
    return Columns(
        x=x,
        y=y,
        rgb=rgb / _share(weight, alpha, counts)[:, None],
        alpha=alpha,
        z=flat["Z"],
        surface=flat["id"],
        weight=weight,
        layer=flat.get(_LAYER, np.zeros(len(x))).astype(np.uint8),
        through=flat.get(_THROUGH),
        visibility=visibility,
        time=flat.get(_TIME),
        aovs=np.stack([flat[name] for name in of_aovs], axis=1) if of_aovs else None,
        **_vectors(flat),
    )


def flattened(pixels: Mapping[str, np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """How many samples each pixel has, row by row, and the channels of all of them, one by one.

    ``pixels`` are arrays (H, W) of arrays, as OpenEXR has them; ``Z`` is among them. There are no
    channels where there are no samples.
    """
    columns = {name: of.ravel() for name, of in pixels.items()}
    counts = np.array([0 if values is None else len(values) for values in columns["Z"]])
    full = np.flatnonzero(counts)
    if not len(full):
        return counts, {}
    return counts, {name: np.concatenate(of[full].tolist()) for name, of in columns.items()}


def _vectors(flat: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns of three numbers that a part of a file has."""
    return {
        column: np.stack([flat[name] for name in names], axis=1)
        for column, names in _VECTORS.items()
        if all(name in flat for name in names)
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
