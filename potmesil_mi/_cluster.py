"""Jobs of many tasks, done by the worker processes of a Dask cluster.

A worker does one task at a time, with its share of the processors of its machine. The task of a
worker that is lost is given to another: it must be safe to do it again, as it is where files are
written whole.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import dataclasses
import logging
import os
import pathlib
import re
import tempfile
import uuid
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ._progress import ProgressCallback
from ._version import package_version
from ._worker import PROFILE, Job, Run, do, forget, same, tell

LOCAL = re.compile(r"local(?::([1-9]\d{0,3}))?")
"""The address of a cluster that is started on this machine, and ends with the job: ``local``, or
``local:4`` for four workers."""

SECONDS = 6.0
"""How long is waited for an answer of a cluster."""

IN_FLIGHT = 3
"""Tasks for each worker that are given to the cluster at once: one done, others at hand."""

DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""Run by local workers: Ctrl-C reaches them, too, but it is the client that ends them."""

INSTALL = "pip install 'potmesil_mi[cluster]'"


class TaskError(RuntimeError):
    """A task that could not be done, by its ``name``, and ``why``."""

    def __init__(self, name: str, why: str) -> None:
        super().__init__(f"{name}: {why}")
        self.name, self.why = name, why


@dataclasses.dataclass
class Cluster:
    """The workers of a cluster, as :func:`joined` gives them.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``client``                    Dask's
    ``scratch``                   a folder that is gone at the end, where output is written
    ``shared``                    whether all workers see it, by the same name
    ``neighbours``                how many workers there are on the machine of each
    ``variant``                   Mitsuba's variant in the workers, ``None``: any
    ============================  ==========================================================
    """

    client: Any
    scratch: pathlib.Path
    shared: bool
    neighbours: Mapping[str, int]
    variant: str | None = None

    def require_shared(self, what: str) -> None:
        """Raise ``OSError`` unless the workers see the folder of the output."""
        if not self.shared:
            raise OSError(
                f"--cluster: {what} asks for a disk that all workers share, but they do not see "
                f"{self.scratch.parent.resolve()}; --shard 3/64 needs none"
            )

    def do(
        self,
        job: Job,
        tasks: Sequence[Any],
        names: Sequence[str],
        report: ProgressCallback,
        file: pathlib.Path | None = None,
    ) -> Iterator[tuple[Any, Any]]:
        """Do the ``tasks`` of a job that has no others, see :meth:`begun` and :meth:`Begun.do`."""
        begun = self.begun(job, file)
        yield from begun.do(tasks, names, report)
        begun.forget()

    def begun(self, job: Job, file: pathlib.Path | None = None) -> Begun:
        """A job whose tasks may depend on what others gave. All workers have ``file``, if any."""
        folder = os.getcwd() if self.shared else None
        run = Run(uuid.uuid4().hex, folder, self.variant, self.neighbours)
        data = self._sent(file)
        # As a task, and not scattered, it is there again when a worker is lost.
        common = self.client.submit(same, (run, job), pure=False)
        return Begun(self.client, run, common, data)

    def _sent(self, file: pathlib.Path | None) -> Any:
        """What tells the workers of a file: its path, or where they do not see it its bytes."""
        if file is None or self.shared:
            return None if file is None else str(file.resolve())
        return self.client.scatter((file.name, file.read_bytes()), broadcast=True, hash=False)


@dataclasses.dataclass(frozen=True)
class Begun:
    """A job that the workers of a cluster have, what they have prepared of it included.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``client``                    Dask's
    ``run``                       what the workers are told
    ``common``, ``data``          the run with the job, and what they are told of its file
    ============================  ==========================================================
    """

    client: Any
    run: Run
    common: Any
    data: Any

    def do(
        self, tasks: Sequence[Any], names: Sequence[str], report: ProgressCallback
    ) -> Iterator[tuple[Any, Any]]:
        """Do ``tasks``, and yield each of them with what it gave, in the order in which they end.

        ``names`` are theirs. In place of what a task gave there is a :class:`TaskError` where it
        could not be done. ``report`` is told how far they are. As many tasks as before go to the
        workers that had these. When the iteration ends early what has not begun is not done.
        """
        from distributed import as_completed

        workers = self.run.neighbours
        queues = _Queues(len(tasks), [*workers])
        at_work: dict[Any, tuple[int, str]] = {}

        def give(worker: str) -> None:
            number = queues.next_of(worker)
            if number is None:
                return
            future = self.client.submit(
                do, self.common, self.data, tasks[number],
                workers=[worker], allow_other_workers=True, priority=-number, pure=False,
            )  # fmt: skip
            at_work[future] = number, worker
            running.add(future)

        running = as_completed(loop=self.client.loop)
        try:
            report("Pictures", 0.0)
            for worker in [*workers] * IN_FLIGHT:
                give(worker)
            for done, future in enumerate(running, 1):
                number, worker = at_work.pop(future)
                result = _result(future, names[number])
                give(worker)
                report(names[number], done / len(tasks))
                yield tasks[number], result
        finally:
            self.client.cancel([*at_work])

    def forget(self) -> None:
        """Have the workers give up what they have prepared."""
        self.client.run(forget, self.run.name)


