"""Point-spread functions: how a lens spreads the light of one point over the film.

Section 3.2 of Potmesil & Chakravarty (1981), figure 9. By default it is the aperture of the lens
that has one; any object with the method ``table`` can take its place.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from .aperture import Aperture
from .disc import Disc
from .lens import ThinLens


@runtime_checkable
class PointSpreadFunction(Protocol):
    """What the focus stage asks of a distribution of intensity."""

    def table(
        self,
        lens: ThinLens,
        depth: float,
        pixels_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """The kernel of a point at ``depth``: its light's integrals over the pixels of a raster.

        ``depth`` is in scene units (``inf`` is allowed), ``pixels_per_mm`` the number of
        pixels in a millimetre of film, ``offset`` the position (x, y) of the point in its
        pixel, from 0 (the left or upper edge) to 1; an array (..., 2) asks for many kernels.
        Returns float64 of shape (..., 2K+1, 2L+1), rows and columns, whose middle element is the
        point's own pixel; each kernel sums to 1. ``largest`` bounds (L, K): what lies farther
        out is left out, for a grid of so many columns and rows cannot see it.
        """
        ...


def aperture_behind(psf: PointSpreadFunction) -> Aperture:
    """The aperture that ``psf`` is; one that is no aperture stands for a round one."""
    return psf if isinstance(psf, Aperture) else Disc()
