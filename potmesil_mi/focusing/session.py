"""A session: samples, a method, and what has been found out about them for every focus."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .. import _backend as jit
from .._memory import require_memory
from .._validation import require_flag, shown
from ..filters.base import FilterFunction, apply_filters, as_filters
from ..optics.aperture import Aperture
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction
from ..optics.telecentric import (
    TelecentricLens,
    ThinLensPicture,
    as_thin_lens,
    require_fitting,
)
from ..optics.usable import require_usable_lens
from ..samples.choosing import require_samples
from ..samples.circles import FOCUS, in_units_of
from ..samples.point_samples import PointSamples
from .derivatives import gradients_of, require_derivatives, without_gradients
from .exposure import Exposure
from .film import FinePicture, ReconstructionFilter, degree_of, reconstruct
from .memo import MAX_BYTES, Memo
from .memory import memory_of_focus
from .methods import Method, MethodName
from .telecentric import changed, require_usable
from .traps import warn_of_traps

GRADIENTS_TAKE = 4
"""Times the memory that a picture takes with gradients: 1.9 of plain scenes, 3.9 of the thicket."""

_memos: weakref.WeakKeyDictionary[PointSamples, Memo] = weakref.WeakKeyDictionary()
"""What :func:`potmesil_mi.focus` has found out, for as long as there are the samples."""

forming = threading.RLock()
"""Held while a picture is formed: what is kept is for one thread at a time."""

_making_memos = threading.Lock()
"""Held while the memo of samples is looked up."""


class FocusSession:
    """Pictures through any lens of the same samples, by one method.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples
    ``method``                    ``layered`` (default), ``lightfield`` or ``paper``; or a
                                  :class:`potmesil_mi.Layered`, ``LightField`` or
                                  ``Equation20`` with its options, or a method of one's own
    ``max_bytes``                 bound of what is kept, >= 0, in bytes (default 2 GiB); what
                                  the last focus used is kept whatever it takes
    ============================  ==========================================================

    What depends on the samples and the aperture alone is found out at the first focus and kept
    for the next. A call that is refused changes nothing. Several threads may use one session, and
    sessions of one or of several samples, at once: pictures are formed one after the other, each
    by all processors. Sums are scattered more slowly while there are other threads. Raises
    ``ValueError`` or ``TypeError`` that names the parameter.
    """

    def __init__(
        self,
        samples: PointSamples,
        method: Method | MethodName = "layered",
        *,
        max_bytes: int = MAX_BYTES,
    ) -> None:
        require_samples(samples)
        if isinstance(max_bytes, bool) or not isinstance(max_bytes, (int, np.integer)):
            raise TypeError(f"max_bytes={shown(max_bytes)}: must be a whole number of bytes >= 0")
        if max_bytes < 0:
            raise ValueError(f"max_bytes={max_bytes}: must be >= 0")
        self._samples = samples
        self._method = Method.parse(method)
        self._memo = Memo(int(max_bytes))

    @property
    def samples(self) -> PointSamples:
        """The samples of which pictures are formed."""
        return self._samples

    @property
    def method(self) -> Method:
        """The method by which they are formed."""
        return self._method

    def focus(
        self,
        lens: ThinLens | TelecentricLens | None = None,
        *,
        psf: PointSpreadFunction | None = None,
        rfilter: ReconstructionFilter | None = None,
        alpha: bool = False,
        filters: Sequence[FilterFunction | str] = (),
    ) -> jit.TensorXf:
        """The picture that ``lens`` forms; parameters are those of :func:`potmesil_mi.focus`."""
        return form_picture(
            self.samples, lens, self.method, self._memo, psf, rfilter, alpha, filters
        )

    def accept_any_focus(self) -> None:
        """Give no warning of a focus where nothing is, as where one sweeps over all distances."""
        self._memo.warned_of.add(FOCUS)

    @property
    def max_bytes(self) -> int:
        """Bound in bytes of what is kept."""
        return self._memo.max_bytes

    @property
    def nbytes(self) -> int:
        """Memory in bytes of what is kept, without the samples."""
        return self._memo.nbytes

    def clear(self) -> None:
        """Give up what is kept; the next focus finds it out again."""
        self._memo.clear()

    def __repr__(self) -> str:
        return f"FocusSession({self.samples!r}, {str(self.method)!r})"


def memo_of(samples: PointSamples) -> Memo:
    """What is kept for ``samples`` as long as they are. Raises ``TypeError`` for anything else."""
    require_samples(samples)
    with _making_memos:
        return _memos.setdefault(samples, Memo())


class AttachedLens(NamedTuple):
    """A lens, in the samples' units, and its point-spread function, with their gradients."""

    lens: ThinLens
    psf: PointSpreadFunction


