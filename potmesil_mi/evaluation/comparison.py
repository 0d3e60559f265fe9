"""The focused picture beside a ray-traced one: how good it is, and how much time it saves.

The built-in ``thinlens`` that stands for the same lens is rendered until its noise is known to be
small, and then again with fewer and fewer samples, or more and more, to find out how many it
needs for the error of the focused picture.
"""

from __future__ import annotations

import dataclasses
import math
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from .._image import require_writable, write_picture
from .._progress import ProgressCallback, reported
from .._validation import require_whole
from ..focusing.api import focus
from ..focusing.methods import Method, MethodName, method_of
from ..optics.lens import ThinLens
from ..tracing.hidden_surface import WrappingIntegrator, render_samples
from ..tracing.sampling import Sampling
from ..tracing.sensor import is_orthographic, pick_sensor, potmesil_sensor
from . import metrics
from .reference import FLOOR_MARGIN, REFERENCE_SPP, Reference
from .search import EqualError, Found, Search
from .thinlens import SAMPLERS, ThinlensRenderer, rounded_up, sample_count, thinlens_sensor
from .timing import Measured, Stages, measured, timed_stages

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
    ``first_picture``             seconds of taking samples anew and focusing them for the
                                  first time, all kernels being compiled
    ``point_samples``             number of point samples
    ``reference``                 converged ``thinlens`` picture, float32 (height, width, 3)
    ``reference_spp``             its samples a pixel
    ``floor``                     PSNR in dB of the reference's own noise
    ``lens``, ``method``          what was focused, and how
    ============================  ==========================================================
    """

    focused: Rendering
    pinhole: Rendering
    equal_samples: Rendering
    equal_error: Rendering | None
    needed: EqualError
    sampler: str
    sampling: tuple[float, float]
    first_picture: float
    point_samples: int
    reference: np.ndarray
    reference_spp: int
    floor: float
    lens: ThinLens
    method: str

    @property
    def refocus_speedup(self) -> float:
        """How many times as long as a refocusing ``thinlens`` takes for the same error."""
        return self.needed.seconds / self.focused.steady

    @property
    def first_speedup(self) -> float:
        """The same for the first picture, the taking of the samples included."""
        return self.needed.seconds / self.first_picture

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
        rows: list[tuple[str, Rendering | None]] = [
            ("pinhole, for scale", self.pinhole),
            (f"focus, {self.method}", self.focused),
            ("thinlens, equal samples", self.equal_samples),
            ("thinlens, equal error", self.equal_error),
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
        lines = [
            f"Point samples: {self.point_samples:,} in {_seconds(self.sampling[0])} s, again in "
            f"{_seconds(self.sampling[1])} s; with the first focus of them "
            f"{_seconds(self.first_picture)} s.",
            f"For the PSNR of the focused picture thinlens ({self.sampler}, the best of "
            f"{', '.join(SAMPLERS)}) needs {sign}{self.needed.spp:.3g} samples a pixel and "
            f"{sign}{_seconds(self.needed.seconds)} s: {sign}{self.refocus_speedup:.3g} times as "
            f"long as refocusing, {sign}{self.first_speedup:.3g} times as long as the first "
            "picture (samples and focus, kernels compiled).",
            "PSNR: linear RGB clipped to [0, 1]. SSIM, FLIP: sRGB, FLIP at "
            f"{metrics.PIXELS_PER_DEGREE:g} pixels a degree.",
        ]
        if self.floor < self.focused.psnr + FLOOR_MARGIN:
            lines.append(
                f"The reference's noise is less than {FLOOR_MARGIN:g} dB below the error of the "
                "focused picture, and is part of all errors here: more --reference-spp."
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
            write_picture(pictures[name], path)
        return list(paths)


def compare(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    *,
    spp: int = 0,
    seed: int = 0,
    sampling: Sampling | None = None,
    reference_spp: int = REFERENCE_SPP,
    reference_floor: float | None = None,
    method: Method | MethodName = "layered",
    lens_points: int | None = None,
    tables: int | None = None,
    inverse_square: bool | None = None,
    squares: int | None = None,
) -> Comparison:
    """Focus point samples of ``scene``, and render it with ``thinlens``, to compare the two.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``scene``, ``sensor``,        as for :func:`potmesil_mi.render_samples`; the lens is the
    ``integrator``, ``spp``,      sensor's
    ``seed``, ``sampling``
    ``reference_spp``             most samples a pixel of the reference, and of a ``thinlens``
                                  that is to reach the error of the focused picture; from 2
                                  (default 4096)
    ``reference_floor``           the reference is done when its own noise, estimated from two
                                  independent halves, is at this PSNR in dB; by default 10 dB
                                  above that of the focused picture
    ``method``, ``lens_points``,  as for :func:`potmesil_mi.focus`
    ``tables``, ``squares``,
    ``inverse_square``
    ============================  ==========================================================

    Both are rendered on an RGB film with the size, crop window and reconstruction filter of the
    sensor's. Raises ``ValueError`` or ``TypeError`` that names the parameter, also for a crop
    window of less than 11x11 pixels, ``ImportError`` without the extra ``compare``.
    """
    require_vectorised_variant("compare")
    metrics.require_extra()
    chosen = method_of(
        method,
        lens_points=lens_points,
        tables=tables,
        inverse_square=inverse_square,
        squares=squares,
    )
    require_whole("reference_spp", reference_spp, 2, 2**24)
    require_whole("seed", seed, 0, 2**32 - 1)
    if reference_floor is not None and not math.isfinite(reference_floor):
        raise ValueError(f"reference_floor={reference_floor}: must be a finite number of dB")
    sensor = _comparable(scene, sensor)
    integrator = integrator or scene.integrator()
    wrapping = isinstance(integrator, WrappingIntegrator)
    nested = integrator.nested if wrapping else integrator
    if sampling is None:
        sampling = integrator.sampling if wrapping else Sampling()
    spp = sample_count(sensor.sampler(), spp)
    renderer = ThinlensRenderer(scene, nested, sensor, seed)
    stages = timed_stages(
        lambda: render_samples(scene, sensor, integrator, spp=spp, seed=seed, sampling=sampling),
        lambda samples, lens: np.array(
            focus(samples, lens, method=chosen, rfilter=sensor.film().rfilter())
        ),
        sensor.lens(),
    )
    paths = float(spp)
    if sampling.pattern == "sampler":
        paths *= 1 + sampling.refine
    else:
        paths *= stages.point_samples / math.prod(sensor.camera().crop_size)
    bounds = _Bounds(spp, paths, reference_spp, reference_floor)
    return _judged(renderer, stages, bounds, chosen)


@dataclasses.dataclass(frozen=True)
class _Bounds:
    """How much is rendered.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``spp``                       samples a pixel of the sampler
    ``paths``                     samples a pixel of the focused picture, whatever its pattern
    ``most``                      samples a pixel of a ``thinlens`` at most
    ``floor``                     PSNR in dB of the reference's noise; ``None``: well above
                                  that of the focused picture
    ============================  ==========================================================
    """

    spp: int
    paths: float
    most: int
    floor: float | None


def _comparable(scene: mi.Scene, sensor: int | mi.Sensor) -> mi.Sensor:
    """The ``potmesil`` sensor, if there is a ``thinlens`` for it and its picture is large enough.

    Raises ``ValueError`` otherwise.
    """
    sensor = pick_sensor(scene, sensor)
    if not is_orthographic(sensor):  # thinlens_sensor refuses it
        sensor = potmesil_sensor(sensor)
    thinlens_sensor(sensor)
    width, height = sensor.camera().crop_size
    if min(width, height) < metrics.SSIM_WINDOW:
        raise ValueError(
            f"film: its crop window has {width}x{height} pixels, must have at least "
            f"{metrics.SSIM_WINDOW}x{metrics.SSIM_WINDOW}"
        )
    return sensor


def _judged(
    renderer: ThinlensRenderer, stages: Stages, bounds: _Bounds, method: Method
) -> Comparison:
    """The focused picture beside all that ``thinlens`` renders."""
    with reported() as report:
        reference = Reference(renderer.for_reference)
        reference.converge(stages.picture, bounds.most, bounds.floor, report)
        mean = reference.mean
        focused = _rated(
            Measured(stages.picture, bounds.paths, stages.focus_first, stages.focus_steady), mean
        )
        report("pinhole", None)
        pinhole = _rated(measured(partial(renderer.pinhole, bounds.spp), bounds.spp), mean)
        searches = {
            name: _search(renderer, name, mean, focused.mean_square, bounds, report)
            for name in SAMPLERS
        }
    best = min(SAMPLERS, key=lambda name: searches[name].rank)
    found = searches[best]
    return Comparison(
        focused=focused,
        pinhole=pinhole,
        equal_samples=_rated(found.start.measured, mean),
        equal_error=None if found.reached is None else _rated(found.reached.measured, mean),
        needed=found.needed,
        sampler=best,
        sampling=stages.sampling,
        first_picture=stages.first_picture,
        point_samples=stages.point_samples,
        reference=mean.astype(np.float32),
        reference_spp=reference.spp,
        floor=reference.floor,
        lens=renderer.sensor.lens(),
        method=method.name,
    )


def _search(
    renderer: ThinlensRenderer,
    sampler: str,
    reference: np.ndarray,
    error: float,
    bounds: _Bounds,
    report: ProgressCallback,
) -> Found:
    """What a sampler of ``thinlens`` needs for ``error``."""

    def measure(count: int) -> Measured:
        report(f"thinlens, {sampler}: {count} samples a pixel", None)
        return measured(partial(renderer.through_lens, sampler, count), count)

    search = Search(measure, partial(rounded_up, sampler), reference)
    return search.run(error, math.ceil(bounds.paths), bounds.most)


def _rated(taken: Measured, reference: np.ndarray) -> Rendering:
    """A picture with its error."""
    return Rendering(
        picture=taken.picture.astype(np.float32),
        spp=taken.spp,
        first=taken.first,
        steady=taken.steady,
        mean_square=metrics.mean_square(taken.picture, reference),
        ssim=metrics.ssim(taken.picture, reference),
        flip=metrics.flip(taken.picture, reference),
    )


def output_paths(output: str | os.PathLike[str]) -> dict[Path, str]:
    """Files that :meth:`Comparison.write` writes, and the picture that each is of.

    In ``output`` if it is a folder or ends in a slash, which makes the folder; else beside it.
    Raises an ``OSError`` where they cannot be written.
    """
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
