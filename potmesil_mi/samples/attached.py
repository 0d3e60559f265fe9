"""Columns of samples with gradients: Dr.Jit arrays beside the plain columns of the same numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from .. import _backend as jit
from .._validation import shown
from ..optics.attached import array_of, has_gradient

WITH_GRADIENTS = ("rgb", "alpha", "z", "weight")
"""The columns in which a picture is differentiable."""


@dataclasses.dataclass(frozen=True, eq=False)
class AttachedColumn:
    """A column that has gradients.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``values``                    its Dr.Jit array, (N,), or of RGB (3 N,)
    ``column``                    its numbers, as the samples have them
    ============================  ==========================================================
    """

    values: Any
    column: np.ndarray

    def chosen(self, which: np.ndarray | slice, column: np.ndarray) -> AttachedColumn:
        """The samples that ``which`` has, whose column is given."""
        import drjit as dr

        index = np.arange(len(self.column))[which]
        channels = self.column.size // len(self.column)
        index = (index[:, None] * channels + np.arange(channels)).ravel()
        return AttachedColumn(
            dr.gather(jit.Float, self.values, jit.from_numpy(jit.UInt32, index)), column
        )


def taken_from(
    columns: Mapping[str, Any], of: Sequence[str] = WITH_GRADIENTS
) -> dict[str, tuple[Any, np.ndarray]]:
    """Of some columns those with gradients: their arrays, and their numbers as NumPy has them.

    ``of`` are the names of those that may have some. Raises ``TypeError`` for gradients of a
    column, or of a type, of which there are none.
    """
    found = {}
    for name, column in columns.items():
        if not has_gradient(column):
            continue
        import drjit as dr

        if name not in of:
            raise TypeError(
                f"{name}={shown(column)}: has gradients enabled, but pictures have derivatives in "
                f"{', '.join(of)} only; detach it, as by dr.detach"
            )
        values = array_of(name, column)
        plain = np.array(dr.detach(column))
        # Dr.Jit's vectors have their channels first.
        is_vector = plain.ndim == 2 and not dr.is_tensor_v(column)
        found[name] = values, plain.T if is_vector else plain
    return found


def require_unattached(attached: Iterable[str], what: str) -> None:
    """Raise ``NotImplementedError`` that ``what`` has no derivatives, if columns are attached."""
    for name in attached:
        raise NotImplementedError(
            f"{name}: has gradients enabled, but {what} has no derivatives; do that first, and "
            "attach the gradients to what it returns"
        )
