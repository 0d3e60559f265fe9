"""The focus stage: a picture through the lens, from point samples.

Section 3.2 of Potmesil & Chakravarty (1981). Methods form the picture on a grid finer than the
pixels; here it is brought to the film.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from .checks import require_whole
from .lens import ThinLens
from .paper import equation_20
from .psf import Disc, PointSpreadFunction
from .samples import PointSamples
from .scene import require_vectorised_variant

METHODS = ("paper",)
MOST_TABLES = 10_000


def focus(
    samples: PointSamples,
    lens: ThinLens | None = None,
    *,
    method: str = "paper",
    psf: PointSpreadFunction | None = None,
    tables: int = 73,
    inverse_square: bool = True,
    squares: int = 2,
    rfilter: mi.ReconstructionFilter | None = None,
    alpha: bool = False,
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
    ``method``                    ``paper``: equation 20. It knows no occlusion
    ``psf``                       how the light of a point is spread; by default
                                  :class:`potmesil_mi.Disc`, uniform
    ``tables``                    number of depths, equally spaced from the nearest to the
                                  farthest sample, with a table each; 2 to 10000 (default 73,
                                  the paper's)
    ``inverse_square``            light falls off as 1/z^2, as in the paper (default); a
                                  ray-traced lens does without
    ``squares``                   each pixel is evaluated as so many squares on a side, 1 to
                                  16 (default 2, the paper's)
    ``rfilter``                   the film's reconstruction filter; box by default
    ``alpha``                     add a fourth channel with the coverage
    ============================  ==========================================================

    Returns linear RGB (A), (height, width, 3 or 4), of the samples' crop window.
    Raises ``ValueError`` or ``TypeError`` that names the parameter, ``RuntimeError`` in scalar
    variants.
    """
    require_vectorised_variant("focus")
    check_options(method=method, tables=tables, inverse_square=inverse_square, squares=squares)
    lens = samples.lens if lens is None else lens
    if not isinstance(lens, ThinLens):
        raise TypeError(f"lens={lens!r}: must be a ThinLens, such as samples.lens.replace(...)")
    psf = Disc() if psf is None else psf
    if not hasattr(psf, "table"):
        raise TypeError(f"psf={psf!r}: must be a point-spread function, such as Disc()")

    fine, weights = equation_20(
        samples,
        ThinLens(**lens.to_dict()).in_units(samples.lens.millimeters_per_unit),
        psf,
        alpha=alpha,
        tables=tables,
        inverse_square=inverse_square,
        per_pixel=squares,
    )
    return mi.TensorXf(reconstruct(fine, weights, squares, rfilter).astype(np.float32))


def film_options(film: mi.Film) -> dict[str, Any]:
    """What :func:`focus` needs to know of the film that its picture is for."""
    alpha = mi.has_flag(film.flags(), mi.FilmFlags.Alpha)
    return {"rfilter": film.rfilter(), "alpha": alpha}


def check_options(
    *, method: str = "paper", tables: int = 73, inverse_square: bool = True, squares: int = 2
) -> None:
    """Raise ``ValueError`` or ``TypeError`` for an option that :func:`focus` cannot use."""
    if method not in METHODS:
        raise ValueError(f"method={method!r}: must be one of {', '.join(METHODS)}")
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
    radius, response = _response(rfilter)
    margin = max(0, math.ceil((radius - 0.5) * squares))
    taps = response((np.arange(-margin, squares + margin) + 0.5) / squares - 0.5)

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
