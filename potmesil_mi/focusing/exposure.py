"""One picture that is to be formed: of which samples, by which lens, on which raster."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

from ..optics.blur import Blur
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction
from ..samples.point_samples import PointSamples
from ..samples.raster import Window

if TYPE_CHECKING:
    from .choices import Choices

FINE_SUBPIXELS = 4
"""Subpixels on a side of a pixel from which on kernels are closer, where visibility is exact."""


class Visibility(NamedTuple):
    """From how many points of the lens visibility is found, and whether of exactly that lens.

    Otherwise that of a lens with a similar aperture will do.
    """

    lens_points: int
    exact: bool


@dataclasses.dataclass(frozen=True)
class Exposure:
    """What a method forms a picture of.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``samples``                   point samples
    ``lens``                      a lens of plain numbers, in the samples' scene units
    ``psf``                       how the light of a point is spread: one channel's
    ``subpixels``                 on a side of a pixel
    ``alpha``                     whether the picture has alpha besides RGB
    ``telecentric``               whether samples and lens stand for those of an orthographic
                                  camera, see :mod:`potmesil_mi.optics.telecentric`: then light
                                  does not fall off, and 1/z is what steps of depth are equal in
    ``degree``                    up to which the film asks for moments: where in a subpixel light
                                  is, see :mod:`potmesil_mi.focusing.moments`
    ``choices``                   what the picture has chosen that the exposure is of a tile of;
                                  ``None`` where it is of the picture itself
    ``lit``                       of a tile: from which subpixels of the samples' window light may
                                  be in it
    ============================  ==========================================================
    """

    samples: PointSamples
    lens: ThinLens
    psf: PointSpreadFunction
    subpixels: int
    alpha: bool
    telecentric: bool = False
    degree: int = 0
    choices: Choices | None = None
    lit: Window | None = None

    @property
    def blur(self) -> Blur:
        """The blur of the lens in subpixels."""
        return Blur.of(self.lens, self.samples.camera).finer(self.subpixels)

    @property
    def subpixels_per_mm(self) -> float:
        """Subpixels in a millimetre of film."""
        focal_length = self.samples.camera.focal_length_pixels
        return focal_length * self.subpixels / self.lens.film_distance

    @property
    def crop(self) -> Window:
        """What the picture shows, in subpixels of the samples' window."""
        crop = self.samples.crop_window.relative_to(self.samples.window)
        return crop.subdivided(self.subpixels)
