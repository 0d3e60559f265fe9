"""The hidden-surface stage: point samples of a scene, seen through a pinhole.

Section 3.1 of Potmesil & Chakravarty (1981), with any of Mitsuba's sampling integrators in the
place of the paper's ray tracer.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Protocol, runtime_checkable

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from .._memory import require_memory
from .._progress import one_bar
from .._validation import require_kind, require_whole, shown
from ..motion.motion import Motion
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, as_thin_lens
from ..optics.usable import require_usable_together
from ..samples.columns import COLUMNS, Columns, parts_of
from ..samples.point_samples import PointSamples
from ..samples.raster import Window
from .aovs import Aovs
from .buffers import MOST_KEPT, SampleBuffer
from .elsewhere import seen_elsewhere
from .exposing import exposed
from .fireflies import Fireflies
from .lens_rays import LensRays
from .lobes import part_lobes
from .memory import memory_of_sampling
from .onward import has_specular
from .overscan import MOST_OVERSCAN, MOST_OVERSCAN_OF_GRIDS, overscan
from .passes import Passes
from .patterns import VisibleSamples, sample_visible
from .peeling import add_hidden, may_hide
from .provenance import provenance_of
from .rays import PrimaryRays
from .sampling import Sampling
from .seen_through import SeenThrough, seen_through
from .sensor import pick_sensor, with_lens
from .shapes import surface_ids
from .splitting import split
from .sweeping import Sweep
from .transmission import VeilKinds, veil_kinds

SAME_DEPTH = 1e-5
"""Ratio, less 1, of depths of one thing that was traced twice."""


@runtime_checkable
class WrappingIntegrator(Protocol):
    """An integrator around the one that gives the radiance, as ``focus`` and ``point_samples``.

    It is told by its attributes and not by its class, which is made anew for each variant.
    """

    nested: mi.Integrator
    sampling: Sampling
    motion: Motion | None


def render_samples(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    *,
    spp: int = 0,
    seed: int = 0,
    sampling: Sampling | None = None,
    lens: TelecentricLens | None = None,
    motion: Motion | None = None,
) -> PointSamples:
    """Point samples of ``scene``: position, radiance, depth and surface of every primary ray.

    ``sensor`` is one, or its number in the scene; a ``perspective`` or ``thinlens`` is sampled
    through the pinhole at its place, an ``orthographic`` along parallel rays (see
    :func:`potmesil_mi.potmesil_sensor`). ``lens`` is for an ``orthographic`` sensor,
    which has none of its own.
    ``integrator`` gives the radiance; by default the scene's, and what is nested in a ``focus``
    or ``point_samples``. ``spp`` samples a pixel, by default as many as the sampler's count;
    some samplers round it up; then come those of ``refine``, see :class:`potmesil_mi.Sampling`.
    With one pass (up to 4M rays), the same ``seed`` and ``refine=0`` the rays are those of
    ``mi.render`` with the same integrator.

    With ``motion`` they are those of an exposure, with ``time`` and ``motion`` of their own: the
    scene is sampled at several instants, with ``spp`` in all of them together, and left as it was.
    What does not move at all has the samples of a scene that stands still.

    Raises ``ValueError`` for an empty scene or bad parameters, ``TypeError`` for a sensor or
    integrator that cannot be used, ``RuntimeError`` in scalar variants.
    """
    require_vectorised_variant("render_samples")
    sensor = pick_sensor(scene, sensor)
    if motion is not None:
        require_kind("motion", motion, Motion, "a Motion, as Motion.load gives")
    require_sampling(sampling)
    sensor = with_lens(sensor, lens)
    integrator = scene.integrator() if integrator is None else integrator
    if isinstance(integrator, WrappingIntegrator):
        sampling, motion = sampling or integrator.sampling, motion or integrator.motion
    nested = nested_of(integrator)
    if mi.has_flag(sensor.film().flags(), mi.FilmFlags.Special):
        raise TypeError("film: must be a film of colours, such as hdrfilm, not a special one")
    require_whole("spp", spp, 0, 2**32 - 1)
    require_whole("seed", seed, 0, 2**32 - 1)

    def sampled(spp: int, seed: int, sweep: Sweep | None) -> PointSamples:
        passes = Passes(sensor.sampler(), spp, seed)
        return _sampled(scene, sensor, nested, passes, sampling, sweep)

    with dr.suspend_grad(), one_bar():
        if motion is not None:
            spp = spp or sensor.sampler().sample_count()
            return exposed(scene, sensor, motion, spp, seed, sampled)
        return _sampled(scene, sensor, nested, Passes(sensor.sampler(), spp, seed), sampling, None)


def require_sampling(sampling: Sampling | None) -> None:
    """Raise ``TypeError`` unless it is a :class:`Sampling`, or ``None``."""
    if sampling is not None:
        require_kind("sampling", sampling, Sampling, "a Sampling, such as Sampling('uniform')")


def nested_of(integrator: mi.Integrator | None) -> mi.SamplingIntegrator:
    """The integrator that gives the radiance: itself, or what it wraps.

    Raises ``TypeError`` for one that does not sample rays.
    """
    nested = integrator.nested if isinstance(integrator, WrappingIntegrator) else integrator
    if not isinstance(nested, mi.SamplingIntegrator):
        name = nested.class_name() if isinstance(nested, mi.Integrator) else shown(nested)
        raise TypeError(f"integrator={name}: must be a sampling integrator, such as path")
    return nested


def _sampled(
    scene: mi.Scene,
    sensor: mi.Sensor,
    integrator: mi.SamplingIntegrator,
    passes: Passes,
    sampling: Sampling | None,
    sweep: Sweep | None,
) -> PointSamples:
    """The stage itself: a window, the samples that the pinhole sees in it, and hidden ones.

    A ``sweep`` makes the window larger, and brings more into sight.
    """
    sampling = sampling or Sampling()
    ids, surfaces = surface_ids(scene)
    follows_windows = sampling.virtual_depth and has_specular(scene)
    crop = _crop_window(sensor.film())
    veils = VeilKinds(False, False)
    if sampling.virtual_depth:
        veils = veil_kinds(scene, sensor, integrator)
    kept = sampling.features, Aovs.of(integrator)
    rays = PrimaryRays(scene, sensor, integrator, passes, crop, ids, follows_windows, veils, *kept)
    widest = sensor.lens()
    if sampling.min_f_number is not None:
        if isinstance(widest, TelecentricLens):
            raise ValueError(
                f"min_f_number={sampling.min_f_number}: must be None for an orthographic sensor, "
                "whose lens has a half_angle"
            )
        widest = widest.replace(f_number=sampling.min_f_number)
    require_usable_together(sensor.camera(), widest)
    if sampling.overscan is not None:
        window = crop.grown(sampling.overscan)
    else:
        on_grid = sampling.pattern != "sampler"
        window = overscan(rays, widest, MOST_OVERSCAN_OF_GRIDS if on_grid else MOST_OVERSCAN)
    if sweep is not None:
        window = window.grown(math.ceil(sweep.reach))
    require_memory(
        memory_of_sampling(
            crop, window, passes.spp, sampling, rays.may_see_images, len(rays.aovs.names)
        ),
        f"sampling {window.width}x{window.height} pixels, {passes.spp} samples each and "
        f"{sampling.refine:.0%} more,",
        "fewer samples (spp), a smaller film or crop windows of it take less",
    )
    fireflies = Fireflies.of(scene, ids, sampling.clamp)
    visible = sample_visible(rays, window, sampling, fireflies)
    radius = _add_hidden(rays, visible, window, widest, sampling.layers, sweep)
    columns = visible.buffer.columns()
    if len(columns) > MOST_KEPT:
        dr.flush_malloc_cache()  # A picture of so many samples needs what Dr.Jit would keep.
    fireflies.clamp_all(columns)
    fireflies.warn(columns, crop)
    return PointSamples(
        **{column.name: getattr(columns, column.name) for column in COLUMNS},
        camera=sensor.camera(),
        lens=sensor.lens(),
        surfaces=surfaces,
        lattice=visible.lattice,
        window=window,
        visibility_radius=radius if columns.visibility is not None else None,
        provenance=provenance_of(integrator, passes, sampling, widest),
        aov_names=rays.aovs.names,
    )


def _add_hidden(
    rays: PrimaryRays,
    visible: VisibleSamples,
    window: Window,
    widest: ThinLens | TelecentricLens,
    layers: int,
    sweep: Sweep | None,
) -> tuple[float, float]:
    """Add to ``visible`` what the widest lens sees behind them and in windows beside them.

    In a ``sweep`` also what it sees at its ends. Returns the half-widths of that lens.
    """
    buffer, paths = visible.buffer, 1 if visible.lattice == 0 else rays.passes.spp
    primary, start = len(buffer), np.empty(0, np.float32)
    lens = LensRays.of(rays, widest, float(buffer.columns().z.min()))
    windows = rays.may_see_images and not lens.telecentric and min(lens.radius) > 0
    seen = None
    if windows:
        first = buffer.columns()
        seen = seen_through(first.x, first.y, rays, lens, which=visible.goes_on)
        del first  # Else there would be two of each column while memory grows.
    if layers > 1:
        chosen = _may_hide(rays, buffer.columns(), seen, window, widest, sweep)
        if len(chosen) > 0:
            start = add_hidden(buffer, chosen, rays, lens, layers, paths, sweep)
        del chosen
    lobes = []
    if seen is not None and rays.may_part_light:
        lobes = part_lobes(buffer, visible.goes_on, seen.through, rays, lens, paths, layers)
    if any(rays.veils):
        split(buffer, primary, rays, paths, lens.parallax if layers > 1 else 0.0)
    if seen is not None and seen.through.any():
        _add_windows(buffer, seen, start, rays, lens)
    del seen
    for lobe in lobes:
        buffer.extend(lobe)
    columns = buffer.columns()
    images = columns.through is not None and columns.through.any()
    if images and layers > 1 and visible.lattice == 0:
        found = seen_elsewhere(rays, lens, window, columns, len(lobes))
        del columns
        for each in found:
            buffer.extend(each)
    if any(rays.veils):  # Some samples stand for others, whose weight is 0.
        buffer.keep(buffer.columns().weight > 0)
    return lens.radius


def _add_windows(
    buffer: SampleBuffer, first: SeenThrough, start: np.ndarray, rays: PrimaryRays, lens: LensRays
) -> None:
    """Add to samples what they are seen through, and which points of the ``lens`` see them.

    ``first`` tells it of the samples that come first. The next begin at ``start`` on their rays,
    and what is behind those are parts of rays that veils have split.
    """
    columns, primary = buffer.columns(), len(first.through)
    x, y = columns.x[primary:], columns.y[primary:]
    begins = np.zeros(len(x), np.float32)
    begins[: len(start)] = start
    rest = seen_through(x, y, rays, lens, begins)
    through, visibility = (
        np.concatenate(pair)
        for pair in ((first.through, rest.through), (first.visibility, rest.visibility))
    )
    depth = np.concatenate([first.depth, rest.depth])
    kept = np.empty(len(columns), dtype=bool)
    for part in parts_of(len(columns)):
        seen, by = through[part], visibility[part]
        # A veil before a window is not seen through it.
        apart = (seen > 0) & ~np.isclose(columns.z[part], depth[part], rtol=SAME_DEPTH, atol=0)
        seen[apart] = by[apart] = 0
        # The pinhole does see what is visible; of the rest there may be what is out of sight.
        unseen, is_visible = (seen > 0) & (by == 0), columns.layer[part] == 0
        by[unseen & is_visible] = 1
        kept[part] = ~unseen | is_visible
    buffer.set("through", through)
    buffer.set("visibility", visibility)
    buffer.keep(kept)


def _may_hide(
    rays: PrimaryRays,
    first: Columns,
    seen: SeenThrough | None,
    window: Window,
    widest: ThinLens | TelecentricLens,
    sweep: Sweep | None,
) -> np.ndarray:
    """Which of the samples ``first``, int (n,), may have something behind them that is seen."""
    camera, lens = rays.sensor.camera(), widest
    if isinstance(lens, TelecentricLens):
        picture = as_thin_lens(first.z, lens, camera)
        first = dataclasses.replace(first, z=picture.depth(first.z))
        lens, camera = picture.lens, picture.camera
    if seen is not None and seen.through.any():
        depth = np.where(seen.through > 0, seen.through, first.z)
        first = dataclasses.replace(first, z=depth)
    return may_hide(first, window, lens, camera, 0.0 if sweep is None else sweep.reach)


def _crop_window(film: mi.Film) -> Window:
    """The film's crop window. Raises ``ValueError`` for a single pixel."""
    crop = Window(*(int(n) for n in (*film.crop_offset(), *film.crop_size())))
    if crop.size == 1:
        raise ValueError("film: its crop window has 1x1 pixels, must have more than one")
    return crop
