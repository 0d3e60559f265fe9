"""What a command says of what it has done: one line for people, or JSON for programs."""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._memory import peak_memory
from .._units import said_length

if TYPE_CHECKING:
    from rich.console import Console

    from ..samples.point_samples import PointSamples


class Report:
    """What a command says at its end, as its options want it.

    A line on standard error, nothing with ``--quiet``, more with ``--verbose``; with ``--json``
    an object on standard output instead.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self._quiet = bool(getattr(options, "quiet", False))
        self._verbose = bool(getattr(options, "verbose", False))
        self._json = bool(getattr(options, "json", False))
        self._began = time.perf_counter()

    def written(self, paths: Sequence[str | Path], samples: PointSamples) -> None:
        """Say which pictures of samples were written, and how their lens blurs them."""
        found = about_picture(samples, samples.lens)
        seconds = time.perf_counter() - self._began
        if self._json:
            files = [str(path) for path in paths]
            self.values({"written": files, **found, "seconds": round(seconds, 3)})
            return
        names = ", ".join(map(str, paths))
        width, height = samples.camera.crop_size
        self.line(f"wrote {names}: {width}x{height}, {sentence(found)}; {seconds:.1f} s")
        if self._verbose:
            self.line(
                f"{len(samples):,} samples, {samples.spp} a pixel, {samples.nbytes / 1e6:,.0f} MB; "
                f"{peak_memory() / 1e9:.2f} GB of memory at most"
            )

    def files(self, paths: Sequence[str | Path], what: str) -> None:
        """Say which files were written, and of ``what`` they are."""
        seconds = time.perf_counter() - self._began
        if self._json:
            names = [str(path) for path in paths]
            self.values({"written": names, "made": what, "seconds": round(seconds, 3)})
        else:
            self.line(f"wrote {', '.join(map(str, paths))}: {what}; {seconds:.1f} s")

    def line(self, text: str) -> None:
        """Say a line, unless the command is to be quiet."""
        if not self._quiet:
            print(f"potmesil: {text}", file=sys.stderr)

    def values(self, values: Mapping[str, Any]) -> None:
        """Print an object as JSON, in which what is infinite is a text."""
        from .._files import in_json

        print(json.dumps(in_json(values), indent=2, ensure_ascii=False))


def console() -> Console:
    """Where tables are printed: as wide as the terminal, or 100 columns."""
    from rich.console import Console

    return Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else 100)


def about_picture(samples: PointSamples, lens: Any) -> dict[str, Any]:
    """How a lens blurs samples, by names: ``focus_distance`` and other lengths in scene units."""
    from ..optics.lens import ThinLens
    from ..samples.circles import largest_circle, sharp_range
    from ..samples.depth_range import DepthRange

    plain = lens.plain()
    near, far = sharp_range(plain, samples.camera)
    found: dict[str, Any] = {"focus_distance": float(plain.focus_distance)}
    if isinstance(plain, ThinLens):
        found["f_number"] = float(plain.f_number)
        found["aperture_radius"] = float(plain.aperture_radius)
        found["millimeters_per_unit"] = float(plain.millimeters_per_unit)
    else:
        found["half_angle"] = float(plain.half_angle)
    found["largest_circle_pixels"] = largest_circle(DepthRange.of(samples), plain, samples.camera)
    found["sharp_from"], found["sharp_to"] = near, far
    return found


def sentence(about: Mapping[str, Any]) -> str:
    """What :func:`about_picture` tells, in words."""
    length = functools.partial(said_length, unit=about.get("millimeters_per_unit"))
    aperture = (
        f"f/{about['f_number']:.3g}" if "f_number" in about else f"{about['half_angle']:g} degrees"
    )
    circle = about["largest_circle_pixels"]
    return (
        f"{aperture} focused at {length(about['focus_distance'])}, sharp from "
        f"{length(about['sharp_from'])} to {length(about['sharp_to'])}, circles up to "
        f"{circle:.{1 if circle < 10 else 0}f} pixels"
    )
