"""An animation: how the lens and the filters change from frame to frame.

Potmesil & Chakravarty (1981) name sequences, fades and focus effects as what the model is for.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .. import _backend as jit
from .._progress import reported, step_progress
from .._units import f_number_of, in_one_unit
from .._validation import require_kind, require_number, require_whole, shown
from ..filters.base import Filter, FilterFunction, as_filters
from ..focusing.session import FocusSession
from ..motion.camera_move import CameraMove
from ..motion.motion import MOTION_TABLES, Motion, Moves, moves_of
from ..motion.shape_move import ShapeMove
from ..motion.shutter import Shutter
from ..motion.toml import read_toml, table_of
from ..motion.track import (
    Scale,
    Track,
    at_frame,
    is_list_of_keys,
    named,
    require_known,
    values_at,
)
from ..optics.aperture import Aperture
from ..optics.lens import ThinLens
from ..optics.lens_checks import IN_MILLIMETERS, IN_SCENE_UNITS
from ..optics.telecentric import TelecentricLens, require_lens
from ..samples.point_samples import PointSamples

if TYPE_CHECKING:
    from ..focusing.film import ReconstructionFilter

LENS_TRACKS: dict[str, Scale] = {
    "focus_distance": "reciprocal",
    "f_number": "logarithmic",
    "aperture_radius": "linear",
    "focal_length": "linear",
    "half_angle": "linear",
    "squeeze": "logarithmic",
    "vignetting": "linear",
}
"""Parameters of a lens that can change, and in what they do so evenly."""

FOCUS_DISTANCE, F_NUMBER = "focus_distance", "f_number"

APERTURE = "aperture"
"""The parameter of a lens that is the same in all frames."""

LEAST_FPS, MOST_FPS = 0.01, 1000.0
"""Fewest and most frames a second."""

MOST_FRAMES = 1_000_000
"""Largest number of a frame."""


@dataclasses.dataclass(frozen=True)
class AnimatedFilter:
    """A filter whose parameters change from frame to frame.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``name``                      of the filter, such as ``fade``
    ``parameters``                by their names, values or a :class:`Track` each
    ============================  ==========================================================
    """

    name: str
    parameters: Mapping[str, Any]

    def __post_init__(self) -> None:
        require_kind("name", self.name, str, "the name of a filter, such as 'fade'")
        require_kind("parameters", self.parameters, Mapping, "a mapping, of names to values")

    def at(self, frame: float) -> Filter:
        """The filter of a frame. Raises what the filter raises."""
        require_number("frame", frame)
        return Filter.member(self.name).of_parameters(values_at(self.parameters, frame))


@dataclasses.dataclass(frozen=True)
class Animation(Moves):
    """How the lens and the filters change from frame to frame.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``frames``                    numbers of the frames, one after the other
    ``lens``                      parameters of the lens that it has in place of the one at
                                  hand: a :class:`Track` each. ``focus_distance`` changes
                                  evenly in 1/U, in which circles of confusion do, of a
                                  telecentric lens in itself, ``f_number`` in stops;
                                  ``aperture`` is an :class:`potmesil_mi.Aperture`
    ``filters``                   those of the finished picture, in their order
    ``fps``                       frames a second, in a movie (default 24)
    ``camera``                    how the camera moves, a :class:`CameraMove`; ``None``: it
                                  stands still
    ``shapes``                    how shapes move, by their ids: a :class:`ShapeMove` each
    ``shutter``                   a :class:`Shutter`, during which what moves is blurred;
                                  ``None``: that of the sensor, which is usually closed at once
    ============================  ==========================================================

    Where camera or shapes move, each frame needs samples of its own.
    """

    frames: range
    lens: Mapping[str, Track | Aperture] = dataclasses.field(default_factory=dict)
    filters: Sequence[AnimatedFilter] = ()
    fps: float = 24.0
    camera: CameraMove | None = None
    shapes: Mapping[str, ShapeMove] = dataclasses.field(default_factory=dict)
    shutter: Shutter | None = None

    def __post_init__(self) -> None:
        require_number("fps", self.fps, LEAST_FPS, MOST_FPS)
        if not isinstance(self.frames, range) or self.frames.step != 1 or not self.frames:
            raise ValueError(f"frames={shown(self.frames)}: must be a range of one frame at least")
        self._require_moves()
        require_kind("lens", self.lens, Mapping, "a mapping, of parameters to a Track each")
        for name, value in self.lens.items():
            if name not in LENS_TRACKS and name != APERTURE:
                known = ", ".join((*LENS_TRACKS, APERTURE))
                raise ValueError(f"lens.{name}: unknown, must be one of {known}")
            kind = Aperture if name == APERTURE else Track
            require_kind(f"lens.{name}", value, kind, f"a {kind.__name__}")
        require_kind("filters", self.filters, (tuple, list), "a tuple of AnimatedFilter")
        for i, one in enumerate(self.filters):
            require_kind(f"filters[{i}]", one, AnimatedFilter, "an AnimatedFilter")

    # ------------------------------------------------------------ from texts

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Animation:
        """Read a TOML file; ``docs/howto/animation.md`` has its form.

        Raises ``OSError`` where it cannot be read, and ``ValueError`` or ``TypeError`` that names
        the file and what in it is wrong.
        """
        return read_toml(path, cls.from_dict)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Animation:
        """The animation that a TOML file describes, of its tables.

        Raises ``ValueError`` or ``TypeError`` that names what is unknown, missing or wrong.
        """
        require_known(values, ("frames", "fps", "lens", "filters", *MOTION_TABLES))
        if "frames" not in values:
            raise ValueError("frames: must be given, a number of frames or [first, last]")
        filters = values.get("filters", [])
        if not isinstance(filters, list) or not all(isinstance(one, Mapping) for one in filters):
            raise TypeError(f"filters={shown(filters)}: must be tables, [[filters]]")
        animation = cls(
            _frames(values["frames"]),
            {name: _of_lens(name, value) for name, value in table_of(values, "lens").items()},
            tuple(_filter(f"filters[{i}]", one) for i, one in enumerate(filters)),
            values.get("fps", cls.fps),
            **moves_of(values),
        )
        for frame in animation._ends():
            animation.filters_at(frame)
        return animation

    def _ends(self) -> list[float]:
        """The first and the last frame, and where filters have keys: between these values are."""
        parameters = (value for one in self.filters for value in one.parameters.values())
        keys = (key.frame for of in parameters if isinstance(of, Track) for key in of.keys)
        first, last = self.frames.start, self.frames.stop - 1
        return sorted({first, last, *(frame for frame in keys if first < frame < last)})

    # ------------------------------------------------------------ by frames

    def lens_at(self, lens: ThinLens | TelecentricLens, frame: float) -> ThinLens | TelecentricLens:
        """What becomes of a ``lens`` at a frame.

        Raises ``ValueError`` or ``TypeError`` that names the frame and the parameter.
        """
        require_lens(lens)
        tracks, distance = dict(self.lens), self.lens.get(FOCUS_DISTANCE)
        with at_frame(frame):
            if isinstance(lens, TelecentricLens) and isinstance(distance, Track):
                # Its circles change evenly with the depth itself.
                tracks[FOCUS_DISTANCE] = dataclasses.replace(distance, scale="linear")
            changes: dict[str, Any] = values_at(tracks, frame)
            return lens.replace(**changes) if changes else lens

    def first_lens(self) -> dict[str, Any]:
        """The parameters of the lens at the first frame."""
        return values_at(self.lens, self.frames.start)

    def filters_at(self, frame: float) -> tuple[Filter, ...]:
        """The filters of a frame. Raises what :meth:`lens_at` raises."""
        filters = []
        for i, one in enumerate(self.filters):
            with at_frame(frame, f": filters[{i}]"):
                filters.append(one.at(frame))
        return tuple(filters)

    def motion_at(self, frame: float) -> Motion:
        """What moves while the picture of a frame is exposed."""
        return Motion(self.camera, self.shapes, self.shutter, frame)

    @property
    def moves(self) -> str:
        """What moves, ``camera`` or ``shapes``, so that each frame needs samples of its own.

        An empty text where neither does.
        """
        if self.camera is not None:
            return "camera"
        return "shapes" if self.shapes else ""

    def lenses(self, lens: ThinLens | TelecentricLens) -> list[ThinLens | TelecentricLens]:
        """What becomes of a ``lens`` at each of the frames."""
        return [self.lens_at(lens, frame) for frame in self.frames]

    def pictures(
        self,
        session: FocusSession | PointSamples,
        frames: Iterable[int] | None = None,
        *,
        lens: ThinLens | TelecentricLens | None = None,
        filters: Iterable[FilterFunction] = (),
        rfilter: ReconstructionFilter | None = None,
        alpha: bool = False,
    ) -> Iterator[tuple[int, jit.TensorXf]]:
        """The frames, with their numbers, as :meth:`potmesil_mi.FocusSession.focus` gives them.

        ============================  ==========================================================
        Parameter                     Meaning
        ============================  ==========================================================
        ``session``                   what pictures are formed by, or samples
        ``frames``                    which frames; all by default
        ``lens``                      the lens that changes; by default the samples' own
        ``filters``                   before those of the animation
        ``rfilter``, ``alpha``        as in :meth:`potmesil_mi.FocusSession.focus`
        ============================  ==========================================================

        Raises ``ValueError`` for a frame that there is not, before the first picture, and where
        something :attr:`moves`, and what :meth:`lens_at` and ``focus`` raise.
        """
        if self.moves:
            raise ValueError(
                f"{self.moves}: moves, so that each frame needs samples of its own; `potmesil "
                "animate SCENE.xml` takes them"
            )
        kinds = (FocusSession, PointSamples)
        require_kind("session", session, kinds, "a FocusSession, or PointSamples")
        if not isinstance(session, FocusSession):
            session = FocusSession(session)
        session.accept_any_focus()
        frames = self.frames if frames is None else frames
        require_kind("frames", frames, Iterable, "numbers of frames")
        chosen = list(frames)
        for frame in chosen:
            require_whole("frames", frame, self.frames.start, self.frames.stop - 1)
        lens = session.samples.lens if lens is None else lens
        lenses = [self.lens_at(lens, frame) for frame in chosen]
        return self._formed(session, chosen, lenses, as_filters(filters), rfilter, alpha)

    def _formed(
        self,
        session: FocusSession,
        frames: list[int],
        lenses: list[ThinLens | TelecentricLens],
        filters: tuple[FilterFunction, ...],
        rfilter: ReconstructionFilter | None,
        alpha: bool,
    ) -> Iterator[tuple[int, jit.TensorXf]]:
        with reported() as report:
            for done, (frame, lens) in enumerate(zip(frames, lenses, strict=True)):
                with step_progress(report, f"Frame {frame}", done, len(frames)):
                    picture = session.focus(
                        lens,
                        filters=(*filters, *self.filters_at(frame)),
                        rfilter=rfilter,
                        alpha=alpha,
                    )
                yield frame, picture


def _frames(value: Any) -> range:
    if isinstance(value, list):
        if len(value) != 2:
            raise ValueError(f"frames={shown(value)}: must be a number, or [first, last]")
        for i, one in enumerate(value):
            require_whole(f"frames[{i}]", one, 0, MOST_FRAMES)
        if value[0] > value[1]:
            raise ValueError(f"frames={shown(value)}: the last must not come before the first")
        return range(value[0], value[1] + 1)
    require_whole("frames", value, 1, MOST_FRAMES)
    return range(value)


def _of_lens(name: str, value: Any) -> Track | Aperture:
    with named(f"lens.{name}"):
        if name == APERTURE:
            return Aperture.parse(value)
        value, unit = _in_numbers(name, value)
        if name == FOCUS_DISTANCE:
            # Of a telecentric lens, which may be focused behind where depths begin, it may be <= 0.
            with contextlib.suppress(ValueError):
                return dataclasses.replace(Track.of(value, LENS_TRACKS[name]), unit=unit)
            return dataclasses.replace(Track.of(value), unit=unit)
        return dataclasses.replace(Track.of(value, LENS_TRACKS.get(name, "linear")), unit=unit)


def _in_numbers(name: str, value: Any) -> tuple[Any, str | None]:
    """A value, or the keys of a track, without texts such as ``1.2m`` and ``f/2.8``; the unit."""
    keys = is_list_of_keys(value) and all(len(key) > 1 for key in value)
    values = [key[1] for key in value] if keys else [value]
    unit = None
    if name == F_NUMBER:
        values = [f_number_of(one) if isinstance(one, str) else one for one in values]
    elif name in (*IN_MILLIMETERS, *IN_SCENE_UNITS):
        values, unit = in_one_unit("value", values)
    if not keys:
        return values[0], unit
    return [[key[0], one, *key[2:]] for key, one in zip(value, values, strict=True)], unit


def _filter(what: str, values: Mapping[str, Any]) -> AnimatedFilter:
    parameters = dict(values)
    name = parameters.pop("name", None)
    with named(what):
        if not isinstance(name, str):
            raise TypeError(f"name={shown(name)}: must be given, such as 'fade'")
        Filter.member(name)
        return AnimatedFilter(
            name,
            {
                key: Track.of(value) if is_list_of_keys(value) else _plain(value)
                for key, value in parameters.items()
            },
        )


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
