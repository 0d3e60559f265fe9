"""Deep EXR files of other programs as samples.

A deep pixel has samples of premultiplied R, G, B and A, each over those behind it (the OpenEXR
standard, "Interpreting Deep Pixels"). A sample of alpha a behind others that let through T becomes
one of the weight a T that the pinhole sees, and a hidden twin of a (1 - T), which a lens may see
past what is before it; what all let through shows nothing. A sample with a ``ZBack`` is a volume:
it is parted in slices, each of the same share of what is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..pictures.picture import Frame
from ..pictures.programs import depth_known
from ..pictures.reading import PictureFile
from .columns import ELSEWHERE, TWINS
from .exr_layout import require_bounded

SLICES = 4
"""Slices of a volume."""

LEAST_ALPHA = 1e-4
"""What covers less, as light that only glows, is taken to cover so much."""

LEAST_WEIGHT = 1e-5
"""What has less of a pixel is left out."""

LEAST_STEP = 1.2
"""Pixels by which one thing moves before another, seen through the lens, that are told apart."""

CHANNELS = ("R", "G", "B", "A", "Z", "ZBack")
"""Channels that are read; without A samples are opaque, without colours black."""


class DeepImage(NamedTuple):
    """A deep picture: where it is, and its samples, by pixel and nearest first.

    ``pixel`` (n,) is row by row, ``rgb`` (n, 3) premultiplied, ``alpha`` (n,), > 0; ``depth`` (n,)
    is as in the file.
    """

    frame: Frame
    pixel: np.ndarray
    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray

    @property
    def x(self) -> np.ndarray:
        """The columns of the samples' pixels in the whole picture, in their middles."""
        return self.pixel % self.frame.size[0] + self.frame.crop_offset[0] + 0.5

    @property
    def y(self) -> np.ndarray:
        """Their rows."""
        return self.pixel // self.frame.size[0] + self.frame.crop_offset[1] + 0.5


class _Flat(NamedTuple):
    """Samples by pixel and nearest first: (n,) each, and premultiplied colours (n, 3)."""

    pixel: np.ndarray
    rgb: np.ndarray
    alpha: np.ndarray
    z: np.ndarray


def is_deep(file: PictureFile) -> bool:
    """Whether a file has nothing but deep parts."""
    return bool(file.parts) and all(part.deep for part in file.parts)


def read_deep(file: PictureFile) -> DeepImage:
    """The first part of a deep file, whose depths are as they are.

    Raises ``ValueError`` for one that is not of scan lines, is truncated or damaged, needs more
    memory than its size justifies, or has no depth; it names the file.
    """
    part, path = file.parts[0], file.path
    known = depth_known(part.attributes, "Z", part.channels)
    frame = Frame.of(part, part.attributes, known, path)
    try:
        flat = _flat(path, frame.rows_and_columns(part, path))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    except RuntimeError as error:  # OpenEXR's, of damaged files.
        raise ValueError(f"{path}: is truncated or damaged: {error}") from error
    return DeepImage(frame, *flat)


