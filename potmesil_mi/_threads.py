"""Work that is shared among threads."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import TypeVar

T = TypeVar("T")

MOST_WAITING = 2
"""Jobs that wait for a thread, each of which may hold a picture; one more waits for room."""


class HostThread(threading.Thread):
    """A thread that evaluates no arrays, see :func:`potmesil_mi._backend.evaluates_alone`."""


class Behind:
    """Jobs that are done behind one's back, one after the other, within a ``with`` block.

    They are to be work of NumPy and of files, and none of Dr.Jit: then pictures are formed as fast
    as if there were no other thread. At the end of the block all jobs are done. The error of a job
    comes out of the next :meth:`do`, or at the end; no job is done after it.
    """

    def __init__(self) -> None:
        self._jobs: queue.Queue[Callable[[], object] | None] = queue.Queue(MOST_WAITING)
        self._error: BaseException | None = None
        self._thread = HostThread(target=self._work, name="potmesil_mi behind")

    def __enter__(self) -> Behind:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        self._jobs.put(None)
        self._thread.join()
        if error is None:
            self._raise()

    def do(self, job: Callable[[], object]) -> None:
        """Have a job done, when those before it are; waits while too many of them wait."""
        self._raise()
        self._jobs.put(job)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._error is None:
                try:
                    job()
                except BaseException as error:
                    self._error = error

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error


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
