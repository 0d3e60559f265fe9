"""Density: chance puts more samples into one subpixel than into another, and none into some.

What a surface covers does not depend on that. So the shares of what the pinhole sees in a subpixel
are scaled to add up to 1, with its light and with what is hidden there, and a subpixel without a
sample shows what the nearest one shows. Then coverage and light are counted on the same area. How
many samples a subpixel had is what it counts in its pixel.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from .detail import Detail
from .fragments import SHARE, Fragments

EVEN = 1e-3
"""Shares of what the pinhole sees in a subpixel may differ by so much from 1."""

BORROWED_DENSITY = 1e-6
"""What a subpixel without a sample counts in its pixel, where others count 1 on the average."""

SPARSE_REACH = 3
"""How far samples reach that stand for an area of several subpixels, in widths of it beyond one."""


class Evened(NamedTuple):
    """Fragments as if each subpixel had its full share of samples, and how many it had.

    ``density``, float32 (height, width), is the share that each subpixel had of the samples of
    what the pinhole sees, 1 on the average; ``None`` where they are even. ``moments``, float32
    (height, width, K), tell where in the subpixel they were: the moments of the density, divided
    by it; ``None`` where the fragments have none. ``seen`` is that of
    :class:`potmesil_mi.focusing.gathering.Gathered`; ``detail`` the table of that of the fragments.
    """

    fragments: Fragments
    density: np.ndarray | None
    moments: np.ndarray | None
    seen: np.ndarray | None = None
    detail: Detail | None = None

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        return sum(of.nbytes for of in self if of is not None)


def evened(
    fragments: Fragments, reach: int, detail: Detail | None = None, is_even: bool | None = None
) -> Evened:
    """The ``fragments`` as if each subpixel had its full share of samples.

    A subpixel without a sample of what the pinhole sees borrows all fragments of the nearest one
    that has some, up to ``reach`` rows and columns away, or farther where samples are so few that
    each stands for several subpixels; where there is none, density is 0. ``is_even`` says whether
    they are even in the picture that they are a tile of; otherwise they are looked at.
    """
    height, width = fragments.height, fragments.width
    subpixel, first = fragments.subpixel, fragments.first
    share = fragments.values[:, SHARE]
    total = np.bincount(subpixel[first], share[first], height * width)
    density = total.astype(np.float32).reshape(height, width)
    if np.abs(density - 1).max() < EVEN if is_even is None else is_even:
        return _with_detail(Evened(fragments, None, _moments(fragments)), detail, None)
    sampled = density > 0
    if not sampled.all():
        fragments = fragments.chosen(sampled.ravel()[subpixel])
    scale = np.divide(1, total, out=np.zeros_like(total), where=total > 0)
    fragments = fragments.scaled(scale[fragments.subpixel])
    if not sampled.all():
        sparse = SPARSE_REACH * (np.sqrt(density) - 1)
        places, donors = _nearest(sampled, np.maximum(reach, sparse))
        fragments = _with_copies(fragments, places, donors)
        density.flat[places] = BORROWED_DENSITY
    return _with_detail(Evened(fragments, density, _moments(fragments)), detail, scale)


def _with_detail(found: Evened, detail: Detail | None, scale: np.ndarray | None) -> Evened:
    """The same with the table of the fragments' detail, evened like these."""
    if detail is None:
        return found
    table = detail.evened(found.fragments, scale)
    rows = np.arange(len(found.fragments), dtype=np.int32)
    fragments = dataclasses.replace(found.fragments, detail=rows)
    return found._replace(fragments=fragments, detail=table)


def _moments(fragments: Fragments) -> np.ndarray | None:
    """The moments of what the pinhole sees of each subpixel, float32 (height, width, K)."""
    if fragments.moments is None:
        return None
    shape = fragments.height, fragments.width
    first = fragments.first
    subpixel, size = fragments.subpixel[first], shape[0] * shape[1]
    moments = np.empty((size, fragments.moments.shape[1]), np.float32)
    for k, shares in enumerate(fragments.moments[..., SHARE].T):
        moments[:, k] = np.bincount(subpixel, shares[first], size)
    return moments.reshape(*shape, -1)


def _nearest(sampled: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Subpixels that are not ``sampled``, and for each the nearest one that is; int64 (n,) each.

    Those are left out that are more rows or columns away than the ``reach`` of that one.
    """
    if not sampled.any():
        return np.empty(0, np.int64), np.empty(0, np.int64)
    nearest = scipy.ndimage.distance_transform_edt(
        ~sampled, return_distances=False, return_indices=True
    )
    places = np.flatnonzero(~sampled)
    row, column = (axis.ravel()[places].astype(np.int64) for axis in nearest)
    width = sampled.shape[1]
    donors = row * width + column
    apart = np.maximum(abs(row - places // width), abs(column - places % width))
    close = apart <= reach.ravel()[donors]
    return places[close], donors[close]


def _with_copies(fragments: Fragments, places: np.ndarray, donors: np.ndarray) -> Fragments:
    """Fragments with copies, at the subpixels ``places``, of all those at the ``donors``."""
    gives = np.zeros(fragments.width * fragments.height, dtype=bool)
    gives[donors] = True
    index = np.flatnonzero(gives[fragments.subpixel])
    given = fragments.subpixel[index]
    order = np.argsort(given, kind="stable")
    index, given = index[order], given[order]
    start, end = (np.searchsorted(given, donors, side=side) for side in ("left", "right"))
    count = end - start
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    copied = fragments.chosen(index[np.repeat(start, count) + within])
    to = np.repeat(places, count)
    copies = dataclasses.replace(
        copied,
        x=(to % fragments.width).astype(np.int32),
        y=(to // fragments.width).astype(np.int32),
    )
    return fragments.and_others(copies).in_order()
