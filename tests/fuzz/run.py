"""Try broken files, as many as one likes, and print what became of them.

    python tests/fuzz/run.py --cases 10000
    python tests/fuzz/run.py --files ~/files-of-others      # these instead, as they are

Each is loaded, and a picture formed of what it holds, in a process of its own kind that is started
anew where it dies or takes too long. Memory is the most that a file takes beyond what the process
had before. With ``--keep FOLDER`` files are kept that are none of "error" and "picture".
"""

from __future__ import annotations

import argparse
import collections
import multiprocessing
import sys
import tempfile
import time
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

LONGEST = 10.0
"""Seconds that a file may take."""

MOST_MEMORY = 500 << 20
"""Bytes of memory that a file of less than ``SMALL`` bytes may take."""

SMALL = 100_000

EXPECTED = ("error", "picture")
TOO_LONG, TOO_LARGE = f"over {LONGEST:g} s", "over 500 MB"
FAULTS = ("died", TOO_LONG, TOO_LARGE, "traceback", "NaN picture", "error without the name")


def main() -> int:
    """Run from the command line; returns 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--files", type=Path, help="a folder of files to be tried as they are")
    parser.add_argument("--keep", type=Path, help="a folder for the files that are faults")
    options = parser.parse_args()
    counts: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder))
        files = sorted(p for p in options.files.rglob("*") if p.is_file()) if options.files else []
        count = len(files) if options.files else options.cases
        began = time.monotonic()
        for number in range(count):
            asked = str(files[number]) if files else options.first + number
            outcome, detail, path = trial.run(asked)
            counts[outcome] += 1
            if outcome not in EXPECTED:
                print(f"{asked}: {outcome}: {detail}", flush=True)
                if options.keep and path is not None and path.is_file():
                    options.keep.mkdir(parents=True, exist_ok=True)
                    (options.keep / f"{number}_{path.name}").write_bytes(path.read_bytes())
            if (number + 1) % 500 == 0:
                print(f"{number + 1} of {count}, {time.monotonic() - began:.0f} s", flush=True)
        trial.stop()
    print(f"{count} files")
    for name in (*FAULTS, *EXPECTED):
        print(f"  {name:24s}{counts[name]:8d}")
    return int(any(counts[name] for name in FAULTS))


class Trial:
    """A process that tries files, and what watches it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.start()

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.ours, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs, str(self.folder)), daemon=True)
        self.process.start()
        theirs.close()
        self.ours.recv()

    def stop(self) -> None:
        self.process.kill()
        self.process.join()
        self.ours.close()

    def run(self, asked: int | str) -> tuple[str, str, Path | None]:
        """What became of a file, what there is to say of it, and where it is."""
        self.ours.send(asked)
        began = time.monotonic()
        path = None
        try:
            while True:
                # What is compiled is not the file's fault: twice as long for all of it together.
                if not self.ours.poll(max(0.0, 2 * LONGEST - (time.monotonic() - began))):
                    outcome = TOO_LONG, ""
                    break
                kind, *values = self.ours.recv()
                if kind == "path":
                    path = Path(values[0])
                else:
                    return values[0], values[1], path
        except EOFError:
            self.process.join()
            outcome = "died", f"exit code {self.process.exitcode}"
        self.stop()
        self.start()
        return *outcome, path


def serve(pipe: Connection, folder: str) -> None:
    """Try the files that are asked for: the seed of a case, or a path."""
    warnings.simplefilter("ignore")
    import numpy as np
    from fuzz.seeds import OF_PICTURES, broken, is_sound, seeds

    import potmesil_mi as pm

    place = Path(folder)
    whole = seeds(place)
    for seed in whole:
        is_sound(seed.load(seed.path))  # Compiles the kernels.
    pipe.send("ready")
    while True:
        asked = pipe.recv()
        if isinstance(asked, str):
            path = Path(asked)

            def load(path: Path) -> pm.PointSamples:
                from potmesil_mi.samples.files import holds_samples

                if holds_samples(path):
                    return pm.PointSamples.load(path)
                return pm.PointSamples.from_image(path, **OF_PICTURES)
        else:
            rng = np.random.default_rng(asked)
            seed = whole[asked % len(whole)]
            path, load = place / f"broken{seed.path.suffix}", seed.load
            path.write_bytes(broken(seed.path.read_bytes(), rng))
        pipe.send(("path", str(path)))
        before, began = memory(reset=True), time.monotonic()
        detail = ""
        try:
            outcome = "picture" if is_sound(load(path)) else "NaN picture"
        except (ValueError, OSError) as error:
            detail = str(error)
            outcome = "error" if path.name in detail else "error without the name"
        except BaseException:
            outcome, detail = "traceback", traceback.format_exc(limit=-3)
        took, size = time.monotonic() - began, path.stat().st_size
        grown = memory() - before
        if outcome in EXPECTED and took > LONGEST:
            outcome, detail = TOO_LONG, f"{took:.1f} s {detail}"
        elif outcome in EXPECTED and grown > MOST_MEMORY and size < SMALL:
            outcome, detail = TOO_LARGE, f"{grown >> 20} MB {detail}"
        pipe.send(("done", outcome, detail[:2000]))


def memory(reset: bool = False) -> int:
    """The most memory of this process in bytes since it was last reset; now, if it is reset."""
    from potmesil_mi._memory import entry_in_bytes

    if reset:
        Path("/proc/self/clear_refs").write_text("5")
    return entry_in_bytes(Path("/proc/self/status"), "VmHWM") or 0


if __name__ == "__main__":
    sys.exit(main())
