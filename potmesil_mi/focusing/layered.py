"""The picture through the lens with what hides what: the methods ``layered`` and ``lightfield``.

Samples are gathered to elements, which points of the lens see them is found and kept for the next
focus, and :mod:`potmesil_mi.spreading` forms the picture.
"""

from __future__ import annotations

import math
import weakref
from typing import Any

import mitsuba as mi
import numpy as np

from ..optics.blur import radius_per_vergence
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction, aperture_behind
from ..samples.point_samples import PointSamples
from .fragments import Elements
from .lens_view import Layers, Pupil
from .splat import through_lens

SIMILAR = 0.025
"""Apertures that differ by no more see the same, as far as ``layered`` can tell."""

MOST_KEPT = 4
"""Apertures (and other questions) for which is kept what they see of samples: it is large."""

CLOSED = 1e-9
"""What a closed aperture's circles have for a radius, in squares per unit of vergence."""

SMALL = 1 << 17
"""Squares of a part of the window up to which ``layered`` takes more tables."""

EXACT_FINEST = 16
"""Where visibility is exact circles of at least twice this radius, in pixels, are spread on
squares so much coarser that their radius there is no less; else those of an aperture's own."""


class _Kept:
    """What has been found out about samples, by the questions that were asked last."""

    def __init__(self) -> None:
        self.elements: dict[Any, Elements] = {}
        self.layers: dict[Any, dict[int, Layers]] = {}

    def of_question(self, about: Any) -> dict[int, Layers]:
        """Layers, by the size of their squares; those of the question asked first are given up."""
        layers = self.layers.pop(about, {})
        while len(self.layers) >= MOST_KEPT:
            del self.layers[next(iter(self.layers))]
        self.layers[about] = layers
        return layers


_kept: weakref.WeakKeyDictionary[PointSamples, _Kept] = weakref.WeakKeyDictionary()


def see_through(
    samples: PointSamples,
    lens: ThinLens,
    psf: PointSpreadFunction,
    *,
    alpha: bool,
    lens_points: int,
    per_pixel: int,
    exact: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The picture that ``lens`` forms of ``samples``, (height * per_pixel, width * per_pixel, C).

    And what each of its squares counts in its pixel.

    Visibility is that of ``lens_points`` points of a lens of the same aperture, or, unless
    ``exact``, of one that differs by at most ``SIMILAR``, for with the film at F the aperture
    changes a little as the lens is focused.
    """
    scale = radius_per_vergence(lens, samples.camera) * per_pixel
    similar = scale
    if scale == 0:
        samples, similar = samples.visible(), CLOSED
    elif not exact:
        steps = round(math.log(scale) / math.log1p(2 * SIMILAR))
        similar = math.exp(steps * math.log1p(2 * SIMILAR))

    aperture = aperture_behind(psf)
    pupil = Pupil.of(aperture, lens, samples, lens_points, per_pixel)
    of_samples = (mi.variant(), per_pixel, alpha, similar, aperture.diffracts)
    about = (*of_samples, pupil.key)

    kept = _kept.setdefault(samples, _Kept())
    known = kept.of_question(about)

    # Here, for a function that called itself for it would keep the samples alive in a cycle.
    if 1 not in known:
        if of_samples not in kept.elements:
            elements = Elements.of(samples, per_pixel, similar, alpha)
            if aperture.diffracts:
                elements = elements.placed(samples, per_pixel)
            kept.elements = {of_samples: elements}
        elements = kept.elements[of_samples]
        known[1] = Layers.of(elements, similar, pupil, spots=not aperture.diffracts)

    def layers_at(factor: int) -> Layers:
        if factor not in known:
            known[factor] = known[1].coarser(factor)
        return known[factor]

    left, top = (
        (offset - start) * per_pixel
        for offset, start in zip(samples.camera.crop_offset, samples.window[:2], strict=True)
    )
    width, height = (size * per_pixel for size in samples.camera.crop_size)
    squares_per_mm = samples.camera.focal_length_pixels * per_pixel / lens.film_distance
    finest = max(EXACT_FINEST * per_pixel if exact else 0, aperture.finest)
    small = math.inf if exact else SMALL
    return through_lens(
        layers_at, lens, psf, (left, top, width, height), scale, squares_per_mm, finest, small
    )
