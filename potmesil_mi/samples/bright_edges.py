"""Where in their pixels bright things end that lie on others: lamps, their mirror images, letters.

A pixel that the edge of something bright goes through is known by its mean alone. Spread from its
middle, light that ends at its border lands a part of a pixel away, which one sees where the circle
of confusion is as small and the contrast large. So such a pixel becomes two samples of the same
depth: the brighter colour beside it and the darker, with the shares that make up the pixel, each in
the middle of its share as if the edge were straight and across the gradient of brightness. That
keeps the light of the pixel, and where what is of both has its middle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.ndimage

from .silhouettes import LEAST_SHARE, extremes

CONTRAST = 3.0
"""How many times as bright as the darkest around a pixel the brightest is, at an edge."""

FLAT = 0.1
"""Part of the step by which the brightness around may go beyond that of the pixels beside."""


class BrightEdges(NamedTuple):
    """The pixels in which something bright ends: (n,), in pixels' order.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``pixel``                     index of the pixel, row by row
    ``share``                     how much of it is bright, 0 to 1
    ``bright``, ``dark``          colours of both, (n, C)
    ``toward``                    where the bright is: unit vectors right and down, (n, 2)
    ============================  ==========================================================
    """

    pixel: np.ndarray
    share: np.ndarray
    bright: np.ndarray
    dark: np.ndarray
    toward: np.ndarray


def bright_edges_of(colours: np.ndarray, without: np.ndarray) -> BrightEdges:
    """Those of a picture (H, W, C), linear, not below 0, of which the first three are its colours.

    ``without``, bool (H, W), are pixels that are parted already.
    """
    brightness = colours[..., :3].sum(axis=2)
    most, least = extremes(brightness, 5)
    row, column = np.nonzero((most > CONTRAST * least) & ~without)
    most, least = most[row, column], least[row, column]
    across = [scipy.ndimage.sobel(brightness, axis, mode="nearest") for axis in (1, 0)]
    toward = np.stack([of[row, column] for of in across], axis=1)
    toward = toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-30)
    # The pixels right beside it, along the gradient, show one of both alone.
    right, down = np.rint(toward.T).astype(int)
    to_bright, to_dark = (
        (
            np.clip(row + sign * down, 0, brightness.shape[0] - 1),
            np.clip(column + sign * right, 0, brightness.shape[1] - 1),
        )
        for sign in (1, -1)
    )
    step = brightness[to_bright] - brightness[to_dark]
    share = (brightness[row, column] - brightness[to_dark]) / np.maximum(step, 1e-30)
    beyond = np.maximum(most - brightness[to_bright], brightness[to_dark] - least)
    kept = (share >= LEAST_SHARE) & (share <= 1 - LEAST_SHARE) & (beyond < FLAT * step)
    pixel, share, mixture = (
        (row * brightness.shape[1] + column),
        share[:, None],
        colours[row, column],
    )
    # No part may have more light than the whole.
    dark = np.minimum(colours[to_dark][kept], mixture[kept] / (1 - share[kept]))
    bright = (mixture[kept] - (1 - share[kept]) * dark) / share[kept]
    return BrightEdges(pixel[kept], share[kept, 0], bright, dark, toward[kept])
