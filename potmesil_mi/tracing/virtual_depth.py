"""How deep things are that a camera sees in mirrors and through panes: the depth of the image.

A lens focuses on the image of what a mirror shows, not on the mirror. Here the primary rays are
followed to what they show, and two neighbours of each along with them (H. Igehy, *Tracing ray
differentials*, SIGGRAPH 1999): one that starts elsewhere in the lens and one in another
direction. They tell where rays from all over the lens have to aim to meet there too.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .._validation import require_whole

STEP = 1e-3
"""How far from a ray the curvature of mirrors is probed, as a share of the ray's length: the
size of a pixel or so, and far above the error of single precision."""

FLAT, CREASE = 5e-7, 0.3
"""Normals a step apart that differ by less are the same but for the rounding of single precision,
by more those of an edge and no curvature."""


def has_specular(scene: mi.Scene) -> bool:
    """Whether the scene may have surfaces that :func:`seen` follows rays at.

    Decided on the host from the flags of the BSDFs, which include those of what is nested in
    them. An instance, which does not tell what it is made of, counts as one.
    """
    return any(
        shape.class_name() == "Instance"
        or (shape.bsdf() is not None and _may_go_on(shape.bsdf().flags()))
        for shape in scene.shapes()
    )


def seen(
    scene: mi.Scene,
    origin: mi.Point3f,
    ray: mi.Ray3f,
    hit: mi.SurfaceInteraction3f,
    axis: mi.Vector3f,
    *,
    bounces: int = 8,
) -> tuple[mi.Float, mi.SurfaceInteraction3f, mi.Bool]:
    """Depth of what primary rays show, mirrors and panes followed up to ``bounces`` of them.

    ``origin`` is the pinhole and ``axis`` the unit vector along which it looks, in the world;
    ``ray`` are rays away from it of unit direction, and ``hit`` is what each meets first.

    At a surface the path goes on

    - straight, where at least half of the light passes so (``mask``, ``null``,
      ``thindielectric``), and at a ``dielectric`` that does not refract;
    - in the mirror's direction, where the BSDF does nothing but reflect as a mirror (also one
      that lets a smaller half pass, like a ``thindielectric`` at a grazing angle).

    Anything else ends it and so does a lamp, at its front: what is refracted, glossy or diffuse
    has the depth of its surface.

    Returns the depth in scene units along the axis, which a thin lens at the pinhole has to be
    focused at for the path's end to be sharp; the last hit, invalid where nothing was; and
    whether a mirror turned the path. Unmirrored, the depth is that of the last hit, and
    ``inf`` of nothing; plane mirrors make it that of the unfolded path. Of the image in a curved
    mirror it is the point from which the light seems to come; where the mirror is astigmatic,
    that of the mean of 1/depth over all directions, for the circle of confusion goes with it.
    What lies infinitely far is seen behind a convex mirror at a finite depth, with an invalid
    hit. ``inf`` stands for all images that are no nearer than infinity: light that reaches the
    lens converging, to a point behind it.

    The curvature is that of the shading normals a pixel or so around; bumps turn the path but do
    not count as curvature. Raises ``ValueError`` or ``TypeError`` for bad ``bounces``.
    """
    require_whole("bounces", bounces, 0, 2**16)
    origin, axis = mi.Point3f(origin), mi.Vector3f(axis)
    if not has_specular(scene):
        return _depth(origin, axis, hit), mi.SurfaceInteraction3f(hit), mi.Bool(False)
    # How the ray's point and direction move with the two coordinates of the point where it
    # leaves the lens, and with those at depth 1 of where it is aimed from there.
    across = mi.coordinate_system(axis)
    cosine = dr.dot(ray.d, axis)
    aimed = [cosine * (v - dr.dot(v, ray.d) * ray.d) for v in across]
    length = dr.select(hit.is_valid(), dr.norm(hit.p - origin), 0)
    state = {
        "active": _is_worth_a_step(hit),
        "count": mi.UInt32(0),
        "mirrored": mi.Bool(False),
        "length": length,
        "direction": mi.Vector3f(ray.d),
        "hit": mi.SurfaceInteraction3f(hit),
        "points": [mi.Vector3f(v) for v in across] + [length * v for v in aimed],
        "directions": [mi.Vector3f(0), mi.Vector3f(0), *aimed],
    }

    def on(s: dict[str, Any]) -> tuple[dict[str, Any]]:
        here, d = s["hit"], s["direction"]
        straight, mirror, reflected = _onward(here, s["active"])
        goes = straight | mirror
        points, directions = _reflected(scene, s, reflected, mirror)
        d = dr.select(mirror, reflected, d)
        there = scene.ray_intersect(here.spawn_ray(d), goes)
        step = dr.select(goes & there.is_valid(), dr.norm(there.p - here.p), 0)
        return (
            {
                "active": goes & _is_worth_a_step(there),
                "count": s["count"] + dr.select(goes, mi.UInt32(1), mi.UInt32(0)),
                "mirrored": s["mirrored"] | mirror,
                "length": s["length"] + step,
                "direction": d,
                "hit": dr.select(goes, there, here),
                "points": [p + step * v for p, v in zip(points, directions, strict=True)],
                "directions": directions,
            },
        )

    (end,) = dr.while_loop((state,), lambda s: s["active"] & (s["count"] < bounces), on)
    depth = dr.select(end["mirrored"], _image_depth(end), _depth(origin, axis, end["hit"]))
    return depth, end["hit"], end["mirrored"]


def passes_straight(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Where :func:`seen` goes straight on: panes, and what is cut out by a mask."""
    active = active & _is_worth_a_step(hit)
    return active & _onward(hit, active)[0]


