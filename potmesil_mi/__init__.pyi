"""Every public name and the module that defines it: for type checkers, and for lazy_loader."""

from . import evaluation
from .filters.filters import (
    Defocus,
    Diffraction,
    Fade,
    Filter,
    Star,
    apply_filters,
    parse_filter,
)
from .focusing.api import focus
from .optics.camera import Camera
from .optics.lens import DepthOfField, ThinLens
from .optics.psf import (
    Aperture,
    Disc,
    ImageAperture,
    Lommel,
    PointSpreadFunction,
    Polygon,
    aperture_of,
)
from .samples.point_samples import PointSamples
from .tracing.hidden_surface import render_samples
from .tracing.sampling import Sampling
from .tracing.sensor import potmesil_sensor

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
    "evaluation",
    "focus",
    "parse_filter",
    "potmesil_sensor",
    "render_samples",
]
