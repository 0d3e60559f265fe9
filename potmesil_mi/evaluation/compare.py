"""The focused picture beside a ray-traced one: how good it is, and how much time it saves.

The built-in ``thinlens`` that stands for the same lens is rendered until its noise is known to be
small, and then again with fewer and fewer samples, or more and more, to find out how many it
needs for the error of the focused picture.
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import math
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from .._image import require_writable, write_picture
from .._validation import require_whole
from ..focusing.api import check_options, focus
from ..optics.lens import ThinLens
from ..optics.psf import Disc
from ..samples.point_samples import PointSamples
from ..tracing.hidden_surface import render_samples
from ..tracing.sampling import Sampling
from ..tracing.sensor import pick_sensor, potmesil_sensor
from . import metrics

SAMPLERS = ("multijitter", "orthogonal", "ldsampler")
"""Mitsuba's samplers among which the best one for ``thinlens`` is looked for."""

FLOOR_MARGIN = 10.0
"""By how many dB the reference's noise is to be below the focused picture's error."""

REFERENCE_SPP = 4096
REFERENCE_PASS = 64
"""Samples a pixel of a reference at most, and of each of the renderings that it is the mean of."""

REPEATS = 3
LONG = 5.0
"""Times are medians of so many repetitions, of one where a rendering takes so many seconds."""

SMALLEST = 1e-30
"""In the place of an error of 0, which has no logarithm."""

DIFFERENCE_FACTOR = 8.0
"""By how much the written difference is amplified."""

PICTURES = ("focused", "thinlens", "reference", "difference")
SUFFIXES = (".exr", ".png")


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
    ``ssim``, ``flip``            of the sRGB pictures, see :mod:`potmesil_mi.metrics`
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


