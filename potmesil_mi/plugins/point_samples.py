"""Integrator ``point_samples``: the hidden-surface stage, as channels of a picture."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics.telecentric import TelecentricLens
from ..tracing.sampling import Sampling
from .settings import has_alpha
from .wrapper import WrapperIntegrator, stacked

if TYPE_CHECKING:
    from ..samples.point_samples import PointSamples

AOVS = ("x", "y", "z", "id", "weight")
"""Channels of the film beside the colours; see :class:`PointSamplesIntegrator`."""


class PointSamplesIntegrator(WrapperIntegrator):
    r"""Point samples of the scene, seen through the pinhole.

    :func:`potmesil_mi.render_samples` gives the samples themselves. Rendered by ``mi.render``
    it gives the pinhole picture of the nested integrator, with the film's filter, and a sample
    of each pixel in further channels, unfiltered: of the one nearest to the pixel's centre

    ==========  ==========================================================================
    Channel     Meaning
    ==========  ==========================================================================
    ``x, y``    position in pixels of the film
    ``z``       depth along the camera's axis in scene units; inf where nothing was hit
    ``id``      surface; 0 where nothing was hit
    ``weight``  weight of all the pixel's samples
    ==========  ==========================================================================

    and AOVs of the nested integrator, such as those of Mitsuba's ``aov``, by their names.

    .. pluginparameters::

     * - (nested)
       - |integrator|
       - A sampling integrator, such as ``path`` or ``direct``.
     * - motion
       - |string|
       - A TOML file that tells what moves while the picture is exposed: tables ``[camera]``,
         ``[shapes.ID]`` and ``[shutter]``, see :class:`potmesil_mi.Motion`. (Default: nothing)
     * - pattern
       - |string|
       - ``sampler``: positions of the sensor's sampler. ``uniform``: the paper's grid of
         (2W+1) x (2H+1) points. ``adaptive``: pixel corners, subdivided in 2x2 squares where
         they differ. (Default: sampler)
     * - threshold
       - |float|
       - ``adaptive``: largest difference of a corner from the mean of the four that is not
         subdivided, in linear intensity clipped to [0, 1]. (Default: 25/255)
     * - subdivisions
       - |int|
       - ``adaptive``: most subdivisions of a pixel, 0 to 8. (Default: 2)
     * - layers
       - |int|
       - Most surfaces along a ray that are sampled, 1 to 16: those behind the first only where a
         ray from some point of the lens reaches them. Not in the film's channels. (Default: 16)
     * - overscan
       - |int|
       - Pixels sampled beyond each side of the crop window, 0 to 10000. Not in the film's
         channels. (Default: as far as circles of confusion reach)
     * - min_f_number
       - |float|
       - The widest aperture that ``layers`` and ``overscan`` must serve. (Default: the lens's)
     * - virtual_depth
       - |bool|
       - Depth of what is seen in mirrors and through glass is that of its image.
         (Default: true)
     * - refine
       - |float|
       - ``sampler``: further samples, as a share of those of the crop window, 0 to 16. They go to
         pixels around which radiance varies most. Not in the film's channels. (Default: 0.25)
     * - focus_range
       - |string|
       - The nearest and the farthest distance that will be focused on, such as ``0.8/3``:
         ``refine`` spends less on what is blurred then. (Default: anything may be in focus)
     * - features
       - |bool|
       - Samples keep albedo and normal, for a denoiser. Not in the film's channels.
         (Default: false)
     * - clamp
       - |float|
       - Most radiance of a sample, in any colour, that shows no lamp and not the sky, > 0:
         brighter ones are scaled down to it. (Default: no limit)

    Colours have the derivatives in materials, textures and lights that the nested integrator has,
    such as ``prb``, with the pattern ``sampler`` and without ``clamp`` and ``motion``; other
    channels count as constant.
    """

    plugin = "point_samples"

    def aov_names(self) -> list[str]:
        """Names of the channels beside the colours."""
        return [*AOVS, *self.nested_aovs()]

    def film_sampling(self) -> Sampling:
        """What the pinhole sees of the film, as often in each pixel, and no more."""
        return dataclasses.replace(self.sampling, layers=1, overscan=0, refine=0)

    def form(self, samples: PointSamples, film: mi.Film) -> tuple[np.ndarray, np.ndarray]:
        """The pinhole picture, and the channels of a sample of each pixel."""
        from ..samples.maps import aov_maps

        visible = along = samples
        if samples.moves:
            from ..focusing.smearing import samples_along_paths

            # What moves comes from beyond the film, too.
            visible = samples.visible()
            along = samples_along_paths(visible)
            visible = visible.crop(visible.crop_window)
        picture, channels = pinhole_picture(along, film), pixel_channels(visible)
        aovs = stacked(aov_maps(visible), channels.shape[:2])
        return picture, np.concatenate([channels, aovs], axis=-1)

    def form_attached(
        self, samples: PointSamples, rgb: mi.TensorXf, lens: Any, film: mi.Film
    ) -> mi.TensorXf:
        """The pinhole picture, of samples with this ``rgb``."""
        if samples.lattice > 0:
            raise NotImplementedError(
                f"pattern={self.sampling.pattern}: must be sampler where parameters of the scene "
                "have gradients; other patterns have derivatives with focus"
            )
        return pinhole_block(samples, rgb, film)

    def to_string(self) -> str:
        """Text for the log and for ``print``."""
        return f"PointSamplesIntegrator[nested = {self.nested}, sampling = {self.sampling}]"


def pinhole_picture(samples: PointSamples, film: mi.Film) -> np.ndarray:
    """RGB (A) of the samples through the film's filter, (height, width, 3 or 4)."""
    from ..focusing.api import focus
    from ..focusing.methods import Equation20

    alpha = has_alpha(film)
    if samples.lattice > 0:
        # A corner belongs to the four pixels around it, which equation 20 knows.
        lens = samples.lens
        pinhole = (
            lens.replace(half_angle=0)
            if isinstance(lens, TelecentricLens)
            else lens.replace(f_number=math.inf)
        )
        method = Equation20(tables=2, inverse_square=False)
        return np.array(focus(samples, pinhole, method=method, rfilter=film.rfilter(), alpha=alpha))
    return np.array(pinhole_block(samples, mi.TensorXf(samples.rgb), film))


def pinhole_block(samples: PointSamples, rgb: mi.TensorXf, film: mi.Film) -> mi.TensorXf:
    """The same of samples that are not on a lattice and have this ``rgb``, by Mitsuba's own means.

    It has derivatives in ``rgb``.
    """
    from ..tracing.passes import wavefronts

    alpha = has_alpha(film)
    film.prepare([])
    block = film.create_block()
    for part in wavefronts(len(samples), 1):
        weight = mi.Float(samples.weight[part])
        row = dr.arange(mi.UInt32, part.start, part.stop) * 3
        columns = [dr.gather(mi.Float, rgb.array, row + colour) for colour in range(3)]
        if alpha:
            columns.append(mi.Float(samples.alpha[part]))
        place = mi.Point2f(samples.x[part], samples.y[part])
        block.put(place, [*(column * weight for column in columns), weight])
        dr.eval(block.tensor())
    tensor = block.tensor()
    light, weight = tensor[..., :-1], tensor[..., -1:]
    return light / dr.maximum(weight, dr.smallest(mi.Float))


def pixel_channels(samples: PointSamples) -> np.ndarray:
    """What ``AOVS`` names, of each pixel's sample nearest to its centre: (height, width, 5)."""
    width, height = samples.camera.crop_size
    pixel = samples.pixel()
    off_centre = np.square(samples.x % 1 - 0.5) + np.square(samples.y % 1 - 0.5)
    order = np.lexsort([off_centre, pixel])
    nearest = order[np.flatnonzero(np.diff(pixel[order], prepend=-1))]
    channels = np.zeros((height * width, len(AOVS)), dtype=np.float32)
    channels[:, AOVS.index("z")] = np.inf
    channels[pixel[nearest], :4] = np.stack(
        [samples.x, samples.y, samples.z, samples.surface], axis=1
    )[nearest]
    channels[:, 4] = np.bincount(pixel, samples.weight, minlength=height * width)
    return channels.reshape(height, width, len(AOVS))
