"""Arithmetic and checks for numbers, NumPy arrays and Dr.Jit arrays alike."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .._validation import shown


def is_drjit(value: Any) -> bool:
    """Whether ``value`` is an array of Dr.Jit, which this does not import."""
    return type(value).__module__.startswith("drjit")


def on_host(value: Any) -> Any:
    """``value`` as a NumPy array, for checks and for results that are plain numbers."""
    if isinstance(value, str):
        return np.asarray(value)
    if is_drjit(value):
        import drjit as dr

        value = dr.detach(value)
    return np.asarray(value)


def positive_finite(values: np.ndarray) -> Any:
    """Which values are > 0 and finite."""
    return (values > 0) & np.isfinite(values)


def require_each(name: str, value: Any, allowed: str, test: Callable[[np.ndarray], Any]) -> None:
    """Raise unless every element of ``value`` is a number that passes ``test``.

    A list is none, since nothing can be computed with it.
    """
    values = np.empty(0, object) if isinstance(value, (list, tuple)) else on_host(value)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"{name}={shown(value)}: must be a number {allowed}")
    passed = test(values)
    if not np.all(passed):
        values, passed = np.broadcast_arrays(values, passed)
        wrong = value if np.ndim(value) == 0 else values[~passed][0]
        raise ValueError(f"{name}={shown(wrong)}: must be {allowed}")


def single(name: str, value: Any) -> float:
    """``value``, of one element, as a plain number. Raises ``ValueError`` where it has several."""
    values = on_host(value)
    if values.size != 1:
        raise ValueError(f"{name}={shown(value)}: has shape {values.shape}, must be one number")
    return float(values.item())


def reciprocal(value: Any) -> Any:
    """1/value with 1/0 = inf, for numbers and arrays of any kind."""
    if isinstance(value, (int, float)):
        return math.copysign(math.inf, value) if value == 0 else 1 / value
    if isinstance(value, (np.ndarray, np.generic)):
        with np.errstate(divide="ignore"):
            return np.true_divide(1.0, value)
    return 1 / value


def clamp_at_zero(value: Any) -> Any:
    """The larger of value and 0, for numbers and arrays of any kind."""
    if isinstance(value, (int, float)):
        return max(value, 0.0)
    if isinstance(value, (np.ndarray, np.generic)):
        return np.maximum(value, 0.0)
    import drjit as dr

    return dr.maximum(value, 0.0)
