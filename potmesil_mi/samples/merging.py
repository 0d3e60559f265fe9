"""Merging: fewer samples that a lens can hardly tell from many."""

from __future__ import annotations

import numpy as np

from .._validation import require_number
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, require_fitting
from .columns import Columns

LEAST_TOLERANCE = 1e-30
"""The least tolerance in pixels, of which multiples can still be counted."""


def require_mergeable(camera: Camera, lens: ThinLens | TelecentricLens, tolerance: float) -> None:
    """Raise ``ValueError`` or ``TypeError`` for bad parameters of :meth:`PointSamples.merge`."""
    require_number("tolerance", tolerance)
    if tolerance < LEAST_TOLERANCE:
        raise ValueError(f"tolerance={tolerance}: must be > 0 pixels and finite")
    require_fitting(camera, lens)


def merged(
    samples: Columns,
    pixel: np.ndarray,
    camera: Camera,
    lens: ThinLens | TelecentricLens,
    tolerance: float,
    are_ids: np.ndarray,
) -> Columns:
    """The merged samples, by the rule of :meth:`PointSamples.merge`.

    ``pixel`` is that of each sample; ``tolerance`` is in pixels of the circle's diameter.
    ``are_ids``, bool (K,), says of which AOVs there is no mean.
    """
    circle = lens.circle_of_confusion(samples.z.astype(np.float64))
    telecentric = isinstance(lens, TelecentricLens)
    if isinstance(lens, TelecentricLens):
        pixels_per_unit = camera.pixels_per_unit
    else:
        pixels_per_unit = camera.focal_length_pixels / lens.film_distance
    step = np.rint(circle * pixels_per_unit / tolerance)
    quarter = 2 * (samples.y % 1 >= 0.5) + (samples.x % 1 >= 0.5)
    keys = np.stack([pixel, quarter, samples.layer, samples.surface, samples.alpha, step])
    if samples.visibility is not None:
        keys = np.vstack([keys, np.unique(samples.visibility, return_inverse=True)[1]])
    if samples.through is not None:
        keys = np.vstack([keys, samples.through > 0])
    if samples.time is not None:
        keys = np.vstack([keys, samples.time])
    order = np.lexsort(keys[::-1])
    ordered = keys[:, order]
    first = np.flatnonzero(
        np.concatenate([[True], (ordered[:, 1:] != ordered[:, :-1]).any(axis=0)])
    )
    weight = samples.weight[order].astype(np.float64)
    total = np.add.reduceat(weight, first)

    def mean(values: np.ndarray) -> np.ndarray:
        scale = weight if values.ndim == 1 else weight[:, None]
        sums = np.add.reduceat(values[order] * scale, first, axis=0)
        return sums / (total if values.ndim == 1 else total[:, None])

    aovs = None
    if samples.aovs is not None:
        aovs = np.where(are_ids, samples.aovs[order][first], mean(samples.aovs))
    with np.errstate(divide="ignore"):
        depth = samples.z.astype(np.float64)
        z = mean(depth) if telecentric else 1 / mean(1 / depth)
    return Columns(
        x=mean(samples.x),
        y=mean(samples.y),
        rgb=mean(samples.rgb),
        alpha=samples.alpha[order][first],
        z=z,
        surface=samples.surface[order][first],
        layer=samples.layer[order][first],
        through=None if samples.through is None else mean(samples.through),
        visibility=None if samples.visibility is None else samples.visibility[order][first],
        albedo=None if samples.albedo is None else mean(samples.albedo),
        normal=None if samples.normal is None else mean(samples.normal),
        time=None if samples.time is None else samples.time[order][first],
        motion=None if samples.motion is None else mean(samples.motion),
        aovs=aovs,
        weight=total,
    )