class Asked(NamedTuple):
    """What a picture is formed by, after everything that is given has been checked.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``lens``                      a thin lens of plain numbers, in the samples' units
    ``picture_of``                of which samples it forms the picture of a telecentric one
    ``channels``                  point-spread functions: of all colours, or of R, G and B
    ``method``, ``subpixels``     how the picture is formed, and on how many on a side of a pixel
    ``rfilter``, ``alpha``        as ``potmesil_mi.focus`` has them
    ``filters``                   special effects
    ``attached``                  the lens and its ``psf`` with their gradients, where anything
                                  has some
    ============================  ==========================================================
    """

    lens: ThinLens
    picture_of: ThinLensPicture | None
    channels: Sequence[PointSpreadFunction]
    method: Method
    subpixels: int
    rfilter: ReconstructionFilter | None
    alpha: bool
    filters: tuple[FilterFunction, ...]
    attached: AttachedLens | None = None

    def adapted(self, samples: PointSamples, memo: Memo) -> tuple[PointSamples, Memo]:
        """The samples that the lens is before, and the memo of these, which ``memo`` keeps."""
        return (
            (samples, memo) if self.picture_of is None else changed(samples, self.picture_of, memo)
        )

    def exposures(self, samples: PointSamples) -> list[Exposure]:
        """The exposure of each channel, of all samples that are :meth:`adapted` or of some."""
        degree = degree_of(self.rfilter, self.subpixels)
        is_telecentric = self.picture_of is not None
        return [
            Exposure(samples, self.lens, each, self.subpixels, self.alpha, is_telecentric, degree)
            for each in self.channels
        ]

    def formed(self, exposures: Sequence[Exposure], memos: Sequence[Memo]) -> np.ndarray:
        """The picture of the exposure of each channel, with its memo; without special effects."""
        pictures = [
            reconstruct(
                FinePicture(*self.method.form(exposure, memo)), self.subpixels, self.rfilter
            )
            for exposure, memo in zip(exposures, memos, strict=True)
        ]
        if len(pictures) == 1:
            return pictures[0]
        parts = (*pictures, pictures[1])[: pictures[0].shape[-1]]  # Alpha is that of green.
        return np.stack([of[..., i] for i, of in enumerate(parts)], axis=-1)

    def filtered(self, picture: np.ndarray, samples: PointSamples) -> jit.TensorXf:
        """The picture, of the samples that are :meth:`adapted`, with its special effects."""
        if self.filters:
            # The field of view is the samples', and so is the film's width.
            pixels_per_mm = samples.camera.focal_length_pixels / self.lens.film_distance
            frame = self.lens.replace(frame_width=samples.camera.film_size[0] / pixels_per_mm)
            picture = apply_filters(picture, self.filters, frame, pixels_per_mm)
        return jit.TensorXf(picture.astype(np.float32, copy=False))


def asked(
    samples: PointSamples,
    lens: ThinLens | TelecentricLens | None,
    method: Method,
    memo: Memo,
    psf: PointSpreadFunction | None,
    rfilter: ReconstructionFilter | None,
    alpha: bool,
    filters: Sequence[FilterFunction | str],
    *,
    by_tiles: bool = False,
) -> Asked:
    """What is asked for, checked, and warned of; parameters are those of ``potmesil_mi.focus``.

    Where a picture is formed ``by_tiles`` it is these that have to fit into memory.
    """
    if jit.variant() is not None:  # None: the first backend that works is taken
        jit.require_vectorised_variant("focus")
    chosen = samples.lens if lens is None else lens
    given_lens, given = lens, _plain(chosen)
    require_fitting(samples.camera, given)
    require_usable_lens(given)
    lens, picture_of = _thin_lens(samples, given)
    psf = lens.aperture if psf is None else psf
    _require_spreading(psf, rfilter)
    names, given_psf, psf = gradients_of(samples, chosen, psf), psf, without_gradients(psf)
    require_flag("alpha", alpha)
    filters = as_filters(filters)
    method.check(lens)
    if picture_of is not None:
        require_usable(psf, filters)
    subpixels = method.squares
    if subpixels is None:
        subpixels = method.default_squares(samples, psf)
    if not by_tiles:
        require_memory_for(samples, method, subpixels, with_gradients=bool(names))
    warn_of_traps(samples, in_units_of(samples, given), given_lens is not None, memo, depth=4)
    channels = psf.channels if isinstance(psf, Aperture) else (psf,)
    _require_hashable(channels)
    flag, attached = bool(alpha), None
    if names:
        require_derivatives(names, samples, chosen, given_psf, channels, filters, by_tiles=by_tiles)
        attached = AttachedLens(in_units_of(samples, chosen), given_psf)
    return Asked(lens, picture_of, channels, method, subpixels, rfilter, flag, filters, attached)


