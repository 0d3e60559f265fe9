"""Every public name and the module that defines it: for type checkers, and for lazy_loader."""

from . import evaluation
from ._examples import example, examples
from ._progress import progress
from ._warnings import FocusWarning
from .animation.animation import AnimatedFilter, Animation
from .filters.base import Filter, apply_filters, parse_filter
from .filters.defocus import Defocus
from .filters.diffraction import Diffraction
from .filters.fade import Fade
from .filters.star import Star
from .focusing.aovs import focus_aovs
from .focusing.api import focus
from .focusing.methods import Equation20, Layered, LightField, Method
from .focusing.session import FocusSession
from .living.api import living_page, living_picture
from .living.picture import LivingPicture
from .motion.camera_move import CameraMove
from .motion.motion import Motion
from .motion.shape_move import ShapeMove
from .motion.shutter import Shutter
from .motion.track import Key, Track, VectorTrack
from .optics.aperture import Aperture, aperture_of
from .optics.camera import Camera
from .optics.disc import Disc
from .optics.image_aperture import ImageAperture
from .optics.lens import DepthOfField, ThinLens
from .optics.lommel import Lommel
from .optics.polygon import Polygon
from .optics.psf import PointSpreadFunction
from .optics.telecentric import TelecentricLens
from .samples.choosing import focus_distance_at, focus_distance_of
from .samples.maps import aov_maps, circle_map
from .samples.motion_vectors import motion_vectors
from .samples.point_samples import PointSamples
from .samples.raster import Window
from .stacks.focal_stack import FocalStack, focal_stack
from .tracing.hidden_surface import render_samples
from .tracing.sampling import Sampling
from .tracing.sensor import potmesil_sensor
from .viewer.widget import interactive

__version__: str

__all__ = [
    "AnimatedFilter",
    "Animation",
    "Aperture",
    "Camera",
    "CameraMove",
    "Defocus",
    "DepthOfField",
    "Diffraction",
    "Disc",
    "Equation20",
    "Fade",
    "Filter",
    "FocalStack",
    "FocusSession",
    "FocusWarning",
    "ImageAperture",
    "Key",
    "Layered",
    "LightField",
    "LivingPicture",
    "Lommel",
    "Method",
    "Motion",
    "PointSamples",
    "PointSpreadFunction",
    "Polygon",
    "Sampling",
    "ShapeMove",
    "Shutter",
    "Star",
    "TelecentricLens",
    "ThinLens",
    "Track",
    "VectorTrack",
    "Window",
    "aov_maps",
    "aperture_of",
    "apply_filters",
    "circle_map",
    "evaluation",
    "example",
    "examples",
    "focal_stack",
    "focus",
    "focus_aovs",
    "focus_distance_at",
    "focus_distance_of",
    "interactive",
    "living_page",
    "living_picture",
    "motion_vectors",
    "parse_filter",
    "potmesil_sensor",
    "progress",
    "render_samples",
]
