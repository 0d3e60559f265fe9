"""Posing: shapes of a scene are moved, and put back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


class PosedShapes:
    """Shapes of a scene that can be moved from where it has them.

    ``names`` are their ids; instances are shapes, too, and what they are made of is not. Raises
    ``ValueError`` for a name that no shape has, or several have, and for a shape that Mitsuba lets
    nobody move, such as a curve.
    """

    def __init__(self, scene: mi.Scene, names: Iterable[str]) -> None:
        shapes = [shape for shape in scene.shapes() if shape.id()]
        known = [shape.id() for shape in shapes]
        self._parameters = mi.traverse(scene)
        self._own: dict[str, dict[str, Any]] = {}
        self._centres: dict[str, np.ndarray] = {}
        for name in names:
            if known.count(name) != 1:
                raise ValueError(
                    f"shapes.{name}: must be the id of one shape of the scene, which has "
                    f"{', '.join(sorted(set(known))) or 'none with an id'}; load the scene with "
                    "optimize=False, so that meshes of one material stay apart"
                )
            shape = shapes[known.index(name)]
            keys = [f"{name}.{key}" for key in ("to_world", "vertex_positions", "vertex_normals")]
            there = [key for key in keys if key in self._parameters]
            if not set(there) & set(keys[:2]):
                raise ValueError(
                    f"shapes.{name}: is a {shape.class_name()}, which Mitsuba lets nobody move"
                )
            self._own[name] = {key: _copy(self._parameters[key]) for key in there}
            self._centres[name] = np.array(shape.bbox().center(), dtype=np.float64).ravel()

    def centre(self, name: str) -> np.ndarray:
        """The middle of the bounding box of a shape where the scene has it, (3,)."""
        return self._centres[name]

    def place(self, transforms: Mapping[str, np.ndarray]) -> None:
        """Move shapes, by their names, from where the scene has them, by matrices (4, 4).

        Matrices are of the world. Shapes that are not named are put back.
        """
        for name, own in self._own.items():
            matrix = np.asarray(transforms.get(name, np.eye(4)), dtype=np.float64)
            for key, value in own.items():
                self._parameters[key] = _moved(key.rsplit(".", 1)[1], value, matrix)
        self._parameters.update()


def _copy(value: Any) -> np.ndarray:
    """A transform as its matrix (4, 4), numbers as they are, float64."""
    return np.array(getattr(value, "matrix", value), dtype=np.float64)


def _moved(kind: str, value: np.ndarray, matrix: np.ndarray) -> Any:
    """A parameter of a shape after the shape was moved."""
    if kind == "to_world":
        return mi.Transform4f(matrix @ value.reshape(4, 4))
    rows = value.reshape(-1, 3)
    if kind == "vertex_positions":
        rows = rows @ matrix[:3, :3].T + matrix[:3, 3]
    else:
        rows = rows @ np.linalg.inv(matrix[:3, :3])
        rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(float).tiny)
    return dr.auto.Float(rows.ravel())
