"""Methods: how a picture is formed. One family of frozen dataclasses and of texts.

What forms it is imported then, so that the options of a method are known without waiting for
Dr.Jit and SciPy.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from .._spec import Spec
from .._validation import require_flag, require_whole
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction, aperture_behind
from ..samples.point_samples import PointSamples
from .exposure import FINE_SUBPIXELS, Exposure, Visibility
from .memo import Memo

if TYPE_CHECKING:
    from .. import _backend as jit
    from .film import FinePicture, ReconstructionFilter

MethodName = Literal["layered", "lightfield", "paper"]
"""The names of the package's own methods."""

MAX_LENS_POINTS = 4096
MAX_TABLES = 10_000
MAX_SQUARES = 16

PAPERS_TABLES = 73
"""Tables in the paper's own run."""

VIGNETTING_LENS_POINTS = 128
"""Lens points, at least, with vignetting: what the rim of the lens cuts is all formed by points."""

MANY_SAMPLES = 64
"""Samples a pixel from which on their noise is less than what whole pixels and few points of the
lens leave out."""

CLOSE_SQUARES = 2
"""Subpixels on a side of a pixel of ``layered`` in crowded scenes, and for many samples."""

CLOSE_LENS_POINTS = 64
"""Lens points of ``layered`` then."""

VERY_MANY_SAMPLES = 256
"""Samples a pixel from which on ``layered`` takes fine subpixels, each of which has enough."""

FINE_SQUARES = FINE_SUBPIXELS
"""Subpixels on a side of a pixel of ``lightfield`` in crowded scenes, and of ``layered`` then."""

FINE_LENS_POINTS = 192
"""Lens points of ``lightfield`` in crowded scenes."""

MAX_FINE_SAMPLES = 3 << 20
"""Most samples that ``lightfield`` looks at more closely in crowded scenes: what each lens point
sees of each is a byte, up to 0.6 GB of them, and all that is made of these about 4.5 GB."""

DIFFRACTION_SQUARES = 2
"""Subpixels on a side of a pixel where light diffracts."""


class Method(Spec, family="method"):
    """How a picture is formed.

    A method of one's own is a frozen dataclass with a ``name`` and :meth:`form`.
    """

    squares: int | None = None
    """Subpixels on a side of a pixel; ``None`` for :meth:`default_squares`."""

    def form(self, exposure: Exposure, memo: Memo) -> FinePicture | tuple[np.ndarray, np.ndarray]:
        """The picture of ``exposure`` on subpixels, and what each of them counts in its pixel.

        Returns float (height, width, 3 or 4) of the crop window in subpixels, linear RGB and
        alpha if it was asked for, and float (height, width); or these with their moments.
        ``memo`` keeps what was found out.
        """
        raise NotImplementedError

    def form_attached(
        self,
        exposure: Exposure,
        memo: Memo,
        lens: ThinLens,
        psf: PointSpreadFunction,
        rfilter: ReconstructionFilter | None,
    ) -> jit.TensorXf:
        """The picture of ``exposure`` in pixels, attached to what has gradients.

        ``lens`` and ``psf`` are those of the exposure, with their gradients. Raises
        ``NotImplementedError`` for a method that has no derivatives.
        """
        raise NotImplementedError(
            f"method={self.name}: has no derivatives, as layered and lightfield have; detach what "
            "has gradients enabled, as by dr.detach"
        )

    def default_squares(self, samples: PointSamples, psf: PointSpreadFunction) -> int:
        """Subpixels on a side of a pixel, unless ``squares`` says it."""
        return 1

    def check(self, lens: ThinLens) -> None:
        """Raise ``ValueError`` for a lens with which the method can form no picture."""


@dataclasses.dataclass(frozen=True)
class VisibleMethod(Method):
    """Methods that know what hides what."""

    lens_points: int | None = None
    squares: int | None = None

    usual_lens_points: ClassVar[int]
    usual_squares: ClassVar[int]
    exact: ClassVar[bool]

    def __post_init__(self) -> None:
        if self.lens_points is not None:
            require_whole("lens_points", self.lens_points, 1, MAX_LENS_POINTS)
        _check_squares(self.squares)

    def form(self, exposure: Exposure, memo: Memo) -> FinePicture:
        """See :meth:`Method.form`."""
        from . import layered

        return layered.form(exposure, memo, visibility_for(self, exposure))

    def form_attached(
        self,
        exposure: Exposure,
        memo: Memo,
        lens: ThinLens,
        psf: PointSpreadFunction,
        rfilter: ReconstructionFilter | None,
    ) -> jit.TensorXf:
        """See :meth:`Method.form_attached`."""
        from .gradients.form import form

        return form(exposure, memo, visibility_for(self, exposure), lens, psf, rfilter)

    def default_squares(self, samples: PointSamples, psf: PointSpreadFunction) -> int:
        """See :meth:`Method.default_squares`: no more than there are samples."""
        diffracts = aperture_behind(psf).diffracts
        squares = DIFFRACTION_SQUARES if diffracts else self.squares_for(samples)
        # Subpixels without a sample show nothing.
        return max(1, min(squares, math.isqrt(samples.spp)))

    def points_for(self, samples: PointSamples) -> int:
        """Lens points for ``samples``, unless ``lens_points`` says it."""
        return self.usual_lens_points

    def squares_for(self, samples: PointSamples) -> int:
        """Subpixels on a side of a pixel for ``samples``, if they are enough."""
        return self.usual_squares


def visibility_for(method: VisibleMethod, exposure: Exposure) -> Visibility:
    """How a method finds visibility for an ``exposure``."""
    points = method.lens_points
    if points is None:
        least = VIGNETTING_LENS_POINTS if exposure.lens.vignetting > 0 else 1
        points = max(method.points_for(exposure.samples), least)
    return Visibility(points, method.exact)


