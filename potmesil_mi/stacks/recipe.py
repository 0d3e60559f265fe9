"""Recipes of data sets: scenes, cameras, lenses, apertures and foci, with what chance chooses."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .._image import PICTURES, require_format
from .._units import MILLIMETERS, Length
from .._validation import require_choice, require_kind, require_whole, shown
from ..motion.toml import read_toml, table_of
from ..motion.track import named, require_known
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from .draws import Draw, seed_of
from .foci import Foci, Lens
from .layouts import LAYOUTS

TABLES = ("scenes", "sampling", "cameras", "lens", "apertures", "foci")
FORM = ("bit_depth", "quality")
SETTINGS = ("seed", "layout", "endings", "maps", *FORM)

MAPS = ("depth", "circles", "normals", "pinhole")
"""What there may be beside the pictures."""

DEFAULT_MAPS = ("depth", "circles", "pinhole")

TURNS = ("pan", "tilt", "swing")
"""Angles by which a camera is turned, in degrees."""

MOVES = ("right", "up", "ahead")
"""What the lengths of ``move`` mean."""

OPENINGS = ("f_number", "aperture_radius", "half_angle")
LENS = ("focal_length", "aperture", "squeeze", "vignetting", "film")
FOCI = ("distances", "distance", "near", "far", "count")

NAME = re.compile(r"\w[\w.-]*")
"""What names of scenes look like, which are folders."""

MOST = 100_000
"""Most of each of cameras, lenses, apertures and foci."""

MOST_SEED = 2**32 - 1


@dataclasses.dataclass(frozen=True)
class StackDraw:
    """A stack that is to be: what chance chose of its lens, and its foci.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``number``                    of all stacks of the data set
    ``lens``, ``aperture``        numbers of both
    ``changes``                   parameters that the lens has in place of the sensor's
    ``foci``                      the distances of its pictures
    ============================  ==========================================================
    """

    number: int
    lens: int
    aperture: int
    changes: Mapping[str, Any]
    foci: Foci

    def lenses(self, lens: Lens) -> list[Lens]:
        """The lens of each picture, of that of the sensor. Raises what ``replace`` does."""
        changes: Any = self.changes
        with named("[lens], [apertures]"):
            opened = lens.replace(**changes)
        with named("[foci]"):
            return self.foci.lenses(opened)


@dataclasses.dataclass(frozen=True)
class View:
    """A scene from a camera: what has samples of its own, of which all its stacks are formed.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``name``                      of the scene
    ``path``, ``define``          its file, and values of what stands in it as ``$KEY``
    ``sensor``, ``camera``        the number of the sensor, and that of the camera of it
    ``seed``                      of the samples
    ``turn``                      by how much the camera is turned: ``pan``, ``tilt`` and ``swing``
                                  in degrees
    ``move``                      by how much it is moved to the right, up and ahead: numbers in
                                  scene units, or texts with a unit
    ``units``                     what a scene unit is, such as ``cm``; ``None``: what the sensor
                                  says
    ``stacks``                    a :class:`StackDraw` each
    ============================  ==========================================================
    """

    name: str
    path: str
    define: Mapping[str, str]
    sensor: int
    camera: int
    seed: int
    turn: Mapping[str, float]
    move: tuple[float | str, ...]
    stacks: tuple[StackDraw, ...]
    units: str | None = None

    def first_lens(self) -> dict[str, Any]:
        """How the first lens is focused and opened; a half-angle is the widest of all."""
        first = self.stacks[0]
        opened = {name: first.changes[name] for name in OPENINGS if name in first.changes}
        if "half_angle" in opened:
            opened["half_angle"] = max(one.changes["half_angle"] for one in self.stacks)
        return {**opened, **first.foci.first_lens()}

    def lenses(self, lens: Lens) -> list[Lens]:
        """The lenses of all stacks, of that of the sensor."""
        return [one for stack in self.stacks for one in stack.lenses(lens)]

    def to_dict(self) -> dict[str, Any]:
        """The view as JSON has it."""
        return dataclasses.asdict(self)


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What a data set is to have; ``docs/howto/stacks.md`` has the form of its file.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``scenes``                    tables of each: ``name``, ``path``, ``define``, ``sensors``,
                                  ``units``
    ``seed``                      of all that chance chooses
    ``sampling``                  ``spp`` and parameters of :class:`potmesil_mi.Sampling`
    ``cameras``, ``lens``,        how many there are, in ``count``, and a :class:`.draws.Draw` of
    ``apertures``, ``foci``       each parameter that chance chooses
    ``layout``, ``endings``       of the files; ``form`` is how pictures are kept in them
    ``maps``                      what there is beside the pictures
    ============================  ==========================================================
    """

    scenes: Sequence[Mapping[str, Any]]
    seed: int
    sampling: Mapping[str, Any]
    cameras: Mapping[str, Any]
    lens: Mapping[str, Any]
    apertures: Mapping[str, Any]
    foci: Mapping[str, Any]
    layout: str
    endings: tuple[str, ...]
    form: Mapping[str, Any]
    maps: frozenset[str]

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Recipe:
        """Read a TOML file; paths of scenes are relative to its folder.

        Raises ``OSError`` where it cannot be read, and ``ValueError`` or ``TypeError`` that names
        the file and the key.
        """
        folder = Path(path).parent
        return read_toml(path, lambda values: cls.from_dict(values, folder))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], folder: Path = Path()) -> Recipe:
        """The recipe of the tables of a TOML file. Raises what names the key."""
        require_known(values, (*SETTINGS, *TABLES))
        seed, layout = values.get("seed", 0), values.get("layout", LAYOUTS[0])
        require_whole("seed", seed, 0, MOST_SEED)
        require_choice("layout", layout, LAYOUTS)
        for name in ("endings", *FORM):
            if name in values and layout != LAYOUTS[0]:
                raise ValueError(
                    f"{name}={shown(values[name])}: must be left out for layout={shown(layout)}"
                )
        endings = _texts("endings", values.get("endings", [".exr"]), PICTURES)
        form: Any = {name: values[name] for name in FORM if name in values}
        require_format([f"picture{ending}" for ending in endings], **form)
        recipe = cls(
            scenes=_scenes(values.get("scenes"), folder),
            seed=seed,
            sampling=table_of(values, "sampling"),
            cameras=_cameras(table_of(values, "cameras")),
            lens=_draws("lens", table_of(values, "lens"), LENS),
            apertures=_draws("apertures", table_of(values, "apertures"), OPENINGS),
            foci=_foci(table_of(values, "foci")),
            layout=layout,
            endings=endings,
            form=form,
            maps=frozenset(_texts("maps", values.get("maps", list(DEFAULT_MAPS)), MAPS, least=0)),
        )
        for name in ("lens", "apertures"):
            _require_usable(name, getattr(recipe, name))
        return recipe

    def views(self) -> list[View]:
        """All views, in the order of the recipe; each is the same whatever others there are."""
        counts = self.lens["count"], self.apertures["count"]
        views: list[View] = []
        for scene in self.scenes:
            for sensor in scene["sensors"]:
                for camera in range(self.cameras["count"]):
                    first = len(views) * counts[0] * counts[1]
                    views.append(self._view(scene, sensor, camera, first))
        return views

    def _view(self, scene: Mapping[str, Any], sensor: int, camera: int, first: int) -> View:
        name = f"{scene['name']}/{sensor}/{camera}"
        turn = {of: self._drawn(self.cameras[of], f"{name}/{of}") for of in TURNS}
        move = tuple(
            self._drawn(draw, f"{name}/{of}")
            for of, draw in zip(MOVES, self.cameras["move"], strict=True)
        )
        stacks: list[StackDraw] = []
        for lens in range(self.lens["count"]):
            for aperture in range(self.apertures["count"]):
                opened = {**_named(self.lens, f"{name}/{lens}")}
                opened |= _named(self.apertures, f"{name}/{lens}/{aperture}")
                changes = {of: self._drawn(draw, place) for (of, place), draw in opened.items()}
                foci = self._foci_of(f"{name}/{lens}/{aperture}")
                stacks.append(StackDraw(first + len(stacks), lens, aperture, changes, foci))
        return View(
            name=scene["name"],
            path=scene["path"],
            define=scene["define"],
            sensor=sensor,
            camera=camera,
            seed=seed_of(self.seed, name),
            turn=turn,
            move=tuple(one if isinstance(one, str) else float(one) for one in move),
            stacks=tuple(stacks),
            units=scene["units"],
        )

    def _foci_of(self, name: str) -> Foci:
        foci = dict(self.foci)
        draw = foci.pop("distance", None)
        if draw is None:
            return Foci(**foci)
        count = foci["count"]
        return Foci([self._drawn(draw, f"{name}/{index}/distance") for index in range(count)])

    def _drawn(self, draw: Draw, name: str) -> Any:
        return draw.at(self.seed, name)


