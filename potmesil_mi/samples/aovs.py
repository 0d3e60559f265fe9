"""AOVs of samples: their names, and what these say of the values.

An integrator such as Mitsuba's ``aov`` gives each ray values beside its radiance. The last part of
the name of each, as in ``dd.T`` or ``nn.X``, says what it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._validation import shown

MOST_AOVS = 63
"""AOVs of a sample, at most: the bytes of these are counted by one byte in archives."""

LONGEST_AOV_NAME = 200
"""Bytes of a name, at most: names of channels in EXR have up to 255."""

DISTANCE, ID = ".T", ".I"
"""How names of distances along the ray end, and of numbers of primitives and shapes."""


def require_aov_names(names: Any) -> tuple[str, ...]:
    """The names of AOVs, a sequence of texts.

    Raises ``ValueError`` or ``TypeError`` for more than ``MOST_AOVS``, for names that are empty,
    too long or not printable, and for the same one twice.
    """
    if isinstance(names, (str, bytes)) or not isinstance(names, Sequence):
        raise TypeError(f"aov_names={shown(names)}: must be a sequence of names")
    if len(names) > MOST_AOVS:
        raise ValueError(
            f"aov_names={shown(names)}: has {len(names)} names, must have at most {MOST_AOVS}"
        )
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"aov_names={shown(names)}: {shown(name)} must be text")
        if not name.isprintable() or not 0 < len(name.encode()) <= LONGEST_AOV_NAME:
            raise ValueError(
                f"aov_names={shown(names)}: {shown(name)} must be printable, of 1 to "
                f"{LONGEST_AOV_NAME} bytes"
            )
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        raise ValueError(
            f"aov_names={shown(names)}: {shown(twice[0])} is there twice, each must be another"
        )
    return tuple(names)


def require_named(names: Sequence[str], aovs: np.ndarray | None) -> None:
    """Raise ``ValueError`` unless there is a name for each column of ``aovs``, (N, K)."""
    count = 0 if aovs is None else aovs.shape[1]
    if len(names) != count:
        raise ValueError(
            f"aov_names={shown(names)}: has {len(names)} names, must have {count}, as many as "
            f"columns of aovs={shown(aovs)}"
        )


def are_ids(names: Sequence[str]) -> np.ndarray:
    """Which AOVs are numbers of things, of which there is no mean, bool (K,)."""
    return np.array([name.endswith(ID) for name in names], dtype=bool)
