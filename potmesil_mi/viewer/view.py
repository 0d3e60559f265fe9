"""A viewer of samples: answers what a page asks, and knows of no page and no connection."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .._files import in_json
from .._image import encoded_picture
from .._progress import progress
from .._validation import require_number
from .._warnings import FocusWarning
from ..filters.base import FilterFunction, as_filters
from ..focusing.film import ReconstructionFilter
from ..focusing.methods import Layered, Method, MethodName
from ..focusing.session import FocusSession
from ..optics.aperture import Aperture
from ..optics.disc import Disc
from ..optics.polygon import Polygon
from ..optics.telecentric import require_fitting
from ..samples.blurring import about_picture, sentence
from ..samples.choosing import focus_distance_at, require_samples
from ..samples.point_samples import PointSamples
from ..samples.smaller import MOST_TIMES, smaller
from ..stacks.foci import Lens
from .asked import BLADES, DISC, METHODS, OWN, POLYGON, STOPS, Asked
from .beside import Beside, Difference
from .copied import as_python, as_xml
from .overlays import Maps
from .sliders import foci, focus_text, opening_of, opening_text, openings

SMALL_PIXELS = 40_000
"""Most pixels of the small pictures that are shown while one drags; a film that has no more has
none."""

QUALITY = 97
SMALL_QUALITY = 85
"""Quality of the JPEGs of pictures; maps are PNGs."""


EXPECTED = (ValueError, TypeError, OSError, RuntimeError, ImportError, MemoryError)
"""Errors that say what is wrong."""


class Answer(NamedTuple):
    """What a page is told, an object as JSON has it, and the picture in a file's bytes."""

    message: dict[str, Any]
    picture: bytes


class _Formed(NamedTuple):
    """A picture, linear (H, W, 3), and by what it was formed."""

    lens: Lens
    method: Method
    picture: np.ndarray


class _Film:
    """A film, of the size of the samples or smaller: its session, its maps, its last picture."""

    def __init__(self, samples: PointSamples, times: int) -> None:
        self.samples = samples
        self.times = times
        self.maps = Maps(samples, times)
        self._session: FocusSession | None = None
        self._formed: _Formed | None = None

    def picture(
        self,
        lens: Lens,
        method: Method,
        rfilter: ReconstructionFilter | None,
        filters: Sequence[FilterFunction],
    ) -> np.ndarray:
        """The picture, linear (H, W, 3), formed anew unless it is the last one."""
        last = self._formed
        if last is None or last.lens != lens or last.method != method:
            if self._session is None or self._session.method != method:
                self._session = FocusSession(self.samples, method)
                self._session.accept_any_focus()  # Sliders reach all that is in sight.
            formed = self._session.focus(lens, rfilter=rfilter, filters=filters)
            last = self._formed = _Formed(lens, method, np.array(formed))
        return last.picture

    @property
    def box(self) -> list[int]:
        """Left, top, width and height of the picture in pixels of the shown one."""
        crop, times = self.samples.crop_window, self.times
        return [crop.left * times, crop.top * times, crop.width * times, crop.height * times]


