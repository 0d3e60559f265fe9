"""Which channels of a file are colours, depth and ids, by the names that programs give them."""

from __future__ import annotations

import re
from typing import NamedTuple

from .._validation import shown
from .reading import PictureFile, PicturePart

DEPTH = re.compile(r"(^|[.:])(z|depth(\.[zyvrt])?|[^.:]+\.t|distance(\.\w)?)$", re.IGNORECASE)
"""Names of channels of depth; the first that are Z of something else are left out."""

NOT_DEPTH = re.compile(
    r"(^|[.:])(\w*(position|normal|vector|velocity|albedo)s?|motion\w*|pworld|pref|uv|p|n)\.(z|t)$",
    re.IGNORECASE,
)
"""Names of channels that are the third of something else."""

MAIN_LAYERS = ("", "rgba", "rgb", "combined", "beauty", "c", "color", "colour", "image")
"""Last names of layers that show the picture, from the first that is looked for."""

LONG_NAMES = {"red": "r", "green": "g", "blue": "b", "alpha": "a"}
"""Other names of channels of colours."""

IDS = ("id", "surface")
"""Names of channels of ids, whole numbers."""

CRYPTOMATTE = re.compile(r"crypto\w*?00\.(r|red)$", re.IGNORECASE)
"""The channel of the ids that take most of each pixel."""


NAME_ONE = "say depth_channel, one of"
"""What is asked for where it is not clear which channel is meant."""


class Channel(NamedTuple):
    """A channel of a part of a file."""

    part: PicturePart
    name: str

    @property
    def full_name(self) -> str:
        """With the name of its part, unless that is in it or is the only one."""
        part = self.part.name
        if not part or self.name.lower().startswith(part.lower()):
            return self.name
        return f"{part}.{self.name}"


def every_channel(file: PictureFile) -> list[Channel]:
    """Those of all parts that are not deep."""
    return [Channel(part, name) for part in file.parts if not part.deep for name in part.channels]


def colours_of(file: PictureFile, layer: str | None) -> list[Channel]:
    """The three channels that show the picture, or one that is grey, and perhaps alpha.

    ``layer`` is the name before that of the channels. Raises ``ValueError`` that names the layers
    there are.
    """
    layers: dict[str, dict[str, Channel]] = {}
    for channel in every_channel(file):
        name, _, last = channel.full_name.rpartition(".")
        last = LONG_NAMES.get(last.lower(), last.lower())
        layers.setdefault(name, {}).setdefault(last, channel)
    coloured = {name: of for name, of in layers.items() if {"r", "g", "b"} <= of.keys()}
    grey = {name: of for name, of in layers.items() if "y" in of}
    if layer is not None:
        chosen = [name for name in (*coloured, *grey) if name.lower() == layer.lower()]
    else:
        ranked = [*coloured] or [name for name in grey if not DEPTH.search(f"{name}.y")]
        chosen = sorted(ranked, key=_rank)
    if not chosen:
        there = ", ".join(repr(name) for name in (*coloured, *grey)) or "none"
        asked = "must have" if layer is None else f"layer={shown(layer)}: must be one of the"
        raise ValueError(f"{file.path}: {asked} layers with R, G and B: {there}")
    of = coloured.get(chosen[0]) or grey[chosen[0]]
    names = [name for name in ("rgba" if "r" in of else "ya") if name in of]
    own = [of[name] for name in names]
    if any(channel.part.number != own[0].part.number for channel in own):
        raise ValueError(f"{file.path}: the channels of {chosen[0]!r} are in several parts")
    return own


def _rank(layer: str) -> int:
    """Where the last name of a layer is among those that show the picture."""
    name = layer.rpartition(".")[2].lower()
    return MAIN_LAYERS.index(name) if name in MAIN_LAYERS else len(MAIN_LAYERS)


def depth_of(file: PictureFile, wanted: str | None, need: bool) -> Channel | None:
    """The channel of depth: that of a name, or the only one whose name says so.

    A file of one channel has that; without ``need`` there may be none. Raises ``ValueError`` that
    names those there are.
    """
    every = every_channel(file)
    if wanted is not None:
        found = [of for of in every if wanted in (of.name, of.full_name)]
        if not found:
            names = ", ".join(of.full_name for of in every)
            raise ValueError(f"{file.path}: depth_channel={shown(wanted)}: must be one of {names}")
        return found[0]
    lower = {of.full_name.lower() for of in every}
    found = [of for of in every if _is_depth(of.full_name, lower)]
    if not found and len(every) == 1:
        return every[0]
    exact = [of for of in found if of.name in ("Z", "depth.Z", "Depth.Z")]
    if len(exact) == 1:
        found = exact
    if len(found) > 1 or (need and not found):
        names = ", ".join(of.full_name for of in (found or every))
        if found:
            raise ValueError(f"{file.path}: several channels may be its depth; {NAME_ONE} {names}")
        raise ValueError(
            f"{file.path}: no channel is called a depth; give depth, a file of it, or {NAME_ONE} "
            f"{names}"
        )
    return found[0] if found else None


def _is_depth(name: str, others: set[str]) -> bool:
    """Whether a channel is called a depth, and is not the third of something else."""
    head, dot, last = name.lower().rpartition(".")
    siblings = {f"{head}{dot}x", f"{head}{dot}y"}
    is_third = last == "z" and siblings <= others
    return bool(DEPTH.search(name)) and not NOT_DEPTH.search(name) and not is_third


def ids_of(file: PictureFile) -> Channel | None:
    """The channel of ids: the first Cryptomatte, or whole numbers named ``id``."""
    every = every_channel(file)
    for channel in every:
        if CRYPTOMATTE.search(channel.name):
            return channel
    for channel in every:
        whole = channel.part.kinds[channel.part.channels.index(channel.name)].startswith("uint")
        if whole and channel.name.rpartition(".")[2].lower() in IDS:
            return channel
    return None