def _flat(path: Path, inside: tuple[slice, slice]) -> _Flat:
    """The samples in some rows and columns of the first part of a file."""
    import OpenEXR

    from .deep_exr import flattened

    require_bounded(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        if not file.parts:
            raise ValueError("is truncated or damaged")
        found = _without_layer(file.parts[0].channels)
        if "Z" not in found:
            raise ValueError("it has no channel Z, as a deep picture must")
        counts, flat = flattened({n: found[n].pixels[inside] for n in CHANNELS if n in found})
    if not flat:
        raise ValueError("there are no samples in it")
    flat = {name: column.astype(np.float64) for name, column in flat.items()}
    if len({len(column) for column in flat.values()}) > 1:
        raise ValueError("is damaged: its channels have different numbers of samples")
    z = flat["Z"]
    rgb = np.stack([flat.get(name, np.zeros_like(z)) for name in "RGB"], axis=1)
    alpha = flat.get("A", np.ones_like(z))
    back = flat.get("ZBack", z)
    valid = np.isfinite(rgb).all(axis=1) & np.isfinite(alpha) & (z > 0) & (back >= z)
    if not valid.all():
        raise ValueError(
            f"{np.count_nonzero(~valid)} of {len(z)} samples are not finite, have a Z that is not "
            "> 0, or a ZBack before it"
        )
    alpha = np.clip(alpha, LEAST_ALPHA, 1)
    return _sliced(_Flat(np.repeat(np.arange(len(counts)), counts), rgb, alpha, z), back)


def _without_layer(channels: Mapping[str, Any]) -> dict[str, Any]:
    """The channels by their last names, those without a layer, or of the first, before others."""
    found: dict[str, Any] = {}
    for name in sorted(channels, key=lambda name: name.count(".")):
        found.setdefault(name.rpartition(".")[2], channels[name])
    return found


def _sliced(flat: _Flat, back: np.ndarray) -> _Flat:
    """The samples, volumes in slices, by pixel and nearest first."""
    thick = np.isfinite(back) & (back > flat.z * (1 + 1e-6))
    parts = [_Flat(*(column[~thick] for column in flat))]
    alpha = 1 - (1 - flat.alpha[thick]) ** (1 / SLICES)
    rgb = flat.rgb[thick] * (alpha / flat.alpha[thick])[:, None]
    for number in range(SLICES):
        at = (number + 0.5) / SLICES
        z = flat.z[thick] + at * (back[thick] - flat.z[thick])
        parts.append(_Flat(flat.pixel[thick], rgb, alpha, z))
    joined = _Flat(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    order = np.lexsort((joined.z, joined.pixel))
    return _Flat(*(column[order] for column in joined))


def columns_of_deep(
    image: DeepImage, z: np.ndarray, radius_per_vergence: float
) -> dict[str, np.ndarray]:
    """The columns of what the pinhole sees, of hidden twins, and of what shows nothing.

    ``z``, (n,), are the depths along the axis; the lens has that ``radius_per_vergence``, in
    pixels. What it does not tell apart gets one depth, so that neither hides the other.
    """
    pixel, rgb, alpha, z, shows = _with_nothing(image, z)
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    first = np.repeat(starts, np.diff(starts, append=len(pixel)))
    before = _let_through(alpha, first)
    seen = alpha * before
    group = _groups(first, radius_per_vergence / z)
    of_group = np.maximum(before[group], LEAST_WEIGHT)
    twin = np.minimum(seen * (1 / of_group - 1), 1)
    number = np.minimum(TWINS + np.arange(len(first)) - first, ELSEWHERE - 1)
    (width, _), (left, top) = image.frame.size, image.frame.crop_offset
    columns = {
        "x": pixel % width + left + 0.5,
        "y": pixel // width + top + 0.5,
        "rgb": rgb / alpha[:, None],
        "alpha": shows,
        "z": z[group],
        "surface": shows.astype(np.uint32),
    }
    columns = {name: np.concatenate([column, column]) for name, column in columns.items()}
    columns["weight"] = np.concatenate([seen, twin])
    columns["layer"] = np.concatenate([np.zeros(len(seen), np.uint8), number.astype(np.uint8)])
    return {name: column[columns["weight"] > LEAST_WEIGHT] for name, column in columns.items()}


def _with_nothing(image: DeepImage, z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pixel, premultiplied colour, alpha, depth, and whether anything shows, of all samples.

    Where a pixel is not opaque, what shows nothing is behind all that is in it.
    """
    size = image.frame.size[0] * image.frame.size[1]
    rest = np.exp(np.bincount(image.pixel, _log_through(image.alpha), size))
    clear = np.flatnonzero(rest > LEAST_WEIGHT)
    pixel = np.concatenate([image.pixel, clear])
    order = np.argsort(pixel, kind="stable")
    columns = (
        pixel,
        np.concatenate([image.rgb, np.zeros((len(clear), 3))]),
        np.concatenate([image.alpha, np.ones(len(clear))]),
        np.concatenate([z, np.full(len(clear), np.inf)]),
        np.concatenate([np.ones(len(z)), np.zeros(len(clear))]),
    )
    return tuple(column[order] for column in columns)


def _let_through(alpha: np.ndarray, first: np.ndarray) -> np.ndarray:
    """What those before each sample of its pixel let through, of which ``first`` is the first."""
    through = _log_through(alpha)
    before = np.cumsum(through) - through
    return np.exp(before - before[first])


def _log_through(alpha: np.ndarray) -> np.ndarray:
    """The logarithm of what each sample lets through."""
    return np.log1p(-np.minimum(alpha, 1 - 1e-12))


def _groups(first: np.ndarray, parallax: np.ndarray) -> np.ndarray:
    """For each sample, the index of that with which its group begins, int64 (n,).

    ``first`` is the index of the first of its pixel. A group goes as far behind its beginning as
    the lens does not tell apart.
    """
    group = first.copy()
    number = np.arange(len(first)) - first
    for step in range(1, int(number.max(initial=0)) + 1):
        at = np.flatnonzero(number == step)
        begin = group[at - 1]
        group[at] = np.where(parallax[begin] - parallax[at] < LEAST_STEP, begin, at)
    return group
