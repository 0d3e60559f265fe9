"""Virtual depth: a camera sees the image in a mirror or behind glass, and the image has a depth.

A lens focuses on the image of what a mirror or a window shows, not on the mirror. Primary rays are
followed here to what they show, and with each go two neighbours (H. Igehy, *Tracing ray
differentials*, SIGGRAPH 1999): one starts elsewhere in the lens, the other goes in another
direction. They tell where rays from all over the lens have to aim to meet there too.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from .._validation import require_whole
from .clearance import ray_from
from .shapes import bsdf_flags

BOUNCES = 16
"""Surfaces at which a path goes on, at most. A filled drinking glass has six, before a mirror they
are thirteen; the rest is for light that is reflected within."""

MOST_BOUNCES = 32
"""The kinds of so many surfaces are bits of a number."""

STEP = 1e-3
"""How far from a ray the curvature of a surface is probed, as a share of the ray's length. It is
about the size of a pixel, and far above the error of single precision."""

FLAT = 5e-7
"""Normals a step apart that differ by less differ by the rounding of single precision only."""

CREASE = 0.3
"""Normals a step apart that differ by more lie on two sides of an edge, which is no curvature."""


def has_specular(scene: mi.Scene) -> bool:
    """Whether the scene may have surfaces at which :func:`trace_visible` goes on.

    The flags of the BSDFs decide it, which include the flags of nested ones.
    """
    return bool(_may_go_on(bsdf_flags(scene)).any())


class Visible(NamedTuple):
    """What primary rays show, one element for each, and the chains of surfaces that show it.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``depth``                     depth in scene units along the axis, > 0
    ``hit``                       the surface that is seen, invalid where there is none
    ``first``                     what the ray meets first, a mirror or a pane perhaps
    ``through_window``            whether the chain turned the ray: what is seen is an image, by
                                  reflection or refraction, and ``depth`` is that of the image
    ``last``                      the last ray of the chain, which meets ``hit``. It begins just
                                  behind the last mirror or pane; without any it is the primary
                                  ray
    ``throughput``                this times the radiance that comes along ``last`` is the light
                                  of the chain along the primary ray. It is the product of the
                                  shares of light of the lobes that were followed; in refracting
                                  surfaces these include the change of radiance by eta²
    ``turns``                     how many surfaces of the chain turned the ray. What lets it
                                  pass straight does not count
    ``lobes``                     bit i is set where the i-th of these, from 0, has reflected
                                  the ray; else it has refracted it
    ``spread``                    how far the ray's end moves as the ray is aimed apart: scene
                                  units across the last ray for each at depth 1, without windows
                                  the depth. Where nothing is hit it is the change of direction
    ============================  ==========================================================
    """

    depth: mi.Float
    hit: mi.SurfaceInteraction3f
    first: mi.SurfaceInteraction3f
    through_window: mi.Bool
    last: mi.Ray3f
    throughput: mi.UnpolarizedSpectrum
    turns: mi.UInt32
    lobes: mi.UInt32
    spread: mi.Float

    @classmethod
    def direct(cls, depth: mi.Float, hit: mi.SurfaceInteraction3f, ray: mi.Ray3f) -> Visible:
        """What rays show that are not followed: what they meet first."""
        return cls(
            depth=depth,
            hit=mi.SurfaceInteraction3f(hit),
            first=hit,
            through_window=mi.Bool(False),
            last=ray,
            throughput=mi.UnpolarizedSpectrum(1),
            turns=mi.UInt32(0),
            lobes=mi.UInt32(0),
            spread=dr.select(hit.is_valid(), depth, 1),
        )


class Onward(NamedTuple):
    """How rays go on at what they have hit, one element for each.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``straight``                  whether the ray goes straight on
    ``turns``                     whether it is reflected or refracted instead
    ``reflects``                  whether it is reflected
    ``direction``                 unit direction in which it is reflected or refracted
    ``eta``                       index of refraction beyond the surface over that before it; 1
                                  where the ray is reflected
    ``weight``                    radiance before the surface over that beyond it
    ============================  ==========================================================
    """

    straight: mi.Bool
    turns: mi.Bool
    reflects: mi.Bool
    direction: mi.Vector3f
    eta: mi.Float
    weight: mi.UnpolarizedSpectrum


@dataclasses.dataclass
class _Path:
    """The state of paths that are followed through mirrors and panes, with their neighbours.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``active``                    whether the path may go on
    ``count``                     surfaces at which it went on
    ``turns``, ``lobes``,         as in :class:`Visible`
    ``throughput``
    ``length``                    its length from the pinhole, in scene units
    ``ray``                       its last ray
    ``hit``                       where it is
    ``points``, ``directions``    derivatives of its point and its direction, four each: by the
                                  two coordinates of where it leaves the lens, and by the two at
                                  depth 1 of where it is aimed from there
    ============================  ==========================================================
    """

    active: mi.Bool
    count: mi.UInt32
    turns: mi.UInt32
    lobes: mi.UInt32
    throughput: mi.UnpolarizedSpectrum
    length: mi.Float
    ray: mi.Ray3f
    hit: mi.SurfaceInteraction3f
    points: list[mi.Vector3f]
    directions: list[mi.Vector3f]


def trace_visible(
    scene: mi.Scene,
    origin: mi.Point3f,
    ray: mi.Ray3f,
    hit: mi.SurfaceInteraction3f,
    axis: mi.Vector3f,
    *,
    bounces: int = BOUNCES,
) -> Visible:
    """Depth of what primary rays show, behind at most ``bounces`` mirrors and panes.

    ``origin`` is the pinhole and ``axis`` the unit vector along which it looks, in the world;
    ``ray`` are rays away from it of unit direction, and ``hit`` is what each meets first.

    At a surface the path goes on

    - straight, where at least half of the light passes so (``mask``, ``null``,
      ``thindielectric``), and at a ``dielectric`` that does not refract;
    - reflected or refracted, where the BSDF does nothing but that, as a smooth ``conductor``, a
      ``dielectric``, and a ``thindielectric`` at a grazing angle. Of two such lobes it follows
      the one with more light; where refraction is impossible, the total reflection.

    Anything else ends the path, and so does the front of a lamp: what is glossy or diffuse has
    the depth of its surface.

    The depth is the one, along the axis, to which a thin lens at the pinhole has to be focused
    for the path's end to be sharp:

    - where nothing turned the path, the depth of the last hit, and ``inf`` where nothing was hit;
    - in plane mirrors, the depth of the unfolded path;
    - in curved mirrors and behind glass, the depth of the point from which the light seems to
      come. An astigmatic image has the mean of 1/depth over all directions, since the circle of
      confusion is affine in it. A convex mirror or a ball of glass shows what is infinitely far
      at a finite depth, with an invalid hit;
    - ``inf`` for every image that is no nearer than infinity: its light reaches the lens
      converging, to a point behind it.

    Curvature is that of the shading normals a pixel or so around; bumps turn the path but do
    not count as curvature. Raises ``ValueError`` or ``TypeError`` for bad ``bounces``.
    """
    require_whole("bounces", bounces, 0, MOST_BOUNCES)
    origin, axis = mi.Point3f(origin), mi.Vector3f(axis)
    if not has_specular(scene):
        return Visible.direct(_depth(origin, axis, hit), hit, ray)
    start = _start(origin, ray, hit, axis)
    (end,) = dr.while_loop(
        (start,),
        lambda path: path.active & (path.count < bounces),
        lambda path: (_step(scene, path),),
    )
    through_window = end.turns > 0
    image = _Image.of(end)
    return Visible(
        depth=dr.select(through_window, image.depth(), _depth(origin, axis, end.hit)),
        hit=end.hit,
        first=hit,
        through_window=through_window,
        last=end.ray,
        throughput=end.throughput,
        turns=end.turns,
        lobes=end.lobes,
        spread=image.spread(),
    )


def _start(
    origin: mi.Point3f, ray: mi.Ray3f, hit: mi.SurfaceInteraction3f, axis: mi.Vector3f
) -> _Path:
    """The paths at what the primary rays meet first."""
    across = mi.coordinate_system(axis)
    cosine = dr.dot(ray.d, axis)
    aimed = [cosine * (v - dr.dot(v, ray.d) * ray.d) for v in across]
    length = dr.select(hit.is_valid(), dr.norm(hit.p - origin), 0)
    return _Path(
        active=_is_worth_a_step(hit),
        count=mi.UInt32(0),
        turns=mi.UInt32(0),
        lobes=mi.UInt32(0),
        throughput=mi.UnpolarizedSpectrum(1),
        length=length,
        ray=mi.Ray3f(ray),
        hit=mi.SurfaceInteraction3f(hit),
        points=[mi.Vector3f(v) for v in across] + [length * v for v in aimed],
        directions=[mi.Vector3f(0), mi.Vector3f(0), *aimed],
    )


def _step(scene: mi.Scene, path: _Path) -> _Path:
    """The paths at what they meet next."""
    here = path.hit
    onward = onward_from(here, path.active)
    goes = onward.straight | onward.turns
    points, directions = _turned(scene, path, onward)
    direction = dr.select(onward.turns, onward.direction, path.ray.d)
    ray = ray_from(here, direction, path.length)
    there = scene.ray_intersect(ray, goes)
    step = dr.select(goes & there.is_valid(), dr.norm(there.p - here.p), 0)
    bit = dr.select(onward.turns & onward.reflects, mi.UInt32(1) << path.turns, 0)
    return _Path(
        active=goes & _is_worth_a_step(there),
        count=path.count + dr.select(goes, mi.UInt32(1), mi.UInt32(0)),
        turns=path.turns + dr.select(onward.turns, mi.UInt32(1), mi.UInt32(0)),
        lobes=path.lobes | bit,
        throughput=path.throughput * dr.select(goes, onward.weight, 1),
        length=path.length + step,
        ray=dr.select(goes, ray, path.ray),
        hit=dr.select(goes, there, here),
        points=[p + step * v for p, v in zip(points, directions, strict=True)],
        directions=directions,
    )


def passes_straight(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Where :func:`trace_visible` goes straight on: panes, and what is cut out by a mask."""
    active = active & _is_worth_a_step(hit)
    return active & onward_from(hit, active).straight


