"""The picture on its way to one colour."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from .._validation import require_number
from ..optics.lens import ThinLens
from .base import Filter
from .spread import three_numbers


@dataclasses.dataclass(frozen=True)
class Fade(Filter):
    """The picture on its way to one colour, for fading in and out.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``amount``                    0, the picture, to 1, the colour
    ``color``                     linear RGB, >= 0 (default black)
    ============================  ==========================================================

    picture (1 - amount) + color amount. Alpha stays, and the colour is multiplied by it.
    """

    amount: float
    color: tuple[float, float, float] = (0.0, 0.0, 0.0)

    name: ClassVar[str] = "fade"

    def __post_init__(self) -> None:
        require_number("amount", self.amount, 0, 1)
        object.__setattr__(self, "color", three_numbers("color", self.color, 0))

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :meth:`Filter.__call__`."""
        faded = picture.copy()
        faded[..., :3] *= 1 - self.amount
        faded[..., :3] += np.multiply(self.color, self.amount) * picture[..., 3:].prod(
            axis=-1, keepdims=True
        )
        return faded
