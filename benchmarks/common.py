"""What the benchmarks share: the paper's scene, measures, tables and the machine they ran on."""

from __future__ import annotations

import potmesil_mi  # before mitsuba: it finds an LLVM  # noqa: F401

# isort: split
import argparse
import os
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy
from rich.console import Console
from rich.table import Table

from potmesil_mi.evaluation import metrics

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / "scenes" / "figure11.xml"
OUTPUT = ROOT / "output"
FOCUS_DISTANCES = (2000.0, 980.0, 550.0, 290.0)

# A table may be as wide as it likes where it does not go to a terminal.
console = Console(width=None if sys.stdout.isatty() else 160, highlight=False, soft_wrap=True)


def parser(description: str, **defaults: Any) -> argparse.ArgumentParser:
    """An argument parser with the options that all benchmarks have."""
    options = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    options.add_argument(
        "--variant",
        nargs="+",
        default=["cuda_ad_rgb", "llvm_ad_rgb"],
        help="Mitsuba variants, of which the first that works is taken",
    )
    options.set_defaults(**defaults)
    return options


def start(arguments: argparse.Namespace) -> None:
    """Set the variant, and say what runs where."""
    mi.set_variant(*arguments.variant)
    console.print(
        f"[bold]{mi.variant()}[/bold], Mitsuba {mi.__version__}, Dr.Jit {dr.__version__}, "
        f"NumPy {np.__version__}, SciPy {scipy.__version__}, Python "
        f"{platform.python_version()}, {os.cpu_count()} {platform.machine()} processors"
    )


def load_paper_scene(res: int, spp: int = 16) -> mi.Scene:
    """The paper's scene, Figure 11, ``res`` pixels each way."""
    return mi.load_file(str(SCENE), optimize=False, res=res, spp=spp)


def timed(action: Callable[[], Any]) -> tuple[np.ndarray, float]:
    """The picture that ``action`` makes, on the host, and the seconds that it took."""
    began = time.perf_counter()
    result = np.array(action())
    return result, time.perf_counter() - began


def first_and_steady(
    action: Callable[[], Any], repeats: int = 3
) -> tuple[np.ndarray, float, float]:
    """The picture, the seconds of the first run, and the median of ``repeats`` more."""
    picture, first = timed(action)
    return picture, first, statistics.median(timed(action)[1] for _ in range(repeats))


def table(title: str, columns: Sequence[str]) -> Table:
    """A table whose first column is text and whose others are numbers."""
    result = Table(title=title, title_justify="left", title_style="bold")
    for number, column in enumerate(columns):
        result.add_column(column, justify="right" if number else "left")
    return result


def srgb_psnr(picture: np.ndarray, reference: np.ndarray) -> float:
    """PSNR in dB of sRGB, clipped to [0, 1], of linear RGB."""
    return metrics.psnr(metrics.srgb(picture[..., :3]), metrics.srgb(reference))


def peak_memory() -> float:
    """Largest memory that this process has had so far, in GiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**30 if sys.platform == "darwin" else peak / 2**20


def memory_now() -> str:
    """Memory that this process has now, in GiB, where the system tells."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return ""
    return f"{pages * resource.getpagesize() / 2**30:.2f}"


def write_png(path: Path, picture: np.ndarray) -> None:
    """Write linear RGB as an sRGB picture."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mi.util.write_bitmap(str(path), picture.astype(np.float32), write_async=False)


def write_comparison(
    folder: Path, stem: str, name: str, picture: np.ndarray, reference: np.ndarray
) -> None:
    """The picture, the reference and the difference, grey for none and 4 times enlarged."""
    write_png(folder / f"{stem}_thinlens.png", reference)
    write_png(folder / f"{stem}_{name}.png", picture)
    difference = np.clip(picture, 0, 1) - np.clip(reference, 0, 1)
    write_png(folder / f"{stem}_{name}_difference.png", np.clip(0.214 + 2 * difference, 0, 1))