def _depth(origin: mi.Point3f, axis: mi.Vector3f, hit: mi.SurfaceInteraction3f) -> mi.Float:
    """Depth of a hit along ``axis``; ``inf`` where nothing was hit."""
    return dr.select(hit.is_valid(), dr.dot(hit.p - origin, axis), dr.inf)


def _only_specular(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, scatters into no more than points."""
    return (flags & (int(mi.BSDFFlags.Smooth) | int(mi.BSDFFlags.Delta1D))) == 0


def _may_go_on(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, may let a path go on."""
    delta = (flags & int(mi.BSDFFlags.Delta)) != 0
    return ((flags & int(mi.BSDFFlags.Null)) != 0) | (delta & _only_specular(flags))


def _is_worth_a_step(hit: mi.SurfaceInteraction3f) -> mi.Bool:
    """Which paths may go on: only their BSDFs are sampled, so that others cost next to nothing."""
    lamp = hit.shape.is_emitter() & (mi.Frame3f.cos_theta(hit.wi) > 0)
    return hit.is_valid() & ~lamp & _may_go_on(hit.bsdf().flags())


def onward_from(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> Onward:
    """How paths go on from ``hit``."""
    bsdf, flags = hit.bsdf(), mi.BSDFFlags
    # Sampled with 1/2, a BSDF of two lobes answers with the greater one.
    sample, weight = bsdf.sample(mi.BSDFContext(), hit, 0.5, mi.Point2f(0.5), active)
    weight = mi.unpolarized_spectrum(weight)
    specular = active & _only_specular(bsdf.flags()) & (dr.max(weight) > 0)
    unbent = mi.has_flag(sample.sampled_type, flags.DeltaTransmission) & (sample.eta == 1)
    straight = specular & (mi.has_flag(sample.sampled_type, flags.Null) | unbent)
    passes = mi.unpolarized_spectrum(bsdf.eval_null_transmission(hit, active))
    null = active & (dr.mean(passes) >= 0.5)
    straight |= null
    return Onward(
        straight=straight,
        turns=specular & ~straight,
        reflects=mi.has_flag(sample.sampled_type, flags.DeltaReflection),
        direction=hit.to_world(sample.wo),
        eta=sample.eta,
        weight=dr.select(null, passes, sample.pdf * weight),
    )


def _turned(
    scene: mi.Scene, path: _Path, onward: Onward
) -> tuple[list[mi.Vector3f], list[mi.Vector3f]]:
    """Derivatives of points and directions behind a mirror or a refracting surface.

    The direction d becomes d/eta + (c/eta - c') n, with c = -d·n and c' = -d'·n of the new
    direction d': Igehy's section 3.1.4. A reflected ray is one of eta = 1 and c' = -c, which is
    his section 3.1.3.
    """
    hit, d, eta, active = path.hit, path.ray.d, onward.eta, onward.turns
    normal = dr.normalize(d - eta * onward.direction)
    normal = dr.mulsign(normal, dr.dot(normal, hit.sh_frame.n))
    cosine, cosine_beyond = -dr.dot(d, normal), -dr.dot(onward.direction, normal)
    along = cosine / eta - cosine_beyond
    along_by_cosine = (1 - cosine / (eta * cosine_beyond)) / eta
    across = mi.coordinate_system(d)
    turns = [_turn(scene, path, v, active) for v in across]
    points, directions = [], []
    for p, v in zip(path.points, path.directions, strict=True):
        turn = dr.dot(p, across[0]) * turns[0] + dr.dot(p, across[1]) * turns[1]
        change = -along_by_cosine * (dr.dot(v, normal) + dr.dot(d, turn))
        v_beyond = v / eta + along * turn + change * normal
        p_on_surface = p - d * (dr.dot(p, hit.n) / dr.dot(d, hit.n))
        points.append(dr.select(active, p_on_surface, p))
        directions.append(dr.select(active, v_beyond, v))
    return points, directions


def _turn(scene: mi.Scene, path: _Path, across: mi.Vector3f, active: mi.Bool) -> mi.Vector3f:
    """Derivative of the surface's normal as a ray moves along ``across``, per scene unit.

    It is measured, for Mitsuba's own is wrong for meshes with texture coordinates. Beyond an edge
    there is nothing to measure; a surface without both neighbours counts as plane.
    """
    hit, d = path.hit, path.ray.d
    step = STEP * path.length
    back = hit.p - d * dr.minimum(20 * step, 0.9 * hit.t)
    change, width = mi.Vector3f(0), mi.Float(0)
    for sign in (-1, 1):
        probe = mi.Ray3f(back + sign * step * across, d, hit.time, hit.wavelengths)
        there = scene.ray_intersect(probe, active)
        turned = there.sh_frame.n - hit.sh_frame.n
        same = active & there.is_valid() & (dr.norm(turned) < CREASE)
        same &= (there.shape == hit.shape) & (there.instance == hit.instance)
        change += dr.select(same, sign * turned, 0)
        width += dr.select(same, step, 0)
    return dr.select((width > 0) & (dr.norm(change) > FLAT), change / width, 0)


class _Image(NamedTuple):
    """How the ends of paths move across their last rays, one element for each path.

    A ray that leaves the lens do away, and is aimed dm apart at depth 1, ends dQ = A do + B dm
    away. Where nothing is hit, Q is the direction. ``a`` and ``b`` are A and B, by rows.
    """

    a: tuple[mi.Float, mi.Float, mi.Float, mi.Float]
    b: tuple[mi.Float, mi.Float, mi.Float, mi.Float]

    @classmethod
    def of(cls, path: _Path) -> _Image:
        """That of the path's end."""
        far = ~path.hit.is_valid()
        ends = [dr.select(far, v, p) for p, v in zip(path.points, path.directions, strict=True)]
        u, v = ([dr.dot(e, w) for e in ends] for w in mi.coordinate_system(path.ray.d))
        return cls(a=(u[0], u[1], v[0], v[1]), b=(u[2], u[3], v[2], v[3]))

    def depth(self) -> mi.Float:
        """Depth to which rays from the whole lens have to be aimed to meet at the path's end.

        Rays that meet have dm = -B^-1 A do; they pass the image, at depth z, where
        do + z dm = 0. So 1/z is an eigenvalue of B^-1 A, and the mean of both is half its trace.
        """
        (a00, a01, a10, a11), (b00, b01, b10, b11) = self.a, self.b
        depth = 2 * (b00 * b11 - b01 * b10) / (b11 * a00 - b01 * a10 - b10 * a01 + b00 * a11)
        return dr.select(depth > 0, depth, dr.inf)

    def spread(self) -> mi.Float:
        """How far the end moves for each dm: the root mean square over its directions."""
        return dr.sqrt(sum(b * b for b in self.b) / 2)
