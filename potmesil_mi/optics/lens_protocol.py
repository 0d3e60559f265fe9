"""What apertures and diffraction ask of a lens, so that they need not know :mod:`.lens`."""

from __future__ import annotations

from typing import Any, Protocol


class LensProtocol(Protocol):
    """A lens, as far as it matters to how its aperture spreads light.

    :class:`potmesil_mi.ThinLens` is one. Lengths are in millimetres, depths in scene units.
    """

    @property
    def focal_length(self) -> Any:
        """F in millimetres."""

    @property
    def f_number(self) -> Any:
        """The aperture number n."""

    @property
    def lens_diameter(self) -> Any:
        """D = F/n in millimetres."""

    @property
    def film_distance(self) -> Any:
        """Distance from the lens to the film in millimetres."""

    @property
    def squeeze(self) -> Any:
        """Height of highlights to their width."""

    def image_distance(self, depth: Any = None) -> Any:
        """V in millimetres of the image of a point at ``depth``."""

    def circle_of_confusion(self, depth: Any) -> Any:
        """Signed diameter C in millimetres of a point at ``depth``, positive nearer than focus."""

    def plain(self) -> LensProtocol:
        """The same lens of plain numbers."""
