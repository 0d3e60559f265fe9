"""The stages in which a picture is formed by tiles, and what is done with a tile in each.

In the first a tile tells of its fragments what visibility and highlights depend on, in the second
of its view what the plan of a focus depends on. What all of them tell makes the whole picture
known, and in the third a tile is formed. What a stage has found out about a tile is kept for the
next while there is room, and found out again where there is not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from ...samples.cropping import part_of
from ...samples.point_samples import PointSamples
from ...samples.raster import Window
from ..choices import Choices
from ..exposure import Exposure, Visibility
from ..highlights import HighlightLimits, Peaks
from ..lens_view import ViewLimits, as_lit, covers_of
from ..memo import Memo
from ..methods import Equation20, VisibleMethod, visibility_for
from ..session import Asked, require_memory_for
from ..view_counts import ViewCounts, coarse_bins
from ..viewing import Viewing
from ..visibility import SightLimits, limits_of, may_be_covered
from .beginning import whole_of_tables, whole_of_view
from .cutting import Tile, covering

KEPT_BYTES = 256 << 20
"""Most bytes of what is kept of tiles from one stage to the next."""


class TileTask(NamedTuple):
    """What is to be done with a tile; ``choices`` has :class:`.Choices` for each channel.

    The ``stage`` is one of :attr:`TileForming.stages`.
    """

    stage: str
    tile: Tile
    choices: tuple[Choices, ...]


class OfFragments(NamedTuple):
    """What a tile tells of its own fragments; ``sight`` is ``None`` where none cover others."""

    sight: SightLimits | None
    peaks: Peaks


class OfView(NamedTuple):
    """What a tile tells of its own part of the view; ``peaks`` are those of single points."""

    counts: ViewCounts
    peaks: Peaks | None


class TileForming:
    """Does the stages of tiles of ``samples``, as is ``asked``; its method has no defaults."""

    def __init__(self, asked: Asked, samples: PointSamples) -> None:
        self.asked = asked
        self.samples, _ = asked.adapted(samples, Memo())
        self.exposures = asked.exposures(self.samples)
        if isinstance(asked.method, VisibleMethod):
            self.exposures = [
                Viewing(each, Memo(), visibility_for(asked.method, each)).exposure
                for each in self.exposures
            ]
        self._kept: dict[tuple[Tile, int], Memo] = {}

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that the method has."""
        if isinstance(self.asked.method, Equation20):
            return ("picture",)
        return "fragments", "view", "picture"

    def begun(self) -> tuple[Choices, ...]:
        """What there is to say of the whole picture before the first stage."""
        method = self.asked.method
        if isinstance(method, VisibleMethod):
            return tuple(whole_of_view(of, visibility_for(method, of)) for of in self.exposures)
        return tuple(map(whole_of_tables, self.exposures))

    def do(self, task: TileTask) -> list[OfFragments] | list[OfView] | np.ndarray:
        """Do a stage with a tile; the picture of its core is float32 (height, width, 3 or 4)."""
        found: Any = []
        for channel, chosen in enumerate(task.choices):
            exposure = self._exposure(task.tile, channel, chosen)
            key = task.tile, channel
            memo = self._kept[key] = self._kept.pop(key, Memo(0))  # The last is at the end.
            if task.stage == "picture":
                found.append((exposure, memo))
            else:
                how = self._how(exposure)
                tell = _of_fragments if task.stage == "fragments" else _of_view
                found.append(tell(Viewing(exposure, memo, how), how, _own(task.tile, exposure)))
        if task.stage == "picture":
            picture = self.asked.formed(*zip(*found, strict=True))
            found = picture[task.tile.core.slices_in(task.tile.crop)].astype(np.float32)
            for channel in range(len(task.choices)):
                self._kept.pop((task.tile, channel))
        self._give_up(task.tile)
        # What this tile took serves no other, which is of another size.
        dr.flush_malloc_cache()
        return found

    def _how(self, exposure: Exposure) -> Visibility:
        method = self.asked.method
        assert isinstance(method, VisibleMethod)
        return visibility_for(method, exposure)

    def _exposure(self, tile: Tile, channel: int, chosen: Choices) -> Exposure:
        """The exposure of a tile."""
        exposure = self.exposures[channel]
        samples = part_of(exposure.samples, tile.crop, tile.sampled)
        require_memory_for(samples, self.asked.method, self.asked.subpixels)
        exposure = dataclasses.replace(exposure, samples=samples, choices=chosen)
        lit = covering(exposure.crop.grown(chosen.light), _own(tile, exposure))
        return dataclasses.replace(exposure, lit=lit)

    def _give_up(self, last: Tile) -> None:
        """Give up what is kept of tiles, those of longest ago first, down to the bound."""
        for key in list(self._kept):
            if sum(memo.nbytes for memo in self._kept.values()) <= KEPT_BYTES:
                return
            if key[0] != last:
                del self._kept[key]


