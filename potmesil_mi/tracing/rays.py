"""Primary rays: through the pinhole, to what they show and with what radiance."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ..samples.raster import Window
from .aovs import Aovs
from .buffers import Traced
from .clearance import ray_from
from .features import Features
from .onward import alphas_of, may_part_light, may_pass_straight, may_show_images, passes_straight
from .passes import Passes
from .sensor import is_orthographic
from .shapes import registry_index
from .transmission import VeilKinds
from .virtual_depth import Visible, trace_visible

UNITS = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
"""The axes of a camera as Mitsuba has them."""


@dataclasses.dataclass(frozen=True)
class PrimaryRays:
    """The primary rays of one run over a scene.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``scene``                     what is looked at
    ``sensor``                    the ``potmesil`` sensor, through whose pinhole rays go, or the
                                  ``potmesil_orthographic``, whose rays are parallel
    ``integrator``                what gives the radiance
    ``passes``                    where random numbers come from
    ``crop``                      the crop window of the sensor's film
    ``surfaces``                  ids of surfaces by index in Dr.Jit's registry; see
                                  :func:`potmesil_mi.tracing.shapes.surface_ids`
    ``follows_windows``           whether depth is that of images in mirrors and glass
    ``veils``                     whether there are veils, whose samples are told apart
    ``features``                  whether albedo and normal are kept
    ``aovs``                      which AOVs of the integrator are kept
    ============================  ==========================================================
    """

    scene: mi.Scene
    sensor: mi.Sensor
    integrator: mi.SamplingIntegrator
    passes: Passes
    crop: Window
    surfaces: mi.UInt32
    follows_windows: bool
    veils: VeilKinds
    features: bool
    aovs: Aovs

    def trace(self, position: mi.Point2f) -> Traced:
        """Radiance, depth and surface of the rays through ``position``, in pixels of the film.

        The sampler is asked in the order in which Mitsuba's own integrators ask it, so that
        the rays and the radiance are theirs.
        """
        return self.traced(position)[0]

    def traced(self, position: mi.Point2f) -> tuple[Traced, mi.Bool]:
        """The same, and which of the rays go on at what they meet first."""
        ray, ray_weight = self.sampled(position)
        visible = self.visible(mi.Ray3f(ray))
        surface, medium = self.surface_of(visible.hit), self.sensor.get_medium()
        traced = self.shaded(ray, ray_weight, visible.depth, surface, medium, visible.hit)
        return traced, visible.goes_on

    def trace_from(
        self,
        position: mi.Point2f,
        start: mi.Float,
        depth: mi.Float,
        surface: mi.UInt32,
        medium: mi.Medium | None,
    ) -> Traced:
        """Radiance of the rest of the rays through ``position``, from the distance ``start`` on.

        It has the ``depth`` and the ``surface`` that are given; the ray begins in a ``medium``.
        """
        ray, ray_weight = self.sampled(position)
        begin_at(ray, start)
        hit = self.visible(mi.Ray3f(ray)).hit if self.features else None
        return self.shaded(ray, ray_weight, depth, surface, medium, hit, start)

    def sampled(self, position: mi.Point2f) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """The ray through ``position`` and its weight; the sampler gives time and wavelengths."""
        sensor, sampler = self.sensor, self.passes.sampler
        time = sensor.shutter_open()
        if sensor.shutter_open_time() > 0:
            time += sampler.next_1d() * sensor.shutter_open_time()
        wavelength_sample = sampler.next_1d() if mi.is_spectral else mi.Float(0)
        return self.through(position, wavelength_sample, time)

    def through(
        self, position: mi.Point2f, wavelength_sample: mi.Float, time: mi.Float
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """The ray through ``position``, in pixels of the film, and its weight."""
        crop = self.crop
        # Opaque, so that one kernel serves films and sample counts of any size.
        scale = _opaque_pair(1 / crop.width, 1 / crop.height)
        offset = _opaque_pair(-crop.left / crop.width, -crop.top / crop.height)
        ray, weight = self.sensor.sample_ray_differential(
            time, wavelength_sample, dr.fma(position, scale, offset), mi.Point2f(0.5)
        )
        ray.scale_differential(dr.opaque(mi.Float, 1 / math.sqrt(self.passes.spp)))
        return ray, weight

    def begun_at(self, position: mi.Point2f, start: mi.Float | float) -> mi.Ray3f:
        """The rest of the rays through ``position``, from the distance ``start`` on."""
        ray = mi.Ray3f(self.through(position, mi.Float(0.5), self.sensor.shutter_open())[0])
        begin_at(ray, start)
        return ray

    def visible(
        self,
        ray: mi.Ray3f,
        lesser: int | mi.UInt32 | None = None,
        *,
        coherent: bool = True,
    ) -> Visible:
        """What a primary ray shows first: in a mirror or behind glass, if these are followed.

        The ray may begin behind what is nearer. ``lesser`` is as in :func:`trace_visible`.
        ``coherent`` rays, which are traced as packets, are next to their neighbours: for others it
        takes up to three times as long.
        """
        hit = self._first_hit(ray, coherent)
        if not self.follows_windows:
            return Visible.direct(self.depth(hit), hit, ray)
        to_world = self.sensor.world_transform()
        axis = to_world @ mi.Vector3f(0, 0, 1)
        origin = to_world @ mi.Point3f(0)
        if self.parallel:
            # Each point of the film has an axis of its own, from the plane at depth 0.
            axis = dr.normalize(axis)
            origin = ray.o - axis * dr.dot(ray.o - origin, axis)
        return trace_visible(self.scene, origin, ray, hit, axis, alphas=self.alphas, lesser=lesser)

    def axes(self) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        """Unit vectors of the camera in the world: to the left, upwards, and where it looks."""
        to_world = self.sensor.world_transform()
        left, up, axis = (dr.normalize(to_world @ mi.Vector3f(*unit)) for unit in UNITS)
        return left, up, axis

    def depth(self, hit: mi.SurfaceInteraction3f) -> mi.Float:
        """Depth of a hit, along the camera's axis; ``inf`` where nothing was hit."""
        return dr.select(hit.is_valid(), self.depth_of(hit.p), dr.inf)

    def distance(self, ray: mi.Ray3f, depth: mi.Float) -> mi.Float:
        """How far along a primary ray a ``depth`` is, in scene units from the ray's origin."""
        return (depth - self.depth_of(ray.o)) / self._along_axis(ray.d)

    def depth_of(self, point: mi.Point3f) -> mi.Float:
        """Depth of a point of the world."""
        return self._along_axis(point - self.sensor.world_transform() @ mi.Point3f(0))

    def _along_axis(self, step: mi.Vector3f) -> mi.Float:
        """By how much the depth grows along a ``step`` in the world."""
        to_world = self.sensor.world_transform()
        if self.parallel:  # Its axes are scaled.
            return dr.dot(step, dr.normalize(to_world @ mi.Vector3f(0, 0, 1)))
        return (to_world.inverse() @ mi.Vector3f(step)).z

    def surface_of(self, hit: mi.SurfaceInteraction3f) -> mi.UInt32:
        """The id of what was hit; 0 where nothing was."""
        return dr.gather(mi.UInt32, self.surfaces, registry_index(hit), hit.is_valid())

    def shaded(
        self,
        ray: mi.RayDifferential3f,
        ray_weight: mi.Spectrum,
        depth: mi.Float,
        surface: mi.UInt32,
        medium: mi.Medium | None,
        hit: mi.SurfaceInteraction3f | None,
        start: mi.Float | float = 0.0,
    ) -> Traced:
        """Radiance and AOVs along ``ray``, with ``depth`` and ``surface`` of what it shows.

        The ray begins in a ``medium``, or in none. ``hit`` is what it shows, of which features are
        kept; ``None`` where they need not be. ``start`` is how much of the ray is left out.
        """
        radiance, valid, aovs = self._sample(ray, medium)
        features = Features.of(hit)._asdict() if self.features and hit is not None else {}
        return Traced(
            rgb=_to_rgb(radiance * ray_weight, ray.wavelengths),
            alpha=dr.select(valid, mi.Float(1), mi.Float(0)),
            z=depth,
            surface=surface,
            aovs=self.aovs.of_ray(aovs, start),
            **features,
        )

    def aovs_along(self, ray: mi.RayDifferential3f) -> mi.ArrayXf | None:
        """The AOVs of a whole ``ray`` alone."""
        return self.aovs.of_ray(self._sample(ray, self.sensor.get_medium())[2], 0.0)

    def _sample(
        self, ray: mi.RayDifferential3f, medium: mi.Medium | None
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        """What the integrator has of a ``ray`` that begins in a ``medium``."""
        sampler, every = self.passes.sampler, mi.Bool(True)
        sample = mi.SamplingIntegrator.sample
        return sample(self.integrator, self.scene, sampler, ray, medium, every)

    @functools.cached_property
    def parallel(self) -> bool:
        """Whether the rays are parallel: the camera is orthographic."""
        return is_orthographic(self.sensor)

    @functools.cached_property
    def alphas(self) -> mi.Float | None:
        """How rough the surfaces are: :func:`potmesil_mi.tracing.onward.alphas_of` the scene."""
        return alphas_of(self.scene)

    @functools.cached_property
    def may_see_images(self) -> bool:
        """Whether anything may be seen in mirrors or through glass, and its depth is followed."""
        return self.follows_windows and (self.alphas is not None or may_show_images(self.scene))

    @functools.cached_property
    def may_part_light(self) -> bool:
        """Whether glass may part the light of rays, outside of participating media."""
        return self.may_see_images and not self.veils.media and may_part_light(self.scene)

    @functools.cached_property
    def all_block(self) -> bool:
        """Whether every surface blocks what is behind it."""
        return not (self.hides_lamps or (self.follows_windows and may_pass_straight(self.scene)))

    @functools.cached_property
    def hides_lamps(self) -> bool:
        """Whether there are lamps that the integrator does not show."""
        if not self.integrator.hide_emitters:
            return False
        return any(shape.is_emitter() for shape in self.scene.shapes())

    def lets_through(self, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Where one sees through what was hit: panes, holes of masks, lamps that are not shown."""
        passes = self._is_left_out(hit)
        if self.follows_windows:
            passes |= passes_straight(hit, active & ~passes)
        return active & passes

    def _is_left_out(self, hit: mi.SurfaceInteraction3f) -> mi.Bool:
        """Whether the integrator does not show what was hit: a lamp, where it hides lamps."""
        if not self.hides_lamps:
            return mi.Bool(False)
        return hit.is_valid() & hit.shape.is_emitter()

    def _first_hit(self, ray: mi.Ray3f, coherent: bool) -> mi.SurfaceInteraction3f:
        """The surface that the integrator sees first: it may leave out area lights."""
        hit = self.scene.ray_intersect(ray, mi.RayFlags.All, coherent=coherent)
        if not self.hides_lamps:
            return hit

        def step(active: mi.Bool, hit: mi.SurfaceInteraction3f) -> tuple[Any, Any]:
            further = ray_from(hit, ray.d, dr.norm(hit.p - ray.o))
            hit = self.scene.ray_intersect(further, mi.RayFlags.All, coherent, active=active)
            return active & self._is_left_out(hit), hit

        state = (self._is_left_out(hit), hit)
        return dr.while_loop(state, lambda active, _: active, step)[1]


def _opaque_pair(x: float, y: float) -> mi.Vector2f:
    """Two numbers that are variables of a kernel, and no literals in its code."""
    return mi.Vector2f(dr.opaque(mi.Float, x), dr.opaque(mi.Float, y))


def begin_at(ray: mi.Ray3f, start: mi.Float | float) -> None:
    """Move the origin of ``ray`` by the distance ``start`` along it; the end stays."""
    ray.o, ray.maxt = ray.o + start * ray.d, ray.maxt - start


def _to_rgb(radiance: mi.Spectrum, wavelengths: mi.Spectrum) -> mi.Color3f:
    """Radiance in linear sRGB, whatever the variant counts it in."""
    if mi.is_polarized:
        radiance = mi.unpolarized_spectrum(radiance)
    if mi.is_spectral:
        return mi.spectrum_to_srgb(radiance, wavelengths)
    return mi.Color3f(radiance.x) if mi.is_monochromatic else radiance
