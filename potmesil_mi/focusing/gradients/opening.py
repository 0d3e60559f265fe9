"""The opening of the lens with gradients: how what is made of an aperture changes with it.

What is made of it is found out in NumPy, once for its numbers, and beside it the derivative: for
parameters that are numbers central differences in double precision, for a picture, in which
kernels are linear but for what the whole lets through, the exact one and its transpose.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, Protocol

import drjit as dr
import numpy as np
import scipy.spatial

from ... import _backend as jit
from ...optics.aperture import Aperture
from ...optics.disc import Disc
from ...optics.psf import PointSpreadFunction
from ..fragments import as_column
from ..kernels import KernelFactory

CELL_PIXELS = 20
"""Pixels, at least, that lie around each lens point in the kernel that tells how much light goes
through there."""


class Slope(Protocol):
    """The derivative of n numbers in P parameters: a linear map, and its transpose."""

    def along(self, parameters: np.ndarray) -> np.ndarray:
        """How the numbers, (n,), change as the parameters, (P,), do."""

    def back(self, numbers: np.ndarray) -> np.ndarray:
        """The transpose: of (n,) what each parameter has, (P,)."""


@dataclasses.dataclass(frozen=True)
class AttachedKernels:
    """Kernels with gradients: the numbers of all, each of a shape (rows, columns)."""

    values: jit.Float
    shapes: list[tuple[int, int]]


def parted(numbers: np.ndarray, shapes: Sequence[tuple[int, int]]) -> list[np.ndarray]:
    """The arrays (rows, columns) of some ``shapes`` that have the ``numbers``."""
    ends = np.cumsum([rows * columns for rows, columns in shapes])
    parts = np.split(numbers, ends[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


class Opening:
    """An aperture, and what is made of it, attached to its parameters; this one has no gradients.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``psf``                       that of kernels, of plain numbers
    ``seen_from``                 the aperture from whose points visibility is found
    ============================  ==========================================================

    Points of an aperture jump, or what they see does, where its parameters change. So visibility is
    found from points all over the circle if there are gradients, and what each of them counts
    changes smoothly.
    """

    def __init__(self, psf: PointSpreadFunction, seen_from: Aperture) -> None:
        self.psf, self.seen_from = psf, seen_from

    def kernels(
        self, factory: KernelFactory, radii: np.ndarray, kernels: Sequence[np.ndarray]
    ) -> AttachedKernels | None:
        """The ``kernels`` that the ``factory`` makes for circles of some radii in its pixels."""
        return None

    def responses(self, responses: np.ndarray, squeeze: float) -> jit.Float:
        """The numbers of the ``responses`` of :func:`.responses_of`."""
        return as_column(responses)

    def weights(self, count: int) -> jit.Float | None:
        """How much light goes through around each of ``count`` points, 1 on the average."""
        return None


def radius_of_cells(count: int) -> int:
    """Radius in pixels of the kernel in which there are ``count`` points."""
    return math.ceil(math.sqrt(CELL_PIXELS * count / math.pi))


@functools.lru_cache(maxsize=8)
def nearest_points(count: int) -> np.ndarray:
    """Which of the points of a disc is nearest to each pixel of their kernel."""
    radius = radius_of_cells(count)
    place = np.arange(-radius, radius + 1) / radius
    places = np.stack(np.meshgrid(place, place), axis=-1)
    return np.asarray(scipy.spatial.cKDTree(Disc().points(count)).query(places)[1])


class _Attach(dr.CustomOp):
    """Numbers that were found out without gradients, attached to parameters."""

    def eval(self, parameters: jit.Float, numbers: np.ndarray, slope: Slope) -> jit.Float:
        self.slope = slope
        return as_column(numbers.astype(np.float32))

    def forward(self) -> None:
        parameters = np.array(self.grad_in("parameters"), dtype=np.float64)
        self.set_grad_out(as_column(self.slope.along(parameters).astype(np.float32)))

    def backward(self) -> None:
        numbers = np.array(self.grad_out(), dtype=np.float64)
        self.set_grad_in("parameters", as_column(self.slope.back(numbers).astype(np.float32)))

    def name(self) -> str:
        return "aperture"


def attached(parameters: jit.Float, numbers: np.ndarray, slope: Slope) -> Any:
    """The ``numbers``, (n,), that the ``parameters``, (P,), make, with the derivative in these."""
    return dr.custom(_Attach, parameters, numbers, slope)


def as_image(kernel: np.ndarray) -> np.ndarray:
    """A kernel (rows, columns), also of one that is a row, which spreads along both axes."""
    return np.outer(kernel, kernel) if kernel.ndim == 1 else kernel
