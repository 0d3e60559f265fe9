"""Where and how deep the image is sampled: the parameters of the hidden-surface stage."""

from __future__ import annotations

import dataclasses
from numbers import Real
from typing import Any, Literal, cast, get_args

from .._validation import (
    require_choice,
    require_flag,
    require_number,
    require_positive,
    require_whole,
    shown,
)

Pattern = Literal["sampler", "uniform", "adaptive"]
"""Where the film is sampled; see ``pattern`` of :class:`Sampling`."""

PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
"""The patterns by their names, the default first."""

PAPERS_THRESHOLD = 25 / 255
"""Difference of intensities from which the paper subdivides a square: 25 steps of 8 bits."""

REFINE = 0.25
"""Further samples, as a share of the even ones: twice as many bring little more."""

MOST_REFINE = 16
"""Most of them."""


@dataclasses.dataclass(frozen=True)
class Sampling:
    """Where the image is sampled.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``pattern``                   ``sampler`` (default): the positions of the sensor's own
                                  sampler, N samples a pixel. ``uniform``: the paper's grid
                                  of (2W+1) x (2H+1) corners, edge middles and centres.
                                  ``adaptive``: pixel corners, and where they differ, the
                                  paper's recursive subdivision in 2x2 squares
    ``threshold``                 ``adaptive``: a square is subdivided where a corner differs
                                  from the mean of the four by more than this in any of R, G,
                                  B, clipped to [0, 1]; >= 0 (default 25/255, the paper's)
    ``subdivisions``              ``adaptive``: largest number of subdivisions of a pixel,
                                  0 to 8 (default 2)
    ``layers``                    most surfaces that are sampled behind each other, 1 to 16
                                  (default): those behind the first only where some point of
                                  the lens sees them, which is traced
    ``overscan``                  pixels sampled beyond each side of the crop window, 0 to
                                  10000; by default as far as the lens sees anything in the
                                  crop window, at any focus within the scene's depth; a warning
                                  says what is missing where that is too far. Far out samples
                                  of the ``sampler`` are few
    ``min_f_number``              the widest aperture that ``layers`` and ``overscan`` must
                                  serve; by default that of the lens at hand
    ``virtual_depth``             depth of what is seen in mirrors and through glass is that of
                                  its image (default), not that of the mirror or glass
    ``refine``                    ``sampler``: further samples, as a share of those of the crop
                                  window, 0 to 16 (default 0.25). They go to pixels around which
                                  radiance varies most
    ``focus_range``               the nearest and the farthest distance that will be focused on,
                                  in scene units, or a text such as ``0.8/3``: ``refine`` spends
                                  less on what is blurred then. Twice the same is one picture.
                                  By default, and with an orthographic sensor, anything may be
                                  in focus
    ``features``                  albedo and normal of each sample are kept, with which
                                  :meth:`potmesil_mi.PointSamples.denoised` tells detail from noise
                                  (default: no); what is seen in mirrors and through glass has
                                  its own, with ``virtual_depth``
    ``clamp``                     most radiance of a sample, in any of R, G and B, > 0: brighter
                                  ones are scaled down to it, unless they show a lamp or the sky.
                                  That makes pictures darker, and takes away single samples that
                                  a lens makes bright discs of; a warning tells of these. By
                                  default there is no limit
    ============================  ==========================================================

    On the grids of ``uniform`` and ``adaptive`` N samples a pixel are N paths averaged at each
    point. Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """

    pattern: Pattern = "sampler"
    threshold: float = PAPERS_THRESHOLD
    subdivisions: int = 2
    layers: int = 16
    overscan: int | None = None
    min_f_number: float | None = None
    virtual_depth: bool = True
    refine: float = REFINE
    focus_range: tuple[float, float] | str | None = None
    features: bool = False
    clamp: float | None = None

    def __post_init__(self) -> None:
        require_choice("pattern", self.pattern, PATTERNS)
        if not isinstance(self.threshold, Real):
            raise TypeError(f"threshold={shown(self.threshold)}: must be a number >= 0")
        if not self.threshold >= 0:
            raise ValueError(f"threshold={self.threshold}: must be >= 0")
        require_whole("subdivisions", self.subdivisions, 0, 8)
        require_whole("layers", self.layers, 1, 16)
        if self.overscan is not None:
            require_whole("overscan", self.overscan, 0, 10_000)
        if self.min_f_number is not None and not isinstance(self.min_f_number, Real):
            raise TypeError(f"min_f_number={shown(self.min_f_number)}: must be a number > 0")
        if self.min_f_number is not None and not self.min_f_number > 0:
            raise ValueError(f"min_f_number={self.min_f_number}: must be > 0")
        for name in ("virtual_depth", "features"):
            require_flag(name, getattr(self, name))
        require_number("refine", self.refine, 0, MOST_REFINE)
        if self.clamp is not None:
            require_positive("clamp", self.clamp)
        if self.focus_range is not None:
            object.__setattr__(self, "focus_range", _focus_range(self.focus_range))

    @property
    def foci(self) -> tuple[float, float] | None:
        """The ``focus_range`` as two numbers."""
        return cast("tuple[float, float] | None", self.focus_range)  # read when this was made


def _focus_range(value: Any) -> tuple[float, float]:
    """Both ends of a ``focus_range``. Raises ``TypeError`` or ``ValueError`` that names it."""
    ends = value.split("/") if isinstance(value, str) else value
    allowed = "two distances > 0, the nearer one first, such as (0.8, 3) or '0.8/3'"
    try:
        near, far = (float(end) for end in ends)
    except TypeError as error:
        raise TypeError(f"focus_range={shown(value)}: must be {allowed}") from error
    except ValueError as error:
        raise ValueError(f"focus_range={shown(value)}: must be {allowed}") from error
    if not 0 < near <= far:
        raise ValueError(f"focus_range={shown(value)}: must be {allowed}")
    return near, far