class Viewer:
    """Pictures of samples through the lenses that a page asks for, one after the other.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples
    ``lens``                      the lens to begin with; the samples' own by default
    ``method``                    the method to begin with
    ``rfilter``, ``filters``      as for :func:`potmesil_mi.focus`
    ``beside``                    what renders the ``thinlens``; ``None`` where there is no scene
    ============================  ==========================================================

    It is for one thread. Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """

    def __init__(
        self,
        samples: PointSamples,
        lens: Lens | None = None,
        method: Method | MethodName = "layered",
        *,
        rfilter: ReconstructionFilter | None = None,
        filters: Sequence[FilterFunction | str] = (),
        beside: Beside | None = None,
    ) -> None:
        require_samples(samples)
        own = samples.lens if lens is None else lens
        require_fitting(samples.camera, own)
        self._own: Lens = own.plain()
        self._method = Method.parse(method)
        self._rfilter = rfilter
        self._filters = as_filters(filters)
        self._beside = beside
        self._foci = foci(samples, self._own)
        self._openings = openings(samples, self._own)
        self._full = _Film(samples, 1)
        self._small: _Film | None = None
        times = math.ceil(math.sqrt(samples.crop_window.size / SMALL_PIXELS))
        self._times = min(times, MOST_TIMES)
        self.lens = self._start_lens()

    @property
    def about(self) -> dict[str, Any]:
        """What a page has to know before it asks: sizes, sliders, and where they stand."""
        camera, provenance = self._full.samples.camera, self._full.samples.provenance
        start = Asked(
            id="",
            focus_distance=float(self.lens.focus_distance),
            at=None,
            opening=self._opening(self.lens),
            shape=OWN,
            blades=6,
            method=OWN,
            exposure=0.0,
            overlay="none",
            small=False,
        )
        overlays = ["none", "depth", "circles", "sharp"]
        if self._beside is not None:
            overlays.append("difference")
        return in_json(
            {
                "title": str(provenance.get("scene", provenance.get("picture", ""))),
                "width": camera.crop_size[0],
                "height": camera.crop_size[1],
                "foci": self._foci,
                "focus_texts": [focus_text(self._own, one) for one in self._foci],
                "openings": self._openings,
                "opening_texts": [opening_text(self._own, one) for one in self._openings],
                "shapes": self._shapes(),
                "blades": BLADES,
                "methods": {OWN: str(self._method)}
                | {name: name for name in METHODS if name != str(self._method)},
                "stops": STOPS,
                "overlays": overlays,
                "has_small": self._times > 1,
                "start": dataclasses.asdict(start),
            }
        )

    def answer(self, message: Any) -> Answer:
        """The picture that a ``message`` of a page asks for, or what is wrong with it.

        An error is an answer, too: nobody but the page is there to be told.
        """
        name = message.get("id", "") if isinstance(message, dict) else ""
        try:
            asked = Asked.of(message)
            with progress(lambda text, share: None), warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", FocusWarning)
                answer = self._answered(asked)
            if not answer.message["small"]:  # Circles of a smaller film say nothing of this one.
                answer.message["note"] = " ".join(str(one.message) for one in caught)
            return answer
        except Exception as error:
            expected = isinstance(error, EXPECTED)
            text = str(error) if expected else f"{type(error).__name__}: {error} (unexpected)"
            return Answer({"kind": "error", "id": str(name)[:80], "text": text}, b"")

    def _answered(self, asked: Asked) -> Answer:
        lens, method = self._lens_of(asked), self._method_of(asked)
        film = self._film(asked.small)
        shown, difference = self._shown(asked, film, lens, method)
        is_map = asked.overlay not in ("none", "sharp")
        gain = 1.0 if is_map else 2.0**asked.exposure
        encoded = encoded_picture(
            shown * np.float32(gain),
            ".png" if is_map else ".jpg",
            SMALL_QUALITY if film.times > 1 else QUALITY,
        )
        self.lens = lens
        said = sentence(about_picture(self._full.samples, lens))
        message: dict[str, Any] = {
            "kind": "picture",
            "id": asked.id,
            "small": film.times > 1,
            "box": self._box(film),
            "type": "image/png" if is_map else "image/jpeg",
            "focus_distance": float(lens.focus_distance),
            "focus_text": focus_text(lens, float(lens.focus_distance)),
            "opening_text": opening_text(lens, self._opening(lens)),
            "line": said if difference is None else f"{said}; {difference.text}",
            "more": difference is not None and not difference.is_done,
        }
        if film.times == 1:  # They are long where the aperture is a picture.
            message["python"] = as_python(lens, method)
            message["xml"] = as_xml(lens, self._full.samples.camera)
        return Answer(in_json(message), encoded)

    def _shown(
        self, asked: Asked, film: _Film, lens: Lens, method: Method
    ) -> tuple[np.ndarray, Difference | None]:
        """What is shown, linear (H, W, 3), and the difference if that is it."""
        if asked.overlay == "depth":
            return film.maps.depth_shown(), None
        if asked.overlay == "circles":
            return film.maps.circles_shown(lens), None
        picture = film.picture(lens, method, self._rfilter, self._filters)
        if asked.overlay == "sharp":
            return film.maps.sharp_shown(lens, picture), None
        if asked.overlay == "difference" and not asked.small:
            if self._beside is None:
                raise ValueError("overlay=difference: needs a scene, of which there are samples")
            difference = self._beside.difference(picture, lens)
            return difference.shown, difference
        return picture, None

    def _shapes(self) -> dict[str, str]:
        """Shapes of the aperture and how a page calls them; what is the lens's own comes once."""
        own = self._aperture
        others = {name: name for name in (DISC, POLYGON) if own != Disc() or name != DISC}
        return {OWN: own.name, **others}

    def _film(self, small: bool) -> _Film:
        if not small or self._times <= 1:
            return self._full
        if self._small is None:
            self._small = _Film(smaller(self._full.samples, self._times), self._times)
        return self._small

    def _box(self, film: _Film) -> list[int]:
        left, top, width, height = film.box
        crop = self._full.samples.crop_window
        return [left - crop.left, top - crop.top, width, height]

    def _start_lens(self) -> Lens:
        """The lens to begin with, which is open and focused within reach."""
        opening = self._opening(self._own)
        least, most = min(self._openings), max(self._openings)
        distance = min(max(float(self._own.focus_distance), self._foci[0]), self._foci[-1])
        return self._replaced(distance, min(max(opening, least), most), self._aperture)

    def _opening(self, lens: Lens) -> float:
        return float(getattr(lens, opening_of(self._own)))

    @property
    def _aperture(self) -> Aperture:
        return Aperture.parse(self._own.aperture)

    def _replaced(self, distance: float, opening: float, aperture: Aperture) -> Lens:
        changes: Any = {
            "focus_distance": distance,
            opening_of(self._own): opening,
            "aperture": aperture,
        }
        return self._own.replace(**changes)

    def _lens_of(self, asked: Asked) -> Lens:
        least, most = min(self._openings), max(self._openings)
        slack = 1e-9 * most  # The lens to begin with may have been rounded.
        require_number(opening_of(self._own), asked.opening, least - slack, most + slack)
        aperture: Aperture = self._aperture
        if asked.shape == DISC:
            aperture = Disc()
        elif asked.shape == POLYGON:
            aperture = Polygon(asked.blades)
        distance = asked.focus_distance
        if asked.at is not None:
            crop = self._full.samples.crop_window
            x, y = asked.at
            distance = focus_distance_at(self._full.samples, x + crop.left, y + crop.top)
        return self._replaced(distance, asked.opening, aperture)

    def _method_of(self, asked: Asked) -> Method:
        """The method; small pictures of what is visible are formed by the quickest one."""
        method = self._method if asked.method == OWN else Method.parse(asked.method)
        if asked.small and self._times > 1 and method.name == "lightfield":
            return Layered()
        return method
