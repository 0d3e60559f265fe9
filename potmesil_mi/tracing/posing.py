"""Posing: shapes of a scene are moved, and put back."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .shapes import shape_names

MOVED = ("to_world", "vertex_positions", "vertex_normals")
"""Parameters of shapes that say where they are; the first two each say it all."""


class PosedShapes:
    """Shapes of a scene that can be moved from where it has them.

    ``names`` are their ids; one without is called as in ``PointSamples.surfaces``. Instances are
    shapes, too, and what they are made of is not. Raises ``ValueError`` for a name that no shape
    has, or several have, and for a shape that Mitsuba lets nobody move, such as a curve.
    """

    def __init__(self, scene: mi.Scene, names: Iterable[str]) -> None:
        shapes, known = scene.shapes(), shape_names(scene)
        self._scene = scene
        self._parameters: dict[str, mi.SceneParameters] = {}
        self._own: dict[str, dict[str, np.ndarray]] = {}
        self._ends: dict[str, np.ndarray] = {}
        for name in names:
            if known.count(name) != 1:
                raise ValueError(
                    f"shapes.{name}: must be the id of one shape of the scene, which has "
                    f"{', '.join(sorted(set(known)))}; load the scene with optimize=False, so that "
                    "meshes of one material stay apart"
                )
            shape = shapes[known.index(name)]
            parameters = mi.traverse(shape)
            there = [key for key in MOVED if key in parameters]
            if not set(there) & set(MOVED[:2]):
                raise ValueError(
                    f"shapes.{name}: is a {shape.class_name()}, which Mitsuba lets nobody move"
                )
            self._parameters[name] = parameters
            self._own[name] = {key: _copy(parameters[key]) for key in there}
            box = shape.bbox()
            self._ends[name] = np.array([box.min, box.max], dtype=np.float64).reshape(2, 3)

    @property
    def centres(self) -> dict[str, np.ndarray]:
        """The middles of the bounding boxes of the shapes where the scene has them, (3,) each."""
        return {name: ends.mean(axis=0) for name, ends in self._ends.items()}

    def corners(self, name: str) -> np.ndarray:
        """The corners of such a box, (8, 3)."""
        return np.array(list(itertools.product(*self._ends[name].T)))

    def place(self, transforms: Mapping[str, np.ndarray]) -> None:
        """Move shapes, by their names, from where the scene has them, by matrices (4, 4).

        Matrices are of the world. Shapes that are not named are put back.
        """
        for name, own in self._own.items():
            matrix = np.asarray(transforms.get(name, np.eye(4)), dtype=np.float64)
            for key, value in own.items():
                self._parameters[name][key] = _moved(key, value, matrix)
            self._parameters[name].update()
        if self._own:
            # A shape alone was traversed, which the scene does not know of.
            self._scene.parameters_changed([])


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