def _depth(origin: mi.Point3f, axis: mi.Vector3f, hit: mi.SurfaceInteraction3f) -> mi.Float:
    return dr.select(hit.is_valid(), dr.dot(hit.p - origin, axis), dr.inf)


def _only_specular(flags: Any) -> Any:
    return (flags & (int(mi.BSDFFlags.Smooth) | int(mi.BSDFFlags.Delta1D))) == 0


def _may_go_on(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, may let a path go on."""
    delta = (flags & int(mi.BSDFFlags.Delta)) != 0
    return ((flags & int(mi.BSDFFlags.Null)) != 0) | (delta & _only_specular(flags))


def _is_worth_a_step(hit: mi.SurfaceInteraction3f) -> mi.Bool:
    """The paths that may go on: the others should cost next to nothing."""
    lamp = hit.shape.is_emitter() & (mi.Frame3f.cos_theta(hit.wi) > 0)
    return hit.is_valid() & ~lamp & _may_go_on(hit.bsdf().flags())


def _onward(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> tuple[mi.Bool, mi.Bool, mi.Vector3f]:
    """Where the path goes straight on, where it is mirrored, and the mirrored direction."""
    bsdf, flags = hit.bsdf(), mi.BSDFFlags
    kinds = bsdf.flags()
    # Sampled with 1/2, a BSDF of two lobes answers with the greater one.
    sample, weight = bsdf.sample(mi.BSDFContext(), hit, 0.5, mi.Point2f(0.5), active)
    specular = active & _only_specular(kinds)
    specular &= dr.max(mi.unpolarized_spectrum(weight)) > 0
    unbent = mi.has_flag(sample.sampled_type, flags.DeltaTransmission) & (sample.eta == 1)
    straight = specular & (mi.has_flag(sample.sampled_type, flags.Null) | unbent)
    passes = mi.unpolarized_spectrum(bsdf.eval_null_transmission(hit, active))
    straight |= active & (dr.mean(passes) >= 0.5)
    mirror = specular & ~straight & ~mi.has_flag(kinds, flags.DeltaTransmission)
    return straight, mirror, hit.to_world(sample.wo)


def _reflected(
    scene: mi.Scene, s: dict[str, Any], reflected: mi.Vector3f, active: mi.Bool
) -> tuple[list[mi.Vector3f], list[mi.Vector3f]]:
    """How the neighbours' points and directions differ behind the mirror; Igehy, section 3.1.3."""
    hit, d = s["hit"], s["direction"]
    normal = dr.normalize(reflected - d)
    normal = dr.mulsign(normal, dr.dot(normal, hit.sh_frame.n))
    across = mi.coordinate_system(d)
    turns = [_turn(scene, s, v, active) for v in across]
    points, directions = [], []
    for p, v in zip(s["points"], s["directions"], strict=True):
        turn = dr.dot(p, across[0]) * turns[0] + dr.dot(p, across[1]) * turns[1]
        toward = dr.dot(v, normal) + dr.dot(d, turn)
        v_reflected = v - 2 * (toward * normal + dr.dot(d, normal) * turn)
        p_on_mirror = p - d * (dr.dot(p, hit.n) / dr.dot(d, hit.n))
        points.append(dr.select(active, p_on_mirror, p))
        directions.append(dr.select(active, v_reflected, v))
    return points, directions


def _turn(scene: mi.Scene, s: dict[str, Any], across: mi.Vector3f, active: mi.Bool) -> mi.Vector3f:
    """The mirror's normal's derivative for rays that move along ``across``, per scene unit.

    Measured, since Mitsuba's own is wrong for meshes with texture coordinates. Beyond an edge
    there is nothing to measure; without both neighbours the mirror is taken for a plane one.
    """
    hit, d = s["hit"], s["direction"]
    step = STEP * s["length"]
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


def _image_depth(s: dict[str, Any]) -> mi.Float:
    """Depth at which rays of the whole lens have to be aimed to meet at the end of the path.

    With the displacement there dQ = A do + B dm of a ray that leaves the lens do away and is
    aimed dm apart at depth 1, rays that meet have dm = -B^-1 A do, and pass the image's depth z
    at do + z dm = 0: 1/z is an eigenvalue of B^-1 A, and their mean half its trace.
    """
    basis = mi.coordinate_system(s["direction"])
    far = ~s["hit"].is_valid()
    ends = [dr.select(far, v, p) for p, v in zip(s["points"], s["directions"], strict=True)]
    (a00, a01, b00, b01), (a10, a11, b10, b11) = ([dr.dot(e, v) for e in ends] for v in basis)
    depth = 2 * (b00 * b11 - b01 * b10) / (b11 * a00 - b01 * a10 - b10 * a01 + b00 * a11)
    return dr.select(depth > 0, depth, dr.inf)
