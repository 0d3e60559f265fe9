"""Special-effect filters: what is done to the finished picture.

Potmesil & Chakravarty (1981) name them as extensions: star and diffraction filters convolved with
the picture, uniform defocusing, fade in and out. Pictures are linear RGB or RGBA, with colours
multiplied by alpha as Mitsuba's films give them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from .._spec import Spec
from .._validation import require_kind, require_number, require_numbers, shown
from ..optics.lens import ThinLens

FilterFunction = Callable[[np.ndarray, ThinLens, float], np.ndarray]
"""What :meth:`Filter.__call__` is: any function of the picture, the lens and pixels_per_mm."""

MODULES = tuple(
    f"potmesil_mi.filters.{name}" for name in ("star", "diffraction", "defocus", "fade")
)
"""Where the filters of the package are."""


class Filter(Spec, ABC, family="filter", modules=MODULES):
    """What is done to a finished picture.

    Any function with the arguments of :meth:`__call__` can be one. A frozen dataclass that derives
    from this, with a ``name``, has a text besides, such as ``star:points=6``.
    """

    @abstractmethod
    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """The picture that becomes of ``picture``, float (H, W, 3 or 4), which stays as it is.

        ``lens`` is what it was taken with, ``pixels_per_mm`` the number of pixels in a millimetre
        of its film: the whole film, of which the picture may be a part, is
        ``lens.frame_width * pixels_per_mm`` pixels wide.
        """


def parse_filter(text: str) -> Filter:
    """The filter of a text such as ``star:points=6,length=0.1``.

    That is the name, and after a colon parameters with commas between; what has three values has
    slashes between, as in ``fade:amount=0.5,color=1/0.9/0.8``. ``str`` of a filter is such a text.
    Raises ``ValueError`` or ``TypeError`` that names what is unknown, missing or out of range.
    """
    return Filter.parse(text)


def as_filters(filters: Iterable[FilterFunction | str]) -> tuple[FilterFunction, ...]:
    """Filters of filters and texts.

    Raises ``TypeError`` for what is neither, and for one alone, ``ValueError`` for a wrong text.
    """
    if isinstance(filters, str) or not isinstance(filters, Iterable):
        raise TypeError(f"filters={shown(filters)}: must be a list, such as ['star:points=6']")
    parsed = tuple(parse_filter(one) if isinstance(one, str) else one for one in filters)
    for one in parsed:
        if not callable(one) or isinstance(one, type):
            raise TypeError(
                f"filters: {one!r} must be a filter, such as Star(), or a text, such as 'star'"
            )
    return parsed


def apply_filters(
    picture: Any,
    filters: Sequence[FilterFunction | str],
    lens: ThinLens,
    pixels_per_mm: float | None = None,
) -> np.ndarray:
    """The picture after each filter, in their order, float32 (H, W, 3 or 4).

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``picture``                   linear RGB (A), (H, W, 3 or 4); stays as it is. Values that
                                  are not finite count as 0
    ``filters``                   filters such as :class:`potmesil_mi.Star`, or their texts, see
                                  :func:`parse_filter`
    ``lens``                      what it was taken with; lengths are shares of its
                                  ``frame_width``
    ``pixels_per_mm``             pixels in a millimetre of film; by default as many as make
                                  the picture the whole frame
    ============================  ==========================================================

    Where the kernel of a filter goes beyond the picture, what is there is taken for the mean of
    what the kernel meets within; so uniform pictures stay uniform. Raises ``ValueError`` or
    ``TypeError`` that names the parameter.
    """
    filters = as_filters(filters)
    image = np.array(require_numbers("picture", picture), dtype=np.float64)
    if image.ndim != 3 or image.shape[-1] not in (3, 4) or image.size == 0:
        raise ValueError(
            f"picture={shown(picture)}: has shape {image.shape}, must be (height, width, 3 or 4)"
        )
    require_kind("lens", lens, ThinLens, "a ThinLens, such as samples.lens")
    if pixels_per_mm is None:
        pixels_per_mm = image.shape[1] / float(lens.frame_width)
    require_number("pixels_per_mm", pixels_per_mm, 0)
    image[~np.isfinite(image)] = 0
    for one in filters:
        filtered = np.asarray(one(image, lens, float(pixels_per_mm)))
        if filtered.shape != image.shape:
            raise ValueError(
                f"filters: {one!r} gave the shape {filtered.shape}, must be {image.shape}"
            )
        image = filtered
    return image.astype(np.float32)
