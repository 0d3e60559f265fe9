"""How long Python and the program take to start: medians of new processes.

    python benchmarks/import_time.py --repeats 9

The first run of each is not counted: it reads files that the others find in memory.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
PROGRAM = (sys.executable, "-c", "import sys; from potmesil_mi.cli import main; sys.exit(main())")
VARIANT = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb')"


def python(code: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code)


CASES = {
    "python": python("pass"),
    "import numpy": python("import numpy"),
    "import mitsuba": python("import mitsuba"),
    "import potmesil_mi": python("import potmesil_mi"),
    "import mitsuba, potmesil_mi": python("import mitsuba, potmesil_mi"),
    "import mitsuba; mi.set_variant": python(VARIANT),
    "the same, and potmesil_mi": python(f"import potmesil_mi; {VARIANT}"),
    "the same, and pm.focus": python(f"import potmesil_mi as pm; {VARIANT}; pm.focus"),
    "potmesil --help": (*PROGRAM, "--help"),
    "potmesil --version": (*PROGRAM, "--version"),
    "potmesil dof": (*PROGRAM, "dof"),
    "potmesil focus --help": (*PROGRAM, "focus", "--help"),
    "potmesil render --help": (*PROGRAM, "render", "--help"),
}


def seconds(command: Sequence[str]) -> tuple[float, float]:
    """Of the clock, and of the processor, which others at work change less."""
    began, used = time.perf_counter(), processor()
    subprocess.run(command, check=True, cwd=REPOSITORY, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began, processor() - used


def processor() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--repeats", type=int, default=9)
    repeats = options.parse_args().repeats
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in CASES}
    for turn in range(repeats + 1):  # in turns, so that what else runs falls on all alike
        for name, command in CASES.items():
            took = seconds(command)
            if turn > 0:
                times[name].append(took)
    print(f"{'':32}{'median s':>10}{'least s':>10}{'CPU s':>10}")
    for name, taken in times.items():
        clock, cpu = zip(*taken, strict=True)
        print(
            f"{name:32}{statistics.median(clock):10.2f}{min(clock):10.2f}"
            f"{statistics.median(cpu):10.2f}"
        )


if __name__ == "__main__":
    main()
