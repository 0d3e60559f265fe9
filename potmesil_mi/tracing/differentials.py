"""Ray differentials: neighbours of a ray on its way by mirrors and through glass.

With a ray go two kinds of neighbours (H. Igehy, *Tracing ray differentials*, SIGGRAPH 1999): some
start elsewhere in the lens, the others go in another direction. They tell where what the ray ends
at has its image.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

STEP = 1e-3
"""How far from a ray the curvature of a surface is probed, as a share of the ray's length. It is
about the size of a pixel, and far above the error of single precision."""

FLAT = 5e-7
"""Normals a step apart that differ by less differ by the rounding of single precision only."""

CREASE = 0.3
"""Normals a step apart that differ by more lie on two sides of an edge, which is no curvature."""


@dataclasses.dataclass
class Differentials:
    """Derivatives of rays' points and directions, four each, one element for each ray.

    They are taken by the two coordinates of where the ray leaves the lens, and by the two at
    depth 1 of where it is aimed from there.
    """

    points: list[mi.Vector3f]
    directions: list[mi.Vector3f]

    @classmethod
    def of_lens(cls, axis: mi.Vector3f, d: mi.Vector3f) -> Differentials:
        """Those of rays of unit direction ``d`` in the lens, which looks along ``axis``."""
        across = mi.coordinate_system(axis)
        aimed = [dr.dot(d, axis) * (v - dr.dot(v, d) * d) for v in across]
        zero = mi.Vector3f(0)
        return cls([*(mi.Vector3f(v) for v in across), zero, zero], [zero, zero, *aimed])

    def moved(self, step: mi.Float) -> Differentials:
        """Those of the rays after ``step`` scene units."""
        points = [p + step * v for p, v in zip(self.points, self.directions, strict=True)]
        return Differentials(points, self.directions)

    def turned(
        self,
        scene: mi.Scene,
        hit: mi.SurfaceInteraction3f,
        d: mi.Vector3f,
        length: mi.Float,
        direction: mi.Vector3f,
        eta: mi.Float,
        active: mi.Bool,
    ) -> Differentials:
        """Those of rays that go on from ``hit`` in the unit vector ``direction``.

        ``length`` is that of the rays up to there, ``eta`` the index of refraction beyond the
        surface over that before it, 1 for a mirror. Where not ``active`` they stay what they are.

        The direction d becomes d' = d/eta + (c/eta - c') n, with c = -d·n and c' = -d'·n: Igehy's
        section 3.1.4. For eta = 1 and c' = -c this is a reflected ray, his section 3.1.3.
        """
        normal = dr.normalize(d - eta * direction)
        normal = dr.mulsign(normal, dr.dot(normal, hit.sh_frame.n))
        before, beyond = -dr.dot(d, normal), -dr.dot(direction, normal)
        factor = before / eta - beyond
        factor_by_before = (1 - before / (eta * beyond)) / eta
        across = mi.coordinate_system(d)
        turns = _turns(scene, hit, d, length, across, active)
        points, directions = [], []
        for p, v in zip(self.points, self.directions, strict=True):
            turn = dr.dot(p, across[0]) * turns[0] + dr.dot(p, across[1]) * turns[1]
            change = -factor_by_before * (dr.dot(v, normal) + dr.dot(d, turn))
            v_beyond = v / eta + factor * turn + change * normal
            p_on_surface = p - d * (dr.dot(p, hit.n) / dr.dot(d, hit.n))
            points.append(dr.select(active, p_on_surface, p))
            directions.append(dr.select(active, v_beyond, v))
        return Differentials(points, directions)

    def transfer(self, d: mi.Vector3f, met: mi.Bool) -> RayTransfer:
        """How the ends of rays of unit direction ``d`` move; they are in the sky unless ``met``."""
        ends = [dr.select(met, p, v) for p, v in zip(self.points, self.directions, strict=True)]
        u, v = ([dr.dot(e, w) for e in ends] for w in mi.coordinate_system(d))
        return RayTransfer(a=(u[0], u[1], v[0], v[1]), b=(u[2], u[3], v[2], v[3]))


class RayTransfer(NamedTuple):
    """How the ends of rays move across the rays, a ray transfer matrix for each.

    A ray that leaves the lens do away, and is aimed dm apart at depth 1, ends dQ = A do + B dm
    away. In the sky, Q is the direction. ``a`` and ``b`` are A and B, by rows.
    """

    a: tuple[mi.Float, mi.Float, mi.Float, mi.Float]
    b: tuple[mi.Float, mi.Float, mi.Float, mi.Float]

    def image_depth(self) -> mi.Float:
        """Depth to which rays from the whole lens have to be aimed to meet at the end.

        Rays that meet have dm = -B^-1 A do; they pass the image, at depth z, where
        do + z dm = 0. So 1/z is an eigenvalue of B^-1 A, and the mean of both is half its trace.
        """
        (a00, a01, a10, a11), (b00, b01, b10, b11) = self.a, self.b
        depth = 2 * (b00 * b11 - b01 * b10) / (b11 * a00 - b01 * a10 - b10 * a01 + b00 * a11)
        return dr.select(depth > 0, depth, dr.inf)

    def spread(self) -> mi.Float:
        """How far the end moves for each dm: the root mean square over its directions."""
        return dr.sqrt(sum(b * b for b in self.b) / 2)


def _turns(
    scene: mi.Scene,
    hit: mi.SurfaceInteraction3f,
    d: mi.Vector3f,
    length: mi.Float,
    across: tuple[mi.Vector3f, mi.Vector3f],
    active: mi.Bool,
) -> list[mi.Vector3f]:
    """Derivatives of the normal at ``hit`` as a ray moves along each of ``across``, per scene unit.

    They are measured, for Mitsuba's own are wrong for meshes with texture coordinates. Beyond an
    edge there is nothing to measure; a surface without both neighbours counts as plane.
    """
    step = STEP * length
    back = hit.p - d * dr.minimum(20 * step, 0.9 * hit.t)

    # A loop: to record what a ray may meet takes long where there are many shapes.
    def probe(number: mi.UInt32, changes: list, widths: list) -> tuple[mi.UInt32, list, list]:
        first, sign = number < 2, 1 - 2 * mi.Float(number & 1)
        aside = dr.select(first, *across)
        ray = mi.Ray3f(back + sign * step * aside, d, hit.time, hit.wavelengths)
        there = scene.ray_intersect(ray, active)
        turned = mi.Vector3f(there.sh_frame.n - hit.sh_frame.n)
        same = active & there.is_valid() & (dr.norm(turned) < CREASE)
        same &= (there.shape == hit.shape) & (there.instance == hit.instance)
        along = same & first, same & ~first
        changes = [
            c + dr.select(on, sign * turned, 0) for c, on in zip(changes, along, strict=True)
        ]
        widths = [w + dr.select(on, step, 0) for w, on in zip(widths, along, strict=True)]
        return number + 1, changes, widths

    state = mi.UInt32(0), [mi.Vector3f(0) for _ in across], [mi.Float(0) for _ in across]
    _, changes, widths = dr.while_loop(state, lambda number, *_: number < 4, probe)
    return [
        dr.select((width > 0) & (dr.norm(change) > FLAT), change / width, 0)
        for change, width in zip(changes, widths, strict=True)
    ]
