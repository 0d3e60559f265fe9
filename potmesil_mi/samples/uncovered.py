"""What a lens sees behind near edges, where a picture of a pinhole has nothing to tell of it.

The farther surface beside a silhouette is taken to go on behind it, as far as a point of the lens
sees: at the depth that it has at the silhouette, in the colours that it has before, mirrored there.
That is a guess, as any is; what is near never goes on behind what is far.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ..optics.disocclusion import disoccluded

APART = 1.0
"""Pixels of parallax by which a surface is farther than another, at least."""


class Uncovered(NamedTuple):
    """Pixels behind which something is seen, (n,), and of which pixels it has depth and colour.

    All are indices, row by row.
    """

    pixel: np.ndarray
    depth_of: np.ndarray
    colour_of: np.ndarray


def uncovered_by(z: np.ndarray, radius_per_vergence: float) -> Uncovered:
    """What goes on behind the near edges of depths z, (H, W), for a lens of that radius.

    ``radius_per_vergence``, see :mod:`potmesil_mi.optics.blur`, is in pixels. Of what is farther
    and seen by some point of the lens, that goes on whose silhouette is the nearest in the picture.
    """
    height, width = z.shape
    parallax = radius_per_vergence / z
    row, column = np.nonzero(disoccluded(z, z, radius_per_vergence))
    behind = _nearest_farther(parallax, row, column)
    found = behind[:, 0] >= 0
    row, column, behind = row[found], column[found], behind[found]
    mirrored = 2 * behind - np.stack([row, column], axis=1)
    inside = np.all((mirrored >= 0) & (mirrored < (height, width)), axis=1)
    mirrored = np.where(inside[:, None], mirrored, behind)
    # The surface itself, and not what is before or behind it there.
    alike = np.abs(parallax[tuple(mirrored.T)] - parallax[tuple(behind.T)])
    length = np.hypot(*(mirrored - behind).T)
    mirrored = np.where((alike <= APART + length / 2)[:, None], mirrored, behind)
    mirrored = np.where(
        (parallax[tuple(mirrored.T)] <= parallax[row, column] - APART)[:, None], mirrored, behind
    )
    pixel, depth_of, colour_of = (
        np.ravel_multi_index(tuple(at), z.shape) for at in ((row, column), behind.T, mirrored.T)
    )
    return Uncovered(pixel, depth_of, colour_of)


def _nearest_farther(parallax: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The nearest place, (n, 2), that is farther and that the lens may see behind each; -1: none.

    By jump flooding (G. Rong & T.-S. Tan, Jump flooding in GPU, I3D 2006): what a place has found
    is tried by others, in steps of powers of 2.
    """
    height, width = parallax.shape
    found = np.full((height, width, 2), -1, np.int32)
    best = np.full(len(row), np.inf)
    held = np.full((len(row), 2), -1, np.int32)
    own = parallax[row, column]
    longest = min(max(1.0, float(own.max(initial=0) - parallax.min()) + 1), max(height, width))
    step = 1 << int(np.ceil(np.log2(longest)))
    steps = [1]
    while step >= 1:
        steps.append(step)
        step //= 2
    for step in [*steps, 1]:
        for down, across in itertools.product((-step, 0, step), repeat=2):
            there = np.clip(row + down, 0, height - 1), np.clip(column + across, 0, width - 1)
            passed_on = found[there]
            for candidate in (np.stack(there, axis=1), passed_on):
                at = np.maximum(candidate, 0)
                farther = own - parallax[at[:, 0], at[:, 1]]
                apart = np.hypot(at[:, 0] - row, at[:, 1] - column)
                better = (candidate[:, 0] >= 0) & (farther >= APART) & (apart < best)
                better &= apart <= farther + 1
                held[better], best[better] = at[better], apart[better]
        found[row, column] = held
    return held
