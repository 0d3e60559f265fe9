"""Which lenses a living picture lets one choose from: its apertures, and how far the focus goes."""

from __future__ import annotations

import math
from collections.abc import Iterable

from .._validation import require_positive, shown
from ..motion.track import is_infinite, named
from ..optics.blur import widest_radius_per_vergence
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.usable import require_usable_lens
from ..samples.depth_range import DepthRange
from ..samples.point_samples import PointSamples
from ..stacks.foci import closest_focus
from .sweep import FocusRange

STOPS = (1, 1.4, 2, 2.8, 4, 5.6, 8, 11, 16, 22, 32, 45, 64, 90, 128, 180, 256, 360, 512)
"""F-numbers as they stand on lenses, a stop apart."""

MOST_STOPS = 6
"""How many of them, at most, follow the lens's own where none are asked for."""

NARROWEST = 2.0
"""They end where circles of confusion grow by no more than this from near to far, in pixels."""


def focus_range(
    samples: PointSamples, lens: ThinLens, near: float | None, far: float | None
) -> FocusRange:
    """From where to where the focus goes: see ``living_picture``."""
    for name, value in (("near", near), ("far", far)):
        if value is not None and not (name == "far" and is_infinite(value)):
            require_positive(name, value, "scene units")
            with named(name):
                require_usable_lens(lens.replace(focus_distance=float(value)))
    closest = closest_focus(lens)
    ends = DepthRange.of(samples).ends(samples.camera)
    chosen = near is None and far is None
    if near is None:
        if not any(map(math.isfinite, ends)):
            raise ValueError("near: must be given, for nothing is in sight that one could focus on")
        near = max(min(ends), closest)
    if far is None:
        far = max(ends, default=math.inf)
    if chosen and near >= far:  # All is at one depth.
        near, far = max(near / 1.25, closest), near * 1.25
    near, far = float(near), float(far)
    if not near < far:
        raise ValueError(f"far={far:g}: must be > near={near:g}")
    return FocusRange(near, far)


def growth(lens: ThinLens, camera: Camera, focused: FocusRange) -> float:
    """By how many pixels circles of confusion grow as the focus goes from one end to the other."""
    radius = widest_radius_per_vergence(lens, camera, focused.near)
    return 2 * radius * (1 / focused.near - 1 / focused.far)


def apertures_of(
    samples: PointSamples, lens: ThinLens, focused: FocusRange, given: Iterable[float] | None
) -> list[float]:
    """The f-numbers, the widest aperture first."""
    if given is not None:
        if isinstance(given, (str, bytes)) or not isinstance(given, Iterable):
            raise TypeError(f"f_numbers={shown(given)}: must be several, in a list")
        found = list(given)
        if not found:
            raise ValueError(f"f_numbers={shown(given)}: must be one at least")
        for i, one in enumerate(found):
            require_positive(f"f_numbers[{i}]", one)
        return sorted({float(one) for one in found})
    own = float(lens.f_number)
    if math.isinf(own):
        raise ValueError("f_numbers: must be given, for the lens of the samples is a pinhole")
    apertures = [own]
    for stop in STOPS:
        wide = growth(lens.replace(f_number=apertures[-1]), samples.camera, focused)
        if len(apertures) <= MOST_STOPS and stop > 1.2 * own and wide > NARROWEST:
            apertures.append(float(stop))
    return apertures
