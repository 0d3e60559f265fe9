"""Integrator ``focus``: the whole camera in one rendering."""

from __future__ import annotations

import dataclasses
import re
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from .._validation import shown
from ..filters.base import Filter, parse_filter
from ..tracing.sensor import has_lens
from .settings import flag_from, has_alpha, method_from
from .wrapper import WrapperIntegrator, stacked

if TYPE_CHECKING:
    from ..samples.point_samples import PointSamples


class FocusIntegrator(WrapperIntegrator):
    r"""Point samples through a pinhole, then the picture through the lens.

    Needs one nested integrator for the radiance, and a ``potmesil`` or ``thinlens`` sensor. The
    picture is put into the film, with its crop window, pixel format, alpha and reconstruction
    filter.

    .. pluginparameters::

     * - (nested)
       - |integrator|
       - A sampling integrator, such as ``path`` or ``direct``.
     * - method
       - |string|
       - ``layered``: what is visible, fast. ``lightfield``: the same with more lens points on a
         finer grid. ``paper``: equation 20 of Potmesil & Chakravarty (1981), which knows no
         occlusion. Or a text with its options, such as ``layered:lens_points=64``.
         (Default: layered)
     * - lens_points
       - |int|
       - ``layered``, ``lightfield``: points of the lens from which visibility is found, 1 to
         4096. (Default: 32, in crowded scenes and from 64 samples a pixel on 64; and 128, in
         crowded scenes 192)
     * - tables
       - |int|
       - ``paper``: number of depths with a table of the circle of confusion, 2 to 10000.
         (Default: 73)
     * - inverse_square
       - |bool|
       - ``paper``: weight samples by 1/z², as printed. (Default: true)
     * - squares
       - |int|
       - Subpixels on a side of a pixel that are formed and averaged, 1 to 16.
         (Default: 1 for ``layered``, but 2 in crowded scenes and from 64 samples a pixel
         on, and 4 from 256; 2 for the others, but 4 for ``lightfield`` in crowded scenes)
     * - filter, filter_2, ...
       - |string|
       - Special effects for the finished picture, in the order of their numbers, of names that
         begin with ``filter``: ``star:points=6,length=0.1,threshold=2``, ``diffraction:scale=20``,
         ``defocus:radius=0.01``, ``fade:amount=0.5,color=1/0.9/0.8``. Parameters are those of
         :class:`potmesil_mi.Star`, ``Diffraction``, ``Defocus`` and ``Fade``. (Default: none)
     * - denoise
       - |bool|
       - Denoise the samples before they are focused, for which ``features`` are kept: see
         :meth:`potmesil_mi.PointSamples.denoised`. Needs the extra ``denoise``. (Default: false)
     * - focus_aovs
       - |bool|
       - AOVs of a nested ``aov`` are blurred by the lens as colours are, and keep their names.
         Every three of them take as long as the picture. (Default: false; channels such as
         ``unfocused.dd.T`` have those of the sample nearest to the middle of each pixel)
     * - motion
       - |string|
       - A TOML file that tells what moves while the picture is exposed: tables ``[camera]``,
         ``[shapes.ID]`` and ``[shutter]``, see :class:`potmesil_mi.Motion`. (Default: nothing)
     * - pattern, threshold, subdivisions, layers, overscan, min_f_number, virtual_depth, features,
         clamp
       - |string|, |float|, |int|, |bool|
       - What is sampled, as for ``point_samples``.
     * - refine, focus_range
       - |float|, |string|
       - Where it is sampled more often, as for ``point_samples``.

    AOVs of the nested integrator, such as those of Mitsuba's ``aov``, follow the colours in the
    film. What is hidden from the pinhole has its own; what a mirror or a pane shows has those of
    the mirror or pane. Distances (``depth``) are along the ray, from the near plane. What ``aov``
    shows of its first nested integrator is the picture, and is not there twice. ``hide_emitters``
    must be said of the ``aov``, too.

    Pictures have the derivatives in materials, textures and lights that the nested integrator has,
    such as ``prb``, and those of :func:`potmesil_mi.focus` in ``focus_distance``, ``f_number`` and
    ``aperture_radius`` of the sensor. There are none in where shapes and the camera are, and none
    with ``clamp``, ``denoise`` or ``motion``, nor with images in mirrors and panes, of which
    ``virtual_depth`` false takes none: these are errors. AOVs count as constant, and so do samples
    that share a ray, of which a warning tells.
    """

    plugin = "focus"

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.method = method_from(props)
        self.filters = _filters(props)
        self.denoise = flag_from(props, "denoise")
        self.focus_aovs = flag_from(props, "focus_aovs")
        if self.denoise:
            from ..samples.denoising import require_extra

            require_extra()
            self.sampling = dataclasses.replace(self.sampling, features=True)

    def check_sensor(self, sensor: mi.Sensor) -> None:
        """Raise ``TypeError`` for a sensor without a lens."""
        if not has_lens(sensor):
            raise TypeError("focus: needs a potmesil or thinlens sensor, this one has no lens")

    def form(self, samples: PointSamples, film: mi.Film) -> tuple[np.ndarray, np.ndarray]:
        """The picture through the samples' lens, and AOVs."""
        from ..focusing.aovs import focus_aovs
        from ..focusing.api import focus
        from ..samples.maps import aov_maps

        picture = focus(
            samples.denoised() if self.denoise else samples,
            samples.lens,  # given: a pinhole is meant
            method=self.method,
            filters=self.filters,
            rfilter=film.rfilter(),
            alpha=has_alpha(film),
        )
        image = np.array(picture)
        if self.focus_aovs:
            planes = focus_aovs(samples, method=self.method, rfilter=film.rfilter())
        else:
            planes = aov_maps(samples)
        return image, stacked(planes, image.shape[:2])

    def form_attached(
        self, samples: PointSamples, rgb: mi.TensorXf, lens: Any, film: mi.Film
    ) -> mi.TensorXf:
        """The picture through the ``lens``, of samples with this ``rgb``."""
        from ..focusing.api import focus

        return focus(
            samples.replace(rgb=rgb),
            lens,
            method=self.method,
            filters=self.filters,
            rfilter=film.rfilter(),
            alpha=has_alpha(film),
        )

    def check_differentiable(self, samples: PointSamples) -> None:
        """Raise ``ValueError`` that names a parameter with which there are no derivatives."""
        super().check_differentiable(samples)
        if self.denoise:
            raise ValueError(
                "denoise=True: must be false where parameters of the scene have gradients, for a "
                "denoiser does not tell derivatives"
            )
        if samples.visibility is not None and samples.visibility.any():
            raise ValueError(
                "virtual_depth=True: must be false where parameters of the scene have gradients, "
                "for what is seen in mirrors and through panes has no derivatives"
            )

    def aov_names(self) -> list[str]:
        """Names of the channels beside the colours."""
        from ..samples.maps import UNFOCUSED

        names = self.nested_aovs()
        return [*names] if self.focus_aovs else [*map(UNFOCUSED.format, names)]

    def to_string(self) -> str:
        """Text for the log and for ``print``."""
        return (
            f"FocusIntegrator[method = {self.method}, filters = {[*map(str, self.filters)]}, "
            f"denoise = {self.denoise}, focus_aovs = {self.focus_aovs}, "
            f"sampling = {self.sampling}, nested = {self.nested}]"
        )


def _filters(props: mi.Properties) -> tuple[Filter, ...]:
    """The filters of the properties whose names begin so, ``filter_2`` before ``filter_10``."""
    names = [name for name in props.keys() if name.startswith("filter")]  # noqa: SIM118
    names.sort(key=_in_natural_order)
    for name in names:
        if not isinstance(props[name], str):
            raise TypeError(f"{name}={shown(props[name])}: must be a string, such as star:points=6")
    return tuple(parse_filter(props[name]) for name in names)


def _in_natural_order(name: str) -> list[int | str]:
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]
