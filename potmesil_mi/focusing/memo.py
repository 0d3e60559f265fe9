"""What has been found out about samples, kept for the next focus."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Protocol, TypeVar

MAX_BYTES = 2 << 30
"""Bytes that a memo keeps by default."""


class Sized(Protocol):
    """A value that knows its memory in bytes."""

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        ...


T = TypeVar("T", bound=Sized)


class Memo:
    """Values by their keys; those that were not used for longest go first.

    ``max_bytes`` bounds them, except that the value used last is always kept. ``get`` and ``trim``
    are for one thread at a time; others may ask for ``nbytes`` or ``clear`` meanwhile.
    """

    def __init__(self, max_bytes: int = MAX_BYTES) -> None:
        self.max_bytes = max_bytes
        self.warned_of: set[str] = set()
        """What users of the samples have been warned of, which they are once."""
        self._values: dict[Hashable, Any] = {}

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of ``key``, which ``make`` makes if it is not there.

        Where ``make`` raises, nothing is changed.
        """
        value = self._values.pop(key, None)
        if value is None:
            value = make()
        self._values[key] = value
        self.trim()
        return value

    def trim(self) -> None:
        """Give up values, which may have grown, down to the bound."""
        while len(self._values) > 1 and self.nbytes > self.max_bytes:
            self._values.pop(next(iter(self._values)), None)

    @property
    def nbytes(self) -> int:
        """Memory of the values in bytes."""
        return sum(value.nbytes for value in list(self._values.values()))

    def clear(self) -> None:
        """Give up everything."""
        self._values.clear()
