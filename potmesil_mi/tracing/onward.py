"""How rays go on at a surface: straight through it, reflected, refracted, or not at all.

It is one rule for the rays of the pinhole, which tell the depth of images, and for those of the
lens, which tell who sees these.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from .shapes import alpha_at, bsdf_alphas, bsdf_flags

DULL = 0.4
"""So far in radians rough microfacets spread the light of a direction when they show no image: a
mirror of an alpha of 0.2. A lens of less than a fifth of its distance to them blurs less than the
microfacets do, whatever depth is taken for the image."""

LEAST_THROUGH = 1 / 256
"""What lets less of the light through hides what is behind it, and what keeps less back is not
there."""


LAST = 1 - 2**-24
"""The last random number before 1: a BSDF of two lobes answers it with the one that transmits."""

ABOUT_HALF = 0.499
"""What lets as much of the light through is passed behind a mirror: a half is passed by all rays,
however it is rounded."""


def has_specular(scene: mi.Scene) -> bool:
    """Whether the scene may have surfaces at which rays of the pinhole go on.

    The flags of the BSDFs decide it, which include the flags of nested ones, and their roughness.
    """
    return bool(_is_specular(bsdf_flags(scene)).any()) or bsdf_alphas(scene) is not None


def alphas_of(scene: mi.Scene) -> mi.Float | None:
    """The table of :func:`bsdf_alphas`."""
    alphas = bsdf_alphas(scene)
    return None if alphas is None else mi.Float(alphas)


def may_show_images(scene: mi.Scene) -> bool:
    """Whether the scene may have smooth surfaces that show images, as mirrors and glass do."""
    return bool(_may_be_glass(bsdf_flags(scene)).any())


def may_part_light(scene: mi.Scene) -> bool:
    """Whether the scene may have smooth glass, which reflects a part of the light."""
    kinds = mi.BSDFFlags
    flags = bsdf_flags(scene)
    glass, lets_through = _may_be_glass(flags), int(kinds.DeltaTransmission) | int(kinds.Null)
    reflects = (flags & int(kinds.DeltaReflection)) != 0
    return bool((glass & reflects & ((flags & lets_through) != 0)).any())


def may_pass_straight(scene: mi.Scene) -> bool:
    """Whether the scene may have surfaces that :func:`passes_straight` finds."""
    kinds = mi.BSDFFlags
    transmits = int(kinds.Null) | int(kinds.DeltaTransmission) | int(kinds.GlossyTransmission)
    return bool((bsdf_flags(scene) & transmits).any())


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
    ``weight``                    radiance before the surface over that beyond it, unless it is
                                  rough
    ``sharpness``                 weight of what is seen beyond in 1/depth; 1 unless it is rough
    ``lesser_share``              where smooth glass parts the light into two lobes the part of it
                                  that goes by the lesser one; else 0, and unless ``lesser`` was
                                  asked for
    ============================  ==========================================================
    """

    straight: mi.Bool
    turns: mi.Bool
    reflects: mi.Bool
    direction: mi.Vector3f
    eta: mi.Float
    weight: mi.UnpolarizedSpectrum
    sharpness: mi.Float
    lesser_share: mi.Float