def _named(draws: Mapping[str, Any], name: str) -> dict[tuple[str, str], Draw]:
    """The draws of a table, by what they are of and by the names by which they are drawn."""
    return {(of, f"{name}/{of}"): draw for of, draw in draws.items() if of != "count"}


def _scenes(values: Any, folder: Path) -> list[dict[str, Any]]:
    if not isinstance(values, list) or not values:
        raise TypeError(f"scenes={shown(values)}: must be tables, [[scenes]], one at least")
    scenes: list[dict[str, Any]] = []
    for i, scene in enumerate(values):
        with named(f"scenes[{i}]"):
            require_known(scene, ("name", "path", "define", "sensors", "units"))
            path = scene.get("path")
            require_kind("path", path, str, "given, the name of a file")
            name = scene.get("name", Path(path).stem)
            if not isinstance(name, str) or not NAME.fullmatch(name):
                raise ValueError(f"name={shown(name)}: must be letters, digits, _, . and -")
            if name in (one["name"] for one in scenes):
                raise ValueError(f"name={shown(name)}: must be another for each scene")
            sensors = scene.get("sensors", [0])
            require_kind("sensors", sensors, list, "a list of numbers of sensors")
            for j, sensor in enumerate(sensors):
                require_whole(f"sensors[{j}]", sensor, 0, MOST)
            if len(set(sensors)) != len(sensors) or not sensors:
                raise ValueError(
                    f"sensors={shown(sensors)}: must be one at least, each of them once"
                )
            units = scene.get("units")
            if units is not None:
                require_choice("units", units, MILLIMETERS)
            define = {key: str(value) for key, value in table_of(scene, "define").items()}
        of = {"define": define, "sensors": sensors, "units": units}
        scenes.append({"name": name, "path": str(folder / path), **of})
    return scenes


