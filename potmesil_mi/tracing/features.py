"""Features: what a surface is like where it is seen, for a denoiser.

Its albedo, which is known without noise, tells the detail of textures from noise, and its normal
tells edges.
"""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

WAVELENGTHS = (610.0, 550.0, 465.0)
"""Of the albedo in R, G and B in spectral variants, in nm: a ray's own are random."""


class Features(NamedTuple):
    """Albedo and shading normal of what rays show, one element for each.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``albedo``                    diffuse reflectance in R, G and B, 0 to 1; 1 of what does not
                                  reflect diffusely, such as metal
    ``normal``                    shading normal in the world, of unit length
    ============================  ==========================================================

    Both are 0 where nothing is hit, and of the front of lamps.
    """

    albedo: mi.Color3f
    normal: mi.Normal3f

    @classmethod
    def of(cls, hit: mi.SurfaceInteraction3f) -> Features:
        """The features of what was hit."""
        is_lamp = hit.is_valid() & hit.shape.is_emitter() & (mi.Frame3f.cos_theta(hit.wi) > 0)
        there = hit.is_valid() & ~is_lamp
        bsdf = hit.bsdf()
        is_diffuse = (bsdf.flags() & int(mi.BSDFFlags.Diffuse)) != 0
        albedo = dr.select(is_diffuse, _reflectance(bsdf, hit, there & is_diffuse), 1)
        normal = hit.sh_frame.n
        return cls(
            albedo=mi.Color3f(dr.select(there, albedo, 0)),
            normal=mi.Normal3f(dr.select(there & dr.all(dr.isfinite(normal)), normal, 0)),
        )


def _reflectance(bsdf: mi.BSDFPtr, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
    """Diffuse reflectance in R, G and B, as Mitsuba estimates it, but no more than 1."""
    if mi.is_spectral:
        hit = mi.SurfaceInteraction3f(hit)
        hit.wavelengths = type(hit.wavelengths)(*WAVELENGTHS, WAVELENGTHS[1])
    reflectance = mi.unpolarized_spectrum(bsdf.eval_diffuse_reflectance(hit, active))
    if mi.is_monochromatic:
        rgb = mi.Color3f(reflectance[0])
    else:
        rgb = mi.Color3f(reflectance[0], reflectance[1], reflectance[2])
    return dr.clip(dr.select(dr.isfinite(rgb), rgb, 0), 0, 1)
