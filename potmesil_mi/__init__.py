"""potmesil_mi: Potmesil & Chakravarty's lens and aperture camera (SIGGRAPH 1981) for Mitsuba 3.

Render a scene once with a pinhole, keep point samples with depth and surface identity, then
form the picture through a lens as often as you like::

    import mitsuba as mi, potmesil_mi as pm        # in either order with mi.set_variant
    samples = pm.render_samples(scene, spp=16)     # once
    image = pm.focus(samples, samples.lens.replace(focus_distance=550, f_number=11))

Importing it registers the plugins ``potmesil`` (sensor), ``point_samples`` and ``focus``
(integrators) for the variant that is set, and again whenever another is set.
"""

from __future__ import annotations

from . import _llvm as llvm

llvm.require_usable()

import mitsuba as mi  # noqa: E402

from . import plugins  # noqa: E402
from .filters.filters import (  # noqa: E402
    Defocus,
    Diffraction,
    Fade,
    Filter,
    Star,
    apply_filters,
    parse_filter,
)
from .focusing.api import focus  # noqa: E402
from .optics.camera import Camera  # noqa: E402
from .optics.lens import DepthOfField, ThinLens  # noqa: E402
from .optics.psf import (  # noqa: E402
    Aperture,
    Disc,
    ImageAperture,
    Lommel,
    PointSpreadFunction,
    Polygon,
    aperture_of,
)
from .samples.point_samples import PointSamples  # noqa: E402
from .tracing.hidden_surface import render_samples  # noqa: E402
from .tracing.sampling import Sampling  # noqa: E402
from .tracing.sensor import potmesil_sensor  # noqa: E402

__all__ = [
    "Aperture",
    "Camera",
    "Defocus",
    "DepthOfField",
    "Diffraction",
    "Disc",
    "Fade",
    "Filter",
    "ImageAperture",
    "Lommel",
    "PointSamples",
    "PointSpreadFunction",
    "Polygon",
    "Sampling",
    "Star",
    "ThinLens",
    "aperture_of",
    "apply_filters",
    "focus",
    "parse_filter",
    "potmesil_sensor",
    "render_samples",
]


def _follow_variant(old: str | None, new: str) -> None:
    llvm.check_llvm(new, old)
    plugins.register()


mi.detail.add_variant_callback(_follow_variant)
if mi.variant() is not None:
    plugins.register()
