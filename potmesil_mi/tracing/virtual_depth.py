"""Virtual depth: a camera sees the image in a mirror or behind a pane, and the image has a depth.

A lens focuses on the image of what a mirror shows, not on the mirror. Primary rays are followed
here to what they show, and with each go two neighbours (H. Igehy, *Tracing ray differentials*,
SIGGRAPH 1999): one starts elsewhere in the lens, the other goes in another direction. They tell
where rays from all over the lens have to aim to meet there too.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from .._validation import require_whole
from .clearance import ray_from
from .shapes import bsdf_flags

STEP = 1e-3
"""How far from a ray the curvature of a mirror is probed, as a share of the ray's length. It is
about the size of a pixel, and far above the error of single precision."""

FLAT = 5e-7
"""Normals a step apart that differ by less differ by the rounding of single precision only."""

LEAST_THROUGH = 1 / 256
"""What lets less of the light through hides what is behind it, and what keeps less back is not
there."""

CREASE = 0.3
"""Normals a step apart that differ by more lie on two sides of an edge, which is no curvature."""


def has_specular(scene: mi.Scene) -> bool:
    """Whether the scene may have surfaces at which :func:`trace_visible` goes on.

    The flags of the BSDFs decide it, which include the flags of nested ones.
    """
    return bool(_may_go_on(bsdf_flags(scene)).any())


class Visible(NamedTuple):
    """What primary rays show, one element for each.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``depth``                     depth in scene units along the axis, > 0
    ``hit``                       the surface that is seen, invalid where there is none
    ``mirrored``                  whether it is seen in a mirror
    ``first``                     what the ray meets first, a mirror or a pane perhaps
    ============================  ==========================================================
    """

    depth: mi.Float
    hit: mi.SurfaceInteraction3f
    mirrored: mi.Bool
    first: mi.SurfaceInteraction3f


@dataclasses.dataclass
class _Path:
    """The state of paths that are followed through mirrors and panes, with their neighbours.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``active``                    whether the path may go on
    ``count``                     surfaces at which it went on
    ``mirrored``                  whether a mirror turned it
    ``length``                    its length from the pinhole, in scene units
    ``direction``                 its unit direction
    ``hit``                       where it is
    ``points``, ``directions``    derivatives of its point and its direction, four each: by the
                                  two coordinates of where it leaves the lens, and by the two at
                                  depth 1 of where it is aimed from there
    ============================  ==========================================================
    """

    active: mi.Bool
    count: mi.UInt32
    mirrored: mi.Bool
    length: mi.Float
    direction: mi.Vector3f
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
    bounces: int = 8,
) -> Visible:
    """Depth of what primary rays show, behind at most ``bounces`` mirrors and panes.

    ``origin`` is the pinhole and ``axis`` the unit vector along which it looks, in the world;
    ``ray`` are rays away from it of unit direction, and ``hit`` is what each meets first.

    At a surface the path goes on

    - straight, where any of the light passes so (``mask``, ``null``), behind a mirror and through
      glass (``thindielectric``) where at least half does, and at a ``dielectric`` that does not
      refract;
    - in the mirror's direction, where the BSDF does nothing but reflect as a mirror (also one
      that lets a smaller half pass, like a ``thindielectric`` at a grazing angle).

    Anything else ends the path, and so does the front of a lamp: what is refracted, glossy or
    diffuse has the depth of its surface.

    The depth is the one, along the axis, to which a thin lens at the pinhole has to be focused
    for the path's end to be sharp:

    - without a mirror, the depth of the last hit, and ``inf`` where nothing was hit;
    - in plane mirrors, the depth of the unfolded path;
    - in a curved mirror, the depth of the point from which the light seems to come. An
      astigmatic mirror has the mean of 1/depth over all directions, since the circle of
      confusion is affine in it. A convex mirror shows what is infinitely far at a finite depth,
      with an invalid hit;
    - ``inf`` for every image that is no nearer than infinity: its light reaches the lens
      converging, to a point behind it.

    Curvature is that of the shading normals a pixel or so around; bumps turn the path but do
    not count as curvature. Raises ``ValueError`` or ``TypeError`` for bad ``bounces``.
    """
    require_whole("bounces", bounces, 0, 2**16)
    origin, axis = mi.Point3f(origin), mi.Vector3f(axis)
    if not has_specular(scene):
        return Visible(_depth(origin, axis, hit), mi.SurfaceInteraction3f(hit), mi.Bool(False), hit)
    start = _start(origin, ray, hit, axis)
    (end,) = dr.while_loop(
        (start,),
        lambda path: path.active & (path.count < bounces),
        lambda path: (_step(scene, path),),
    )
    depth = dr.select(end.mirrored, _image_depth(end), _depth(origin, axis, end.hit))
    return Visible(depth, end.hit, end.mirrored, hit)


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
        mirrored=mi.Bool(False),
        length=length,
        direction=mi.Vector3f(ray.d),
        hit=mi.SurfaceInteraction3f(hit),
        points=[mi.Vector3f(v) for v in across] + [length * v for v in aimed],
        directions=[mi.Vector3f(0), mi.Vector3f(0), *aimed],
    )


def _step(scene: mi.Scene, path: _Path) -> _Path:
    """The paths at what they meet next."""
    here = path.hit
    straight, mirror, reflected = _onward(here, path.active, path.mirrored)
    goes = straight | mirror
    points, directions = _reflected(scene, path, reflected, mirror)
    direction = dr.select(mirror, reflected, path.direction)
    there = scene.ray_intersect(ray_from(here, direction, path.length), goes)
    step = dr.select(goes & there.is_valid(), dr.norm(there.p - here.p), 0)
    return _Path(
        active=goes & _is_worth_a_step(there),
        count=path.count + dr.select(goes, mi.UInt32(1), mi.UInt32(0)),
        mirrored=path.mirrored | mirror,
        length=path.length + step,
        direction=direction,
        hit=dr.select(goes, there, here),
        points=[p + step * v for p, v in zip(points, directions, strict=True)],
        directions=directions,
    )


def passes_straight(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Where :func:`trace_visible` goes straight on: panes, masks where they are not opaque."""
    active = active & _is_worth_a_step(hit)
    return active & _onward(hit, active, mi.Bool(False))[0]


