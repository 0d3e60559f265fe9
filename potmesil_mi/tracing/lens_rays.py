"""Rays between the points of a lens and the surfaces: which surfaces does the lens see at all?

A shadow ray answers it, whatever the surface is a part of: nothing is known of shapes here.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi

from .._backend import from_numpy
from ..optics.blur import widest_radius_per_vergence
from ..optics.disc import lens_points
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from .clearance import clearance
from .rays import PrimaryRays

LENS_POINTS = 16
"""Points of the lens from which a surface is looked at before it is said to be out of sight."""

TURN = round((5**0.5 - 1) / 2 * 2**32)
"""By how much of a turn of 2**32 the points of one ray are turned against those of the one before:
the golden section, which leaves no pattern."""


STRIDE = 4
"""So many points further on is the next that is looked from: it is as far out, or farther."""


@dataclasses.dataclass
class Target:
    """What primary rays meet, one element for each.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``point``                     where it is; where nothing is met, a point of the ray
    ``normal``                    its unit normal
    ``direction``                 unit direction of the ray; a point of the lens must see the
                                  same side of a surface
    ``met``                       whether there is a surface; else the sky is to be seen in the
                                  direction of the ray
    ``number``                    number of the ray, for which the points of the lens are turned
    ============================  ==========================================================
    """

    point: mi.Point3f
    normal: mi.Normal3f
    direction: mi.Vector3f
    met: mi.Bool
    number: mi.UInt32


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
    ``across``                    unit vectors to the left and upwards
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
    clip: tuple[mi.Float, mi.Float]

    @classmethod
    def of(cls, rays: PrimaryRays, lens: ThinLens | TelecentricLens, nearest: float) -> LensRays:
        """Those of ``lens`` at the pinhole of ``rays``, at the focus where it is widest.

        It may be focused from depth ``nearest`` on.
        """
        sensor, camera = rays.sensor, rays.sensor.camera()
        if isinstance(lens, TelecentricLens):
            width = height = lens.slope
        else:
            height = widest_radius_per_vergence(lens, camera, nearest) / camera.focal_length_pixels
            width = height / lens.squeeze
        *across, axis = rays.axes()
        return cls(
            rays=rays,
            origin=sensor.world_transform() @ mi.Point3f(0),
            axis=axis,
            across=(across[0], across[1]),
            radius=(float(width), float(height)),
            telecentric=isinstance(lens, TelecentricLens),
            clip=(dr.opaque(mi.Float, camera.near_clip), dr.opaque(mi.Float, camera.far_clip)),
        )

    @property
    def parallax(self) -> float:
        """Pixels by which things move as one looks from the lens's rim, per unit of vergence.

        Of a telecentric lens it is per unit of depth.
        """
        camera = self.rays.sensor.camera()
        scale = camera.pixels_per_unit if self.telecentric else camera.focal_length_pixels
        return max(self.radius) * scale

    def see(self, target: Target, first: mi.UInt32, end: mi.UInt32) -> mi.Bool:
        """Whether any of the points from ``first`` to before ``end`` sees each target, bool (N,).

        Each target has an order of its own of all ``LENS_POINTS`` of them.
        """
        width, height = (dr.opaque(mi.Float, half) for half in self.radius)
        side = dr.dot(target.normal, target.direction)

        def look(active: mi.Bool, step: mi.UInt32) -> tuple[mi.Bool, mi.UInt32]:
            x, y = lens_point(target.number, step, active)
            ray = self._towards(target, x * width, y * height)
            same_side = (dr.dot(target.normal, ray.d) * side > 0) | ~target.met
            sees = same_side & ~self._is_blocked(ray, active & same_side)
            return active & ~sees, step + 1

        state = dr.full(mi.Bool, True, dr.width(target)), mi.UInt32(first)
        left, _ = dr.while_loop(state, lambda active, step: active & (step < end), look)
        return ~left

    def _towards(self, target: Target, u: mi.Float, v: mi.Float) -> mi.Ray3f:
        """The ray from the point (u, v) of the lens to ``target``."""
        step = u * self.across[0] + v * self.across[1]
        if self.telecentric:
            # It comes along its slope from the plane at depth 0.
            slope = dr.select(target.met, self.axis + step, self.axis)
            start = target.point - dr.dot(target.point - self.origin, self.axis) * slope
            onward = dr.normalize(self.axis + step)
        else:
            start, onward = self.origin + step, target.direction
        apart = target.point - start
        length = dr.norm(apart)
        direction = dr.select(target.met, apart / length, onward)
        near, far = (depth / dr.dot(direction, self.axis) for depth in self.clip)
        result = mi.Ray3f(start + near * direction, direction)
        end = dr.select(target.met, length - clearance(target.point, length), far)
        result.maxt = dr.maximum(end - near, 0)
        return result

    def _is_blocked(self, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
        """Whether anything lies on ``ray``."""
        if self.rays.all_block:
            return self.rays.scene.ray_test(ray, active=active)

        def step(
            going: mi.Bool, blocked: mi.Bool, ray: mi.Ray3f
        ) -> tuple[mi.Bool, mi.Bool, mi.Ray3f]:
            hit = self.rays.scene.ray_intersect(ray, active=going)
            meets = going & hit.is_valid()
            passes = self.rays.lets_through(hit, meets)
            passed = hit.t + clearance(hit.p, hit.t)
            ray = mi.Ray3f(ray)
            ray.o = dr.select(passes, ray.o + passed * ray.d, ray.o)
            ray.maxt = dr.select(passes, ray.maxt - passed, ray.maxt)
            return passes & (ray.maxt > 0), blocked | (meets & ~passes), ray

        state = (mi.Bool(active), mi.Bool(False), mi.Ray3f(ray))
        return dr.while_loop(state, lambda going, *_: going, step)[1]


def lens_point(
    number: mi.UInt32, step: mi.UInt32, active: mi.Bool | bool = True
) -> tuple[mi.Float, mi.Float]:
    """From where the target of a ``number`` is looked at in a ``step``, in radii of the lens.

    Each target begins with other points, from the middle of the lens to its rim, and has an order
    of its own of all ``LENS_POINTS`` of them.
    """
    u, v = (from_numpy(mi.Float, column) for column in lens_points(LENS_POINTS).T)
    point = (step * STRIDE + step // (LENS_POINTS // STRIDE) + number) % LENS_POINTS
    x, y = dr.gather(mi.Float, u, point, active), dr.gather(mi.Float, v, point, active)
    # Backwards: a point is as far on from the one before it as the next target would be turned.
    sine, cosine = dr.sincos(mi.Float(number * TURN) * (-2 * dr.pi / 2**32))
    return cosine * x - sine * y, sine * x + cosine * y
