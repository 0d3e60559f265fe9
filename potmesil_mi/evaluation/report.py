"""What a comparison has found out: numbers in a table and in words, and pictures as files."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from .._files import require_path, require_writable
from .._image import write_picture
from ..optics.lens import ThinLens
from . import metrics
from .reference import FLOOR_MARGIN
from .search import EqualError
from .thinlens import SAMPLERS

if TYPE_CHECKING:
    from rich.table import Table

DIFFERENCE_FACTOR = 8.0
"""By how much the written difference is amplified."""

PICTURES = ("focused", "thinlens", "reference", "difference")
"""The pictures that are written."""

SUFFIXES = (".exr", ".png")
"""The formats in which each of them is written."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rendering:
    """A picture, what it took and how near it comes to the reference.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``picture``                   linear RGB, float32 (height, width, 3)
    ``spp``                       samples a pixel that were really taken
    ``first``, ``steady``         seconds of the first time, in which kernels may have been
                                  compiled, and the median of repetitions
    ``mean_square``, ``psnr``     error of linear RGB clipped to [0, 1], and the same in dB
    ``ssim``, ``flip``            of the sRGB pictures, see :mod:`potmesil_mi.evaluation.metrics`
    ============================  ==========================================================
    """

    picture: np.ndarray
    spp: float
    first: float
    steady: float
    mean_square: float
    ssim: float
    flip: float

    @property
    def psnr(self) -> float:
        """PSNR in dB against the reference."""
        return metrics.decibels(self.mean_square)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """What :func:`compare` found out.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``focused``                   the focused picture; its times are of focusing alone, the
                                  steady one of refocusing
    ``pinhole``                   the picture that is not focused at all, for scale
    ``equal_samples``             ``thinlens`` with as many samples, as its sampler rounds up
    ``equal_error``               ``thinlens`` of the measured sample count whose error is the
                                  nearest to that of ``focused``; ``None`` where none reached it
    ``needed``                    samples and time of ``thinlens`` for exactly that error
    ``sampler``                   the sampler of ``thinlens`` that needs the least time
    ``sampling``                  seconds of taking the point samples, first and again
    ``denoising``                 seconds of denoising them; ``None`` where neither they nor
                                  ``thinlens`` are denoised
    ``noise``, ``bias``           the part of the mean squared error of ``focused`` that another
                                  seed changes, and the rest with its standard error, which
                                  more samples do not lower: both without the noise of the
                                  reference; the second may be negative
    ``first_picture``             seconds of taking samples anew, denoising and focusing them for
                                  the first time, all kernels being compiled
    ``point_samples``             number of point samples
    ``reference``                 converged ``thinlens`` picture, float32 (height, width, 3)
    ``reference_spp``             its samples a pixel
    ``floor``                     PSNR in dB of the reference's own noise
    ``lens``, ``method``          what was focused, and how
    ``said``                      what is said of each picture in its files, by its name
    ============================  ==========================================================
    """

    focused: Rendering
    pinhole: Rendering
    equal_samples: Rendering
    equal_error: Rendering | None
    needed: EqualError
    sampler: str
    sampling: tuple[float, float]
    denoising: float | None
    noise: float
    bias: tuple[float, float]
    first_picture: float
    point_samples: int
    reference: np.ndarray
    reference_spp: int
    floor: float
    lens: ThinLens
    method: str
    said: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)

    @property
    def refocus_speedup(self) -> float:
        """How many times as long as a refocusing ``thinlens`` takes for the same error."""
        return self.needed.seconds / self.focused.steady

    @property
    def first_speedup(self) -> float:
        """The same for the first picture, the taking of the samples included."""
        return self.needed.seconds / self.first_picture

    @property
    def bias_psnr(self) -> tuple[float, str]:
        """PSNR in dB of the bias, and ``">"`` where it is not seen for the noise of the estimate.

        Then it is that of what it may be at most: the estimate, or 0, and two standard errors.
        """
        bias, error = self.bias
        if bias > 2 * error:
            return metrics.decibels(bias), ""
        return metrics.decibels(max(bias, 0) + 2 * error), ">"

    @property
    def thinlens(self) -> Rendering:
        """The ``thinlens`` of about equal error, or of equal samples where none reached it."""
        return self.equal_error or self.equal_samples

    @property
    def difference(self) -> np.ndarray:
        """|focused - reference|, both clipped to [0, 1], times ``DIFFERENCE_FACTOR``."""
        apart = np.clip(self.focused.picture, 0, 1) - np.clip(self.reference, 0, 1)
        return np.abs(apart) * np.float32(DIFFERENCE_FACTOR)

    def table(self) -> Table:
        """The measurements as a ``rich.table.Table``."""
        from rich.box import SIMPLE
        from rich.table import Table

        height, width = self.reference.shape[:2]
        table = Table(
            title=f"Against a converged thinlens; {width}x{height}, f/{self.lens.f_number:g}, "
            f"focused at {self.lens.focus_distance:g}, {mi.variant()}",
            box=SIMPLE,
            collapse_padding=True,
        )
        headings = ("", "samples\na pixel", "first\ns", "steady\ns", "PSNR\ndB", "SSIM", "FLIP")
        for heading in headings:
            table.add_column(heading, justify="right" if heading else "left")
        denoised = "" if self.denoising is None else ", denoised"
        rows: list[tuple[str, Rendering | None]] = [
            ("pinhole, for scale", self.pinhole),
            (f"focus, {self.method}{denoised}", self.focused),
            (f"thinlens{denoised}, equal samples", self.equal_samples),
            (f"thinlens{denoised}, equal error", self.equal_error),
        ]
        for name, row in rows:
            if row is None:
                table.add_row(name, f"> {self.needed.spp:.0f}")
                continue
            scores = (f"{row.psnr:.2f}", f"{row.ssim:.4f}", f"{row.flip:.4f}")
            spp = f"{row.spp:.4g}"
            table.add_row(name, spp, _seconds(row.first), _seconds(row.steady), *scores)
        floor = f"{self.floor:.2f}"
        table.add_section()
        table.add_row("reference, its noise", f"{self.reference_spp}", "", "", floor)
        return table

    def summary(self) -> str:
        """Sample counts, times and ratios in words."""
        sign = {"": "", ">": "more than ", "<=": "at most "}[self.needed.bound]
        denoised = ""
        if self.denoising is not None:
            denoised = f", denoised in {_seconds(self.denoising)} s"
        bias, bound = self.bias_psnr
        lines = [
            f"Point samples: {self.point_samples:,} in {_seconds(self.sampling[0])} s, again in "
            f"{_seconds(self.sampling[1])} s{denoised}; with the first focus of them "
            f"{_seconds(self.first_picture)} s.",
            f"Without the noise of its samples the focused picture would be at {bound}{bias:.2f} "
            f"dB, by that noise alone it is at {metrics.decibels(self.noise):.2f} dB (two seeds).",
            f"For the PSNR of the focused picture thinlens ({self.sampler}, the best of "
            f"{', '.join(SAMPLERS)}) needs {sign}{self.needed.spp:.3g} samples a pixel and "
            f"{sign}{_seconds(self.needed.seconds)} s: {sign}{self.refocus_speedup:.3g} times as "
            f"long as refocusing, {sign}{self.first_speedup:.3g} times as long as the first "
            "picture (all of the above, kernels compiled).",
            "PSNR: linear RGB clipped to [0, 1]. SSIM, FLIP: sRGB, FLIP at "
            f"{metrics.PIXELS_PER_DEGREE:g} pixels a degree.",
        ]
        if self.floor < self.focused.psnr + FLOOR_MARGIN:
            lines.append(
                f"The reference's noise is less than {FLOOR_MARGIN:g} dB below the error of the "
                "focused picture, and is part of all errors here: more --reference-spp or --budget."
            )
        return "\n".join(lines)

    def write(self, output: str | os.PathLike[str]) -> list[Path]:
        """Write ``focused``, ``thinlens``, ``reference``, ``difference``; returns the files.

        Each as ``.exr`` and ``.png``: in the folder ``output``, or with ``output-`` before their
        names.
        """
        pictures = {
            "focused": self.focused.picture,
            "thinlens": self.thinlens.picture,
            "reference": self.reference,
            "difference": self.difference,
        }
        paths = output_paths(output)
        for path, name in paths.items():
            write_picture(pictures[name], path, self.said.get(name))
        return list(paths)


def output_paths(output: str | os.PathLike[str]) -> dict[Path, str]:
    """Files that :meth:`Comparison.write` writes, and the picture that each is of.

    In ``output`` if it is a folder or ends in a slash, which makes the folder; else beside it.
    Raises an ``OSError`` where they cannot be written.
    """
    require_path(output, "output")
    text = os.fspath(output)
    named_folder = text.endswith(("/", os.sep))
    if named_folder:
        Path(text).mkdir(parents=True, exist_ok=True)
    in_folder = named_folder or Path(text).is_dir()
    paths = {}
    for name in PICTURES:
        for suffix in SUFFIXES:
            path = Path(text) / f"{name}{suffix}" if in_folder else Path(f"{text}-{name}{suffix}")
            paths[require_writable(path, SUFFIXES)] = name
    return paths


def _seconds(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"
