"""Checks of parameters that several modules share."""

from __future__ import annotations

from typing import Any

import numpy as np


def require_whole(name: str, value: Any, least: int, most: int) -> None:
    """Raise ``TypeError`` unless ``value`` is whole, ``ValueError`` unless it is in range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}={value!r}: must be a whole number from {least} to {most}")
    if not least <= value <= most:
        raise ValueError(f"{name}={value}: must be {least} to {most}")
