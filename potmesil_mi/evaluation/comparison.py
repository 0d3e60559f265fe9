"""The focused picture beside a ray-traced one: how good it is, and how much time it saves.

The built-in ``thinlens`` that stands for the same lens is rendered until its noise is known to be
small, and then again with fewer and fewer samples, or more and more, to find out how many it
needs for the error of the focused picture.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from .._progress import ProgressCallback, reported
from .._validation import require_flag, require_number, require_whole
from ..focusing.api import focus
from ..focusing.methods import Method, MethodName, method_of
from ..samples.denoising import require_extra
from ..samples.formed import attributes_of_formed, attributes_through
from ..samples.point_samples import PointSamples
from ..tracing.hidden_surface import (
    WrappingIntegrator,
    nested_of,
    render_samples,
    require_sampling,
)
from ..tracing.passes import sample_count
from ..tracing.sampling import Sampling
from ..tracing.sensor import is_orthographic, pick_sensor, potmesil_sensor
from . import metrics
from .reference import REFERENCE_SPP, Reference
from .report import Comparison, Rendering
from .search import Found, Search
from .thinlens import MOST_SPP, SAMPLERS, ThinlensRenderer, rounded_up, thinlens_sensor
from .timing import NEVER, Deadline, Measured, Stages, measured, timed_stages

BUDGET = 600.0
"""Seconds for all that ``thinlens`` renders."""

OF_REFERENCE = 0.5
"""The part of them that the reference may take."""


def compare(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    *,
    spp: int = 0,
    seed: int = 0,
    sampling: Sampling | None = None,
    reference_spp: int = REFERENCE_SPP,
    reference_floor: float | None = None,
    budget: float | None = BUDGET,
    denoise: bool = False,
    method: Method | MethodName = "layered",
    lens_points: int | None = None,
    tables: int | None = None,
    inverse_square: bool | None = None,
    squares: int | None = None,
) -> Comparison:
    """Focus point samples of ``scene``, and render it with ``thinlens``, to compare the two.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``scene``, ``sensor``,        as for :func:`potmesil_mi.render_samples`; the lens is the
    ``integrator``, ``spp``,      sensor's
    ``seed``, ``sampling``
    ``reference_spp``             most samples a pixel of the reference, and of a ``thinlens``
                                  that is to reach the error of the focused picture; from 2
                                  (default 4096)
    ``reference_floor``           the reference is done when its own noise, estimated from two
                                  independent halves, is at this PSNR in dB; by default 10 dB
                                  above that of the focused picture
    ``budget``                    seconds for all that ``thinlens`` renders, about, from 0 (default
                                  600): the reference may take half of them, and stays noisier
                                  where it needs more; ``None`` for no bound
    ``denoise``                   whether the samples are denoised before they are focused, and
                                  ``thinlens`` after it is rendered (default: no); needs the
                                  extra ``denoise``
    ``method``, ``lens_points``,  as for :func:`potmesil_mi.focus`
    ``tables``, ``squares``,
    ``inverse_square``
    ============================  ==========================================================

    Both are rendered on an RGB film with the size, crop window and reconstruction filter of the
    sensor's. Raises ``ValueError`` or ``TypeError`` that names the parameter, also for a crop
    window of less than 11x11 pixels, ``ImportError`` without the extra ``compare``.
    """
    require_vectorised_variant("compare")
    metrics.require_extra()
    chosen = method_of(
        method,
        lens_points=lens_points,
        tables=tables,
        inverse_square=inverse_square,
        squares=squares,
    )
    _require_samples(spp, seed, sampling, denoise)
    _require_bounds(reference_spp, reference_floor, budget)
    if denoise:
        require_extra()
    sensor = pick_sensor(scene, sensor)
    integrator = scene.integrator() if integrator is None else integrator
    nested = nested_of(integrator)
    sensor = _comparable(sensor)
    if sampling is None:
        sampling = integrator.sampling if isinstance(integrator, WrappingIntegrator) else Sampling()
    sampling = dataclasses.replace(sampling, features=sampling.features or denoise)
    spp = sample_count(sensor.sampler(), spp)
    renderer = ThinlensRenderer(scene, nested, sensor, seed, denoise)

    def take_samples(number: int) -> PointSamples:
        other = (seed + number) % 2**32
        return render_samples(scene, sensor, integrator, spp=spp, seed=other, sampling=sampling)

    stages = timed_stages(
        take_samples,
        PointSamples.denoised if denoise else None,
        lambda samples, lens: np.array(
            focus(samples, lens, method=chosen, rfilter=sensor.film().rfilter())
        ),
        sensor.lens(),
        partial(attributes_of_formed, method=chosen),
    )
    paths = float(spp)
    if sampling.pattern == "sampler":
        paths *= 1 + sampling.refine
    else:
        paths *= stages.point_samples / math.prod(sensor.camera().crop_size)
    deadline = NEVER if budget is None else Deadline.after(budget)
    bounds = _Bounds(spp, paths, reference_spp, reference_floor, deadline)
    return _judged(renderer, stages, bounds, chosen)


def _require_samples(spp: int, seed: int, sampling: Sampling | None, denoise: bool) -> None:
    """Raise ``ValueError`` or ``TypeError`` for bad parameters of the samples."""
    for name, value in (("spp", spp), ("seed", seed)):
        require_whole(name, value, 0, 2**32 - 1)
    require_sampling(sampling)
    require_flag("denoise", denoise)


def _require_bounds(
    reference_spp: int, reference_floor: float | None, budget: float | None
) -> None:
    """Raise ``ValueError`` or ``TypeError`` for bad parameters of :func:`compare`."""
    require_whole("reference_spp", reference_spp, 2, MOST_SPP)
    if reference_floor is not None:
        require_number("reference_floor", reference_floor)
    if budget is not None:
        require_number("budget", budget, 0)


@dataclasses.dataclass(frozen=True)
class _Bounds:
    """How much is rendered.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``spp``                       samples a pixel of the sampler
    ``paths``                     samples a pixel of the focused picture, whatever its pattern
    ``most``                      samples a pixel of a ``thinlens`` at most
    ``floor``                     PSNR in dB of the reference's noise; ``None``: well above
                                  that of the focused picture
    ``deadline``                  when all of it is to be done
    ============================  ==========================================================
    """

    spp: int
    paths: float
    most: int
    floor: float | None
    deadline: Deadline


def _comparable(sensor: mi.Sensor) -> mi.Sensor:
    """The ``potmesil`` sensor, if there is a ``thinlens`` for it and its picture is large enough.

    Raises ``ValueError`` otherwise.
    """
    if not is_orthographic(sensor):  # thinlens_sensor refuses it
        sensor = potmesil_sensor(sensor)
    thinlens_sensor(sensor)
    width, height = sensor.camera().crop_size
    if min(width, height) < metrics.SSIM_WINDOW:
        raise ValueError(
            f"film: its crop window has {width}x{height} pixels, must have at least "
            f"{metrics.SSIM_WINDOW}x{metrics.SSIM_WINDOW}"
        )
    return sensor


def _judged(
    renderer: ThinlensRenderer, stages: Stages, bounds: _Bounds, method: Method
) -> Comparison:
    """The focused picture beside all that ``thinlens`` renders."""
    with reported() as report:
        reference = Reference(renderer.for_reference)
        until = bounds.deadline.part(OF_REFERENCE)
        reference.converge(stages.picture, bounds.most, bounds.floor, until, report)
        mean = reference.mean
        focused = _rated(
            Measured(stages.picture, bounds.paths, stages.focus_first, stages.focus_steady), mean
        )
        report("pinhole", None)
        pinhole = _rated(measured(partial(renderer.pinhole, bounds.spp), bounds.spp), mean)
        searches = {}
        for left, name in enumerate(SAMPLERS):
            until = bounds.deadline.part(1 / (len(SAMPLERS) - left))
            error = focused.mean_square
            searches[name] = _search(renderer, name, mean, error, bounds, until, report)
    best = min(SAMPLERS, key=lambda name: searches[name].rank)
    found = searches[best]
    return Comparison(
        focused=focused,
        pinhole=pinhole,
        equal_samples=_rated(found.start.measured, mean),
        equal_error=None if found.reached is None else _rated(found.reached.measured, mean),
        needed=found.needed,
        sampler=best,
        sampling=stages.sampling,
        denoising=stages.denoising if renderer.denoise else None,
        noise=metrics.mean_square(stages.picture, stages.other) / 2,
        bias=metrics.mean_product((stages.picture, stages.other), reference.independent),
        first_picture=stages.first_picture,
        point_samples=stages.point_samples,
        reference=mean.astype(np.float32),
        reference_spp=reference.spp,
        floor=reference.floor,
        lens=renderer.sensor.lens(),
        method=method.name,
        said=_said(renderer, stages, (found.reached or found.start).measured.spp, reference.spp),
    )


def _said(
    renderer: ThinlensRenderer, stages: Stages, spp: float, reference_spp: float
) -> dict[str, Mapping[str, Any]]:
    """What is said of each of the pictures, of which ``thinlens`` has ``spp`` samples a pixel."""

    def of(method: str, **more: float) -> dict[str, Any]:
        sensor = renderer.sensor
        return attributes_through(sensor.camera(), sensor.lens(), method, **more)

    return {
        "focused": stages.said,
        "thinlens": of("thinlens", seed=renderer.seed, spp=spp),
        "reference": of("thinlens", seed=renderer.seed, spp=reference_spp),
        "difference": of("difference"),
    }


def _search(
    renderer: ThinlensRenderer,
    sampler: str,
    reference: np.ndarray,
    error: float,
    bounds: _Bounds,
    deadline: Deadline,
    report: ProgressCallback,
) -> Found:
    """What a sampler of ``thinlens`` needs for ``error``."""

    def measure(count: int) -> Measured:
        report(f"thinlens, {sampler}: {count} samples a pixel", None)
        return measured(partial(renderer.through_lens, sampler, count), count)

    search = Search(measure, partial(rounded_up, sampler), reference)
    return search.run(error, math.ceil(bounds.paths), bounds.most, deadline)


def _rated(taken: Measured, reference: np.ndarray) -> Rendering:
    """A picture with its error."""
    return Rendering(
        picture=taken.picture.astype(np.float32),
        spp=taken.spp,
        first=taken.first,
        steady=taken.steady,
        mean_square=metrics.mean_square(taken.picture, reference),
        ssim=metrics.ssim(taken.picture, reference),
        flip=metrics.flip(taken.picture, reference),
    )