def _own(tile: Tile, exposure: Exposure) -> Window:
    """What a tile counts, in subpixels of its samples' window."""
    return tile.own.relative_to(exposure.samples.window).subdivided(exposure.subpixels)


def _size(chosen: Choices, subpixels: int) -> tuple[int, int]:
    """Columns and rows of the whole picture's subpixels."""
    return chosen.window.width * subpixels, chosen.window.height * subpixels


def _of_fragments(viewing: Viewing, how: Visibility, own: Window) -> OfFragments:
    fragments, chosen = viewing.evened().fragments, viewing.exposure.choices
    assert chosen is not None
    width, height = _size(chosen, viewing.exposure.subpixels)
    covers, sight = covers_of(fragments), None
    coverable = may_be_covered(covers, viewing.radius_per_vergence)
    inside = own.contains(covers.x, covers.y)
    if inside.any():
        sight = limits_of(covers.chosen(inside), coverable[inside])
        sight = sight._replace(width=width, height=height)
    lit = as_lit(fragments, viewing.lens_points)
    return OfFragments(sight, _peaks(lit.chosen(own.contains(lit.x, lit.y)), (height, width)))


def _peaks(fragments: Any, shape: tuple[int, int]) -> Peaks:
    """How bright fragments of a tile are, which are where they are in the whole picture."""
    place = (fragments.y + fragments.top) * np.int64(shape[1]) + fragments.x + fragments.left
    kind = np.min_scalar_type(shape[0] * shape[1])  # Those of all tiles come together.
    return Peaks.of(fragments)._replace(shape=shape, subpixel=place.astype(kind))


def _of_view(viewing: Viewing, how: Visibility, own: Window) -> OfView:
    exposure, view = viewing.exposure, viewing.pyramid().finest
    chosen, some = exposure.choices, view.unoccluded
    assert chosen is not None
    assert chosen.bins is not None
    size = _size(chosen, exposure.subpixels)
    coarse = coarse_bins(chosen.bins, chosen.bin_count, exposure.blur, viewing.fineness.kept_radius)
    counts = ViewCounts.of(view, own, size, list(coarse))
    peaks = None
    if some.offset is not None:
        peaks = _peaks(some.chosen(own.contains(some.x, some.y)), size[::-1])
    return OfView(counts, peaks)


def known_by(choices: Sequence[Choices], told: Sequence[Sequence[Any]]) -> tuple[Choices, ...]:
    """What is known of the whole picture after all of its tiles have told of a stage.

    ``told`` has what each of them told, for each channel.
    """
    every = zip(*told, strict=True)
    return tuple(_known(chosen, of) for chosen, of in zip(choices, every, strict=True))


def _known(chosen: Choices, told: Sequence[Any]) -> Choices:
    limits = _limits([of.peaks for of in told])
    if isinstance(told[0], OfView):
        counts = ViewCounts.added([of.counts for of in told])
        return dataclasses.replace(chosen, counts=counts, single=limits)
    assert limits is not None
    sights = [of.sight for of in told if of.sight is not None]
    ends: dict[str, Callable[..., Any]] = {"farthest": min, "nearest": max, "last_bin": max}
    sight = sights[0]._replace(
        **{name: end(getattr(of, name) for of in sights) for name, end in ends.items()}
    )
    return dataclasses.replace(chosen, limits=ViewLimits(sight, limits))


def _limits(every: Sequence[Peaks | None]) -> HighlightLimits | None:
    """The limits of the highlights of all tiles, if there are any that may be some."""
    peaks = [of for of in every if of is not None]
    if not peaks:
        return None
    subpixel, first, peak = (np.concatenate(of) for of in list(zip(*peaks, strict=True))[1:])
    return Peaks(peaks[0].shape, subpixel, first, peak).highlights()[1]
