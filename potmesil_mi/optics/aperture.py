"""Apertures: the shapes of a lens's opening, and what they make of the light of one point.

Section 3.2 of Potmesil & Chakravarty (1981), figure 9: the focus stage asks for the kernel of a
point-spread function, the integrals of the intensity over the pixels of a raster. Lengths here are
in radii of the aperture, which knows no lens.

Apertures are described as a photographer sees them from behind the camera, the right way up. So
highlights beyond the focused plane show them; nearer ones show them upside down.

A shape of one's own needs a name and :meth:`Aperture.corner_area`, and no more.
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .._spec import Spec
from .lens_protocol import LensProtocol
from .summed_area import summed_area

SHARP = 1e-6
"""Least radius of a circle of confusion, in pixels: a sharp point is a circle of it."""

FINE_RADIUS = 128
"""Radius, in pixels, of the profiles in which the variances of an aperture are measured."""

POINTS_MAP = 256
"""Elements on a side of the picture of an aperture from which its points are drawn, where the
aperture does not say better."""


MODULES = tuple(
    f"potmesil_mi.optics.{name}" for name in ("disc", "polygon", "lommel", "image_aperture")
)
"""Where the apertures of the package are."""


A = TypeVar("A", bound="Aperture")


class Aperture(Spec, ABC, family="aperture", modules=MODULES):
    """An aperture of the lens, and the point-spread function that goes with it.

    One of one's own is a frozen dataclass with a ``name`` and :meth:`corner_area`; it then has a
    text, as ``ring:inner=0.5``. What has the ``table`` of :class:`potmesil_mi.PointSpreadFunction`
    and no more can be given to :func:`potmesil_mi.focus` as ``psf``, too.
    """

    finest: ClassVar[float] = 6
    """Radius of a circle, in pixels, at which its kernel shows all there is to be seen."""

    diffracts: ClassVar[bool] = False
    """Whether the light goes beyond the circle of confusion, in patterns that change with it."""

    is_round: ClassVar[bool] = False
    """Whether it looks the same however it is turned."""

    @property
    def ends_sharply(self) -> bool:
        """Whether a diffraction pattern ends at the circle of confusion."""
        return False

    @property
    def channels(self) -> tuple[Aperture, ...]:
        """Those of red, green and blue, or one for all of them."""
        return (self,)

    @property
    def attached(self) -> dict[str, Any]:
        """Dr.Jit arrays, in one dimension, of its parameters that have gradients, by their names.

        Pictures have derivatives in these.
        """
        return {}

    def without_gradients(self: A) -> A:
        """The same aperture, of plain numbers only."""
        return self

    def table(
        self,
        lens: LensProtocol,
        depth: float,
        pixels_per_mm: float,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """The kernel of a point at ``depth``: see :meth:`potmesil_mi.PointSpreadFunction.table`."""
        radius = float(lens.circle_of_confusion(depth)) * pixels_per_mm / 2
        return self.circle_kernel(radius, float(lens.squeeze), offset, largest)

    def circle_kernel(
        self,
        radius: float,
        squeeze: float = 1.0,
        offset: ArrayLike = (0.0, 0.0),
        largest: tuple[int, int] | None = None,
    ) -> np.ndarray:
        """The kernel of a circle of a radius in pixels, positive nearer than what is focused.

        ``offset``, ``largest`` and the result are those of
        :meth:`potmesil_mi.PointSpreadFunction.table`.
        """
        offset = np.asarray(offset, dtype=np.float64)
        size = max(abs(radius), SHARP)
        if radius > 0:  # Upside down.
            return self.upright_kernel(size, squeeze, 1 - offset, largest)[..., ::-1, ::-1]
        return self.upright_kernel(size, squeeze, offset, largest)

    def upright_kernel(
        self,
        radius: float,
        squeeze: float,
        offset: np.ndarray,
        largest: tuple[int, int] | None,
    ) -> np.ndarray:
        """The kernel of the aperture itself, upright, ``radius`` pixels in size."""
        x, y = np.moveaxis(offset, -1, 0)
        reach_x, reach_y = math.ceil(radius / squeeze), math.ceil(radius)
        if largest is not None:
            reach_x, reach_y = min(reach_x, largest[0]), min(reach_y, largest[1])
        area = self.corner_area(
            (np.arange(-reach_x, reach_x + 2) - x[..., None])[..., None, :] * (squeeze / radius),
            (np.arange(-reach_y, reach_y + 2) - y[..., None])[..., :, None] / radius,
        )
        return np.maximum(np.diff(np.diff(area, axis=-2), axis=-1), 0.0) / self._area

    def profiles(
        self, radii: Sequence[float], squeeze: float = 1.0
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """The sums of the columns, and of the rows, of each :meth:`circle_kernel` of some radii.

        Points are in the middle of a pixel. It takes much less time than the kernels do.
        """
        beyond = np.array(2.0)
        reaches, found = [], []
        for stretch in (squeeze, 1.0):
            sizes = [max(abs(radius), SHARP) / stretch for radius in radii]
            reaches.append([np.arange(-math.ceil(n), math.ceil(n) + 2) - 0.5 for n in sizes])
            edges = np.concatenate([of / n for of, n in zip(reaches[-1], sizes, strict=True)])
            of_all = (edges, beyond) if len(reaches) == 1 else (beyond, edges)
            area = self.corner_area(*of_all) / self._area
            parts = np.split(area, np.cumsum([len(of) for of in reaches[-1]])[:-1])
            found.append([np.maximum(np.diff(part), 0.0) for part in parts])
        return [
            (across[::-1], down[::-1]) if radius > 0 else (across, down)
            for radius, across, down in zip(radii, *found, strict=True)
        ]

    @functools.cached_property
    def _area(self) -> float:
        beyond = np.array(2.0)
        return float(self.corner_area(beyond, beyond))

    @functools.cached_property
    def variances(self) -> tuple[float, float]:
        """Variances of what the aperture lets through, across and down, in radii squared."""
        (weights,) = self.profiles([-FINE_RADIUS])
        places = (np.arange(len(weights[0])) - len(weights[0]) // 2) / FINE_RADIUS
        across, down = (float(w @ places**2 - (w @ places) ** 2) for w in weights)
        return across, down

    @abstractmethod
    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """What the aperture lets through left of ``x`` and above ``y``, as an area.

        Coordinates are in radii of the aperture, x to the right and y downwards from its middle;
        arrays broadcast. What any rectangle lets through is the second difference of this.
        Nothing lies beyond 1 from the middle.
        """

    def transmission(self, size: int) -> np.ndarray:
        """What the aperture lets through, float64 (size, size), 0 to 1.

        Over the square around it, rows from the top, columns from the left, seen from behind the
        camera: integrated over the elements.
        """
        edges = np.linspace(-1, 1, size + 1)
        area = self.corner_area(edges[None, :], edges[:, None])
        return np.clip(np.diff(np.diff(area, axis=0), axis=1) * (size / 2) ** 2, 0, 1)

    def points(self, count: int) -> np.ndarray:
        """Points spread evenly over the aperture, (count, 2), in radii, x right and y downwards."""
        return points_of_map(self.transmission(POINTS_MAP), count)


def aperture_of(description: Aperture | str) -> Aperture:
    """An aperture from text, or itself.

    The text is that of :meth:`Aperture.describe`: ``disc``, ``polygon:blades=6,rotation=15``,
    ``lommel:wavelengths=610/550/465``; or ``image:filename=heart.png``. Raises ``TypeError`` for
    what is neither, ``ValueError`` for an unknown name or parameter.
    """
    return Aperture.parse(description)


def points_of_map(transmission_map: np.ndarray, count: int) -> np.ndarray:
    """Points of an aperture that is a picture, (count, 2), as dense as what it lets through.

    ``transmission_map`` (H, W) is >= 0, rows from the top; its larger side is the diameter.
    Coordinates are in radii, x right and y downwards.
    """
    height, width = transmission_map.shape
    integral = summed_area(transmission_map) * (2 / max(height, width)) ** 2
    # A sequence fills the square evenly, by the golden section. The inverse of the distribution
    # of rows makes a row of its first number, that of columns in the row a column of the second.
    k = np.arange(count)
    first = (k + 0.5) / count
    second = (0.5 + k * (math.sqrt(5) - 1) / 2) % 1
    rows = np.concatenate([[0], integral[1:, -1]])
    y = np.interp(first * rows[-1], rows, np.arange(height + 1))
    row = np.minimum(y.astype(int), height - 1)
    columns = np.cumsum(transmission_map[row], axis=1)
    columns = np.concatenate([np.zeros((count, 1)), columns], axis=1)
    x = np.array(
        [
            np.interp(share * column[-1], column, np.arange(width + 1))
            for share, column in zip(second, columns, strict=True)
        ]
    )
    return (np.stack([x, y], axis=-1) - [width / 2, height / 2]) * (2 / max(height, width))
