"""What can be changed of point samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np

from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from .provenance import Provenance
from .raster import Window


class Changes(TypedDict, total=False):
    """What :meth:`PointSamples.replace` can change: the fields of :class:`PointSamples`.

    Some columns may be Dr.Jit arrays with gradients.
    """

    x: np.ndarray
    y: np.ndarray
    rgb: Any
    alpha: Any
    z: Any
    surface: np.ndarray
    weight: Any
    layer: np.ndarray | None
    through: np.ndarray | None
    visibility: np.ndarray | None
    albedo: np.ndarray | None
    normal: np.ndarray | None
    time: np.ndarray | None
    motion: np.ndarray | None
    aovs: np.ndarray | None
    aov_names: Sequence[str]
    visibility_radius: Sequence[float] | None
    camera: Camera
    lens: ThinLens | TelecentricLens
    surfaces: Mapping[int, str]
    lattice: int
    window: Window | None
    provenance: Provenance
