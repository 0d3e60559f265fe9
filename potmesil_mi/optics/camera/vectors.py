"""Points, vectors and matrices of NumPy and of Dr.Jit alike, for the formulas of cameras.

=================  ======================================  ======================================
What               NumPy, lists and tuples of numbers      Dr.Jit
=================  ======================================  ======================================
number             a number, or an array of shape (...)     ``Float``
point, vector      (..., 2), (..., 3) or (..., 4)           ``Array2f``, ``Array3f``, ``Array4f``,
                                                            Mitsuba's points and vectors, a tuple
                                                            of ``Float``
square matrix      (..., n, n)                              ``Matrix2f`` to ``Matrix4f``
4x3 matrix         (..., 4, 3)                              a tuple of its four rows
=================  ======================================  ======================================

Shapes of NumPy broadcast as NumPy has it. As soon as one argument is of Dr.Jit, so is the result,
in the largest precision that came in (``Float64`` counts), and it is differentiable; an argument of
NumPy then is one point or matrix, or a flat batch of them. Arrays of ``drjit.scalar`` and of
Mitsuba's scalar types count as NumPy's. Nothing here imports Dr.Jit: its arrays bring it along.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..._validation import shown
from ..arithmetic import on_host

Components = Sequence[Any]
"""The numbers of a point: floats, NumPy arrays of one shape (...), or Dr.Jit ``Float``."""


def homogeneous(points: Any, w: float = 1.0) -> Any:
    """Points with ``w`` as one more component; 1 is for points, 0 for directions."""
    return assemble([*components("points", points), w])


def multiply(matrix: Any, vectors: Any) -> Any:
    """``matrix`` times homogeneous column ``vectors``, without a division."""
    leaf = leaf_of(matrix, vectors)
    rows, vector = entries("matrix", matrix, leaf), components("vectors", vectors, None, leaf)
    _require_same("matrix", len(rows[0]), "vectors", len(vector))
    return assemble([dot(row, vector) for row in rows])


def transform_points(matrix: Any, points: Any) -> Any:
    """Points (..., n) moved by an affine matrix (..., n + 1, n + 1), whose last row is not read."""
    leaf = leaf_of(matrix, points)
    rows, point = entries("matrix", matrix, leaf), components("points", points, None, leaf)
    _require_same("matrix", len(rows[0]), "points with a 1", len(point) + 1)
    return assemble([dot(row[:-1], point) + row[-1] for row in rows[:-1]])


def transform_directions(matrix: Any, directions: Any) -> Any:
    """Directions (..., n) turned by an affine matrix (..., n + 1, n + 1), which does not shift."""
    leaf = leaf_of(matrix, directions)
    rows = entries("matrix", matrix, leaf)
    direction = components("directions", directions, None, leaf)
    _require_same("matrix", len(rows[0]), "directions with a 0", len(direction) + 1)
    return assemble([dot(row[:-1], direction) for row in rows[:-1]])


def compose(*matrices: Any) -> Any:
    """The product of matrices; the rightmost is applied first."""
    leaf = leaf_of(matrices)
    product = entries("matrices[0]", matrices[0], leaf)
    for i, matrix in enumerate(matrices[1:], 1):
        rows = entries(f"matrices[{i}]", matrix, leaf)
        _require_same(f"matrices[{i - 1}]", len(product[0]), f"matrices[{i}]", len(rows))
        columns = list(zip(*rows, strict=True))
        product = [[dot(row, column) for column in columns] for row in product]
    return assemble_matrix(product)


# ---------------------------------------------------------------- taking apart, putting together


def leaf_of(*values: Any) -> Any:
    """Dr.Jit's type of single numbers for what is computed of ``values``; ``None`` for NumPy."""
    drjit = sys.modules.get("drjit")
    if drjit is None:
        return None
    leaves: list[Any] = []
    waiting = list(values)
    while waiting:
        value = waiting.pop()
        if isinstance(value, (tuple, list)):
            waiting += value
        elif isinstance(value, drjit.ArrayBase) and drjit.is_jit_v(value):
            leaves.append(drjit.leaf_t(value))
    return drjit.expr_t(*leaves, float) if leaves else None


