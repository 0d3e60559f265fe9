"""Refocusing in several threads and processes at once: right pictures, and memory that stays flat.

    python benchmarks/threads.py

Each thread focuses the same samples, and each process its own, at distances of its own in turn;
each picture is compared with the one that a single thread made before.
"""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import common
import mitsuba as mi
import numpy as np
from common import console

import potmesil_mi as pm
from potmesil_mi._memory import entry_in_bytes

DISTANCES = 20


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--at-once", type=int, default=4, help="threads, and then processes")
    options.add_argument("--refocuses", type=int, default=1000, help="of all threads together")
    options.add_argument("--method", default="layered")
    options.add_argument("--res", type=int, default=96)
    options.add_argument("--alone", action="store_true", help="as one of the processes")
    arguments = options.parse_args()
    common.start(arguments)
    scene = mi.load_file(str(common.SCENE), optimize=False, res=arguments.res)
    samples = pm.render_samples(scene, spp=4, seed=1)
    lenses = [samples.lens.replace(focus_distance=290 + 60 * i) for i in range(DISTANCES)]
    expected = [np.array(pm.focus(samples, lens, method=arguments.method)) for lens in lenses]

    def refocus(thread: int, count: int) -> float:
        worst = 0.0
        for step in range(count):
            i = (7 * thread + step) % DISTANCES
            picture = np.array(pm.focus(samples, lenses[i], method=arguments.method))
            worst = max(worst, float(np.abs(picture - expected[i]).max()))
        return worst

    threads = 1 if arguments.alone else arguments.at_once
    with ThreadPoolExecutor(threads) as pool:
        memory = []
        worst = 0.0
        for _ in range(4):
            each = arguments.refocuses // threads // 4
            worst = max(worst, *pool.map(refocus, range(threads), [each] * threads))
            memory.append(resident())
    quarters = ", ".join(f"{of:.0f}" for of in memory)
    console.print(
        f"{threads} threads, {arguments.refocuses} refocuses: largest difference {worst:.1g}, "
        f"MB after each quarter: {quarters}"
    )
    if arguments.alone:
        sys.exit(int(worst > 1e-4))
    count = arguments.refocuses // threads
    command = [sys.executable, __file__, "--alone", "--refocuses", str(count)]
    command += ["--method", arguments.method, "--res", str(arguments.res)]
    processes = [
        subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(arguments.at_once)
    ]
    wrong = sum(process.wait() != 0 for process in processes)
    console.print(f"{arguments.at_once} processes: {wrong} with a wrong picture or an error")


def resident() -> float:
    """Memory of this process in MB."""
    found = entry_in_bytes(Path("/proc/self/status"), "VmRSS")
    return float("nan") if found is None else found / 2**20


if __name__ == "__main__":
    main()
