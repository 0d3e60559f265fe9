"""From vertices of an object to pixels: perspective division, viewport, and all steps in a row.

Section 5.8 of *Camera Models* (projecting a triangle) and Juenemann, *The graphics pipeline (1)*,
steps 1 to 5. Pixel coordinates have their origin at the top left corner of the picture, x to the
right and y down, and pixel (i, j) covers [i, i + 1] x [j, j + 1].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from .projection import Behind, perspective_divide
from .vectors import (
    assemble,
    components,
    homogeneous,
    leaf_of,
    multiply,
    number,
    require,
    transform_points,
)


class ProjectedVertices(NamedTuple):
    """Vertices at every station of the pipeline, from the object to the picture.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``world``                     (..., 3), after the object's transformation
    ``camera``                    (..., 3), as the camera sees them
    ``clip``                      (..., 4), homogeneous, before the perspective division
    ``ndc``                       (..., 3), normalised device coordinates: x, y, pseudodepth
    ``pixels``                    (..., 2)
    ============================  ==========================================================
    """

    world: Any
    camera: Any
    clip: Any
    ndc: Any
    pixels: Any


def pixel_from_ndc(ndc: Any, width: Any, height: Any) -> Any:
    """The viewport transform: pixels (..., 2) of normalised device coordinates (..., 2 or 3).

    x_s = w_s/2 x + w_s/2 and y_s = -h_s/2 y + h_s/2 (Juenemann, step 5) for a picture of ``width``
    by ``height`` pixels; z is not read. Raises ``ValueError`` for a size that is not > 0.
    """
    leaf = leaf_of(ndc, width, height)
    x, y = components("ndc", ndc, None, leaf)[:2]
    w, h = _size(width, height, leaf)
    return assemble([w / 2 * x + w / 2, -h / 2 * y + h / 2])


def ndc_from_pixel(pixels: Any, width: Any, height: Any) -> Any:
    """The x and y of NDC (..., 2) of a pixel (..., 2): the inverse of :func:`pixel_from_ndc`."""
    leaf = leaf_of(pixels, width, height)
    x, y = components("pixels", pixels, 2, leaf)
    w, h = _size(width, height, leaf)
    return assemble([2 * x / w - 1.0, 1.0 - 2 * y / h])


def project_vertices(
    vertices: Any,
    world_from_object: Any,
    camera_from_world: Any,
    clip_from_camera: Any,
    width: Any,
    height: Any,
    behind: Behind = "refuse",
) -> ProjectedVertices:
    """Vertices (..., 3) of an object, such as the three of a triangle, projected to pixels.

    The steps are those of section 5.8 of *Camera Models*: object to world to camera, homogeneous
    perspective, division by the last component; then the viewport. The matrices are (4, 4), or
    broadcast with the vertices. ``clip_from_camera`` is one of :meth:`Frustum.clip_from_camera`,
    :func:`perspective_clip_from_camera` and :func:`orthographic_clip_from_camera`.

    Raises ``ValueError`` for a vertex at or behind the camera: clip the face first
    (:func:`clip_face`). With ``behind="nan"`` its ``ndc`` and ``pixels`` are NaN instead.
    """
    world = transform_points(world_from_object, vertices)
    camera = transform_points(camera_from_world, world)
    clip = multiply(clip_from_camera, homogeneous(camera))
    ndc = perspective_divide(clip, behind)
    return ProjectedVertices(world, camera, clip, ndc, pixel_from_ndc(ndc, width, height))


def _size(width: Any, height: Any, leaf: Any) -> tuple[Any, Any]:
    size = number("width", width, leaf), number("height", height, leaf)
    for name, value in zip(("width", "height"), size, strict=True):
        require(name, value, (value > 0) & (value < math.inf), "> 0 pixels and finite")
    return size
