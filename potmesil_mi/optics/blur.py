"""The blur of a lens: the circle of confusion as an affine function of vergence.

Point P at depth z appears through the lens point u (in the unit disc) at x + r u pixels, with
r = R f (1/z - 1/U), where R is the aperture's radius, f the distance of the film in pixels and U
the focused distance. So r is the radius of the circle of confusion (equation 8), and two depths
move against each other by up to R f |1/z_1 - 1/z_2| pixels, whatever is in focus.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from .camera import Camera
from .lens import ThinLens


@dataclasses.dataclass(frozen=True)
class Blur:
    """The signed radius of the circle of confusion: affine in vergence, which is 1/depth.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``radius_per_vergence``       R f, the radius per scene unit of 1/z - 1/U, >= 0; in pixels
                                  of the film, or in subpixels, see :meth:`finer`
    ``focused_vergence``          1/U per scene unit, the vergence of the focused plane; 0 for
                                  a lens that is focused at infinity
    ============================  ==========================================================
    """

    radius_per_vergence: float
    focused_vergence: float

    @classmethod
    def of(cls, lens: ThinLens, camera: Camera) -> Blur:
        """The blur of ``lens`` before the film of ``camera``, in pixels."""
        return cls(radius_per_vergence(lens, camera), 1 / float(lens.plain().focus_distance))

    def radius(self, vergence: Any) -> Any:
        """The signed radius at ``vergence`` (a number or an array): positive nearer than focus."""
        return self.radius_per_vergence * (vergence - self.focused_vergence)

    def finer(self, subpixels: int) -> Blur:
        """The same blur in subpixels, of which there are so many on a side of a pixel."""
        return Blur(self.radius_per_vergence * subpixels, self.focused_vergence)


def radius_per_vergence(lens: ThinLens, camera: Camera) -> float:
    """R f: radius in pixels of the circle of confusion per scene unit of 1/z - 1/U."""
    lens = lens.plain()
    return float(lens.aperture_radius) * camera.focal_length_pixels


def widest_radius_per_vergence(lens: ThinLens, camera: Camera, nearest: float) -> float:
    """The largest :func:`radius_per_vergence` of the lens for a focus from ``nearest`` on.

    With the film at F the aperture's radius grows as the lens is focused nearer (R = V_u / 2n).
    ``nearest``, in scene units, counts where the lens can focus on it: from twice its focal
    length.
    """
    lens = lens.plain()
    least = 2 * lens.focal_length / lens.millimeters_per_unit
    focused = lens.replace(focus_distance=min(max(nearest, least), lens.focus_distance))
    return max(radius_per_vergence(lens, camera), radius_per_vergence(focused, camera))
