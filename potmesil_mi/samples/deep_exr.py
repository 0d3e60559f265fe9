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

Version 1 had neither hidden samples nor overscan, and positions relative to the pixel. Versions
1 and 2 call the lens's ``film`` ``image_distance``.

What is in a file is not trusted: its header is data of a known form, names no other file, and
memory is taken only as its size justifies.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from .._image import require_writable, written_whole
from .._validation import require_whole
from ..optics.aperture import Aperture
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TYPE, TelecentricLens, require_fitting
from .columns import Columns, require_visibility_radius
from .exr_layout import require_bounded
from .raster import Window

VERSION = 3
"""Of the files that are written; earlier ones are read as well."""

F_NUMBERS = (1e-4, 1e12)
"""Finite aperture numbers of which single precision forms pictures."""

MAGNITUDES = (1e-30, 1e30)
"""The same of other numbers of a camera and a lens, if they are neither 0 nor infinite."""

_SMALL_AS_0 = ("to_world", "principal_point_offset")
"""Numbers that may be as small as they like: they are added to larger ones."""

LONGEST_JSON = 1 << 26
"""Most characters of a camera or a lens. An aperture of 4096 x 4096 elements may be as long."""

_OWN = ("potmesil.x", "potmesil.y", "potmesil.weight", "potmesil.alpha")
_LAYER = "potmesil.layer"
_THROUGH = "potmesil.through"
_VISIBILITY = ("potmesil.visibility0", "potmesil.visibility1")
_FEATURES = {"albedo": ("albedo.R", "albedo.G", "albedo.B"), "normal": ("N.X", "N.Y", "N.Z")}
"""Channels of columns for denoisers, by the names that renderers commonly give them."""


@dataclasses.dataclass(frozen=True)
class Header:
    """What a file says of its samples as a whole.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``camera``, ``lens``          the pinhole that took them, the lens that came with it
    ``window``                    pixels of the film that were sampled
    ``surfaces``                  name of every surface id
    ``lattice``                   positions are multiples of 1/lattice pixels; 0 for any
    ``visibility_radius``         half-widths of the lens of which samples have visibility, or
                                  ``None``
    ============================  ==========================================================

    Raises ``ValueError`` or ``TypeError`` that names the field for a crop window that goes beyond
    ``window``, and for numbers of which single precision forms no picture: an f-number that is
    neither in ``F_NUMBERS`` nor infinite, others beyond ``MAGNITUDES``, of which only the
    upper bound holds for ``to_world`` and ``principal_point_offset``.
    """

    camera: Camera
    lens: ThinLens | TelecentricLens
    window: Window
    surfaces: Mapping[int, str]
    lattice: int
    visibility_radius: Sequence[float] | None = None

    def __post_init__(self) -> None:
        require_whole("lattice", self.lattice, 0, 1 << 16)
        for half_width in self.visibility_radius or ():
            _require_magnitude("visibility_radius", half_width, MAGNITUDES[0])
        crop = Window(*self.camera.crop_offset, *self.camera.crop_size)
        if not self.window.covers(crop):
            raise ValueError(
                f"crop window {tuple(crop)}: must lie in the window {tuple(self.window)} that was "
                "sampled"
            )
        require_fitting(self.camera, self.lens)
        lens = self.lens.plain()
        least, most = F_NUMBERS
        if isinstance(lens, ThinLens) and not (
            least <= lens.f_number <= most or lens.f_number == math.inf
        ):
            raise ValueError(f"f_number={lens.f_number}: must be {least:g} to {most:g}, or inf")
        for name, value in [*lens.parameters().items(), *self.camera.to_dict().items()]:
            if name not in ("f_number", "aperture_radius"):
                _require_magnitude(name, value, 0.0 if name in _SMALL_AS_0 else MAGNITUDES[0])


def write(path: str | os.PathLike[str], header: Header, columns: Columns) -> None:
    """Write samples to a deep EXR, whose name must end in ``.exr``.

    Raises ``ValueError`` for another name and ``OSError`` where it cannot be written; then
    nothing is left behind.
    """
    path = require_writable(path, [".exr"])
    attributes = _attributes(header)
    hidden = columns.layer > 0
    parts = [OpenEXR.Part(attributes, _channels(columns, header.window, ~hidden), name="visible")]
    if hidden.any():
        channels = _channels(columns, header.window, hidden)
        parts.append(OpenEXR.Part(dict(attributes), channels, name="hidden"))
    with written_whole(path) as temporary, OpenEXR.File(parts) as file:
        file.write(str(temporary))


