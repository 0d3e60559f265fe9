"""How deep what the pinhole sees is."""

from __future__ import annotations

import dataclasses
import math
import weakref
from typing import Any, Protocol

import numpy as np

from ..optics.camera import Camera
from .raster import Window

_ranges: weakref.WeakKeyDictionary[Any, DepthRange] = weakref.WeakKeyDictionary()
"""What :meth:`DepthRange.of` has found, for as long as there are the samples."""


class Seen(Protocol):
    """What is asked of :class:`potmesil_mi.PointSamples`, which shows its own depths."""

    @property
    def x(self) -> np.ndarray:
        """Positions across, in pixels of the film."""

    @property
    def y(self) -> np.ndarray:
        """Positions down."""

    @property
    def z(self) -> np.ndarray:
        """Depths in scene units."""

    @property
    def layer(self) -> np.ndarray:
        """0 for what the pinhole sees."""

    @property
    def crop_window(self) -> Window:
        """What the picture shows."""


@dataclasses.dataclass(frozen=True)
class DepthRange:
    """Depths of what the pinhole sees within the picture, in scene units along the axis.

    ``nearest`` and ``farthest`` are those of what was hit, ``None`` where nothing was;
    ``has_sky`` is whether something was not.
    """

    nearest: float | None
    farthest: float | None
    has_sky: bool

    @classmethod
    def of(cls, samples: Seen) -> DepthRange:
        """That of samples, which is looked up once."""
        found = _ranges.get(samples)
        if found is None:
            found = _ranges[samples] = cls._looked_up(samples)
        return found

    @classmethod
    def _looked_up(cls, samples: Seen) -> DepthRange:
        crop = samples.crop_window
        z = samples.z[(samples.layer == 0) & crop.contains(samples.x, samples.y)]
        hit = np.isfinite(z)
        every = bool(hit.all())
        z = z if every else z[hit]
        if len(z) == 0:
            return cls(None, None, not every)
        return cls(float(z.min()), float(z.max()), not every)

    def ends(self, camera: Camera) -> list[float]:
        """The nearest and the farthest depth, ``inf`` for the sky.

        To an orthographic camera the sky is just behind the farthest surface.
        """
        found = [depth for depth in (self.nearest, self.farthest) if depth is not None]
        sky = self.has_sky and not (found and camera.projection == "orthographic")
        return [*found, math.inf] if sky else found
