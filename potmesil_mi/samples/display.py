"""What a notebook shows of point samples: a thumbnail of what the pinhole sees, and facts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .._html import card
from .._units import said_length
from ..optics.display import opening_of, thin_lens_facts, view_of
from .depth_range import DepthRange, Seen
from .raster import Window

if TYPE_CHECKING:
    from ..optics.camera import Camera

THUMBNAIL = 192
"""Pixels on the longer side of a thumbnail, at most."""

ENOUGH = 1 << 17
"""So many samples make a thumbnail; of more, one of every two or three or so is taken."""

MOST_SURFACES = 8
"""Names of surfaces that are told."""


class Shown(Seen, Protocol):
    """What is asked of :class:`potmesil_mi.PointSamples`, which shows itself."""

    @property
    def rgb(self) -> np.ndarray:
        """Radiance in linear sRGB."""

    @property
    def weight(self) -> np.ndarray:
        """Shares of a pixel."""

    @property
    def camera(self) -> Camera:
        """The pinhole."""

    @property
    def lens(self) -> Any:
        """The lens that came with it."""

    @property
    def surfaces(self) -> Mapping[int, str]:
        """Names of ids."""

    @property
    def spp(self) -> int:
        """Rays in a pixel."""

    @property
    def instants(self) -> int:
        """Instants of the exposure."""

    @property
    def nbytes(self) -> int:
        """Size in memory."""

    def __len__(self) -> int: ...


def html_of_samples(samples: Shown) -> str:
    """A card of samples, which takes some milliseconds however many there are."""
    facts = scene_facts(samples)
    lens = samples.lens
    facts["lens"] = opening_of(lens)
    if samples.camera.projection == "orthographic":
        facts["focused at"] = f"{lens.focus_distance:.4g}"
        circle = 1 / samples.camera.pixels_per_unit
        near, far = lens.depth_of_field(circle)
        facts["depth of field"] = f"{near:.4g} to {far:.4g} (to a pixel)"
    else:
        known = thin_lens_facts(lens)
        facts |= {name: known[name] for name in ("focused at", "depth of field") if name in known}
    return card("PointSamples", facts, thumbnail(samples))


def scene_facts(samples: Shown) -> dict[str, str]:
    """What the samples are of, whatever the lens."""
    width, height = samples.crop_window.width, samples.crop_window.height
    unit = getattr(samples.lens, "millimeters_per_unit", None)
    depths = DepthRange.of(samples)
    near, far = (said_length(depth, unit) for depth in (depths.nearest, depths.farthest))
    hidden = len(samples) - int(np.count_nonzero(samples.layer == 0))
    facts = {
        "picture": f"{width}×{height} pixels, {view_of(samples.camera)}",
        "samples": f"{len(samples):,}, {samples.spp} a pixel, {samples.nbytes / 1e6:.0f} MB",
        "hidden": f"{100 * hidden / len(samples):.0f} % are of what only a lens sees",
        "depth": f"{near} to {far}" + (", and the sky" if depths.has_sky else ""),
        "surfaces": _names(list(dict.fromkeys(samples.surfaces.values()))),
    }
    if samples.instants > 1:
        facts["exposure"] = f"{samples.instants} instants"
    return facts


def thumbnail(samples: Shown) -> np.ndarray:
    """What the pinhole sees, linear RGB, float32 (H, W, 3), ``THUMBNAIL`` pixels at most."""
    crop = samples.crop_window
    scale = min(1.0, THUMBNAIL / max(crop.width, crop.height))
    small = Window(0, 0, max(round(crop.width * scale), 1), max(round(crop.height * scale), 1))
    step = -(-len(samples) // ENOUGH)
    some: slice | np.ndarray = slice(None)
    if step > 1:  # Equal steps could meet the same columns of pixels in every row.
        some = np.arange(0, len(samples) - step + 1, step)
        some += np.random.default_rng(0).integers(step, size=len(some))
    x, y = samples.x[some], samples.y[some]
    visible = np.flatnonzero((samples.layer[some] == 0) & crop.contains(x, y))
    pixel = small.pixel_of(
        (x[visible] - crop.left) * (small.width / crop.width),
        (y[visible] - crop.top) * (small.height / crop.height),
    )
    weight = samples.weight[some][visible]
    rgb = samples.rgb[some][visible]
    total = np.bincount(pixel, weight, small.size)
    sums = np.stack([np.bincount(pixel, weight * one, small.size) for one in rgb.T], axis=1)
    found = np.flatnonzero(total)
    if len(found) == 0:
        return np.zeros((*small.shape, 3), np.float32)
    # A pixel without a sample gets what is on its left.
    filled = found[np.maximum(np.searchsorted(found, np.arange(small.size), "right") - 1, 0)]
    mean = sums[filled] / total[filled, None]
    return mean.reshape(*small.shape, 3).astype(np.float32)


def _names(names: list[str]) -> str:
    rest = len(names) - MOST_SURFACES
    listed = ", ".join(name[:40] for name in names[:MOST_SURFACES])
    return f"{listed} and {rest} more" if rest > 0 else listed or "none has a name"
