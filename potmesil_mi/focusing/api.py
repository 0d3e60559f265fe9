"""The focus stage: a picture through the lens, from point samples.

Section 3.2 of Potmesil & Chakravarty (1981). Methods form the picture on a grid finer than the
pixels; here it is brought to the film.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from .._validation import require_whole
from ..filters.filters import Filter, apply_filters, as_filters
from ..optics.lens import ThinLens
from ..optics.psf import Aperture, PointSpreadFunction, aperture_behind
from ..samples.point_samples import PointSamples
from .equation20 import equation_20
from .layered import see_through

METHODS = ("layered", "lightfield", "paper")
OPTIONS = ("method", "lens_points", "tables", "inverse_square", "squares")
MOST_TABLES = 10_000
MOST_LENS_POINTS = 4096

LENS_POINTS = {"layered": 32, "lightfield": 128}
VIGNETTING_LENS_POINTS = 128
SQUARES = {"layered": 1, "lightfield": 2, "paper": 2}
DIFFRACTION_SQUARES = 2


def focus(
    samples: PointSamples,
    lens: ThinLens | None = None,
    *,
    method: str = "layered",
    psf: PointSpreadFunction | None = None,
    lens_points: int | None = None,
    tables: int | None = None,
    inverse_square: bool | None = None,
    squares: int | None = None,
    rfilter: mi.ReconstructionFilter | None = None,
    alpha: bool = False,
    filters: Sequence[Filter | str] = (),
) -> mi.TensorXf:
    """The picture that ``lens`` forms of ``samples``.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples, of :func:`potmesil_mi.render_samples` or a
                                  file
    ``lens``                      any lens, in scene units of any size; the samples' own by
                                  default. The field of view stays that of the samples: the
                                  picture is that of a ``thinlens`` with this
                                  ``aperture_radius`` and ``focus_distance`` at their place
    ``method``                    ``layered`` (default): what is visible, fast.
                                  ``lightfield``: the same with more lens points, on a finer
                                  grid; the one to trust. ``paper``: equation 20, which knows
                                  no occlusion
    ``psf``                       how the light of a point is spread; by default the lens's
                                  ``aperture``. One that is no :class:`potmesil_mi.Aperture`
                                  ``layered`` and ``lightfield`` use for what the whole lens
                                  sees; what only parts of it see they spread uniformly
    ``lens_points``               ``layered``, ``lightfield``: points of the lens from which
                                  visibility is found, 1 to 4096 (default 32 and 128; with
                                  vignetting 128)
    ``tables``                    ``paper``: number of depths, equally spaced from the nearest
                                  to the farthest sample, with a table each; 2 to 10000
                                  (default 73, the paper's)
    ``inverse_square``            ``paper``: light falls off as 1/z^2 (default, the paper's);
                                  a ray-traced lens does without
    ``squares``                   each pixel is evaluated as so many squares on a side, 1 to
                                  16 (default: ``layered`` 1, the others, and with
                                  diffraction all, 2; but 1 where there are less than 4
                                  samples a pixel, except in ``paper``)
    ``rfilter``                   the film's reconstruction filter; box by default
    ``alpha``                     add a fourth channel with the coverage
    ``filters``                   special effects, applied to the finished picture in their
                                  order: :class:`potmesil_mi.Star`, ``Diffraction``,
                                  ``Defocus``, ``Fade``, or texts such as ``star:points=6``
    ============================  ==========================================================

    What ``layered`` and ``lightfield`` find out about samples is kept as long as they are, for
    the next focus of any of the last four apertures. Returns linear RGB (A), (height, width, 3 or
    4), of the samples' crop window. Raises ``ValueError`` or ``TypeError`` that names the
    parameter, ``RuntimeError`` in scalar variants.
    """
    require_vectorised_variant("focus")
    options: dict[str, Any] = {
        "method": method,
        "lens_points": lens_points,
        "tables": tables,
        "inverse_square": inverse_square,
        "squares": squares,
    }
    check_options(**{name: value for name, value in options.items() if value is not None})
    filters = as_filters(filters)
    lens = samples.lens if lens is None else lens
    if not isinstance(lens, ThinLens):
        raise TypeError(f"lens={lens!r}: must be a ThinLens, such as samples.lens.replace(...)")
    lens = lens.plain().in_units(samples.lens.millimeters_per_unit)
    psf = lens.aperture if psf is None else psf
    if not hasattr(psf, "table"):
        raise TypeError(f"psf={psf!r}: must be a point-spread function, such as Disc()")
    if method == "paper" and lens.vignetting > 0:
        raise ValueError(
            f"vignetting={lens.vignetting}: must be 0 for the method paper, whose tables are the "
            "same all over the picture"
        )
    if squares is None:
        squares = _squares(method, samples, psf)
    if method == "paper":
        form = functools.partial(
            equation_20,
            tables=73 if tables is None else tables,
            inverse_square=True if inverse_square is None else bool(inverse_square),
        )
    else:
        if lens_points is None:
            # What the rim cuts is all formed by points.
            least = VIGNETTING_LENS_POINTS if lens.vignetting > 0 else 1
            lens_points = max(LENS_POINTS[method], least)
        form = functools.partial(see_through, lens_points=lens_points, exact=method == "lightfield")
    channels = psf.channels if isinstance(psf, Aperture) else (psf,)
    pictures = [
        reconstruct(*form(samples, lens, each, alpha=alpha, per_pixel=squares), squares, rfilter)
        for each in channels
    ]
    picture = pictures[0]
    if len(channels) == 3:  # Alpha is that of green.
        picture = np.stack(
            [of[..., i] for i, of in enumerate((*pictures, pictures[1])[: picture.shape[-1]])],
            axis=-1,
        )
    if filters:
        # The field of view is the samples', and so is the film's width.
        pixels_per_mm = samples.camera.focal_length_pixels / lens.film_distance
        lens = lens.replace(frame_width=samples.camera.film_size[0] / pixels_per_mm)
        picture = apply_filters(picture, filters, lens, pixels_per_mm)
    return mi.TensorXf(picture.astype(np.float32))


def _squares(method: str, samples: PointSamples, psf: PointSpreadFunction) -> int:
    """Squares on a side of a pixel by default."""
    if method == "paper":
        return SQUARES[method]
    squares = DIFFRACTION_SQUARES if aperture_behind(psf).diffracts else SQUARES[method]
    # No more than there are samples: squares without any show nothing.
    pixels = samples.window[2] * samples.window[3]
    return max(1, min(squares, math.isqrt(len(samples) // pixels)))


def film_options(film: mi.Film) -> dict[str, Any]:
    """What :func:`focus` needs to know of the film that its picture is for."""
    alpha = mi.has_flag(film.flags(), mi.FilmFlags.Alpha)
    return {"rfilter": film.rfilter(), "alpha": alpha}


def check_options(
    *,
    method: str = "layered",
    lens_points: int = 1,
    tables: int = 2,
    inverse_square: bool = True,
    squares: int = 1,
) -> None:
    """Raise ``ValueError`` or ``TypeError`` for an option that :func:`focus` cannot use."""
    if method not in METHODS:
        raise ValueError(f"method={method!r}: must be one of {', '.join(METHODS)}")
    require_whole("lens_points", lens_points, 1, MOST_LENS_POINTS)
    require_whole("tables", tables, 2, MOST_TABLES)
    require_whole("squares", squares, 1, 16)
    if not isinstance(inverse_square, (bool, np.bool_)):
        raise TypeError(f"inverse_square={inverse_square!r}: must be True or False")


def reconstruct(
    fine: np.ndarray,
    weights: np.ndarray,
    squares: int,
    rfilter: mi.ReconstructionFilter | None = None,
) -> np.ndarray:
    """Pixels of a film from ``squares`` x ``squares`` values in each.

    A pixel is the mean of the squares under its filter (box by default), each weighted by
    ``weights``, float (H, W). Where all weights are 0 it is 0.
    """
    if squares == 1 and (rfilter is None or rfilter.is_box_filter()):
        return fine
    radius, response = _response(rfilter)
    margin = max(0, math.ceil((radius - 0.5) * squares))
    taps = response((np.arange(-margin, squares + margin) + 0.5) / squares - 0.5).tolist()

    def filtered(values: np.ndarray) -> np.ndarray:
        for axis in (0, 1):
            values = np.moveaxis(values, axis, 0)
            padded = np.pad(values, [(margin, margin)] + [(0, 0)] * (values.ndim - 1))
            stop = len(values)
            values = sum(
                tap * padded[start : start + stop : squares] for start, tap in enumerate(taps)
            )
            values = np.moveaxis(values, 0, axis)
        return values

    weights = weights[..., None]
    total = filtered(weights)
    return filtered(fine * weights) / np.where(total == 0, 1, total)


def _response(
    rfilter: mi.ReconstructionFilter | None,
) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
    """Radius in pixels and response of a filter."""
    if rfilter is None or rfilter.is_box_filter():
        return 0.5, np.ones_like
    return rfilter.radius(), lambda x: np.array(rfilter.eval(mi.Float(x)), dtype=np.float64)
