"""The points of a lens from which visibility is found."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from ..optics.aperture import Aperture
from ..optics.lens import ThinLens
from ..samples.point_samples import PointSamples
from .fragments import Fragments

HIGHLIGHT_POINTS = 16
"""Highlights are looked at from so many times as many lens points as other fragments."""


@dataclasses.dataclass(frozen=True, eq=False)
class LensPoints:
    """The points of the lens from which visibility is found.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``points``                    float64 (M, 2), in radii of the aperture, x to the right and
                                  y downwards in the picture of a highlight nearer than the
                                  focused plane
    ``highlight_points``          float64 (16 M, 2), the same for highlights
    ``cell``                      radius, in radii of the aperture, by which :class:`Jitter`
                                  moves points of an aperture that is not round; 0 for a round
                                  one, whose points are turned
    ``squeeze``                   of the lens
    ``middle``                    the principal point, (2,), in subpixels of the window
    ``rim_distance``              subpixels from ``middle`` at which the rim of the lens, which is
                                  in front of the aperture, appears shifted by a radius of the
                                  aperture; ``inf`` without vignetting
    ``times``                     float64 (M,), -0.5 to 0.5, when in the part of an exposure
                                  that fragments stand for the points look; ``None`` where
                                  nothing moves
    ============================  ==========================================================

    Equal ones see the same; they are hashable, and so are part of the key of what is kept.
    """

    points: np.ndarray
    highlight_points: np.ndarray
    cell: float
    squeeze: float
    middle: tuple[float, float]
    rim_distance: float
    times: np.ndarray | None = None

    @classmethod
    def of(
        cls, aperture: Aperture, lens: ThinLens, samples: PointSamples, count: int, subpixels: int
    ) -> LensPoints:
        """``count`` points of the aperture, with ``subpixels`` on a side of a pixel."""
        scale = -1 / np.array([lens.squeeze, 1])
        x, y = samples.camera.principal_point
        left, top = samples.window[:2]
        middle = ((x - left) * subpixels, (y - top) * subpixels)
        corner = math.hypot(*samples.camera.film_size) / 2 * subpixels
        whole_disc = aperture.is_round and lens.squeeze == 1 and lens.vignetting == 0
        return cls(
            aperture.points(count) * scale,
            aperture.points(HIGHLIGHT_POINTS * count) * scale,
            0.0 if whole_disc else 1 / math.sqrt(HIGHLIGHT_POINTS * count),
            float(lens.squeeze),
            middle,
            corner / (2 * lens.vignetting) if lens.vignetting > 0 else math.inf,
        )

    def nearest(
        self, seen: np.ndarray, samples: PointSamples, radius_per_vergence: float, subpixels: int
    ) -> np.ndarray:
        """What the points see, uint8 (n, M), where it is known for others: that of the nearest.

        ``seen``, (n, K), is for the K ``visibility_points`` of ``samples``, which are gathered on
        ``subpixels`` on a side of a pixel; ``radius_per_vergence`` is that of the aperture there.
        """
        radius = radius_per_vergence / (samples.camera.focal_length_pixels * subpixels)
        apart = self.points[:, None] * radius - samples.visibility_points
        return np.ascontiguousarray(seen[:, np.argmin((apart**2).sum(axis=-1), axis=1)])

    @property
    def has_rim(self) -> bool:
        """Whether the rim of the lens cuts anything."""
        return self.rim_distance < math.inf

    def inside_rim(self, fragments: Fragments, points: np.ndarray) -> np.ndarray:
        """Whether the rim lets through what each point sees of each fragment, bool (N, M)."""
        across, down = (
            (at + 0.5 - middle) / self.rim_distance
            for at, middle in zip((fragments.x, fragments.y), self.middle, strict=True)
        )
        u, v = points[:, 0] * self.squeeze, points[:, 1]
        return (u - across[:, None]) ** 2 + (v - down[:, None]) ** 2 <= 1

    def at_instants(self, count: int, each: int) -> list[LensPoints]:
        """The points that look at each of ``count`` parts of an exposure: ``each`` of these.

        Those of all parts together are spread over the lens as these are.
        """
        points = _dealt(self.points, count, each)
        highlight_points = _dealt(self.highlight_points, count, HIGHLIGHT_POINTS * each)
        times = (_shuffled(each) + 0.5) / each - 0.5
        return [
            dataclasses.replace(
                self, points=points[i], highlight_points=highlight_points[i], times=times
            )
            for i in range(count)
        ]

    @functools.cached_property
    def _identity(self) -> tuple[object, ...]:
        arrays = self.points.tobytes(), self.highlight_points.tobytes()
        return (*arrays, self.cell, self.squeeze, self.middle, self.rim_distance)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, LensPoints):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)


def _dealt(points: np.ndarray, count: int, each: int) -> np.ndarray:
    """Points, ``count`` x ``each`` of (N, 2), dealt out in turn so that each part has its share."""
    points = points[np.arange(count * each) * len(points) // (count * each)]
    order = _orders(count, each)[..., None]
    return np.take_along_axis(points.reshape(each, count, 2), order, axis=1).swapaxes(0, 1)


@functools.lru_cache(maxsize=16)
def _orders(count: int, each: int) -> np.ndarray:
    """``each`` times the numbers below ``count``, in an order of its own each time.

    They are kept, for they take as long as half of a picture and are few, and so must not be
    written to.
    """
    orders = np.stack([_shuffled(count, seed) for seed in range(each)])
    orders.flags.writeable = False
    return orders


def _shuffled(count: int, seed: int = 0) -> np.ndarray:
    """The numbers from 0 on, in an order that has nothing to do with that of the lens points."""
    return np.random.default_rng(seed).permutation(count)
