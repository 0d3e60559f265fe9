"""What a worker process of a Dask cluster does: see :mod:`potmesil_mi._cluster`."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
import socket
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from . import _backend as jit
from ._progress import progress
from ._version import package_version

PROFILE = "distributed.worker.profile.enabled"
"""A setting of Dask by which workers look at the frames of threads again and again: that may wait
for ever, see :func:`potmesil_mi._backend.evaluates_alone`."""

KEEP_MEMORY = {-1: 1 << 30, -3: 32 << 20}
"""``M_TRIM_THRESHOLD`` and ``M_MMAP_THRESHOLD`` of glibc. As Dask sets the first each array is new
memory of the system, and a focus takes three times as long."""


class Job(Protocol):
    """What tasks have in common. It goes to the workers by ``pickle``."""

    def prepared(self, file: Path | None) -> Any:
        """What its tasks need; made once in each worker, of the ``file`` that all of them have."""

    def do(self, prepared: Any, task: Any) -> Any:
        """Do a task; what it returns comes back."""


@dataclasses.dataclass(frozen=True)
class Run:
    """What the workers are told of a run.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``name``                      one of its own
    ``folder``                    in which tasks are done, ``None`` where the disk is not shared
    ``variant``                   Mitsuba's
    ``neighbours``                how many workers there are on the machine of each
    ============================  ==========================================================
    """

    name: str
    folder: str | None
    variant: str | None
    neighbours: Mapping[str, int]


_working = threading.Lock()
"""Held by the task that is done: the arrays of Dr.Jit are for one thread at a time."""

_kept: dict[str, Any] = {}
"""What the last run has prepared in this process, by its name."""


def same(value: Any) -> Any:
    """The value itself: as a task, so that Dask has it again when a worker is lost."""
    return value


class Told(NamedTuple):
    """What a worker tells: its machine, whether it shares the disk and profiles, the version."""

    host: str
    sees: bool
    profiles: bool
    version: str


def tell(path: str, text: str, folder: str) -> Told:
    """What a worker tells; the disk is shared if a ``text`` is in a file, and a folder there."""
    import dask

    try:
        sees = Path(path).read_text(encoding="utf-8") == text and Path(folder).is_dir()
    except OSError:
        sees = False
    profiles = bool(dask.config.get(PROFILE, False))
    return Told(socket.gethostname(), sees, profiles, package_version())


def do(common: tuple[Run, Job], data: Any, task: Any) -> tuple[Any, list[Any]]:
    """Do a task in a worker; returns what it gave, and its warnings."""
    run, job = common
    with contextlib.ExitStack() as stack:
        stack.enter_context(_working)
        stack.enter_context(jit.alone())
        stack.enter_context(progress(lambda text, share: None))
        stack.enter_context(_in_folder(run.folder))
        warned = stack.enter_context(warnings.catch_warnings(record=True))
        if run.name not in _kept:
            _kept.clear()
            _prepare(run)
            _kept[run.name] = _prepared(job, data)
        result = job.do(_kept[run.name], task)
    return result, [(of.category, str(of.message)) for of in warned]


def forget(name: str) -> None:
    """Give up what a run has prepared in this process."""
    _kept.pop(name, None)


def _prepare(run: Run) -> None:
    """Dr.Jit's threads are as many as leave each worker of the machine its own processors."""
    import drjit as dr
    from dask.system import cpu_count
    from distributed import get_worker

    with contextlib.suppress(AttributeError, OSError, TypeError):  # Only glibc has them.
        for setting, size in KEEP_MEMORY.items():
            ctypes.CDLL(None).mallopt(setting, size)
    neighbours = run.neighbours.get(get_worker().address, max(run.neighbours.values(), default=1))
    dr.set_thread_count(max(cpu_count() // neighbours, 1))
    if run.variant is not None:
        import mitsuba as mi

        mi.set_variant(*run.variant.split(","))


def _prepared(job: Job, data: str | tuple[str, bytes] | None) -> Any:
    """What the tasks of a job need, of the path of its file, or of its name and bytes."""
    if not isinstance(data, tuple):
        return job.prepared(None if data is None else Path(data))
    with tempfile.TemporaryDirectory() as folder:
        name, content = data
        file = Path(folder) / name
        file.write_bytes(content)
        return job.prepared(file)


@contextlib.contextmanager
def _in_folder(folder: str | None) -> Iterator[None]:
    """Relative paths are those of the ``folder`` within the block."""
    if folder is None:
        yield
        return
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
