"""Which kind a depth is: a plane in the picture stays a plane under one of them alone.

1/z of a plane is affine in the pixel (camera-models, section 5.7: lines stay lines under the
perspective with pseudodepth), and so are 1/z itself as a depth and NDC depth. Of lengths of rays it
is not. So depths in tiles of a picture are tried as each kind, and what is left of the best affine
function tells.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .camera import Camera
from .depth import ray_length_from_depth

KINDS = ("z", "distance", "inverse or ndc")
"""Kinds of depth that planes tell apart."""

TILES = 6
"""Tiles along the shorter side of the picture."""

FLAT = 2e-3
"""Largest error, as a part of 1/z, of a tile that is taken for a plane."""

TELLS = 4.0
"""How many times as flat a kind makes the planes, at least, as any other where it is the one."""


def bending(depth: Any, camera: Camera) -> dict[str, float]:
    """How much planes are bent by taking ``depth``, (H, W), for each kind: least for the right one.

    It is the root mean square of what is left of the best affine function of the pixel, as a part
    of 1/z: the median over tiles that are planes for some kind, NaN where there are none. What is
    0, infinite or not a number is no depth.
    """
    depth = np.asarray(depth, np.float64)
    height, width = depth.shape
    size = max(4, min(height, width) // TILES)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    left, top = camera.crop_offset
    slant = ray_length_from_depth(np.ones_like(depth), x + left, y + top, camera)
    # Far above what is there stands what programs write for nothing.
    there = np.isfinite(depth) & (depth > 0) & (depth < 1e9)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / depth
        verging = dict(zip(KINDS, (inverse, slant * inverse, depth), strict=True))
    left_over: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for row in range(0, height - size + 1, size):
        for column in range(0, width - size + 1, size):
            tile = np.s_[row : row + size, column : column + size]
            if there[tile].all():
                for kind in KINDS:
                    left_over[kind].append(_left_over(verging[kind][tile]))
    errors = np.array([left_over[kind] for kind in KINDS])
    if errors.size == 0:
        return dict.fromkeys(KINDS, math.nan)
    flat = errors.min(axis=0) < FLAT
    if not flat.any():
        return dict.fromkeys(KINDS, math.nan)
    return dict(zip(KINDS, np.median(errors[:, flat], axis=1).tolist(), strict=True))


def verdict(bent: dict[str, float]) -> str:
    """What :func:`bending` tells, in words."""
    if any(math.isnan(value) for value in bent.values()):
        return "there is no plane in it that would tell which it is"
    said = ", ".join(f"{kind} {value:.1e}" for kind, value in bent.items())
    best, second = sorted(bent, key=lambda kind: bent[kind])[:2]
    if bent[second] < TELLS * bent[best]:
        return f"planes in it do not tell which it is (they are bent by {said})"
    return f"planes in it stay planes if it is {best} (they are bent by {said})"


def _left_over(values: np.ndarray) -> float:
    """What is left of the best affine function, as a part of the mean."""
    rows, columns = (np.arange(size) - (size - 1) / 2 for size in values.shape)
    rest = values - values.mean()
    for along in (rows[:, None], columns[None]):
        rest = rest - along * (rest * along).sum() / np.broadcast_to(along**2, rest.shape).sum()
    return float(np.sqrt(np.mean(rest**2)) / max(abs(values.mean()), 1e-30))
