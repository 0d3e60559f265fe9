"""Rays between the points of a lens and the surfaces: which surfaces does the lens see at all?

A shadow ray answers it, whatever the surface is a part of: nothing is known of shapes here.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from ..optics.blur import widest_radius_per_vergence
from ..optics.disc import lens_points
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from .clearance import clearance
from .rays import PrimaryRays

LENS_POINTS = 32
"""Points of the lens from which a surface is looked at before it is said to be out of sight."""

TURN = round((5**0.5 - 1) / 2 * 2**32)
"""By how much of a turn of 2**32 the points of one ray are turned against those of the one before:
the golden section, which leaves no pattern."""


@dataclasses.dataclass(frozen=True)
class LensRays:
    """Rays from all over a round lens at the pinhole.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``rays``                      those of the pinhole, with the scene
    ``origin``                    the pinhole; of a telecentric lens any point of the plane at
                                  depth 0
    ``axis``                      unit vector along which depth is counted
    ``across``                    unit vectors to the right and downwards
    ``radius``                    half-widths of the lens along ``across`` in scene units; of a
                                  telecentric lens the slope of the outermost rays to the axis
    ``telecentric``               whether rays meet the plane at depth 0 anywhere
    ``clip``                      depths at which rays begin and end
    ============================  ==========================================================
    """

    rays: PrimaryRays
    origin: mi.Point3f
    axis: mi.Vector3f
    across: tuple[mi.Vector3f, mi.Vector3f]
    radius: tuple[float, float]
    telecentric: bool
    clip: tuple[float, float]

    @classmethod
    def of(cls, rays: PrimaryRays, lens: ThinLens | TelecentricLens, nearest: float) -> LensRays:
        """Those of ``lens`` at the pinhole of ``rays``, at the focus where it is widest.

        It may be focused from depth ``nearest`` on.
        """
        sensor, camera = rays.sensor, rays.sensor.camera()
        to_world = sensor.world_transform()
        if isinstance(lens, TelecentricLens):
            width = height = lens.slope
        else:
            height = widest_radius_per_vergence(lens, camera, nearest) / camera.focal_length_pixels
            width = height / lens.squeeze
        x, y, z = (dr.normalize(to_world @ mi.Vector3f(*unit)) for unit in np.eye(3).tolist())
        return cls(
            rays=rays,
            origin=to_world @ mi.Point3f(0),
            axis=z,
            across=(x, y),
            radius=(float(width), float(height)),
            telecentric=isinstance(lens, TelecentricLens),
            clip=(float(camera.near_clip), float(camera.far_clip)),
        )

    def see(self, ray: mi.Ray3f, hit: mi.SurfaceInteraction3f, number: mi.UInt32) -> mi.Bool:
        """Whether any point of the lens sees what ``ray`` of the pinhole meets at ``hit``.

        It is to see the side that the ray meets; the sky in the direction of ``ray`` where that
        meets nothing. ``number`` is that of the ray, for which the points are turned.
        """
        u, v = (from_numpy(mi.Float, column) for column in lens_points(LENS_POINTS).T)
        sine, cosine = dr.sincos(mi.Float(number * TURN) * (2 * dr.pi / 2**32))
        width, height = (dr.opaque(mi.Float, half) for half in self.radius)
        side = dr.dot(hit.n, ray.d)

        def look(active: mi.Bool, number: mi.UInt32) -> tuple[mi.Bool, mi.UInt32]:
            x, y = dr.gather(mi.Float, u, number, active), dr.gather(mi.Float, v, number, active)
            x, y = cosine * x - sine * y, sine * x + cosine * y
            from_lens = self._towards(ray, hit, x * width, y * height)
            same_side = (dr.dot(hit.n, from_lens.d) * side > 0) | ~hit.is_valid()
            sees = same_side & ~self._is_blocked(from_lens, active & same_side)
            return active & ~sees, number + 1

        left, _ = dr.while_loop(
            (dr.full(mi.Bool, True, dr.width(ray.d)), mi.UInt32(0)),
            lambda active, number: active & (number < LENS_POINTS),
            look,
        )
        return ~left

    def _towards(
        self, ray: mi.Ray3f, hit: mi.SurfaceInteraction3f, u: mi.Float, v: mi.Float
    ) -> mi.Ray3f:
        """The ray from the point (u, v) of the lens to ``hit``, or along ``ray`` to the sky."""
        step = u * self.across[0] + v * self.across[1]
        if self.telecentric:
            # It comes along its slope from the plane at depth 0.
            start = ray.o - self.axis * dr.dot(ray.o - self.origin, self.axis)
            depth = dr.dot(hit.p - self.origin, self.axis)
            start = dr.select(hit.is_valid(), hit.p - depth * (self.axis + step), start)
            onward = dr.normalize(self.axis + step)
        else:
            start, onward = self.origin + step, ray.d
        apart = hit.p - start
        length = dr.norm(apart)
        direction = dr.select(hit.is_valid(), apart / length, onward)
        near, far = (depth / dr.dot(direction, self.axis) for depth in self.clip)
        result = mi.Ray3f(start + near * direction, direction, ray.time, ray.wavelengths)
        end = dr.select(hit.is_valid(), length - clearance(hit, length), far)
        result.maxt = dr.maximum(end - near, 0)
        return result

    def _is_blocked(self, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
        """Whether anything lies on ``ray``."""
        if self.rays.all_block:
            return self.rays.scene.ray_test(ray, active)

        def step(
            going: mi.Bool, blocked: mi.Bool, ray: mi.Ray3f
        ) -> tuple[mi.Bool, mi.Bool, mi.Ray3f]:
            hit = self.rays.scene.ray_intersect(ray, going)
            meets = going & hit.is_valid()
            passes = self.rays.lets_through(hit, meets)
            passed = hit.t + clearance(hit, hit.t)
            ray = mi.Ray3f(ray)
            ray.o = dr.select(passes, ray.o + passed * ray.d, ray.o)
            ray.maxt = dr.select(passes, ray.maxt - passed, ray.maxt)
            return passes & (ray.maxt > 0), blocked | (meets & ~passes), ray

        state = (mi.Bool(active), mi.Bool(False), mi.Ray3f(ray))
        return dr.while_loop(state, lambda going, *_: going, step)[1]