def read(path: str | os.PathLike[str]) -> tuple[Header, Columns]:
    """What ``write`` wrote.

    Raises ``OSError`` where there is no file or it cannot be read, and ``ValueError`` for one
    that is not EXR, is truncated or damaged, needs more memory than its size justifies (see
    ``exr_layout.require_bounded``), does not hold the samples of this package, or holds
    samples of which no picture can be formed. Each names the file.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder, not a file")
    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file")
    if not path.is_file():
        raise OSError(f"{path}: is not a file that can be read from its end")
    try:
        return _read(path)
    except OSError as error:
        raise type(error)(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    except Exception as error:  # Whatever OpenEXR, a parser or a check makes of a damaged file.
        what = str(error) or type(error).__name__
        raise ValueError(f"{path}: is damaged or not of this version: {what}") from error


def _read(path: Path) -> tuple[Header, Columns]:
    """See ``read``; errors do not name the file."""
    if not OpenEXR.isOpenExrFile(str(path)):
        raise ValueError("is not an EXR file")
    require_bounded(path)  # OpenEXR unpacks attributes also where it reads the header alone.
    with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
        attributes, parts = dict(file.header()), len(file.parts)
    missing = {"potmesil:samples", "potmesil:camera", "potmesil:lens"} - set(attributes)
    if attributes.get("type") != OpenEXR.deepscanline or missing:
        raise ValueError(
            "does not hold point samples; it must be a deep EXR that PointSamples.save wrote"
        )
    header, version = _parsed(attributes)
    del attributes
    with OpenEXR.File(str(path), separate_channels=True) as file:
        if len(file.parts) < parts:  # parts that cannot be read are left out
            raise ValueError("is truncated or damaged")
        read = [_columns(part.channels, header.window, version) for part in file.parts]
    columns = [part for part in read if part is not None]
    if not columns:
        raise ValueError("there are no samples in it")
    samples = Columns.joined(columns)
    require_visibility_radius(header.visibility_radius, samples.visibility is not None)
    if not samples.all_valid:
        raise ValueError(
            f"is damaged: {np.count_nonzero(~samples.is_valid())} of {len(samples)} samples have "
            "radiance, alpha, position or weight not finite, depth or weight not > 0, through "
            "not finite or < 0, albedo not 0 to 1, or a normal longer than 1"
        )
    return header, samples


def _attributes(header: Header) -> dict[str, Any]:
    """The header as attributes of OpenEXR."""
    lens = header.lens.plain()
    width, height = header.camera.film_size
    manifest = OpenEXR.IDManifest()
    group = manifest.add({"id"})
    group.setComponent("name")
    group.setHashScheme(OpenEXR.ID_MANIFEST_NOTHASHED)
    group.setEncodingScheme(OpenEXR.ID_MANIFEST_ID_SCHEME)
    group.setLifetime(OpenEXR.LIFETIME_STABLE)
    for surface, name in header.surfaces.items():
        group.insert(surface, name)
    # What OpenEXR has attributes for; a telecentric lens has none of it.
    standard = {}
    if isinstance(lens, ThinLens):
        standard = {
            "aperture": lens.f_number,
            "focus": lens.focus_distance * lens.millimeters_per_unit / 1000,
            "nominalFocalLength": lens.focal_length,
        }
    return {
        "type": OpenEXR.deepscanline,
        "compression": OpenEXR.ZIPS_COMPRESSION,
        "displayWindow": _corners(Window(0, 0, width, height)),
        "dataWindow": _corners(header.window),
        "idManifest": manifest,
        **standard,
        "potmesil:camera": json.dumps(header.camera.to_dict()),
        "potmesil:lens": json.dumps(header.lens.to_dict()),
        "potmesil:samples": json.dumps(_about(header)),
    }


def _about(header: Header) -> dict[str, Any]:
    """What a file says of its samples beside camera and lens."""
    about: dict[str, Any] = {"version": VERSION, "lattice": header.lattice}
    if header.visibility_radius is not None:
        about["visibility_radius"] = list(header.visibility_radius)
    return about


def _corners(window: Window) -> tuple[np.ndarray, np.ndarray]:
    """First and last pixel, both of the window, as OpenEXR has them."""
    return (
        np.array([window.left, window.top], dtype=np.int32),
        np.array([window.right - 1, window.bottom - 1], dtype=np.int32),
    )


def _parsed(attributes: dict[str, Any]) -> tuple[Header, int]:
    """The header that attributes stand for, and the version of the file."""
    about = _json_object(attributes, "potmesil:samples")
    radius = about.pop("visibility_radius", None)
    if about.keys() != {"version", "lattice"}:
        raise ValueError("potmesil:samples: must be a JSON object with lattice, version")
    if radius is not None:
        require_visibility_radius(radius, True)
    version = about["version"]
    if isinstance(version, bool) or version not in range(1, VERSION + 1):
        known = ", ".join(map(str, range(1, VERSION)))
        raise ValueError(f"version {version}: must be {known} or {VERSION}")
    (left, top), (right, bottom) = (
        tuple(int(n) for n in corner) for corner in attributes["dataWindow"]
    )
    window = Window.of((left, top, right - left + 1, bottom - top + 1), "dataWindow")
    header = Header(
        Camera.from_dict(_json_object(attributes, "potmesil:camera")),
        _lens(_json_object(attributes, "potmesil:lens")),
        window,
        {entry.id(): entry.text()[0] for entry in attributes["idManifest"][0]},
        about["lattice"],
        None if radius is None else (float(radius[0]), float(radius[1])),
    )
    return header, version


def _json_object(
    attributes: dict[str, Any], name: str, names: set[str] | None = None
) -> dict[str, Any]:
    """The JSON object in a text attribute; with ``names`` it must have those."""
    text = attributes[name]
    if not isinstance(text, str) or len(text) > LONGEST_JSON:
        raise ValueError(f"{name}: must be text of at most {LONGEST_JSON} characters")
    try:
        values = json.loads(text, parse_constant=_infinity)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name}: is not JSON: {error}") from error
    if not isinstance(values, dict) or (names and names != values.keys()):
        expected = f" with {', '.join(sorted(names))}" if names else ""
        raise ValueError(f"{name}: must be a JSON object{expected}")
    return values


def _infinity(text: str) -> float:
    """What JSON has no word for and Python writes; NaN is nowhere a value."""
    if text == "NaN":
        raise ValueError("NaN is not a number that is allowed")
    return float(text)


def _lens(values: dict[str, Any]) -> ThinLens | TelecentricLens:
    """The lens of a header, whose aperture names no file."""
    for name, value in values.items():
        if not isinstance(value, (str, int, float)) or isinstance(value, bool):
            raise ValueError(f"{name}={str(value)[:80]}: must be a number or text")
    if "aperture" in values:
        values = {**values, "aperture": Aperture.parse(values["aperture"], from_file=True)}
    kind = values.get("type")
    if kind is None:
        return ThinLens.from_dict(values)
    if kind != TYPE:
        raise ValueError(f"type={kind!r}: must be {TYPE}, or not be there for a thin lens")
    return TelecentricLens.from_dict(values)


def _require_magnitude(name: str, value: Any, least: float) -> None:
    """Raise ``ValueError`` for a number, or one in a tuple, that single precision cannot use."""
    if isinstance(value, tuple):
        for i, item in enumerate(value):
            _require_magnitude(f"{name}[{i}]", item, least)
        return
    most = MAGNITUDES[1]
    usable = not isinstance(value, (int, float)) or value == 0 or abs(value) == math.inf
    if not usable and not least <= abs(value) <= most:
        allowed = f"0, or {least:g} to {most:g}" if least else f"at most {most:g}"
        raise ValueError(f"{name}={value}: must be {allowed} in size")


def _channels(columns: Columns, window: Window, chosen: np.ndarray) -> dict[str, np.ndarray]:
    """The deep channels of the ``chosen`` samples."""
    pixel = window.pixel_of(columns.x, columns.y)[chosen]
    order = np.lexsort([columns.z[chosen], pixel])
    counts = np.bincount(pixel, minlength=window.size)
    order = np.flatnonzero(chosen)[order]
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
    for column, features in _FEATURES.items():
        values = getattr(columns, column)
        if values is not None:
            channels |= dict(zip(features, np.ascontiguousarray(values[order].T), strict=True))
    return {
        name: _per_pixel(values, counts).reshape(window.shape) for name, values in channels.items()
    }


def _columns(channels: dict[str, Any], window: Window, version: int) -> Columns | None:
    """The samples of one part of a file; none where it has no samples."""
    names = ["R", "G", "B", "Z", "id", *_OWN]
    optional = _LAYER, _THROUGH, *_VISIBILITY, *itertools.chain(*_FEATURES.values())
    names += [name for name in optional if name in channels]
    absent = [name for name in names if name not in channels]
    if absent:
        raise ValueError(f"is damaged or not of this version: it has no channel {absent[0]}")
    pixels = {name: channels[name].pixels.ravel() for name in names}
    counts = np.array([0 if values is None else len(values) for values in pixels["Z"]])
    if not counts.any():
        return None
    flat = {
        name: np.concatenate([values for values in column if values is not None])
        for name, column in pixels.items()
    }
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
        **_features(flat),
    )


def _features(flat: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns for denoisers that a part of a file has."""
    return {
        column: np.stack([flat[name] for name in names], axis=1)
        for column, names in _FEATURES.items()
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
