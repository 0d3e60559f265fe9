"""Compositing with gradients: the rules of :mod:`potmesil_mi.focusing.composite`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...samples.raster import Window
from ..composite import FAINTEST, MOST_FILLED, weights_of
from ..film import places_of_crop, rows_and_columns
from ..fragments import SHARE, gathered

ROUNDED = 1 / 64
"""How far from where a share is clipped the bend is rounded."""


@dataclasses.dataclass(frozen=True)
class Spread:
    """The light of a slice: RGB and share, interleaved, and alpha, of the pixels of ``box``."""

    colours: jit.Float
    alpha: jit.Float | None
    box: Window
    resolution: int
    is_sharp: bool


@dataclasses.dataclass(frozen=True)
class Composited:
    """A picture: its channels, and what each subpixel counts in its pixel."""

    channels: list[jit.Float]
    weights: jit.Float


def composite(
    slices: Sequence[Spread],
    crop: Window,
    subpixels: int,
    density: np.ndarray | None,
    its_gradient: jit.Float | None,
) -> Composited:
    """Slices, from the nearest, put behind each other in the ``crop``.

    ``density``, (H, W), is that of the samples in the crop, and ``its_gradient`` the same where it
    has derivatives.
    """
    count = 5 if slices and slices[0].alpha is not None else 4
    total = [dr.zeros(jit.Float, crop.size) for _ in range(count)]
    covered = dr.zeros(jit.Float, crop.size)
    behind: list[jit.Float] | None = None
    sharp: jit.Float | None = None
    for each in slices:
        light = _in_crop(each, crop)
        light[SHARE] = dr.maximum(light[SHARE], 0)
        if behind is None and sharp is not None:
            behind = [dr.zeros(jit.Float, crop.size) for _ in range(count)]
        admitted = _clipped((1 - covered) / dr.maximum(light[SHARE], FAINTEST), 1)
        admitted = dr.select(light[SHARE] > FAINTEST, admitted, 0)
        if each.is_sharp:
            sharp = dr.detach(light[SHARE])
        light = [of * admitted for of in light]
        covered = covered + light[SHARE]
        if behind is None:
            total = [a + b for a, b in zip(total, light, strict=True)]
        else:
            behind = [a + b for a, b in zip(behind, light, strict=True)]
        dr.eval(total, covered, behind, sharp)
    if behind is not None:
        left = (1 - covered) / dr.maximum(behind[SHARE], FAINTEST)
        more = 1 + _clipped(left, MOST_FILLED)
        total = [a + b * more for a, b in zip(total, behind, strict=True)]
    covered = total[SHARE]
    there = dr.select(covered > FAINTEST, covered, dr.inf)
    channels = [of / there for channel, of in enumerate(total) if channel != SHARE]
    weights = _weights(covered, sharp, crop, subpixels, density, its_gradient)
    return Composited(channels, weights)


def _clipped(value: jit.Float, most: float) -> jit.Float:
    """A value, no less than 0 and no more than ``most``; where it is clipped, rounded.

    Slices that just fill a subpixel are at the bend, and have to have a derivative there: the mean
    of those on both sides.
    """
    return _ramp(value) - _ramp(value - most)


def _ramp(value: jit.Float) -> jit.Float:
    """A value where it is positive, else 0; the bend between is part of a parabola."""
    bend = dr.square(value + ROUNDED) / (4 * ROUNDED)
    return dr.select(value > ROUNDED, value, dr.select(value < -ROUNDED, 0, bend))


def _weights(
    covered: jit.Float,
    sharp: jit.Float | None,
    crop: Window,
    subpixels: int,
    density: np.ndarray | None,
    its_gradient: jit.Float | None,
) -> jit.Float:
    """What subpixels count in their pixels; which of them by their density, has no gradients."""
    on_host = np.array(dr.detach(covered)).reshape(crop.shape)
    share = None if sharp is None else np.array(sharp).reshape(crop.shape)
    values = weights_of(on_host, share, density, subpixels, alone=subpixels == 1)
    weights = jit.from_numpy(jit.Float, values.ravel())
    if its_gradient is None or density is None:
        return weights
    by_density = jit.from_numpy(jit.Bool, (values == density).ravel())
    relative = its_gradient / dr.maximum(dr.detach(its_gradient), FAINTEST)
    return weights * dr.select(by_density, relative, 1)


def _in_crop(each: Spread, crop: Window) -> list[jit.Float]:
    """The channels of the light of a slice in the subpixels of the crop."""
    colours, alpha, box = each.colours, each.alpha, each.box
    for _ in range(each.resolution.bit_length() - 1):
        colours, alpha, box = _doubled(colours, alpha, box)
    place, inside = places_of_crop(crop, box)
    light = list(gathered(jit.Array4f, colours, place, inside))
    if alpha is not None:
        light.append(gathered(jit.Float, alpha, place, inside))
    return light


def _doubled(
    colours: jit.Float, alpha: jit.Float | None, box: Window
) -> tuple[jit.Float, jit.Float | None, Window]:
    """Twice as many pixels along both axes, interpolated linearly between their middles."""
    finer = box.subdivided(2)
    row, column = rows_and_columns(dr.arange(jit.UInt32, finer.size), finer.width)
    ends = dr.opaque(jit.Int32, box.height - 1), dr.opaque(jit.Int32, box.width - 1)
    own = row // 2, column // 2
    beside = [
        jit.UInt32(dr.clip(jit.Int32(at) + dr.select(fine % 2 == 0, -1, 1), 0, end))
        for at, fine, end in zip(own, (row, column), ends, strict=True)
    ]
    stride = dr.opaque(jit.UInt32, box.width)
    light, its_alpha = jit.Array4f(0), jit.Float(0)
    for at_row, down in ((own[0], 0.75), (beside[0], 0.25)):
        for at_column, across in ((own[1], 0.75), (beside[1], 0.25)):
            place = at_row * stride + at_column
            light += gathered(jit.Array4f, colours, place) * (down * across)
            if alpha is not None:
                its_alpha += gathered(jit.Float, alpha, place) * (down * across)
    return dr.ravel(light), None if alpha is None else its_alpha, finer
