"""Cameras: where they stand, how they project, what they see. No Mitsuba, no Dr.Jit of its own.

The view pipeline of two lecture texts, *Camera Models* and Juenemann's *Camera models and the view
pipeline*, and section 2.1 of the paper; ``docs/camera-models.md`` has their formulas by number.

=================  =============================================================================
``vectors``        points and matrices of NumPy and of Dr.Jit alike, and what shapes they have
``basis``          position and orientation: gaze and up, look-at, pan, tilt and swing, dolly
``projection``     perspective and parallel projection, pseudodepth, NDC, shadows on a plane
``frustum``        fields of view, planes and their sizes, what is inside, zoom
``clipping``       which vertices of clip space are seen, and the part of a face that is
``pipeline``       viewport, and all steps from the object to the pixel
``pinhole``        ``Camera``: the pinhole that took a set of point samples
=================  =============================================================================
"""

from .basis import (
    CAMERA_AXES,
    HALF_TURN,
    Angles,
    CameraAxes,
    angles_of,
    basis_from_gaze,
    camera_from_world,
    convert_axes,
    dolly,
    look_at,
    orientation,
    rigid_inverse,
    world_from_camera,
)
from .clipping import (
    CLIP_PLANES,
    ClippedFaces,
    clip_face,
    clip_faces,
    inside_clip,
    outside_planes,
)
from .frustum import FRUSTUM_PLANES, BallInFrustum, Frustum, PlaneValues, dolly_zoom
from .pinhole import FOV_AXES, Camera, FovAxis, horizontal_fov
from .pipeline import ProjectedVertices, ndc_from_pixel, pixel_from_ndc, project_vertices
from .projection import (
    BEHIND,
    Behind,
    homogeneous_perspective,
    image_from_camera,
    image_from_world,
    image_from_world_matrix,
    orthographic_clip_from_camera,
    orthographic_image,
    parallel_projection_onto_plane,
    perspective_clip_from_camera,
    perspective_divide,
    plane_projection,
    plane_through,
    projection_onto_plane,
    pseudodepth,
    pseudodepth_coefficients,
    pseudodepth_perspective,
    vanishing_point,
)
from .vectors import compose, homogeneous, multiply, transform_directions, transform_points

__all__ = [
    "BEHIND",
    "CAMERA_AXES",
    "CLIP_PLANES",
    "FOV_AXES",
    "FRUSTUM_PLANES",
    "HALF_TURN",
    "Angles",
    "BallInFrustum",
    "Behind",
    "Camera",
    "CameraAxes",
    "ClippedFaces",
    "FovAxis",
    "Frustum",
    "PlaneValues",
    "ProjectedVertices",
    "angles_of",
    "basis_from_gaze",
    "camera_from_world",
    "clip_face",
    "clip_faces",
    "compose",
    "convert_axes",
    "dolly",
    "dolly_zoom",
    "homogeneous",
    "homogeneous_perspective",
    "horizontal_fov",
    "image_from_camera",
    "image_from_world",
    "image_from_world_matrix",
    "inside_clip",
    "look_at",
    "multiply",
    "ndc_from_pixel",
    "orientation",
    "orthographic_clip_from_camera",
    "orthographic_image",
    "outside_planes",
    "parallel_projection_onto_plane",
    "perspective_clip_from_camera",
    "perspective_divide",
    "pixel_from_ndc",
    "plane_projection",
    "plane_through",
    "project_vertices",
    "projection_onto_plane",
    "pseudodepth",
    "pseudodepth_coefficients",
    "pseudodepth_perspective",
    "rigid_inverse",
    "transform_directions",
    "transform_points",
    "vanishing_point",
    "world_from_camera",
]