def _cameras(table: Mapping[str, Any]) -> dict[str, Any]:
    move = table.get("move", [0, 0, 0])
    if not isinstance(move, list) or len(move) != len(MOVES):
        raise TypeError(f"[cameras].move={shown(move)}: must be three, to the right, up and ahead")
    turns = {name: table.get(name, 0) for name in TURNS}
    draws = {name: table[name] for name in table if name not in (*TURNS, "move", "count")}
    require_known({f"[cameras].{name}": None for name in draws}, ())
    found = _draws("cameras", {**turns, "count": table.get("count", 1)}, TURNS)
    found["move"] = [Draw.of(f"[cameras].move[{i}]", one) for i, one in enumerate(move)]
    for name in TURNS:
        if found[name].unit or any(isinstance(value, str) for value in found[name].values):
            raise TypeError(f"[cameras].{name}={shown(table[name])}: must be numbers, of degrees")
    for i, draw in enumerate(found["move"]):
        _require_lengths(f"[cameras].move[{i}]", draw)
    return found


def _draws(name: str, table: Mapping[str, Any], known: Sequence[str]) -> dict[str, Any]:
    """The draws of a table of the recipe, and its ``count``."""
    for key in table:
        if key not in (*known, "count"):
            allowed = ", ".join((*known, "count"))
            raise ValueError(f"[{name}].{key}: unknown, must be one of {allowed}")
    count = table.get("count", 1)
    require_whole(f"[{name}].count", count, 1, MOST)
    draws = {key: Draw.of(f"[{name}].{key}", table[key]) for key in table if key != "count"}
    return {**draws, "count": count}


def _foci(table: Mapping[str, Any]) -> dict[str, Any]:
    for key in table:
        if key not in FOCI:
            raise ValueError(f"[foci].{key}: unknown, must be one of {', '.join(FOCI)}")
    if "distance" in table:
        drawn = {key: table[key] for key in table if key in ("distance", "count")}
        if len(drawn) < len(table):
            raise ValueError("[foci].distance: must not be given with distances, near or far")
        found = _draws("foci", drawn, ("distance",))
        _require_lengths("[foci].distance", found["distance"])
        return found
    try:
        Foci(**table)
    except (ValueError, TypeError) as error:
        raise type(error)(f"[foci].{error}") from error
    return dict(table)


def _require_lengths(name: str, draw: Draw) -> None:
    """Raise ``ValueError`` for what a draw chooses from that is text and no length."""
    for value in draw.values:
        if isinstance(value, str):
            try:
                Length.of(value)
            except ValueError as error:
                raise ValueError(f"{name}={error}") from None


def _require_usable(name: str, draws: Mapping[str, Any]) -> None:
    """Raise for a value that no lens can have, before the first scene is loaded."""
    thin, telecentric = ThinLens(50.0, 4.0), TelecentricLens(1.0, 1.0)
    for key, draw in draws.items():
        for value in draw.values if isinstance(draw, Draw) else ():
            lens: Any = telecentric if key == "half_angle" else thin
            try:
                lens.replace(**{key: value})
            except (ValueError, TypeError) as error:
                raise type(error)(f"[{name}].{error}") from error


def _texts(name: str, values: Any, known: Sequence[str], least: int = 1) -> tuple[str, ...]:
    require_kind(name, values, list, f"a list of {', '.join(known)}")
    for i, value in enumerate(values):
        require_choice(f"{name}[{i}]", value, known)
    if len(values) < least:
        raise ValueError(f"{name}: must be one at least of {', '.join(known)}")
    return tuple(values)