def form_picture(
    samples: PointSamples,
    lens: ThinLens | TelecentricLens | None,
    method: Method,
    memo: Memo,
    psf: PointSpreadFunction | None,
    rfilter: ReconstructionFilter | None,
    alpha: bool,
    filters: Sequence[FilterFunction | str],
) -> jit.TensorXf:
    """The picture, after everything that is given has been checked; see ``potmesil_mi.focus``."""
    wanted = asked(samples, lens, method, memo, psf, rfilter, alpha, filters)
    with forming:
        if wanted.attached is not None:
            exposure = wanted.exposures(samples)[0]
            attached = method.form_attached(exposure, memo, *wanted.attached, rfilter)
            memo.trim()
            return attached
        owned = memo
        samples, memo = wanted.adapted(samples, owned)
        exposures = wanted.exposures(samples)
        picture = wanted.formed(exposures, [memo] * len(exposures))
        for grown in (memo, owned):
            grown.trim()
        return wanted.filtered(picture, samples)


def require_memory_for(
    samples: PointSamples, method: Method, subpixels: int, *, with_gradients: bool = False
) -> None:
    """Raise ``MemoryError`` where the picture takes more than there is."""
    window, takes = samples.window, memory_of_focus(samples, method, subpixels)
    what = f"focusing {window.width}x{window.height} pixels on {subpixels}x{subpixels} subpixels"
    less = "a crop of the samples and fewer squares take less"
    if with_gradients:
        require_memory(GRADIENTS_TAKE * takes, f"{what} with gradients", less)
    else:
        require_memory(takes, what, f"tiles, {less}")


def _thin_lens(
    samples: PointSamples, lens: ThinLens | TelecentricLens
) -> tuple[ThinLens, ThinLensPicture | None]:
    """The thin lens that forms the picture, and of which samples it does for a telecentric one."""
    if isinstance(lens, TelecentricLens):
        depths = [samples.z]
        if samples.motion is not None:
            depths += [samples.z + side * samples.motion[:, 2] for side in (-0.5, 0.5)]
        picture = as_thin_lens(np.concatenate(depths), lens, samples.camera)
        return picture.lens, picture
    return in_units_of(samples, lens), None


def _require_spreading(psf: Any, rfilter: Any) -> None:
    """Raise ``TypeError`` for what spreads no light."""
    if not isinstance(psf, PointSpreadFunction):
        raise TypeError(f"psf={shown(psf)}: must be a point-spread function, such as Disc()")
    if rfilter is not None and not isinstance(rfilter, ReconstructionFilter):
        raise TypeError(
            f"rfilter={shown(rfilter)}: must be a reconstruction filter, such as film.rfilter()"
        )


def _require_hashable(channels: Sequence[PointSpreadFunction]) -> None:
    """Raise ``TypeError`` for an aperture by which nothing can be kept."""
    for psf in channels:
        try:
            hash(psf)
        except TypeError as error:
            raise TypeError(
                f"psf={type(psf).__name__}: must be hashable, as a frozen dataclass of hashable "
                f"fields is ({error})"
            ) from None


def _plain(lens: Any) -> ThinLens | TelecentricLens:
    if isinstance(lens, TelecentricLens):
        return lens
    if not isinstance(lens, ThinLens):
        raise TypeError(
            f"lens={shown(lens)}: must be a ThinLens, such as samples.lens.replace(...)"
        )
    return lens.plain()
