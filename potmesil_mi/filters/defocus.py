"""The whole picture out of focus by the same."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from .._validation import require_number
from ..optics.disc import disc_kernel
from ..optics.lens import ThinLens
from .base import Filter
from .spread import frame_width, spread


@dataclasses.dataclass(frozen=True)
class Defocus(Filter):
    """The whole picture out of focus by the same, whatever its depth.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``radius``                    of the circle that becomes of a point, as a share of the
                                  frame's width; 0 to 1
    ============================  ==========================================================

    Colours and alpha alike.
    """

    radius: float

    name: ClassVar[str] = "defocus"

    def __post_init__(self) -> None:
        require_number("radius", self.radius, 0, 1)

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :meth:`Filter.__call__`."""
        height, width = picture.shape[:2]
        radius = self.radius * frame_width(lens, pixels_per_mm)
        kernel = disc_kernel(radius, (0.5, 0.5), (width - 1, height - 1))
        blurred = spread(picture, kernel[..., None] / kernel.sum())
        # A mean is no less than the least value, but for the rounding of transforms.
        return np.maximum(blurred, picture.min(axis=(0, 1)))
