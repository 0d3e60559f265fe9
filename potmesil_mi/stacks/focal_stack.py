"""A focal stack: pictures of the same samples through several lenses, formed when asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .. import _backend as jit
from .._html import card, displayed
from .._progress import reported, step_progress
from .._units import said_length
from .._validation import require_kind, shown
from ..filters.base import FilterFunction, as_filters
from ..focusing.methods import Method, MethodName
from ..focusing.session import FocusSession
from ..optics.display import opening_of
from ..optics.telecentric import require_fitting
from ..samples.display import scene_facts, thumbnail
from ..samples.point_samples import PointSamples
from .foci import Foci, Lens, warn_of_no_focus

if TYPE_CHECKING:
    from ..focusing.film import ReconstructionFilter


class FocalStack:
    """Pictures of the same samples through several lenses: what :func:`focal_stack` gives.

    Iterating over it forms one picture after the other, linear RGB (A), (height, width, 3 or 4),
    as :func:`potmesil_mi.focus` gives them, and keeps none; ``stack[i]`` forms one of them. Its
    length is the number of pictures.

    ============================  ==========================================================
    Attribute                     Meaning
    ============================  ==========================================================
    ``lenses``                    the lens of each picture, in order
    ``session``                   the :class:`potmesil_mi.FocusSession` that forms them
    ============================  ==========================================================
    """

    def __init__(self, session: FocusSession, lenses: Sequence[Lens], **picture: Any) -> None:
        self.session = session
        self.lenses = tuple(lenses)
        self._picture = picture
        session.accept_any_focus()

    def __len__(self) -> int:
        return len(self.lenses)

    def __getitem__(self, index: int) -> jit.TensorXf:
        return self.session.focus(self.lenses[index], **self._picture)

    def __iter__(self) -> Iterator[jit.TensorXf]:
        with reported() as report:
            for index in range(len(self)):
                with step_progress(report, f"Picture {index}", index, len(self)):
                    picture = self[index]
                yield picture

    def _repr_html_(self) -> str | None:
        return displayed(lambda: card("FocalStack", self._facts(), thumbnail(self.session.samples)))

    def _facts(self) -> dict[str, str]:
        unit = getattr(self.lenses[0], "millimeters_per_unit", None)
        foci = sorted({float(lens.plain().focus_distance) for lens in self.lenses})
        ends = " to ".join(said_length(end, unit) for end in dict.fromkeys((foci[0], foci[-1])))
        return {
            "pictures": f"{len(self)}",
            "focused at": ends,
            "lens": ", ".join(dict.fromkeys(opening_of(lens) for lens in self.lenses)),
            "method": f"{self.session.method}",
            **scene_facts(self.session.samples),
        }

    def __repr__(self) -> str:
        return f"FocalStack({len(self)} pictures of {self.session!r})"


def focal_stack(
    samples: PointSamples | FocusSession,
    distances: Sequence[float | str] | None = None,
    *,
    near: float | str | None = None,
    far: float | str | None = None,
    count: int | None = None,
    f_numbers: Sequence[float | str] | None = None,
    lenses: Sequence[Lens | Mapping[str, Any]] | None = None,
    method: Method | MethodName | None = None,
    rfilter: ReconstructionFilter | None = None,
    alpha: bool = False,
    filters: Sequence[FilterFunction | str] = (),
) -> FocalStack:
    """Pictures of the same samples at several focused distances, apertures, or lenses.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples, whose lens changes from picture to picture; or
                                  a :class:`potmesil_mi.FocusSession` of them. They must serve
                                  the widest aperture, see ``Sampling.min_f_number``
    ``distances``                 focused distances in scene units, ``inf`` allowed (of a
                                  :class:`potmesil_mi.TelecentricLens` any finite numbers)
    ``near``, ``far``, ``count``  in their place ``count`` distances, 2 at least, from ``near`` to
                                  ``far``, at equal steps of the circle of confusion: equal
                                  steps of 1/U, where ``far`` may be ``inf``; of U for a
                                  :class:`potmesil_mi.TelecentricLens`
    ``f_numbers``                 aperture numbers F/D, with each of which all distances are
                                  focused on, in order; the lens's own by default
    ``lenses``                    in place of all these the lenses themselves, in order; or
                                  mappings of what each has in place of the parameters of
                                  ``samples.lens``
    ``method``                    as in :func:`potmesil_mi.focus`, ``layered`` by default; ``None``
                                  with a session, which has its own
    ``rfilter``, ``alpha``,       as in :func:`potmesil_mi.focus`
    ``filters``
    ============================  ==========================================================

    What is found out about the samples is found out once. All lenses are checked before the first
    picture is formed. Raises ``ValueError`` or ``TypeError`` that names the parameter, and for a
    lens its place.
    """
    allowed = "PointSamples, as render_samples gives, or a FocusSession"
    require_kind("samples", samples, (PointSamples, FocusSession), allowed)
    if isinstance(samples, FocusSession):
        if method is not None:
            raise ValueError(
                f"method={shown(method)}: must be None for a session, which has its own"
            )
        session = samples
    else:
        session = FocusSession(samples, "layered" if method is None else method)
    found = Foci(distances, near, far, count, f_numbers, lenses).lenses(session.samples.lens)
    for i, lens in enumerate(found):
        if lenses is not None:
            try:
                require_fitting(session.samples.camera, lens)
            except ValueError as error:
                raise ValueError(f"lenses[{i}]: {error}") from error
    warn_of_no_focus(session.samples, found, depth=2)
    return FocalStack(session, found, rfilter=rfilter, alpha=alpha, filters=as_filters(filters))
