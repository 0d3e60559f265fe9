"""Memory: what a picture takes at its largest while it is formed, told before it is begun."""

from __future__ import annotations

import numpy as np

from ..optics.aperture import Aperture
from ..samples.point_samples import PointSamples
from .methods import Equation20, Layered, LightField, Method

BYTES_AT_LEAST = 50e6
"""What is taken for the smallest picture."""

BYTES_AT_ONCE = 30.0
"""For each of the samples that are gathered at once."""

BYTES_OF_SUBPIXEL = 322.0
"""For each subpixel of the samples' window: its fragment, and the picture."""

BYTES_OF_SUMS = 274.0
"""For each subpixel, the sums over samples, whose memory large pictures give back."""

COVERED = 3.3
"""Fragments, for each hidden sample, at which points of the lens look one by one."""

BYTES_OF_TABLE = 320.0
"""For each subpixel, by tables."""

BYTES_OF_TABLED = 78.0
"""For each sample, by tables."""


def memory_of_focus(samples: PointSamples, method: Method, subpixels: int | None = None) -> float:
    """Bytes that the first picture of ``samples`` takes at its largest, beside these.

    ``method`` forms ``subpixels`` x ``subpixels`` in a pixel, by default as many as it says for the
    lens that came with the samples.
    """
    # What forms pictures is imported when it is needed: see the methods.
    from .locating import GATHERED_AT_ONCE
    from .viewing import MOST_KEPT
    from .visibility import MAX_COVERED

    if subpixels is None:
        aperture = Aperture.parse(samples.lens.aperture)
        subpixels = method.squares or method.default_squares(samples, aperture)
    size, count = samples.window.size * subpixels**2, len(samples)
    if isinstance(method, Equation20):
        return BYTES_AT_LEAST + BYTES_OF_TABLE * size + BYTES_OF_TABLED * count
    needed = BYTES_AT_LEAST + BYTES_OF_SUBPIXEL * size
    needed += BYTES_OF_SUMS * size if size <= MOST_KEPT else 0
    needed += BYTES_AT_ONCE * min(count, GATHERED_AT_ONCE)
    if isinstance(method, (Layered, LightField)):
        points = method.lens_points or method.points_for(samples)
        hidden = int(np.count_nonzero(samples.layer))
        needed += COVERED * hidden * points
        needed += np.dtype(np.float32).itemsize * min(size * points, MAX_COVERED)
    return needed
