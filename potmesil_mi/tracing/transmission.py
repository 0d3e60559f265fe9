"""Transmission: what of a scene may let a part of the light through, and what a medium does so.

The transmittance of a stretch of a medium, and where along it a photon was scattered, are those of
the Beer-Lambert law.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from .onward import channel_mean, may_be_veil
from .shapes import bsdf_flags, every_shape

STEPS = 64
"""Steps in which the extinction of a heterogeneous medium is added up along a ray. In all of them
a ray looks at the same part, another one than its neighbours: the error leaves no pattern."""

VOLUMETRIC = re.compile(r"volumetric|volpath", re.IGNORECASE)
"""How integrators that know participating media are named."""


class VeilKinds(NamedTuple):
    """Whether surfaces and participating media may let a part of the light through."""

    surfaces: bool
    media: bool


def veil_kinds(scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator) -> VeilKinds:
    """What may be a veil as ``sensor`` and ``integrator`` see the scene.

    The flags of the BSDFs tell of surfaces. Media are veils for integrators that know media, which
    their names tell.
    """
    surfaces = bool(may_be_veil(bsdf_flags(scene)).any())
    if not VOLUMETRIC.search(str(integrator)):
        return VeilKinds(surfaces, False)
    bounds = dr.any(every_shape(scene).is_medium_transition())
    return VeilKinds(surfaces, bool(bounds) or sensor.get_medium() is not None)


class Stretch(NamedTuple):
    """What a medium does to light along a stretch of a ray, one element for each.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``through``                   the transmittance of the whole
    ``scattered``                 distance from the ray's origin at which a photon was scattered
                                  or absorbed that did not get through
    ``before``                    mean transmittance up to there
    ``extinction``                mean extinction there, per scene unit
    ============================  ==========================================================
    """

    through: mi.UnpolarizedSpectrum
    scattered: mi.Float
    before: mi.Float
    extinction: mi.Float

    @classmethod
    def of(
        cls,
        medium: mi.MediumPtr,
        ray: mi.Ray3f,
        length: mi.Float,
        random: Sequence[mi.Float],
        active: mi.Bool,
    ) -> Stretch:
        """The stretch of ``medium`` from the origin of ``ray`` on, ``length`` long or infinite.

        Of two ``random`` numbers from 0 to 1 one says where a photon was scattered, with a density
        of the extinction times the transmittance, and the other in which colour this was and at
        which place of its steps the ray looks at a heterogeneous medium.
        """
        meets, near, far = medium.intersect_aabb(ray)
        meets &= active
        near = dr.select(meets, dr.maximum(near, 0), 0)
        far = dr.select(meets, dr.maximum(dr.minimum(far, length), near), near)
        steps = dr.select(medium.is_homogeneous(), mi.UInt32(1), mi.UInt32(STEPS))
        width = (far - near) / mi.Float(steps)
        place = mi.Float(random[1])

        def extinction(begin: mi.Float, going: mi.Bool) -> mi.UnpolarizedSpectrum:
            there = dr.zeros(mi.MediumInteraction3f)
            there.t = begin + dr.select(dr.isfinite(width), place * width, 0)
            there.p, there.wi, there.medium = ray(there.t), -ray.d, medium
            there.time, there.wavelengths = ray.time, ray.wavelengths
            return medium.get_scattering_coefficients(there, going)[2]

        def add(step: mi.UInt32, begin: mi.Float, depth: Any) -> tuple[Any, Any, Any]:
            depth = depth + _depth(extinction(begin, step < steps), width)
            return step + 1, begin + width, depth

        start = mi.UInt32(0), mi.Float(near), mi.UnpolarizedSpectrum(0)
        *_, depth = dr.while_loop(start, lambda step, *_: meets & (step < steps), add)
        through = dr.exp(-depth)
        channel, share = _channel(1 - through, place)
        aim = -dr.log(1 - mi.Float(random[0]) * share)

        def seek(step: Any, begin: Any, depth: Any, at: Any, mean: Any) -> tuple[Any, ...]:
            thickness = extinction(begin, step < steps)
            there = begin + (aim - _of(depth, channel)) / _of(thickness, channel)
            after = depth + _depth(thickness, width)
            found = (_of(after, channel) >= aim) | (step + 1 == steps)
            at = dr.clip(dr.select(found, there, begin), begin, begin + width)
            depth = dr.select(found, depth + _depth(thickness, at - begin), after)
            mean = channel_mean(thickness)
            return dr.select(found, steps, step + 1), begin + width, depth, at, mean

        state = *start, mi.Float(near), mi.Float(0)
        *_, before, at, mean = dr.while_loop(state, lambda step, *_: meets & (step < steps), seek)
        return cls(through, at, channel_mean(dr.exp(-before)), mean)


def _depth(extinction: mi.UnpolarizedSpectrum, width: mi.Float) -> mi.UnpolarizedSpectrum:
    """Optical depth of a step, which may be infinitely wide."""
    return dr.select(extinction > 0, extinction * width, 0)


def _channel(shares: mi.UnpolarizedSpectrum, sample: mi.Float) -> tuple[mi.UInt32, mi.Float]:
    """A channel, chosen by ``sample`` in proportion to ``shares``, and its share."""
    left = sample * dr.sum(shares)
    channel = mi.UInt32(0)
    for number in range(len(shares) - 1):
        left -= shares[number]
        channel = dr.select(left >= 0, mi.UInt32(number + 1), channel)
    return channel, _of(shares, channel)


def _of(spectrum: mi.UnpolarizedSpectrum, channel: mi.UInt32) -> mi.Float:
    """The value of a ``channel`` of a spectrum."""
    value = mi.Float(spectrum[0])
    for number in range(1, len(spectrum)):
        value = dr.select(channel == number, spectrum[number], value)
    return value
