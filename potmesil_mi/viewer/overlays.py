"""What a viewer shows in the place of the picture, or in it: linear colours, (H, W, 3)."""

from __future__ import annotations

import numpy as np

from .._image import linear_from_srgb
from ..optics.lens import ThinLens
from ..samples.circles import SHARP, circle_colors
from ..samples.maps import circles_of, depth_map
from ..samples.point_samples import PointSamples
from ..stacks.foci import Lens

DIMMED = 0.25
"""What is left of the light of what is not sharp."""


class Maps:
    """The maps of samples, of which the depth is looked up once.

    Their film has pixels that are ``times`` as large as those in which circles are told.
    """

    def __init__(self, samples: PointSamples, times: int) -> None:
        self._samples = samples
        self._times = times
        self._depth: np.ndarray | None = None

    @property
    def depth(self) -> np.ndarray:
        """The depth of each pixel, (H, W), in scene units."""
        if self._depth is None:
            self._depth = depth_map(self._samples)
        return self._depth

    def circles(self, lens: Lens) -> np.ndarray:
        """The signed diameters of the circles of confusion, (H, W), in pixels of the whole film."""
        return circles_of(self.depth, lens, self._samples.camera) * np.float32(self._times)

    def depth_shown(self) -> np.ndarray:
        """The nearest white and what is farther darker, by equal steps of the circle."""
        with np.errstate(divide="ignore"):
            farness = 1 / self.depth if self._is_thin else -self.depth
        seen = farness[np.isfinite(self.depth)]
        if len(seen) == 0:
            return np.zeros((*self.depth.shape, 3), np.float32)
        least, most = (0.0 if self._has_sky else seen.min()), seen.max()
        share = (np.nan_to_num(farness, neginf=least) - least) / max(most - least, 1e-30)
        gray = linear_from_srgb(np.clip(share, 0, 1))
        return np.repeat(gray[..., None], 3, axis=2).astype(np.float32)

    def circles_shown(self, lens: Lens) -> np.ndarray:
        """Orange nearer than the focus, blue beyond it, grey what is sharp."""
        return circle_colors(self.circles(lens))

    def sharp_shown(self, lens: Lens, picture: np.ndarray) -> np.ndarray:
        """The picture, in which what is not sharp is dim and without colour."""
        sharp = np.abs(self.circles(lens)) <= SHARP
        dim = np.repeat(picture.mean(axis=2, keepdims=True) * np.float32(DIMMED), 3, axis=2)
        return np.where(sharp[..., None], picture, dim)

    @property
    def _is_thin(self) -> bool:
        return isinstance(self._samples.lens, ThinLens)

    @property
    def _has_sky(self) -> bool:
        return self._is_thin and not np.isfinite(self.depth).all()
