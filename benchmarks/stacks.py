"""A focal stack: what writing its pictures adds to the refocuses that form them.

    python benchmarks/stacks.py --count 100
    python benchmarks/stacks.py --count 100 --cluster local

All pictures are formed alone, then written one after the other, by a thread meanwhile as
``potmesil stack`` does, and by one that is not known to evaluate no arrays. Seconds of processors
tell more than others where something else runs, too. With ``--cluster`` one process, with all its
threads, with one alone and on one processor, is compared with the workers of a cluster, whose
processors are theirs: with one thread a process still writes on another processor meanwhile.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import common
import drjit as dr
import numpy as np
from common import console

import potmesil_mi as pm
from potmesil_mi import _backend as jit
from potmesil_mi import _threads
from potmesil_mi._cluster import joined
from potmesil_mi.stacks import forming
from potmesil_mi.stacks.foci import Foci
from potmesil_mi.stacks.layouts import plain_files
from potmesil_mi.stacks.plan import StackPlan
from potmesil_mi.stacks.workers import do_elsewhere


class InTurn:
    """Does jobs at once, in the place of ``Behind``."""

    def __enter__(self) -> InTurn:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def do(self, job: Callable[[], object]) -> None:
        job()


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--count", type=int, default=100, help="pictures")
    options.add_argument("--res", type=int, default=512, help="pixels each way")
    options.add_argument("--method", default="layered")
    options.add_argument("--repeats", type=int, default=1)
    options.add_argument("--circles", action="store_true", help="with a map of circles for each")
    options.add_argument("--cluster", help="local, or the address of a cluster")
    arguments = options.parse_args()
    common.start(arguments)
    samples = pm.render_samples(common.load_paper_scene(arguments.res), spp=16)
    session = pm.FocusSession(samples, arguments.method)
    lenses = Foci(near=290.0, far=2000.0, count=arguments.count).lenses(samples.lens)
    for lens in lenses[:: max(len(lenses) // 8, 1)]:  # compiles what they need
        np.array(session.focus(lens))
    if arguments.cluster:
        by_cluster(arguments, session, lenses)
        return
    ways = {
        "refocuses alone": lambda: alone(session, lenses),
        "written in turn": lambda: written(arguments, session, lenses, InTurn),
        "written behind": lambda: written(arguments, session, lenses, _threads.Behind),
        "by any thread": lambda: by_any_thread(arguments, session, lenses),
    }
    result = common.table(
        f"{arguments.count} pictures of figure11, {arguments.res}x{arguments.res}, "
        f"{arguments.method}: seconds",
        ["", "all", "of processors", "beyond the refocuses"],
    )
    for _ in range(arguments.repeats):
        first = None
        for name, way in ways.items():
            began, used = time.perf_counter(), time.process_time()
            way()
            took, used = time.perf_counter() - began, time.process_time() - used
            first = took if first is None else first
            result.add_row(name, f"{took:.1f}", f"{used:.1f}", f"{took - first:+.1f}")
    console.print(result)


def alone(session: pm.FocusSession, lenses: list[pm.ThinLens]) -> None:
    for lens in lenses:
        np.array(session.focus(lens))


def written(
    arguments: argparse.Namespace,
    session: pm.FocusSession,
    lenses: list[pm.ThinLens],
    behind: type,
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        plan = plan_in(folder, arguments, lenses)
        before, forming.Behind = forming.Behind, behind
        try:
            forming.Forming(session).do(plan, plan.items)
        finally:
            forming.Behind = before


def plan_in(folder: str, arguments: argparse.Namespace, lenses: list[pm.ThinLens]) -> StackPlan:
    files = plain_files([str(Path(folder) / "{:04d}.exr")])
    maps = frozenset({"circles"} if arguments.circles else ())
    return StackPlan.of(lenses, files, how={"source": "figure11.xml"}, maps=maps)


@contextlib.contextmanager
def on_one_processor() -> Iterator[None]:
    """Bind all threads of this process to one processor; those that they start are so, too."""
    tasks = [int(task) for task in os.listdir("/proc/self/task")]
    before = {task: os.sched_getaffinity(task) for task in tasks}
    try:
        for task in tasks:
            os.sched_setaffinity(task, {min(before[task])})
        yield
    finally:
        for task in os.listdir("/proc/self/task"):
            with contextlib.suppress(ProcessLookupError):
                os.sched_setaffinity(int(task), before.get(int(task), before[os.getpid()]))


def by_cluster(
    arguments: argparse.Namespace, session: pm.FocusSession, lenses: list[pm.ThinLens]
) -> None:
    result = common.table(
        f"{arguments.count} pictures of figure11, {arguments.res}x{arguments.res}, "
        f"{arguments.method}: seconds",
        ["", "all", "of processors", "one process to this"],
    )
    threads = dr.thread_count()
    with (
        tempfile.TemporaryDirectory() as folder,
        joined(arguments.cluster, Path(folder)) as cluster,
    ):

        def together() -> None:
            with jit.alone():
                do_elsewhere(cluster, forming.Forming(session), plan, plan.items)

        def alone_with(count: int) -> Callable[[], None]:
            def run() -> None:
                dr.set_thread_count(count)
                own = pm.FocusSession(session.samples, session.method)
                with jit.alone():
                    forming.Forming(own).do(plan, plan.items)
                dr.set_thread_count(threads)

            return run

        def on_one() -> None:
            with on_one_processor():
                alone_with(1)()

        def used() -> float:
            return time.process_time() + sum(cluster.client.run(time.process_time).values())

        plan = plan_in(folder, arguments, lenses)
        ways = {
            f"one process, {threads} threads": alone_with(threads),
            "one process, 1 thread": alone_with(1),
            "one process on one processor": on_one,
            f"{len(cluster.neighbours)} workers": together,
        }
        warm = plan_in(folder, arguments, lenses[:: max(len(lenses) // 8, 1)])
        do_elsewhere(cluster, forming.Forming(session), warm, warm.items)
        for _ in range(arguments.repeats):
            rows = {}
            for name, way in ways.items():
                if way is on_one and not Path("/proc/self/task").is_dir():
                    console.print(f"{name}: is measured on Linux alone")
                    continue
                began, before = time.perf_counter(), used()
                way()
                rows[name] = time.perf_counter() - began, used() - before
            last = rows[name][0]
            for name, (took, busy) in rows.items():
                result.add_row(name, f"{took:.1f}", f"{busy:.1f}", f"{took / last:.2f}")
    console.print(result)


def by_any_thread(
    arguments: argparse.Namespace, session: pm.FocusSession, lenses: list[pm.ThinLens]
) -> None:
    before, _threads.HostThread = _threads.HostThread, threading.Thread
    try:
        written(arguments, session, lenses, _threads.Behind)
    finally:
        _threads.HostThread = before


if __name__ == "__main__":
    main()
