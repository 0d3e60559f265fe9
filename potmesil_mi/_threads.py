"""Work that is shared among threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def processors() -> int:
    """How many threads may work at once."""
    return os.cpu_count() or 1


def for_each(work: Callable[[T], object], items: Sequence[T]) -> None:
    """Do ``work`` for each of the ``items``, by as many threads as there are processors.

    It is to be work of NumPy or SciPy, which lets other threads run, and none of Dr.Jit: see
    :func:`potmesil_mi._backend.evaluates_alone`. The threads have ended when this returns.
    """
    workers = min(processors(), len(items))
    if workers <= 1:
        for item in items:
            work(item)
        return
    with ThreadPoolExecutor(workers) as pool:
        for _ in pool.map(work, items):
            pass