@dataclasses.dataclass(frozen=True)
class EqualError:
    """What ``thinlens`` takes to reach an error.

    ``spp`` samples a pixel and ``seconds``, interpolated between measured counts unless the
    sampler makes just that one. ``bound`` is ``">"`` where even that many were not enough, and
    ``"<="`` where that many, the fewest of this sampler, were more than enough.
    """

    spp: float
    seconds: float
    bound: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
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

    def table(self) -> Any:
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
    **options: Any,
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
    ``options``                   of :func:`potmesil_mi.focus`: ``method``, ``tables``, ...
    ============================  ==========================================================

    Both are rendered on an RGB film with the size, crop window and reconstruction filter of the
    sensor's. Raises ``ValueError`` or ``TypeError`` that names the parameter, also for a crop
    window of less than 11x11 pixels, ``ImportError`` without the extra ``compare``.
    """
    require_vectorised_variant("compare")
    metrics.require_extra()
    check_options(**options)
    require_whole("reference_spp", reference_spp, 2, 2**24)
    require_whole("seed", seed, 0, 2**32 - 1)
    if reference_floor is not None and not math.isfinite(reference_floor):
        raise ValueError(f"reference_floor={reference_floor}: must be a finite number of dB")
    sensor = potmesil_sensor(pick_sensor(scene, sensor))
    width, height = (int(n) for n in sensor.film().crop_size())
    if min(width, height) < metrics.SSIM_WINDOW:
        raise ValueError(
            f"film: its crop window has {width}x{height} pixels, must have at least "
            f"{metrics.SSIM_WINDOW}x{metrics.SSIM_WINDOW}"
        )
    integrator = integrator or scene.integrator()
    nested = getattr(integrator, "nested", integrator)

    spp = sample_count(sensor.sampler(), spp)

    def render(sampler: str, spp: int, number: int) -> np.ndarray:
        equivalent = thinlens_sensor(sensor, sampler=sampler, spp=spp)
        return _render(scene, nested, equivalent, seed + 1 + number)

    def converged(spp: int, number: int) -> np.ndarray:
        return render(SAMPLERS[0], spp, 1000 + number)

    def pinhole(number: int) -> np.ndarray:
        closed = sensor.lens().replace(aperture_radius=0)
        return _render(scene, nested, thinlens_sensor(sensor, closed, spp=spp), seed + number)

    def rated(picture: np.ndarray, spp: float, first: float, steady: float) -> Rendering:
        error = metrics.mean_square(picture, reference.mean)
        scores = metrics.ssim(picture, reference.mean), metrics.flip(picture, reference.mean)
        return Rendering(picture.astype(np.float32), spp, first, steady, error, *scores)

    thinlens_sensor(sensor)  # raises, before anything is rendered, where there is none
    stages = _timed_stages(
        lambda: render_samples(scene, sensor, integrator, spp=spp, seed=seed, sampling=sampling),
        lambda samples, lens: np.array(
            focus(samples, lens, rfilter=sensor.film().rfilter(), **options)
        ),
        sensor.lens(),
    )
    paths: float = spp
    sampling = sampling or getattr(integrator, "sampling", None) or Sampling()
    if sampling.pattern != "sampler":
        paths *= stages.point_samples / (width * height)
    with _progress() as say:
        reference = _Reference(converged)
        reference.converge(stages.picture, reference_spp, reference_floor, say)
        focused = rated(stages.picture, paths, stages.focus_first, stages.focus_steady)
        say("pinhole")
        not_focused = rated(*_measured(pinhole, spp))
        searches = {}
        for name in SAMPLERS:
            search = _Search(
                partial(render, name),
                partial(_rounded_up, name),
                reference.mean,
                partial(_prefixed, say, f"thinlens, {name}: "),
            )
            search.run(focused.mean_square, math.ceil(paths), reference_spp)
            searches[name] = search
    best = min(SAMPLERS, key=lambda name: searches[name].rank)
    search = searches[best]
    return Comparison(
        focused=focused,
        pinhole=not_focused,
        equal_samples=rated(*search.start.measured),
        equal_error=None if search.reached is None else rated(*search.reached.measured),
        needed=search.needed,
        sampler=best,
        sampling=stages.sampling,
        first_picture=stages.first_picture,
        point_samples=stages.point_samples,
        reference=reference.mean.astype(np.float32),
        reference_spp=reference.spp,
        floor=reference.floor,
        lens=sensor.lens(),
        method=options.get("method", inspect.signature(focus).parameters["method"].default),
    )


def thinlens_sensor(
    sensor: mi.Sensor,
    lens: ThinLens | None = None,
    *,
    sampler: str = SAMPLERS[0],
    spp: int = 16,
) -> mi.Sensor:
    """The built-in ``thinlens`` exactly equivalent to ``lens`` at the place of ``sensor``.

    ``sensor`` is one that :func:`potmesil_mi.potmesil_sensor` takes, with its own lens by
    default; as for :func:`potmesil_mi.focus` its aperture and focus count, and the field of view
    stays the sensor's. Placement, clipping planes, shutter and medium stay too.
    The film is of RGB in single precision, with the size, crop window and reconstruction filter
    of the sensor's; ``sampler`` rounds ``spp`` up to a count that it can take. A closed aperture
    gives a ``perspective``. Raises ``ValueError`` for a sensor whose principal point is off the
    centre, which ``thinlens`` does not know.
    """
    sensor = potmesil_sensor(sensor)
    lens = sensor.lens() if lens is None else lens
    camera = sensor.camera()
    plain = lens.aperture == Disc() and lens.squeeze == 1 and lens.vignetting == 0
    if not plain and lens.plain().aperture_radius > 0:
        raise ValueError(
            f"aperture={lens.aperture}, squeeze={lens.squeeze}, vignetting={lens.vignetting}: "
            "must be a disc, 1 and 0 to be compared: thinlens knows no other"
        )
    if any(camera.principal_point_offset):
        raise ValueError(
            f"principal_point_offset={camera.principal_point_offset}: must be 0, thinlens has none"
        )
    equivalent = mi.load_dict(
        {
            **lens.in_units(sensor.lens().millimeters_per_unit).to_thinlens(),
            "fov": camera.x_fov,
            "to_world": mi.ScalarTransform4f(np.array(camera.to_world)),
            "near_clip": camera.near_clip,
            "far_clip": camera.far_clip,
            "shutter_open": camera.shutter_open,
            "shutter_close": camera.shutter_close,
            "film": _rgb_film(sensor.film()),
            "sampler": {"type": sampler, "sample_count": _rounded_up(sampler, spp)},
        }
    )
    if sensor.get_medium() is not None:
        equivalent.set_medium(sensor.get_medium())
    return equivalent


def sample_count(sampler: mi.Sampler, spp: int = 0) -> int:
    """How many samples a pixel ``sampler`` takes where ``spp`` are asked for, 0 for its own."""
    if spp > 0:
        sampler = sampler.clone()
        with _without_warnings():
            sampler.set_sample_count(spp)
    return int(sampler.sample_count())


def output_paths(output: str | os.PathLike[str]) -> dict[Path, str]:
    """Files that :meth:`Comparison.write` writes, and the picture that each is of.

    In ``output`` if it is a folder or ends in a slash, else beside it. Raises an ``OSError``
    where they cannot be written.
    """
    text = os.fspath(output)
    in_folder = Path(text).is_dir() or text.endswith(("/", os.sep))
    paths = {}
    for name in PICTURES:
        for suffix in SUFFIXES:
            path = Path(text) / f"{name}{suffix}" if in_folder else Path(f"{text}-{name}{suffix}")
            paths[require_writable(path, SUFFIXES)] = name
    return paths


def _rgb_film(film: mi.Film) -> mi.Film:
    size, crop_size, crop_offset = film.size(), film.crop_size(), film.crop_offset()
    return mi.load_dict(
        {
            "type": "hdrfilm",
            "width": int(size.x),
            "height": int(size.y),
            "crop_width": int(crop_size.x),
            "crop_height": int(crop_size.y),
            "crop_offset_x": int(crop_offset.x),
            "crop_offset_y": int(crop_offset.y),
            "pixel_format": "rgb",
            "component_format": "float32",
            "sample_border": film.sample_border(),
            "rfilter": film.rfilter(),
        }
    )


def _render(scene: mi.Scene, integrator: mi.Integrator, sensor: mi.Sensor, seed: int) -> np.ndarray:
    spp = sensor.sampler().sample_count()
    with _without_warnings():
        picture = mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed % 2**32)
    return np.array(picture)


@dataclasses.dataclass(frozen=True, eq=False)
class _Stages:
    """A focused picture, and what its two stages took; see :class:`Comparison`."""

    picture: np.ndarray
    point_samples: int
    sampling: tuple[float, float]
    focus_first: float
    focus_steady: float
    first_picture: float


def _timed_stages(
    take_samples: Callable[[], PointSamples],
    form: Callable[[PointSamples, ThinLens], np.ndarray],
    lens: ThinLens,
) -> _Stages:
    def new_samples() -> tuple[float, float]:
        """Seconds of taking samples that are not kept, and of their first picture."""
        samples, seconds = _timed(take_samples)
        return seconds, _timed(partial(form, samples, lens))[1]

    samples, sampling_first = _timed(take_samples)
    picture, focus_first = _timed(lambda: form(samples, lens))
    again = [new_samples()]
    while len(again) < REPEATS and again[0][0] < LONG:
        again.append(new_samples())
    # Slightly refocused, so that no result of the lens itself can be used again.
    others = [
        lens.replace(focus_distance=lens.focus_distance * (1 + number / 100))
        for number in range(1, REPEATS + 1)
    ]
    steady = statistics.median(_timed(partial(form, samples, other))[1] for other in others)
    sampling = (sampling_first, statistics.median(taking for taking, _ in again))
    first_picture = statistics.median(map(sum, again))
    return _Stages(picture, len(samples), sampling, focus_first, steady, first_picture)


def _timed(action: Callable[[], Any]) -> tuple[Any, float]:
    began = time.perf_counter()
    result = action()
    return result, time.perf_counter() - began


def _measured(
    render: Callable[[int], np.ndarray], spp: float
) -> tuple[np.ndarray, float, float, float]:
    """Picture, samples, seconds of the first time, median of the repetitions.

    ``render`` is given a number that is 0 for the picture and another for each repetition.
    """
    picture, first = _timed(lambda: render(0))
    times: list[float] = []
    while not times or (len(times) < REPEATS and times[0] < LONG):
        times.append(_timed(lambda: render(1 + len(times)))[1])
    return picture, spp, first, statistics.median(times)


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    """Samplers say at every rendering that they round a count up."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level)