class _Queues:
    """Numbers of tasks, those of each worker one after the other.

    What tasks that follow each other have in common is so found out by few workers, and not by all.
    """

    def __init__(self, count: int, workers: Sequence[str]) -> None:
        ends = [count * i // len(workers) for i in range(len(workers) + 1)]
        self._left = {
            worker: collections.deque(range(*ends[i : i + 2])) for i, worker in enumerate(workers)
        }

    def next_of(self, worker: str) -> int | None:
        """The next of a worker's own, or else the last of whoever has most; ``None``: none left."""
        own = self._left[worker]
        if own:
            return own.popleft()
        longest = max(self._left.values(), key=len)
        return longest.pop() if longest else None


def require_extra() -> None:
    """Raise ``ImportError`` that tells what to install where Dask is not."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ImportError(f"--cluster: needs Dask: {INSTALL}") from None


@contextlib.contextmanager
def joined(address: str, folder: pathlib.Path, variant: str | None = None) -> Iterator[Cluster]:
    """The cluster at an ``address`` such as ``tcp://host:8786``, or ``local``, or ``local:4``.

    ``folder`` is where output is written. Raises ``ImportError`` without Dask, and ``OSError`` that
    tells what is wrong where nobody answers, there are no workers, or these cannot do tasks.
    """
    require_extra()
    from distributed import Client

    with contextlib.ExitStack() as stack:
        # What is raised tells all that the log does.
        stack.enter_context(_quiet())
        local = LOCAL.fullmatch(address)
        if local:
            where: Any = stack.enter_context(_local(int(local[1]) if local[1] else None))
        else:
            _require_answer(address)
            where = address
        client = stack.enter_context(Client(where, timeout=SECONDS, set_as_default=False))
        try:
            client.wait_for_workers(1, timeout=SECONDS)
        except (OSError, asyncio.TimeoutError):
            raise OSError(
                f"--cluster {address}: has no workers; start some with "
                f"`dask worker {address} --nthreads 1 --nworkers N`"
            ) from None
        folder.mkdir(parents=True, exist_ok=True)
        scratch = stack.enter_context(
            tempfile.TemporaryDirectory(prefix=".potmesil-", dir=folder, ignore_cleanup_errors=True)
        )
        yield _cluster(client, address, pathlib.Path(scratch), variant)


def _require_answer(address: str) -> None:
    """Raise ``OSError`` unless a scheduler answers at an address; Dask's client leaves a mess."""
    from distributed import Security
    from distributed.comm import connect

    async def ask() -> None:
        asked = Security().get_connection_args("client")
        await (await connect(address, timeout=SECONDS, **asked)).close()

    try:
        asyncio.run(ask())
    except Exception as error:
        raise OSError(
            f"--cluster {address}: no scheduler of Dask answers there within {SECONDS:g} s; must "
            f"be such as tcp://host:8786, local, or local:4 ({error})"
        ) from None


@contextlib.contextmanager
def _local(workers: int | None = None) -> Iterator[Any]:
    """A cluster on this machine, of so many workers; by default one for each processor.

    Memory is watched over by :mod:`._memory`; Dask would end workers that it thinks use too much.
    """
    import dask
    from dask.system import cpu_count
    from distributed import LocalCluster

    with (
        dask.config.set({PROFILE: False}),
        LocalCluster(
            n_workers=workers or cpu_count(),
            threads_per_worker=1,
            processes=True,
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
            preload=[DEAF],
        ) as cluster,
    ):
        yield cluster


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Dask's log tells nothing of this process within the block."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


def _cluster(client: Any, address: str, scratch: pathlib.Path, variant: str | None) -> Cluster:
    """The cluster, when its workers have been asked what they see; they must have this package."""
    token = uuid.uuid4().hex
    (scratch / "token").write_text(token, encoding="utf-8")
    try:
        found = client.run(tell, str((scratch / "token").resolve()), token, os.getcwd())
    except Exception as error:
        raise OSError(
            f"--cluster {address}: its workers must have Python and potmesil_mi "
            f"{package_version()} as this machine has them: {error}"
        ) from error
    for worker, its in found.items():
        if its.version != package_version():
            raise OSError(
                f"--cluster {address}: its worker {worker} has potmesil_mi {its.version}, and this "
                f"is {package_version()}"
            )
    if any(its.profiles for its in found.values()):
        warnings.warn(
            f"--cluster {address}: its workers look at what their threads do, which may wait for "
            "ever; start them with DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False",
            stacklevel=1,
        )
    hosts = [its.host for its in found.values()]
    neighbours = {worker: hosts.count(its.host) for worker, its in found.items()}
    return Cluster(client, scratch, all(its.sees for its in found.values()), neighbours, variant)


def _result(future: Any, name: str) -> Any:
    """What a task gave, or its error; its warnings are given here."""
    from distributed import KilledWorker

    try:
        result, warned = future.result()
    except KilledWorker:
        return TaskError(
            name,
            "the workers that did it were lost, one after the other; perhaps there is not enough "
            "memory for so many on a machine",
        )
    except asyncio.CancelledError:  # No ``Exception``.
        return TaskError(name, "the scheduler gave it up, for what it needs was lost with a worker")
    except Exception as error:
        return TaskError(name, str(error) or type(error).__name__)
    for category, text in warned:
        warnings.warn(text, category, stacklevel=1)
    return result
