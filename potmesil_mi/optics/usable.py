"""Cameras and lenses of which pictures can be formed in single precision."""

from __future__ import annotations

import math
from typing import Any

from .camera import Camera
from .lens import ThinLens
from .telecentric import TelecentricLens, require_fitting

F_NUMBERS = (1e-4, 1e12)
"""Finite aperture numbers of which single precision forms pictures."""

MAGNITUDES = (1e-30, 1e30)
"""The same of other numbers of a camera and a lens, if they are neither 0 nor infinite."""

_SMALL_AS_0 = ("to_world", "principal_point_offset")
"""Numbers that may be as small as they like: they are added to larger ones."""


def require_usable_together(camera: Camera, lens: ThinLens | TelecentricLens) -> None:
    """Raise ``ValueError`` unless single precision can form the picture of a lens and a camera.

    That is so where :func:`.telecentric.require_fitting` raises, of an f-number that is given and
    is neither in ``F_NUMBERS`` nor infinite, and of other numbers beyond ``MAGNITUDES``, of which
    only the upper bound holds for ``to_world`` and ``principal_point_offset``. It names the number.
    """
    require_fitting(camera, lens)
    require_usable_lens(lens)
    for name, value in camera.to_dict().items():
        require_magnitude(name, value, 0.0 if name in _SMALL_AS_0 else MAGNITUDES[0])


def require_usable_lens(lens: ThinLens | TelecentricLens) -> None:
    """Raise ``ValueError`` for a lens with numbers that single precision cannot use."""
    least, most = F_NUMBERS
    for name, value in lens.plain().parameters().items():
        # That of a lens with an aperture_radius depends on the unit, which may be anything.
        if name != "f_number":
            require_magnitude(name, value)
        elif not (least <= value <= most or value == math.inf):
            raise ValueError(f"f_number={value}: must be {least:g} to {most:g}, or inf")


def require_usable_view(lens: ThinLens) -> None:
    """Raise ``ValueError`` for a lens whose field of view no camera has."""
    plain = lens.plain()
    if not 0 < plain.fov < 180:
        raise ValueError(
            f"focal_length={plain.focal_length}, frame_width={plain.frame_width}: must make a "
            f"field of view > 0 and < 180 degrees, not {plain.fov}"
        )


def require_magnitude(name: str, value: Any, least: float = MAGNITUDES[0]) -> None:
    """Raise ``ValueError`` for a number, or one in a tuple, that single precision cannot use."""
    if isinstance(value, tuple):
        for i, item in enumerate(value):
            require_magnitude(f"{name}[{i}]", item, least)
        return
    most = MAGNITUDES[1]
    usable = not isinstance(value, (int, float)) or value == 0 or abs(value) == math.inf
    if not usable and not least <= abs(value) <= most:
        allowed = f"0, or {least:g} to {most:g}" if least else f"at most {most:g}"
        raise ValueError(f"{name}={value}: must be {allowed} in size")