@dataclasses.dataclass(frozen=True)
class Layered(VisibleMethod):
    """What is visible through the lens, formed quickly.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``lens_points``               points of the lens from which visibility is found, 1 to 4096
                                  (default 32; from 64 samples a pixel on and in crowded
                                  scenes 64; with vignetting 128)
    ``squares``                   subpixels on a side of a pixel, 1 to 16 (default 1; from 64
                                  samples a pixel on, in crowded scenes and with diffraction 2;
                                  from 256 on 4)
    ============================  ==========================================================

    A scene is crowded where for every four samples that the pinhole sees there is a hidden one,
    as behind hair.
    """

    name: ClassVar[str] = "layered"
    usual_lens_points: ClassVar[int] = 32
    usual_squares: ClassVar[int] = 1
    exact: ClassVar[bool] = False

    def points_for(self, samples: PointSamples) -> int:
        """Lens points for ``samples``, unless ``lens_points`` says it."""
        return CLOSE_LENS_POINTS if _worth_a_close_look(samples) else self.usual_lens_points

    def squares_for(self, samples: PointSamples) -> int:
        """Subpixels on a side of a pixel for ``samples``, if they are enough."""
        if samples.spp >= VERY_MANY_SAMPLES:
            return FINE_SQUARES
        return CLOSE_SQUARES if _worth_a_close_look(samples) else self.usual_squares


def _worth_a_close_look(samples: PointSamples) -> bool:
    """Whether what :class:`Layered` leaves out would show."""
    return samples.spp >= MANY_SAMPLES or samples.is_crowded


@dataclasses.dataclass(frozen=True)
class LightField(VisibleMethod):
    """What is visible through the lens, with more lens points on a finer raster: to be trusted.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``lens_points``               points of the lens from which visibility is found, 1 to 4096
                                  (default 128, in crowded scenes 192)
    ``squares``                   subpixels on a side of a pixel, 1 to 16 (default 2, in crowded
                                  scenes 4; no more than the root of the samples a pixel)
    ============================  ==========================================================

    Scenes are crowded as for :class:`Layered`. It takes about 1.5 kB of memory for each
    sample; with more than 3145728 of them they are looked at like others.
    """

    name: ClassVar[str] = "lightfield"
    usual_lens_points: ClassVar[int] = 128
    usual_squares: ClassVar[int] = 2
    exact: ClassVar[bool] = True

    def points_for(self, samples: PointSamples) -> int:
        """Lens points for ``samples``, unless ``lens_points`` says it."""
        return FINE_LENS_POINTS if _may_be_fine(samples) else self.usual_lens_points

    def squares_for(self, samples: PointSamples) -> int:
        """Subpixels on a side of a pixel for ``samples``, if they are enough."""
        return FINE_SQUARES if _may_be_fine(samples) else self.usual_squares


@dataclasses.dataclass(frozen=True)
class Equation20(Method):
    """Equation 20 of the paper as printed, which knows no occlusion.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``tables``                    depths, equally spaced from the nearest to the farthest
                                  sample, with a table each; 2 to 10000 (default 73, the
                                  paper's)
    ``inverse_square``            light falls off as 1/z^2 (default, the paper's); a
                                  ray-traced lens does without
    ``squares``                   subpixels on a side of a pixel, 1 to 16 (default 2)
    ============================  ==========================================================
    """

    tables: int = PAPERS_TABLES
    inverse_square: bool = True
    squares: int | None = None

    name: ClassVar[str] = "paper"

    def __post_init__(self) -> None:
        require_whole("tables", self.tables, 2, MAX_TABLES)
        require_flag("inverse_square", self.inverse_square)
        _check_squares(self.squares)

    def form(self, exposure: Exposure, memo: Memo) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Method.form`; nothing is kept."""
        from . import equation20

        return equation20.form(exposure, self.tables, bool(self.inverse_square))

    def default_squares(self, samples: PointSamples, psf: PointSpreadFunction) -> int:
        """See :meth:`Method.default_squares`: as many as the paper's."""
        return 2

    def check(self, lens: ThinLens) -> None:
        """See :meth:`Method.check`: the tables are the same all over the picture."""
        if lens.vignetting > 0:
            raise ValueError(
                f"vignetting={lens.vignetting}: must be 0 for the method paper, whose tables are "
                "the same all over the picture"
            )


def method_of(
    method: Method | str,
    *,
    lens_points: int | None = None,
    tables: int | None = None,
    inverse_square: bool | None = None,
    squares: int | None = None,
) -> Method:
    """The method of a name, a text such as ``layered:lens_points=64``, or itself.

    Options that are given replace its own; those that it does not have are checked and ignored.
    Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """
    method = Method.parse(method)
    options = {
        "lens_points": lens_points,
        "tables": tables,
        "inverse_square": inverse_square,
        "squares": squares,
    }
    given = {name: value for name, value in options.items() if value is not None}
    for kind in (Layered, Equation20):
        kind(**_of(kind, given))
    changed: Any = method
    return dataclasses.replace(changed, **_of(type(method), given)) if given else method


def _of(kind: type[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that a method has."""
    names = {field.name for field in dataclasses.fields(kind)}
    return {name: value for name, value in options.items() if name in names}


def _may_be_fine(samples: PointSamples) -> bool:
    """Whether samples are of a crowded scene, and few enough to look at it closely."""
    return samples.is_crowded and len(samples) <= MAX_FINE_SAMPLES


def _check_squares(squares: int | None) -> None:
    if squares is not None:
        require_whole("squares", squares, 1, MAX_SQUARES)
