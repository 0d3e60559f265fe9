r"""Clipping in homogeneous clip space, before the perspective division.

Juenemann, *The graphics pipeline (1): vertex part*: a vertex (x, y, z, w) of clip space is outside
the view frustum where \|x\| > w, \|y\| > w or \|z\| > w. Faces are clipped by the algorithm of
Sutherland & Hodgman (*Reentrant Polygon Clipping*, 1974), plane by plane: linear in homogeneous
coordinates, so that it holds for vertices behind the camera, which the division would put in front
of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .frustum import PlaneValues
from .vectors import absolute, assemble, components, dot, leaf_of, where

CLIP_PLANES = PlaneValues(
    left=(1.0, 0.0, 0.0, 1.0),
    right=(-1.0, 0.0, 0.0, 1.0),
    bottom=(0.0, 1.0, 0.0, 1.0),
    top=(0.0, -1.0, 0.0, 1.0),
    near=(0.0, 0.0, 1.0, 1.0),
    far=(0.0, 0.0, -1.0, 1.0),
)
"""The planes of the frustum in clip space: a vertex is on the inner side where the product with it
is >= 0."""


class ClippedFaces(NamedTuple):
    """Faces cut to the frustum, see :func:`clip_faces`.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``vertices``                  a tuple of clip-space vertices (..., 4); from ``count`` on the
                                  first one is repeated, which adds no area
    ``count``                     how many of them there are, (...); 0 for a face that is not
                                  seen
    ============================  ==========================================================
    """

    vertices: tuple[Any, ...]
    count: Any


def inside_clip(clip: Any) -> Any:
    """Whether clip-space vertices (..., 4) are in the frustum: |x|, |y|, |z| <= w."""
    x, y, z, w = components("clip", clip, 4)
    return (absolute(x) <= w) & (absolute(y) <= w) & (absolute(z) <= w)


def outside_planes(clip: Any) -> PlaneValues:
    """Beyond which planes of the frustum clip-space vertices (..., 4) are."""
    vertex = components("clip", clip, 4)
    return PlaneValues(*(dot(plane, vertex) < 0 for plane in CLIP_PLANES))


def clip_face(vertices: Any) -> np.ndarray:
    """One convex or concave face (k, 4) of clip space, cut to the frustum: (m, 4), NumPy.

    Vertices keep their order. m is 0 for a face that is not seen, and never 1 or 2. Of a concave
    face that falls apart the pieces are joined along the frustum's side, as is usual.

    Raises ``ValueError`` for fewer than three vertices or other than four components.
    """
    face = np.asarray(vertices)
    if face.ndim != 2 or face.shape[0] < 3 or face.shape[1] != 4:
        raise ValueError(f"vertices: has shape {face.shape}; must be (3 or more, 4)")
    for plane in np.array(CLIP_PLANES):
        side = face @ plane
        kept: list[Any] = []
        for i, here in enumerate(side):
            if here >= 0:
                kept.append(face[i])
            j = (i + 1) % len(face)
            if (here >= 0) != (side[j] >= 0):
                kept.append(face[i] + (face[j] - face[i]) * (here / (here - side[j])))
        if len(kept) < 3:
            return np.empty((0, 4))
        face = np.stack(kept)
    return face


def clip_faces(vertices: Any) -> ClippedFaces:
    """Many convex faces of clip space at once, cut to the frustum; differentiable on Dr.Jit.

    ``vertices`` is a sequence of the k vertices, each (..., 4) or an ``Array4f`` (of a NumPy array
    (..., k, 4) those of its axis before the last). Each plane cuts off a convex face at most one
    vertex more than it takes, so k + 6 come back, of which the first ``count`` are the face. The
    same vertices as :func:`clip_face`, in the same order.
    """
    leaf = leaf_of(vertices)
    if leaf is None and not isinstance(vertices, (tuple, list)):
        vertices = np.moveaxis(np.asarray(vertices), -2, 0)
    face = [components(f"vertices[{i}]", v, 4, leaf) for i, v in enumerate(vertices)]
    if len(face) < 3:
        raise ValueError(f"vertices: has {len(face)}; must have 3 or more")
    count = 0.0 * face[0][0] + float(len(face))
    for plane in CLIP_PLANES:
        face, count = _cut(face, count, plane)
    seen = count >= 3
    count = where(seen, count, 0.0)
    return ClippedFaces(tuple(assemble(vertex) for vertex in face), _whole(count, leaf))


def _cut(face: list[Any], count: Any, plane: Any) -> tuple[list[Any], Any]:
    """The faces behind one plane, with one vertex more. ``count`` of ``face`` are there.

    Each of its edges may give two vertices: its first, and where it meets the plane. Those that are
    there get the next free place, by a choice among all places: without a branch, and so alike for
    all faces of a batch.
    """
    sides = [dot(plane, vertex) for vertex in face]
    empty = [0.0 * x for x in face[0]]
    result = [list(empty) for _ in range(len(face) + 1)]
    place = 0.0 * count
    for i, vertex in enumerate(face):
        last = count == i + 1
        j = (i + 1) % len(face)
        end = [where(last, a, b) for a, b in zip(face[0], face[j], strict=True)]
        end_side = where(last, sides[0], sides[j])
        exists = count > i
        crosses = exists & ((sides[i] >= 0) != (end_side >= 0))
        share = sides[i] / where(crosses, sides[i] - end_side, 1.0)
        meeting = [a + (b - a) * share for a, b in zip(vertex, end, strict=True)]
        for there, candidate in ((exists & (sides[i] >= 0), vertex), (crosses, meeting)):
            for k in range(min(2 * i + 2, len(result))):
                taken = there & (place == k)
                result[k] = [where(taken, a, b) for a, b in zip(candidate, result[k], strict=True)]
            place = where(there, place + 1.0, place)
    filled = [
        [where(place > k, a, b) for a, b in zip(vertex, result[0], strict=True)]
        for k, vertex in enumerate(result)
    ]
    return filled, place


def _whole(count: Any, leaf: Any) -> Any:
    """``count`` as whole numbers: of NumPy, or Dr.Jit's ``UInt32``."""
    if leaf is None:
        return np.asarray(count).astype(np.int64)[()]
    import drjit

    return drjit.uint32_array_t(leaf)(count)
