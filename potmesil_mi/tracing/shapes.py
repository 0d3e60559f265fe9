"""What a scene's shapes are: their surface ids, and the shapes that instances are made of.

Both go by Dr.Jit's registry of shapes, in which :func:`registry_index` finds what a ray has hit.
"""

from __future__ import annotations

import re
from operator import itemgetter
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

ALPHA = re.compile(r"(^|\.)alpha(_[uv])?(\.value|\.data)?$")
"""The names by which ``mi.traverse`` finds the roughness of microfacets."""


def surface_ids(scene: mi.Scene) -> tuple[mi.UInt32, dict[int, str]]:
    """Stable ids of the scene's surfaces.

    Returns a table that turns a shape's index in Dr.Jit's registry into its id, and the name of
    every id. Ids count from 1 in the order of the names, so that they are the same each time
    the scene is loaded; 0 is no surface. A shape without a name (an ``id`` in XML) is called by
    its type and its rank by place and size. Raises ``ValueError`` for a scene without shapes.
    """
    names = shape_names(scene)
    if not names:
        raise ValueError("scene: is empty, there must be at least one shape")
    named = sorted(((name, i) for i, name in enumerate(names)), key=itemgetter(0))
    indices = _indices(scene)
    table = np.zeros(indices.max() + 1, dtype=np.uint32)
    table[indices[[i for _, i in named]]] = np.arange(1, len(named) + 1)
    return mi.UInt32(table), {id_: name for id_, (name, _) in enumerate(named, 1)}


def shape_names(scene: mi.Scene) -> list[str]:
    """What the shapes of a scene are called, in their order.

    A shape without an ``id`` is called by its type and its rank by place and size.
    """
    shapes = scene.shapes()
    names = [shape.id() for shape in shapes]
    unnamed = [(_place_and_size(shape), i) for i, shape in enumerate(shapes) if not shape.id()]
    for rank, (_, i) in enumerate(sorted(unnamed), start=1):
        names[i] = f"{shapes[i].class_name()}_{rank}"
    return names


def emitter_ids(scene: mi.Scene, table: mi.UInt32) -> np.ndarray:
    """Ids of the surfaces that are lamps, uint32 (N,), by the table of :func:`surface_ids`."""
    lamps = np.array(scene.shapes_dr().is_emitter())
    return np.array(table)[_indices(scene)[lamps]]


def bsdf_flags(scene: mi.Scene) -> np.ndarray:
    """The flags of the BSDFs of :func:`every_shape`."""
    return np.array(every_shape(scene).bsdf().flags())


def every_shape(scene: mi.Scene) -> mi.ShapePtr:
    """The scene's shapes, and those that instances are made of.

    Instances do not tell their shapes, which come before them in Dr.Jit's registry: where there
    are instances, shapes of other scenes may be among the result.
    """
    if any(shape.class_name() == "Instance" for shape in scene.shapes()):
        return dr.reinterpret_array(mi.ShapePtr, dr.arange(mi.UInt32, _indices(scene).max() + 1))
    return scene.shapes_dr()


def bsdf_alphas(scene: mi.Scene) -> np.ndarray | None:
    """How rough microfacets are that do nothing but reflect and refract: their alpha.

    Returns float32 by index in Dr.Jit's registry of BSDFs, with 0 for other BSDFs, and ``None``
    where there is no such one. Of textures, and of nested BSDFs, it is the mean. Shapes are those
    of :func:`every_shape`.
    """
    kinds, bsdfs = mi.BSDFFlags, every_shape(scene).bsdf()
    flags, indices = (np.array(each) for each in (bsdfs.flags(), _registered(bsdfs)))
    glossy = (flags & (int(kinds.GlossyReflection) | int(kinds.GlossyTransmission))) != 0
    glossy &= (flags & (int(kinds.Diffuse) | int(kinds.Delta1D))) == 0
    rough = np.unique(indices[glossy])
    if len(rough) == 0:
        return None
    alphas = np.zeros(rough.max() + 1, dtype=np.float32)
    pointers = dr.reinterpret_array(mi.BSDFPtr, mi.UInt32(rough))
    for i, index in enumerate(rough):
        found = [np.mean(np.array(v)) for k, v in mi.traverse(pointers[i]) if ALPHA.search(k)]
        alphas[index] = np.mean(found) if found else 0
    return alphas if alphas.any() else None


def registry_index(hit: mi.SurfaceInteraction3f) -> mi.UInt32:
    """Index in Dr.Jit's registry of what was hit: of the instance, where there is one."""
    shape = dr.select(hit.instance != mi.ShapePtr(None), hit.instance, hit.shape)
    return _registered(shape)


def alpha_at(hit: mi.SurfaceInteraction3f, alphas: mi.Float, active: mi.Bool) -> mi.Float:
    """Of the table that :func:`bsdf_alphas` gives, what is true of ``hit``."""
    index = _registered(hit.bsdf())
    return dr.gather(mi.Float, alphas, index, active & (index < dr.width(alphas)))


def _registered(pointers: Any) -> mi.UInt32:
    """Indices of instances in Dr.Jit's registry."""
    return dr.reinterpret_array(mi.UInt32, pointers)


def _indices(scene: mi.Scene) -> np.ndarray:
    """Indices in Dr.Jit's registry of the scene's shapes, in their order."""
    return np.array(_registered(scene.shapes_dr()))


def _place_and_size(shape: mi.Shape) -> tuple[Any, ...]:
    """A key that orders shapes without names in the same way each time a scene is loaded."""
    box = shape.bbox()
    corners = [float(v) for corner in (box.min, box.max) for v in np.array(corner).ravel()]
    return shape.class_name(), *corners, shape.primitive_count()