def _rounded_up(sampler: str, spp: float) -> int:
    """The samples a pixel that ``sampler`` takes where at least ``spp`` are asked for."""
    with _without_warnings():
        return sample_count(mi.load_dict({"type": sampler, "sample_count": math.ceil(spp)}))


class _Reference:
    """The mean of renderings with seeds of their own, and how much noise is left in it.

    ``render`` gives a picture of so many samples a pixel, and of a number that is new each time.
    """

    def __init__(self, render: Callable[[int, int], np.ndarray]) -> None:
        self.render = render
        self.count = self.spp = 0
        self.halves: list[Any] = [0.0, 0.0]

    @property
    def mean(self) -> np.ndarray:
        """The picture, linear RGB."""
        return (self.halves[0] + self.halves[1]) / self.count

    @property
    def floor(self) -> float:
        """PSNR in dB of the noise of the mean.

        The halves are independent, so their difference has the variance of each twice, and
        their mean half that of each: a quarter of the mean squared difference.
        """
        half = self.count / 2
        return metrics.decibels(
            metrics.mean_square(self.halves[0] / half, self.halves[1] / half) / 4
        )

    def converge(
        self,
        picture: np.ndarray,
        most: int,
        floor: float | None,
        say: Callable[..., None],
    ) -> None:
        """Add renderings until the noise is at ``floor`` dB, or ``most`` samples are taken.

        Without ``floor`` it is to be well below the error of ``picture``.
        """
        spp = _rounded_down(min(REFERENCE_PASS, most // 2))
        say("reference", 0.0)
        while True:
            for half in (0, 1):
                self.halves[half] = self.halves[half] + self.render(spp, self.count).astype(float)
                self.count += 1
                self.spp += spp
            target = metrics.psnr(picture, self.mean) + FLOOR_MARGIN if floor is None else floor
            if self.floor >= target or self.spp + 2 * spp > most:
                return
            needed = min(self.spp * 10 ** ((target - self.floor) / 10), most)
            say(
                f"reference: {self.spp} samples a pixel, noise at {self.floor:.1f} dB of "
                f"{target:.1f}",
                self.spp / needed,
            )


def _rounded_down(spp: int) -> int:
    """The largest number up to ``spp`` that the reference's sampler does not round up."""
    return next(n for n in range(spp, 0, -1) if _rounded_up(SAMPLERS[0], n) == n)


@dataclasses.dataclass(frozen=True, eq=False)
class _Point:
    """One sample count in a search; ``measured`` as of :func:`_measured`."""

    measured: tuple[np.ndarray, float, float, float]
    mean_square: float

    @property
    def spp(self) -> float:
        return self.measured[1]

    @property
    def seconds(self) -> float:
        return self.measured[3]


class _Search:
    """The samples that a sampler of ``thinlens`` needs for an error.

    ``render`` gives a picture of so many samples a pixel and of a number, ``rounded_up`` the
    nearest count that the sampler can take.
    """

    def __init__(
        self,
        render: Callable[[int, int], np.ndarray],
        rounded_up: Callable[[float], int],
        reference: np.ndarray,
        say: Callable[[str], None],
    ) -> None:
        self.render, self.rounded_up, self.reference, self.say = render, rounded_up, reference, say
        self.points: dict[int, _Point] = {}

    def run(self, error: float, start: int, most: int) -> None:
        """Double or halve the count from ``start`` until ``error`` is between two, up to ``most``.

        Then one more in between, where the error should be reached by a straight line in
        logarithms. Sets ``start``, ``reached``, ``needed`` and ``rank``, which is the less the
        better the sampler.
        """
        low = high = self.start = self.at(start)
        while high.mean_square > error and self.rounded_up(2 * high.spp) <= most:
            low, high = high, self.at(2 * high.spp)
        while low.mean_square <= error and (below := self.fewer_than(low.spp)) is not None:
            low, high = below, low
        self.reached: _Point | None = high
        if high.mean_square > error:
            self.reached, self.needed = None, EqualError(high.spp, high.seconds, ">")
            # None reached it: the sampler whose noise falls the fastest is the best.
            self.rank = (1.0, high.mean_square * high.seconds)
            return
        if low.mean_square <= error:
            self.reached, self.needed = low, EqualError(low.spp, low.seconds, "<=")
        else:
            between = self.between(low, high, _crossing(low, high, error)[0])
            if between is not None:
                low, high = (low, between) if between.mean_square <= error else (between, high)
            self.needed = EqualError(*_crossing(low, high, error))
            self.reached = min(
                low, high, key=lambda point: abs(_log(point.mean_square) - _log(error))
            )
        self.rank = (0.0, self.needed.seconds)

    def at(self, spp: float) -> _Point:
        """The count that the sampler makes of ``spp``, measured once."""
        count = self.rounded_up(spp)
        if count not in self.points:
            self.say(f"{count} samples a pixel")
            measured = _measured(lambda number: self.render(count, number), count)
            error = metrics.mean_square(measured[0], self.reference)
            self.points[count] = _Point(measured, error)
        return self.points[count]

    def between(self, low: _Point, high: _Point, spp: float) -> _Point | None:
        """About ``spp``, if the sampler has anything there between two others."""
        count = self.rounded_up(spp)
        if count >= high.spp:
            counts = range(math.floor(spp), int(low.spp), -1)
            count = next((n for n in counts if self.rounded_up(n) == n), count)
        return self.at(count) if low.spp < count < high.spp else None

    def fewer_than(self, spp: float) -> _Point | None:
        """About half of ``spp``, or whatever the sampler has that is less."""
        half = spp / 2
        while half >= 0.5:
            if self.rounded_up(half) < spp:
                return self.at(half)
            half /= 2
        return None


def _crossing(low: _Point, high: _Point, error: float) -> tuple[float, float]:
    """Samples and seconds at which the line through two points, in logarithms, has the error."""
    above, below = _log(low.mean_square), _log(high.mean_square)
    share = (above - _log(error)) / (above - below)
    return (
        low.spp * (high.spp / low.spp) ** share,
        low.seconds * (high.seconds / low.seconds) ** share,
    )


def _log(error: float) -> float:
    return math.log(max(error, SMALLEST))


def _prefixed(say: Callable[..., None], prefix: str, text: str) -> None:
    say(prefix + text)


def _seconds(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"


@contextlib.contextmanager
def _progress() -> Iterator[Any]:
    """A function that shows what is being done, and its share, if standard error is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(
        *columns,
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as progress:
        task = progress.add_task("reference", total=None)

        def say(text: str, share: float | None = None) -> None:
            progress.update(task, description=text, completed=share or 0, total=share and 1.0)

        yield say
