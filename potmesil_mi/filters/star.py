"""Rays around bright spots."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np

from .._validation import require_number, require_whole
from ..optics.lens import ThinLens
from .base import Filter
from .spread import frame_width, light_above, with_light_moved

LEAST_WIDTH = 1.5
"""Width of a ray of :class:`Star` in pixels, at half its height, that is sampled without dots."""


@dataclasses.dataclass(frozen=True)
class Star(Filter):
    """Rays around bright spots, as of a glass with engraved lines before the lens.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``points``                    number of rays, 1 to 64 (default 4)
    ``length``                    of a ray, as a share of the frame's width; 0 to 2 (default
                                  0.1). Light falls off along it as (1 - distance/length)^2
    ``threshold``                 what is brighter, in its brightest channel, is spread; >= 0
                                  (default 1)
    ``rotation``                  degrees by which the star is turned, anticlockwise; at 0
                                  (default) a ray points upwards
    ``strength``                  share of the light above ``threshold`` that goes into the
                                  rays, 0 to 1 (default 0.5)
    ``width``                     of a ray at half its height, as a share of the frame's
                                  width; 0 to 1 (default 0.001), but no less than 1.5 pixels
    ============================  ==========================================================

    The light is taken from the bright spots, none is added; that of a spot keeps its hue. Alpha
    stays.
    """

    points: int = 4
    length: float = 0.1
    threshold: float = 1.0
    rotation: float = 0.0
    strength: float = 0.5
    width: float = 0.001

    name: ClassVar[str] = "star"

    def __post_init__(self) -> None:
        require_whole("points", self.points, 1, 64)
        require_number("length", self.length, 0, 2)
        require_number("threshold", self.threshold, 0)
        require_number("rotation", self.rotation)
        require_number("strength", self.strength, 0, 1)
        require_number("width", self.width, 0, 1)

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :meth:`Filter.__call__`."""
        light = self.strength * light_above(self.threshold, picture)
        if not light.any():
            return picture.copy()
        frame = frame_width(lens, pixels_per_mm)
        kernel = self.kernel(frame, picture.shape[:2])
        return with_light_moved(picture, light, kernel[..., None])

    def kernel(self, frame: float, size: tuple[int, int]) -> np.ndarray:
        """The star of one point, float64 (2K+1, 2L+1), of sum 1, on a frame of so many pixels.

        ``size``, rows and columns of the picture, bounds it.
        """
        length = self.length * frame
        sigma = max(self.width * frame, LEAST_WIDTH) / math.sqrt(8 * math.log(2))
        y, x = _offsets(math.ceil(length + 4 * sigma), size)
        kernel = np.zeros((y.size, x.size))
        for k in range(self.points):
            angle = math.radians(self.rotation) + 2 * math.pi * k / self.points
            right, down = -math.sin(angle), -math.cos(angle)
            along, across = x * right + y * down, x * down - y * right
            kernel += np.exp(-0.5 * (across / sigma) ** 2) * _ray(along, length, sigma)
        return kernel / kernel.sum()


def _offsets(reach: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Rows (N, 1) and columns (1, M) of a kernel, from its middle, as far as a picture has any."""
    down, across = (min(reach, n - 1) for n in size)
    return np.arange(-down, down + 1.0)[:, None], np.arange(-across, across + 1.0)[None, :]


def _ray(along: np.ndarray, length: float, sigma: float) -> np.ndarray:
    """Brightness along a ray of ``length`` pixels, its beginning as soft as its sides."""
    import scipy.special  # not for the names of filters

    if length == 0:
        return np.exp(-0.5 * (along / sigma) ** 2)
    fall = np.clip(1 - along / length, 0, 1) ** 2
    return fall * scipy.special.ndtr(along / sigma)
