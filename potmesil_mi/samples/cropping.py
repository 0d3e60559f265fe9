"""The samples of a part of a picture."""

from __future__ import annotations

import dataclasses
from typing import Any

from .raster import Window


def part_of(samples: Any, window: Window, sampled: Window) -> Any:
    """Those of the ``PointSamples`` that are in ``sampled``, of which there are some.

    ``window`` is the crop window of their camera.
    """
    camera = dataclasses.replace(
        samples.camera,
        crop_offset=(window.left, window.top),
        crop_size=(window.width, window.height),
    )
    inside = sampled.shows(samples.x, samples.y, samples.window, edges=samples.lattice > 0)
    return samples.chosen(inside).replace(camera=camera, window=sampled)