def passes_straight(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Where rays of the pinhole go straight on: through panes, and masks that are not opaque."""
    active = active & may_go_on(hit)
    return active & onward_from(hit, active, mi.Bool(False)).straight


def is_veil(hit: mi.SurfaceInteraction3f, through: mi.Float) -> mi.Bool:
    """Where a surface that lets ``through`` a part of the light is seen itself, too.

    The image in a pane of glass is not in the pane.
    """
    return (through < 1 - LEAST_THROUGH) & may_be_veil(hit.bsdf().flags())


def may_be_veil(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, may be half transparent."""
    null, glass = (flags & int(mi.BSDFFlags.Null)) != 0, _may_be_glass(flags)
    return null & ~glass & ~_only_null(flags)


def _only_specular(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, scatters into no more than points."""
    return (flags & (int(mi.BSDFFlags.Smooth) | int(mi.BSDFFlags.Delta1D))) == 0


def _is_specular(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, may let a path go on."""
    delta = (flags & int(mi.BSDFFlags.Delta)) != 0
    return ((flags & int(mi.BSDFFlags.Null)) != 0) | (delta & _only_specular(flags))


def _only_null(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, does nothing but let light through."""
    delta = mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission
    return _only_specular(flags) & ((flags & int(delta)) == 0)


def _may_be_glass(flags: Any) -> Any:
    """Whether a BSDF of such flags, a number or an array, may show images as glass does."""
    return _only_specular(flags) & ~_only_null(flags)


def channel_mean(spectrum: mi.UnpolarizedSpectrum) -> mi.Float:
    """Mean of the channels, of which there are a few.

    ``dr.mean`` has the number of elements of each channel as a constant in its kernel, which is
    compiled anew for each.
    """
    return dr.sum(spectrum) / len(spectrum)


def may_go_on(hit: mi.SurfaceInteraction3f, alphas: mi.Float | None = None) -> mi.Bool:
    """Which paths may go on from ``hit``; by rough surfaces only with their ``alphas``.

    Only their BSDFs are sampled, so that others cost next to nothing.
    """
    lamp = hit.shape.is_emitter() & (mi.Frame3f.cos_theta(hit.wi) > 0)
    window = _is_specular(hit.bsdf().flags())
    if alphas is not None:
        window |= alpha_at(hit, alphas, hit.is_valid()) > 0
    return hit.is_valid() & ~lamp & window


def onward_from(
    hit: mi.SurfaceInteraction3f,
    active: mi.Bool,
    turned: mi.Bool,
    alphas: mi.Float | None = None,
    *,
    lesser: mi.Bool | None = None,
    reflects: mi.Bool | None = None,
    mirrors: mi.Bool | None = None,
) -> Onward:
    """How paths go on from ``hit``; by rough surfaces only with their ``alphas``.

    What turns them does so by the lobe of more light; where the ``lesser`` one is asked for, smooth
    glass that parts the light goes by the other. ``turned`` is whether anything has turned them
    before: then what hides more than it lets through ends them.

    With ``reflects`` what turns them does so by the lobe that it asks for; where such glass
    ``mirrors``, it does so even if it lets more of the light pass straight.
    """
    bsdf, flags = hit.bsdf(), mi.BSDFFlags
    kinds = bsdf.flags()
    transmission = int(flags.DeltaTransmission) | int(flags.GlossyTransmission)
    sample, weight = _sampled(hit, active)
    smooth = active & _only_specular(kinds)
    glass = _may_be_glass(kinds)
    lesser_share, other = mi.Float(0), mi.Bool(False)
    if lesser is not None:
        reflected = _reflects(sample)
        beside = _sampled(hit, smooth & glass, sample1=dr.select(reflected, LAST, 0))
        parts = smooth & glass & (dr.max(beside[1]) > 0) & (_reflects(beside[0]) != reflected)
        shares = [
            of.pdf * channel_mean(value) * dr.square(of.eta)
            for of, value in (beside, (sample, weight))
        ]
        lesser_share = dr.select(parts, shares[0] / (shares[0] + shares[1]), 0)
        other = parts & lesser
        sample, weight = dr.select(other, beside[0], sample), dr.select(other, beside[1], weight)
    alpha = mi.Float(0) if alphas is None else alpha_at(hit, alphas, active & ~smooth)
    specular = (smooth | (alpha > 0)) & (dr.max(weight) > 0)
    unbent = ((sample.sampled_type & transmission) != 0) & (sample.eta == 1)
    straight = specular & (mi.has_flag(sample.sampled_type, flags.Null) | unbent)
    passes = mi.unpolarized_spectrum(bsdf.eval_null_transmission(hit, active))
    least = dr.select(turned | glass, ABOUT_HALF, LEAST_THROUGH)
    null = active & ~other & (channel_mean(passes) >= least)
    straight |= null
    if mirrors is not None:
        straight &= ~(smooth & glass & mirrors)
    turns = specular & ~straight
    if reflects is not None:
        sample, weight = _turned_by(hit, reflects, turns)
        turns &= (dr.max(weight) > 0) & ~mi.has_flag(sample.sampled_type, flags.Null)
    onward = Onward(
        straight=straight,
        turns=turns,
        reflects=_reflects(sample),
        direction=hit.to_world(sample.wo),
        eta=sample.eta,
        weight=dr.select(null, passes, sample.pdf * weight),
        sharpness=mi.Float(1),
        lesser_share=lesser_share,
    )
    return onward if alphas is None else _of_microfacets(onward, hit, alpha)


def _of_microfacets(onward: Onward, hit: mi.SurfaceInteraction3f, alpha: mi.Float) -> Onward:
    """``onward`` in the middle of the lobes of microfacets, where ``alpha`` > 0."""
    rough = onward.turns & (alpha > 0)
    d, eta = -hit.wi, dr.select(onward.reflects, 1, onward.eta)
    cosine = dr.abs(d.z)
    beyond = dr.sqrt(1 - (1 - cosine**2) / eta**2)
    z = dr.select(onward.reflects, -d.z, dr.mulsign(beyond, d.z))
    middle = mi.Vector3f(d.x / eta, d.y / eta, z)
    # By as much the direction changes as the normal does, which changes by alpha.
    lobe = alpha * dr.abs(z - d.z / eta)
    sharpness = dr.square(dr.maximum(1 - dr.square(lobe / DULL), 0))
    return onward._replace(
        turns=onward.turns & (~rough | (dr.isfinite(z) & (sharpness > 0))),
        direction=dr.select(rough, hit.to_world(middle), onward.direction),
        sharpness=dr.select(rough, sharpness, 1),
    )


def _turned_by(
    hit: mi.SurfaceInteraction3f, reflects: mi.Bool, active: mi.Bool
) -> tuple[mi.BSDFSample3f, mi.UnpolarizedSpectrum]:
    """A sample of the lobe that ``reflects``, or else of the one that refracts."""
    transmission = mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.GlossyTransmission
    # Without Null a mask takes itself for all hole.
    lobes = int(transmission) | int(mi.BSDFFlags.Null)
    refracted = _sampled(hit, active, mi.BSDFContext(mi.TransportMode.Radiance, lobes))
    # A BSDF of two lobes answers 0 with the one that reflects.
    reflected, weight = _sampled(hit, active, sample1=0)
    weight = dr.select(_reflects(reflected), weight, 0)
    chosen = dr.select(reflects, reflected, refracted[0])
    return chosen, dr.select(reflects, weight, refracted[1])


def _reflects(sample: mi.BSDFSample3f) -> mi.Bool:
    """Whether a sample is one of a lobe that reflects."""
    reflection = int(mi.BSDFFlags.DeltaReflection) | int(mi.BSDFFlags.GlossyReflection)
    return (sample.sampled_type & reflection) != 0


def _sampled(
    hit: mi.SurfaceInteraction3f,
    active: mi.Bool,
    context: mi.BSDFContext | None = None,
    sample1: mi.Float | float = 0.5,
) -> tuple[mi.BSDFSample3f, mi.UnpolarizedSpectrum]:
    """A sample of the BSDF at ``hit`` and its weight: of two lobes the one with more light."""
    # Sampled with 1/2, a BSDF of two lobes answers with the greater one.
    context = mi.BSDFContext() if context is None else context
    sample, weight = hit.bsdf().sample(context, hit, sample1, mi.Point2f(0.5), active)
    return sample, mi.unpolarized_spectrum(weight)
