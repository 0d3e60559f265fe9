"""Choosing a focus: how deep what is to be sharp is, by its place in the picture or by its name."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable

import numpy as np

from .._validation import require_kind, require_number, shown
from .point_samples import PointSamples

CENTER = "center"
"""What :func:`focus_distance_of` takes for the middle of the picture."""

MOST_NAMES = 12
"""Names that an error lists, at most."""


def focus_distance_at(samples: PointSamples, x: float, y: float) -> float:
    """The depth of what is seen at a place of the picture, to focus on it.

    ``samples`` are point samples; ``x``, ``y`` are pixels of the whole film, from its top left
    corner to the right and downwards, and may be between pixels. What most of that pixel shows
    counts: the median depth of the surface with most of its area. Of what is seen in a mirror or
    through glass it is the depth of the image, which is what a lens focuses on.

    Returns a depth along the axis in scene units, as ``focus_distance`` of a lens takes it: ``inf``
    where nothing is hit. Raises ``TypeError`` for other than numbers and ``ValueError`` for a place
    outside of the picture (its crop window), or without samples.
    """
    require_samples(samples)
    require_number("x", x)
    require_number("y", y)
    crop = samples.crop_window
    right, bottom = crop.left + crop.width, crop.top + crop.height
    if not (crop.left <= x <= right and crop.top <= y <= bottom):
        raise ValueError(
            f"x={x:g}, y={y:g}: must be in the picture, {crop.left} to {right} across and "
            f"{crop.top} to {bottom} down"
        )
    column, row = min(math.floor(x), right - 1), min(math.floor(y), bottom - 1)
    found = np.flatnonzero((samples.y >= row) & (samples.y <= row + 1))
    across = samples.x[found]
    found = found[(across >= column) & (across <= column + 1)]
    found = found[samples.layer[found] == 0]
    if len(found) == 0:
        raise ValueError(f"x={x:g}, y={y:g}: there are no samples in this pixel")
    surfaces, which = np.unique(samples.surface[found], return_inverse=True)
    areas = np.bincount(which, samples.weight[found], len(surfaces))
    return _middle(samples, found[which == np.argmax(areas)])


def focus_distance_of(samples: PointSamples, name: str) -> float:
    """The depth of a thing, to focus on it: the median of all that is seen of it.

    ``samples`` are point samples; ``name`` is one of those in ``samples.surfaces``, which are the
    ids of shapes in a scene, or ``"center"`` for what the middle of the picture shows.

    Returns a depth along the axis in scene units. Raises ``TypeError`` for other than text, and
    ``ValueError`` for a name that there is not, which tells those like it, and for a thing that is
    nowhere in sight.
    """
    require_samples(samples)
    require_kind("name", name, str, "text, a name of samples.surfaces")
    ids = [surface for surface, called in samples.surfaces.items() if called == name]
    if not ids and name == CENTER:
        crop = samples.crop_window
        middle = crop.left + crop.width / 2, crop.top + crop.height / 2
        return focus_distance_at(samples, *middle)
    if not ids:
        raise ValueError(f"name={shown(name)}: is not in the scene; {_alike(samples, name)}")
    of_it = np.isin(samples.surface, np.array(ids, np.uint32)) & (samples.layer == 0)
    found = np.flatnonzero(of_it)
    if len(found) == 0:
        raise ValueError(
            f"name={shown(name)}: the pinhole sees nothing of it; in sight are "
            f"{_names(seen_surfaces(samples))}"
        )
    return _middle(samples, found)


def seen_surfaces(samples: PointSamples) -> list[str]:
    """The names of what the pinhole sees, those of the largest area first."""
    first = samples.layer == 0
    ids, which = np.unique(samples.surface[first], return_inverse=True)
    areas = np.bincount(which, samples.weight[first], len(ids))
    names = [samples.surfaces.get(int(ids[i])) for i in np.argsort(-areas, kind="stable")]
    return list(dict.fromkeys(name for name in names if name is not None))


def require_samples(samples: object) -> None:
    """Raise ``TypeError`` unless they are samples."""
    require_kind("samples", samples, PointSamples, "PointSamples, as render_samples gives")


def _alike(samples: PointSamples, name: str) -> str:
    """What a user may have meant by a name that there is not."""
    every = list(dict.fromkeys(samples.surfaces.values()))
    alike = difflib.get_close_matches(name, every)
    if alike:
        return f"did you mean {_names(alike)}?"
    return f"must be {CENTER} or one of {_names(seen_surfaces(samples))}"


def _names(names: Iterable[str]) -> str:
    listed = [repr(name[:60]) for name in names]
    rest = len(listed) - MOST_NAMES
    return ", ".join(listed[:MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")


def _middle(samples: PointSamples, found: np.ndarray) -> float:
    """The median depth of samples, by their areas; one of these depths."""
    order = found[np.argsort(samples.z[found], kind="stable")]
    areas = np.cumsum(samples.weight[order], dtype=np.float64)
    return float(samples.z[order[np.searchsorted(areas, areas[-1] / 2)]])