def number(name: str, value: Any, leaf: Any = None) -> Any:
    """``value`` as one number or a batch: NumPy's (...), or of type ``leaf``.

    A single host number stays a Python float beside Dr.Jit, so that it has every precision. Raises
    ``TypeError`` that says ``name`` for what is no number.
    """
    leaf = leaf or leaf_of(value)
    if leaf is not None and leaf_of(value) is not None:
        if sys.modules["drjit"].depth_v(value) != 1 or sys.modules["drjit"].is_tensor_v(value):
            raise TypeError(f"{name}: must be a Float and not a {type(value).__name__}")
        return leaf(value)
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}={shown(value)}: must be a number")
    if array.dtype.kind != "f":
        array = array.astype(np.float64)
    if leaf is None:
        return array[()]
    if array.ndim > 1:
        raise TypeError(
            f"{name}: has shape {array.shape}; beside arrays of Dr.Jit it must be one, or a flat "
            "batch of them"
        )
    return leaf(array) if array.ndim else float(array)


def components(name: str, value: Any, count: int | None = None, leaf: Any = None) -> list[Any]:
    """The numbers of a point or vector, of ``count`` of them if that is given.

    Raises ``TypeError`` for what is no point, ``ValueError`` for another count.
    """
    own = leaf_of(value)
    parts: list[Any]
    if own is None:
        array = np.asarray(value)
        if array.ndim == 0:
            raise TypeError(f"{name}={shown(value)}: must be a point or vector, {_shape(count)}")
        parts = [array[..., i] for i in range(array.shape[-1])]
    elif isinstance(value, (tuple, list)):
        parts = list(value)
    elif sys.modules["drjit"].is_vector_v(value) and sys.modules["drjit"].depth_v(value) == 2:
        parts = [value[i] for i in range(len(value))]
    else:
        raise TypeError(f"{name}: must be a vector such as Array3f and not {type(value).__name__}")
    if len(parts) != (count or len(parts)):
        raise ValueError(f"{name}={shown(value)}: has {len(parts)} components; must have {count}")
    leaf = leaf or own
    return [number(f"{name}[{i}]", part, leaf) for i, part in enumerate(parts)]


def finite_components(name: str, value: Any, count: int, leaf: Any = None) -> list[Any]:
    """What :func:`components` gives; raises ``ValueError`` where not all numbers are finite."""
    parts = components(name, value, count, leaf)
    for part in parts:
        require(name, parts, absolute(part) < np.inf, "finite")
    return parts


def entries(name: str, value: Any, leaf: Any = None) -> list[list[Any]]:
    """The numbers of a matrix, row by row. Raises ``TypeError`` for what is no matrix."""
    own = leaf_of(value)
    if own is None:
        array = np.asarray(value)
        if array.ndim < 2:
            raise TypeError(
                f"{name}={shown(value)}: must be a matrix, an array of shape (..., n, n)"
            )
        rows = [array[..., i, :] for i in range(array.shape[-2])]
        return [components(f"{name}[{i}]", row, None, leaf) for i, row in enumerate(rows)]
    if isinstance(value, (tuple, list)):
        return [components(f"{name}[{i}]", row, None, leaf or own) for i, row in enumerate(value)]
    if not sys.modules["drjit"].is_matrix_v(value):
        raise TypeError(f"{name}: must be a matrix such as Matrix4f and not {type(value).__name__}")
    size = range(len(value))
    return [[number(name, value[i, j], leaf or own) for j in size] for i in size]


def assemble(parts: Components) -> Any:
    """The point of these numbers: the inverse of :func:`components`."""
    leaf = leaf_of(list(parts))
    if leaf is None:
        dtype = np.result_type(*parts)
        return np.stack(np.broadcast_arrays(*parts), axis=-1).astype(dtype, copy=False)
    return _type_of("Array", len(parts), leaf)(*parts)


def assemble_matrix(rows: Sequence[Components]) -> Any:
    """The matrix of these numbers: the inverse of :func:`entries`."""
    flat = [part for row in rows for part in row]
    leaf = leaf_of(flat)
    if leaf is None:
        stacked = np.stack(np.broadcast_arrays(*flat), axis=-1)
        stacked = stacked.astype(np.result_type(*flat), copy=False)
        return stacked.reshape(*stacked.shape[:-1], len(rows), len(rows[0]))
    if len(rows) != len(rows[0]):
        return tuple(_type_of("Array", len(row), leaf)(*row) for row in rows)
    return _type_of("Matrix", len(rows), leaf)(*flat)


