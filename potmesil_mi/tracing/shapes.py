"""What a scene's shapes are: their surface ids, and which of them enclose a volume.

Both are tables over Dr.Jit's registry of shapes, in which :func:`registry_index` finds what a ray
has hit. This is the one module that reads the vertices and faces of meshes, in :func:`_mesh`.
"""

from __future__ import annotations

from operator import itemgetter
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

ORIENTATION_SAMPLES = 4096
"""Points of a closed shape at which its normals are compared with the way out of it."""

CLOSED_TYPES = ("Sphere", "Cylinder")
"""Classes of shapes without a mesh that enclose a volume; a cylinder's ends are left open."""


def surface_ids(scene: mi.Scene) -> tuple[mi.UInt32, dict[int, str]]:
    """Stable ids of the scene's surfaces.

    Returns a table that turns a shape's index in Dr.Jit's registry into its id, and the name of
    every id. Ids count from 1 in the order of the names, so that they are the same each time
    the scene is loaded; 0 is no surface. A shape without a name (an ``id`` in XML) is called by
    its type and its rank by place and size. Raises ``ValueError`` for a scene without shapes.
    """
    shapes = list(scene.shapes())
    if not shapes:
        raise ValueError("scene: is empty, there must be at least one shape")
    unnamed = sorted((shape for shape in shapes if not shape.id()), key=_place_and_size)
    named = [(f"{s.class_name()}_{rank}", s) for rank, s in enumerate(unnamed, start=1)]
    named = sorted(
        named + [(shape.id(), shape) for shape in shapes if shape.id()], key=itemgetter(0)
    )
    indices = [_index_of(shape) for _, shape in named]
    table = np.zeros(max(indices) + 1, dtype=np.uint32)
    table[indices] = np.arange(1, len(indices) + 1)
    return mi.UInt32(table), {i: name for i, (name, _) in enumerate(named, 1)}


def closed_shapes(scene: mi.Scene) -> mi.Float:
    """Which shapes enclose a volume, by their index in Dr.Jit's registry, as in ``surface_ids``.

    1 for those whose normals point out of it, -1 for those whose normals point into it, 0 for
    the others. Spheres and cylinders enclose one, and so do meshes in which every edge joins two
    faces that run along it in opposite directions. All others, instances too, count as open.
    """
    shapes = list(scene.shapes())
    indices = [_index_of(shape) for shape in shapes]
    table = np.zeros(max(indices) + 1, dtype=np.float32)
    table[indices] = [_side_of_normals(shape) if _is_closed(shape) else 0 for shape in shapes]
    return mi.Float(table)


def registry_index(hit: mi.SurfaceInteraction3f) -> mi.UInt32:
    """Index in Dr.Jit's registry of what was hit: of the instance, where there is one."""
    shape = dr.select(hit.instance != mi.ShapePtr(None), hit.instance, hit.shape)
    return dr.reinterpret_array(mi.UInt32, shape)


def _index_of(shape: mi.Shape) -> int:
    """Index in Dr.Jit's registry of a shape on the host."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _place_and_size(shape: mi.Shape) -> tuple[Any, ...]:
    """A key that orders shapes without names in the same way each time a scene is loaded."""
    box = shape.bbox()
    corners = [float(v) for corner in (box.min, box.max) for v in np.array(corner).ravel()]
    return shape.class_name(), *corners, shape.primitive_count()


def _side_of_normals(shape: mi.Shape) -> float:
    """1 where the normals of a closed shape point outwards, else -1."""
    number = dr.arange(mi.UInt32, ORIENTATION_SAMPLES)
    sample = mi.Point2f(
        (mi.Float(number) + 0.5) / ORIENTATION_SAMPLES, mi.radical_inverse_2(number, 0)
    )
    position = shape.sample_position(0.0, sample)
    middle = mi.Point3f(shape.bbox().center())
    dr.make_opaque(middle)  # one kernel serves all shapes
    # By Gauss's theorem the flux of x - middle is three times the volume.
    flux = dr.mean(dr.dot(position.n, position.p - middle))
    return -1.0 if float(np.array(flux).ravel()[0]) < 0 else 1.0


def _is_closed(shape: mi.Shape) -> bool:
    """Whether the shape encloses a volume; see :func:`closed_shapes`."""
    mesh = _mesh(shape)
    return shape.class_name() in CLOSED_TYPES if mesh is None else is_closed_mesh(*mesh)


def is_closed_mesh(positions: np.ndarray, faces: np.ndarray) -> bool:
    """Whether every edge joins two faces that run along it in opposite directions.

    ``positions`` (V, 3) are those of vertices, ``faces`` (F, 3) their numbers in each triangle.
    Vertices at one place count as one: meshes have several where normals or texture coordinates
    differ.
    """
    vertex = np.unique(positions, axis=0, return_inverse=True)[1].ravel()[faces].astype(np.int64)
    edges = np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges = edges[edges[:, 0] != edges[:, 1]]
    count = len(positions)
    forth, back = edges @ [count, 1], edges @ [1, count]
    return len(np.unique(forth)) == len(forth) and np.array_equal(np.sort(forth), np.sort(back))


def _mesh(shape: mi.Shape) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions (V, 3) and faces (F, 3) of a mesh, ``None`` of other shapes.

    Mitsuba 3.9 exposes them as flat arrays; 3.10 makes tensors of them, under other names.
    """
    parameters = mi.traverse(shape)
    if "vertex_positions" not in parameters:
        return None
    positions = np.array(parameters["vertex_positions"]).reshape(-1, 3)
    return positions, np.array(parameters["faces"]).reshape(-1, 3)
