"""A focal stack: what writing its pictures adds to the refocuses that form them.

    python benchmarks/stacks.py --count 100

All pictures are formed alone, then written one after the other, by a thread meanwhile as
``potmesil stack`` does, and by one that is not known to evaluate no arrays. Seconds of processors
tell more than others where something else runs, too.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import common
import numpy as np
from common import console

import potmesil_mi as pm
from potmesil_mi import _threads
from potmesil_mi.stacks import forming
from potmesil_mi.stacks.foci import Foci
from potmesil_mi.stacks.layouts import plain_files
from potmesil_mi.stacks.plan import StackPlan


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
    arguments = options.parse_args()
    common.start(arguments)
    samples = pm.render_samples(common.load_paper_scene(arguments.res), spp=16)
    session = pm.FocusSession(samples, arguments.method)
    lenses = Foci(near=290.0, far=2000.0, count=arguments.count).lenses(samples.lens)
    for lens in lenses[:: max(len(lenses) // 8, 1)]:  # compiles what they need
        np.array(session.focus(lens))
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
        files = plain_files([str(Path(folder) / "{:04d}.exr")])
        maps = frozenset({"circles"} if arguments.circles else ())
        plan = StackPlan.of(lenses, files, how={"source": "figure11.xml"}, maps=maps)
        before, forming.Behind = forming.Behind, behind
        try:
            forming.Forming(session).do(plan, plan.items)
        finally:
            forming.Behind = before


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
