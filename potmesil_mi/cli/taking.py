"""Point samples of the scene that a command is given, and how it says to focus them."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from .options import given_denoise, given_method, given_sampling, scene_with_lens

if TYPE_CHECKING:
    import mitsuba as mi

    from ..filters.base import FilterFunction
    from ..focusing.methods import Method
    from ..optics.lens import ThinLens
    from ..optics.telecentric import TelecentricLens
    from ..samples.point_samples import PointSamples
    from ..tracing.sampling import Sampling

    Adapt = Callable[[ThinLens | TelecentricLens, Sampling], Sampling]


class Taken(NamedTuple):
    """Samples, and how the options and the scene's integrator say that they are focused."""

    samples: PointSamples
    method: Method
    filters: tuple[FilterFunction, ...]
    film: mi.Film
    has_alpha: bool


def take(options: argparse.Namespace, adapt: Adapt) -> Taken:
    """Render the samples of the scene of the options, and keep them where these say.

    ``adapt`` makes of the lens, and of what options and integrator say of the sampling, what is
    sampled.
    """
    from ..plugins.settings import FocusSettings, has_alpha
    from ..samples.denoising import require_extra
    from ..tracing.hidden_surface import render_samples

    method = given_method(options)
    filters: tuple[FilterFunction, ...] = ()
    if options.denoise:
        require_extra()
    scene, sensor = scene_with_lens(options)
    integrator = scene.integrator()
    sampling = adapt(sensor.lens(), given_sampling(options, integrator))
    denoise = given_denoise(options, integrator)
    if isinstance(integrator, FocusSettings):
        method = given_method(options, integrator.method)
        filters = integrator.filters
    if denoise:
        sampling = dataclasses.replace(sampling, features=True)
    samples = render_samples(
        scene,
        sensor,
        integrator,
        spp=options.spp,
        seed=options.seed,
        sampling=sampling,
    )
    if options.samples:
        samples.save(options.samples)
    if denoise:
        samples = samples.denoised()
    film = sensor.film()
    return Taken(samples, method, filters, film, has_alpha(film))
