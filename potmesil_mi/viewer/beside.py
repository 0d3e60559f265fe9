"""The ray-traced ``thinlens`` beside the picture, rendered bit by bit while one looks."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..stacks.foci import Lens

if TYPE_CHECKING:
    import mitsuba as mi

    from ..evaluation.reference import Reference

PASS = 16
"""Samples a pixel of a rendering; each answer adds two."""

MOST_SPP = 2048
"""Samples a pixel after which it is good enough."""


class Difference(NamedTuple):
    """How far a picture is from ``thinlens``.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``shown``                     the difference, amplified, linear (H, W, 3)
    ``text``                      what there is to say of it
    ``is_done``                   whether more rendering would change little
    ============================  ==========================================================
    """

    shown: np.ndarray
    text: str
    is_done: bool


class Beside:
    """Renders a scene with the ``thinlens`` that stands for a lens, two renderings at a time.

    What has been rendered is kept until it is asked for another lens.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, seed: int) -> None:
        self._scene = scene
        self._sensor = sensor
        self._seed = seed
        self._lens: Lens | None = None
        self._reference: Reference | None = None

    def difference(self, picture: np.ndarray, lens: Lens) -> Difference:
        """The difference of the ``picture`` of a lens from two renderings more than the last time.

        Raises ``ValueError`` for a lens that has no ``thinlens``.
        """
        from ..evaluation import metrics
        from ..evaluation.report import DIFFERENCE_FACTOR

        reference = self._reference_of(lens)
        if reference.spp < MOST_SPP:
            reference.add(PASS)
        mean = reference.mean
        apart = np.abs(np.clip(picture, 0, 1) - np.clip(mean, 0, 1)) * DIFFERENCE_FACTOR
        text = (
            f"difference to thinlens x {DIFFERENCE_FACTOR:g}: {metrics.psnr(picture, mean):.1f} dB "
            f"with {reference.spp} samples a pixel, whose noise is at {reference.floor:.1f} dB"
        )
        return Difference(apart.astype(np.float32), text, reference.spp >= MOST_SPP)

    def _reference_of(self, lens: Lens) -> Reference:
        from ..evaluation.reference import Reference
        from ..evaluation.thinlens import ThinlensRenderer
        from ..optics.lens import ThinLens
        from ..tracing.hidden_surface import nested_of

        if not isinstance(lens, ThinLens):
            raise ValueError(f"lens={type(lens).__name__}: must be a ThinLens to be compared")
        if self._reference is None or lens != self._lens:
            renderer = ThinlensRenderer(
                self._scene,
                nested_of(self._scene.integrator()),
                self._sensor,
                self._seed,
                lens=lens,
            )
            self._lens, self._reference = lens, Reference(renderer.for_reference)
        return self._reference
