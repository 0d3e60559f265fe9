"""End programs at random moments while they render, save and focus, and look at what they leave.

    python tests/fuzz/kills.py --count 50

Each writes over a whole picture and whole samples: afterwards each must be the old or a new one,
and whole. After SIGTERM and SIGINT nothing else may be there; after SIGKILL what is left must be
gone when the next has written there.
"""

from __future__ import annotations

import argparse
import collections
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import potmesil_mi as pm
from potmesil_mi.pictures.reading import PictureFile

SCENE = Path(__file__).parents[2] / "scenes" / "figure11.xml"
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


def main() -> int:
    """Run from the command line; returns 1 if anything was not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    found: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        picture, samples = folder / "a.exr", folder / "a.samples"
        render = ["render", str(SCENE), "-D", "res=300", "--spp", "4", "-o", str(picture)]
        jobs = [[*render, "--samples", str(samples)], ["focus", str(samples), "-o", str(picture)]]
        took = [timed(job) for job in jobs]
        for number in range(options.count):
            job, longest = rng.choice(list(zip(jobs, took, strict=True)))
            which = SIGNALS[number % len(SIGNALS)]
            code = ended(job, which, rng.uniform(0, longest))
            found["ended before" if code == 0 else which.name] += 1
            found["broken"] += not (is_whole(picture) and is_whole(samples))
            left = {path.name for path in folder.iterdir()} - {picture.name, samples.name}
            if which != signal.SIGKILL:
                found["left behind"] += bool(left)
            elif left:
                found["left by SIGKILL"] += 1
            if left:
                timed(jobs[0])
                left = {path.name for path in folder.iterdir()} - {picture.name, samples.name}
                found["not removed by the next"] += bool(left)
    for what, count in sorted(found.items()):
        print(f"{what:26s}{count:5d}")
    return int(any(found[what] for what in ("broken", "left behind", "not removed by the next")))


def timed(job: list[str]) -> float:
    began = time.monotonic()
    subprocess.run([sys.executable, "-m", "potmesil_mi", *job], check=True)
    return time.monotonic() - began


def ended(job: list[str], which: signal.Signals, after: float) -> int:
    """The exit code of a program that got a signal after so many seconds."""
    command = [sys.executable, "-m", "potmesil_mi", *job]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as program:
        try:
            return program.wait(after)
        except subprocess.TimeoutExpired:
            program.send_signal(which)
            return program.wait()


def is_whole(path: Path) -> bool:
    """Whether a picture or samples can be read to the end."""
    try:
        if path.suffix == ".samples":
            pm.PointSamples.load(path)
        else:
            file = PictureFile(path)
            file.channels(file.parts[0], ["R", "G", "B"])
    except (OSError, ValueError) as error:
        print(f"{path}: {error}")
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