def is_veil(hit: mi.SurfaceInteraction3f, through: mi.Float) -> mi.Bool:
    """Where a surface that lets ``through`` a part of the light is seen itself, too.

    The image in a pane of glass is not in the pane.
    """
    return (through < 1 - LEAST_THROUGH) & may_be_veil(hit.bsdf().flags())


def may_be_veil(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, may be half transparent."""
    null, glass = (flags & int(mi.BSDFFlags.Null)) != 0, _may_be_glass(flags)
    return null & ~glass & ~_only_null(flags)


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


def _only_null(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, does nothing but let light through."""
    delta = mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission
    return _only_specular(flags) & ((flags & int(delta)) == 0)


def _may_be_glass(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, may show images as glass does."""
    return _only_specular(flags) & ~_only_null(flags)


def _onward(
    hit: mi.SurfaceInteraction3f, active: mi.Bool, mirrored: mi.Bool
) -> tuple[mi.Bool, mi.Bool, mi.Vector3f]:
    """Where the path goes straight on, where it is mirrored, and the mirrored direction.

    ``mirrored`` is whether it has been before.
    """
    bsdf, flags = hit.bsdf(), mi.BSDFFlags
    kinds = bsdf.flags()
    # Sampled with 1/2, a BSDF of two lobes answers with the greater one.
    sample, weight = bsdf.sample(mi.BSDFContext(), hit, 0.5, mi.Point2f(0.5), active)
    specular = active & _only_specular(kinds)
    specular &= dr.max(mi.unpolarized_spectrum(weight)) > 0
    unbent = mi.has_flag(sample.sampled_type, flags.DeltaTransmission) & (sample.eta == 1)
    straight = specular & (mi.has_flag(sample.sampled_type, flags.Null) | unbent)
    passes = mi.unpolarized_spectrum(bsdf.eval_null_transmission(hit, active))
    half = mirrored | _may_be_glass(kinds)
    straight |= active & (dr.mean(passes) >= dr.select(half, 0.5, LEAST_THROUGH))
    mirror = specular & ~straight & ~mi.has_flag(kinds, flags.DeltaTransmission)
    return straight, mirror, hit.to_world(sample.wo)


def _reflected(
    scene: mi.Scene, path: _Path, reflected: mi.Vector3f, active: mi.Bool
) -> tuple[list[mi.Vector3f], list[mi.Vector3f]]:
    """Derivatives of points and directions behind the mirror (Igehy, section 3.1.3)."""
    hit, d = path.hit, path.direction
    normal = dr.normalize(reflected - d)
    normal = dr.mulsign(normal, dr.dot(normal, hit.sh_frame.n))
    across = mi.coordinate_system(d)
    turns = [_turn(scene, path, v, active) for v in across]
    points, directions = [], []
    for p, v in zip(path.points, path.directions, strict=True):
        turn = dr.dot(p, across[0]) * turns[0] + dr.dot(p, across[1]) * turns[1]
        toward = dr.dot(v, normal) + dr.dot(d, turn)
        v_reflected = v - 2 * (toward * normal + dr.dot(d, normal) * turn)
        p_on_mirror = p - d * (dr.dot(p, hit.n) / dr.dot(d, hit.n))
        points.append(dr.select(active, p_on_mirror, p))
        directions.append(dr.select(active, v_reflected, v))
    return points, directions


def _turn(scene: mi.Scene, path: _Path, across: mi.Vector3f, active: mi.Bool) -> mi.Vector3f:
    """Derivative of the mirror's normal as a ray moves along ``across``, per scene unit.

    It is measured, for Mitsuba's own is wrong for meshes with texture coordinates. Beyond an edge
    there is nothing to measure; a mirror without both neighbours counts as plane.
    """
    hit, d = path.hit, path.direction
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


def _image_depth(path: _Path) -> mi.Float:
    """Depth to which rays from the whole lens have to be aimed to meet at the path's end.

    A ray that leaves the lens do away, and is aimed dm apart at depth 1, ends dQ = A do + B dm
    away. Rays that meet have dm = -B^-1 A do; they pass the image, at depth z, where
    do + z dm = 0. So 1/z is an eigenvalue of B^-1 A, and the mean of both is half its trace.
    """
    basis = mi.coordinate_system(path.direction)
    far = ~path.hit.is_valid()
    ends = [dr.select(far, v, p) for p, v in zip(path.points, path.directions, strict=True)]
    (a00, a01, b00, b01), (a10, a11, b10, b11) = ([dr.dot(e, v) for e in ends] for v in basis)
    depth = 2 * (b00 * b11 - b01 * b10) / (b11 * a00 - b01 * a10 - b10 * a01 + b00 * a11)
    return dr.select(depth > 0, depth, dr.inf)