def _type_of(kind: str, size: int, leaf: Any) -> Any:
    """Dr.Jit's type such as ``Array3f`` for numbers of type ``leaf``."""
    suffix = leaf.__name__.replace("Float", "f")
    return getattr(sys.modules[leaf.__module__], f"{kind}{size}{suffix}")


def _shape(count: int | None) -> str:
    return f"an array of shape (..., {count or 'n'}) or Dr.Jit's Array{count or 'n'}f"


def _require_same(name: str, count: int, other: str, other_count: int) -> None:
    if count != other_count:
        raise ValueError(f"{name}: has {count} columns; must have {other_count}, as {other} has")


# ---------------------------------------------------------------- arithmetic of components


def dot(a: Components, b: Components) -> Any:
    """The inner product."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def cross(a: Components, b: Components) -> list[Any]:
    """The right-handed cross product of two vectors in space."""
    return [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]


def length(a: Components) -> Any:
    """The Euclidean length."""
    return sqrt(dot(a, a))


def scaled(a: Components, factor: Any) -> list[Any]:
    """Every component times ``factor``."""
    return [x * factor for x in a]


def unit(name: str, a: Components) -> list[Any]:
    """The vector of length 1 in the direction of ``a``; raises ``ValueError`` for a zero vector."""
    size = length(a)
    require(name, a, (size > 0) & (size < np.inf), "a finite vector other than zero")
    return scaled(a, 1 / size)


def _either(name: str) -> Callable[..., Any]:
    """The function ``name`` that NumPy and Dr.Jit both have."""

    def function(*values: Any) -> Any:
        if leaf_of(*values) is not None:
            return getattr(sys.modules["drjit"], name)(*values)
        return _like(values, getattr(np, name)(*values))

    function.__doc__ = f"``{name}`` of NumPy or of Dr.Jit."
    return function


sqrt, sin, cos, tan = (_either(name) for name in ("sqrt", "sin", "cos", "tan"))
minimum, maximum, absolute = (_either(name) for name in ("minimum", "maximum", "abs"))


def _like(values: Sequence[Any], result: Any) -> Any:
    """``result``, as a Python number where all ``values`` are: beside Dr.Jit's one of NumPy would
    widen them, as it has a precision of its own.
    """
    return result.item() if all(type(value) in (float, int, bool) for value in values) else result


def arctan2(y: Any, x: Any) -> Any:
    """The angle of (x, y) in radians."""
    leaf = leaf_of(y, x)
    if leaf is not None:
        return sys.modules["drjit"].atan2(leaf(y), leaf(x))
    return _like([y, x], np.arctan2(y, x))


def where(condition: Any, value: Any, other: Any) -> Any:
    """``value`` where the condition holds, and else ``other``."""
    if leaf_of(condition, value, other) is None:
        return _like([condition, value, other], np.where(condition, value, other)[()])
    return sys.modules["drjit"].select(condition, value, other)


def radians(degrees: Any) -> Any:
    """An angle in radians of one in degrees."""
    return degrees * (np.pi / 180)


def degrees(radians: Any) -> Any:
    """An angle in degrees of one in radians."""
    return radians * (180 / np.pi)


# ---------------------------------------------------------------- checks


def require(name: str, value: Any, condition: Any, allowed: str) -> None:
    """Raise ``ValueError`` that names the first value for which the condition does not hold.

    ``value`` is a number or a list of components. Within a symbolic loop or call of Dr.Jit nothing
    can be looked at, and nothing is refused.
    """
    leaf = leaf_of(condition)
    if leaf is not None:
        drjit = sys.modules["drjit"]
        if drjit.flag(drjit.JitFlag.SymbolicScope):
            return
    passed = np.asarray(on_host(condition))
    if passed.all():
        return
    parts = [on_host(part) for part in (value if isinstance(value, (tuple, list)) else [value])]
    passed, *parts = np.broadcast_arrays(passed, *parts)
    numbers = [float(part[~passed][0]) for part in parts]
    text = f"({', '.join(map(repr, numbers))})" if len(numbers) > 1 else repr(numbers[0])
    raise ValueError(f"{name}={text}: must be {allowed}")
