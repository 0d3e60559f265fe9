"""How long samples take to be saved, loaded and focused from a file, and how large that is.

    python benchmarks/storage.py --res 512 --spp 16 --repeats 5

Times are medians of the clock; the formats are measured in turns. A focus is a whole process of
``potmesil focus``, from its start to its end, whose kernels are in Dr.Jit's cache.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common

import potmesil_mi as pm
from potmesil_mi.samples.files import ENDINGS

PROGRAM = (sys.executable, "-c", "import sys; from potmesil_mi.cli import main; sys.exit(main())")


def focused(path: Path) -> Callable[[], Any]:
    """What focuses a file in a process of its own."""
    command = [*PROGRAM, "focus", str(path), "-o", str(path.with_name("picture.exr"))]
    return lambda: subprocess.run(command, check=True, cwd=common.ROOT)


def seconds(action: Callable[[], Any]) -> float:
    began = time.perf_counter()
    action()
    return time.perf_counter() - began


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=512, help="pixels each way")
    options.add_argument("--spp", type=int, default=16, help="samples a pixel")
    options.add_argument("--repeats", type=int, default=5)
    arguments = options.parse_args()
    common.start(arguments)
    samples = pm.render_samples(common.load_paper_scene(arguments.res), spp=arguments.spp)

    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"samples{ending}") for ending in ENDINGS]
        times: dict[str, list[list[float]]] = {path.suffix: [] for path in paths}
        for turn in range(arguments.repeats + 1):
            for path in paths:
                took = [
                    seconds(lambda path=path: samples.save(path)),
                    seconds(lambda path=path: pm.PointSamples.load(path)),
                    seconds(focused(path)),
                ]
                if turn > 0:  # The first imports libraries, and fills caches.
                    times[path.suffix].append(took)
        table = common.table(
            f"{len(samples):,} samples, {samples.nbytes / 1e6:.0f} MB in memory",
            ["file", "save (s)", "load (s)", "potmesil focus (s)", "MB", "bytes a sample"],
        )
        for path in paths:
            size = path.stat().st_size
            medians = [
                statistics.median(column) for column in zip(*times[path.suffix], strict=True)
            ]
            table.add_row(
                path.suffix,
                *(f"{median:.2f}" for median in medians),
                f"{size / 1e6:.1f}",
                f"{size / len(samples):.1f}",
            )
    common.console.print(table)


if __name__ == "__main__":
    main()
