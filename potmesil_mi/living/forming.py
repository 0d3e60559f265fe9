"""Forming the pictures of sweeps: those that a page may keep, and those it is measured at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np

from .._image import in_srgb
from .._progress import progress, reported, step_progress
from ..focusing.session import FocusSession
from ..optics.lens import ThinLens
from .jpeg import POSTER, encoded
from .lenses import growth
from .sweep import FocusRange, Sweep

HALVINGS = 2
"""How often steps of a sweep are halved, at most, where blends have not been measured."""


class SweepForming:
    """Forms the pictures of sweeps, in 8 bits of sRGB."""

    def __init__(self, session: FocusSession, focused: FocusRange, picture: dict[str, Any]) -> None:
        self._session = session
        self._focused = focused
        self._picture = picture

    def poster(self, lens: ThinLens, place: float) -> bytes:
        """What is seen before anything else."""
        return encoded(self.formed(lens, place), POSTER).data

    def sweeps(
        self, lens: ThinLens, apertures: Sequence[float], error: float, file: BinaryIO
    ) -> list[Sweep]:
        """Pictures from near to far, an aperture after the other, and between those that count.

        So it is known of all blends by how much they err, where no more than ``error`` is allowed.
        The pictures are kept in a ``file``.
        """
        camera = self._session.samples.camera
        lenses = [lens.replace(f_number=f_number) for f_number in apertures]
        places = [self._focused.places(growth(one, camera, self._focused)) for one in lenses]
        count, done, found = sum(map(len, places)), 0, []
        with reported() as report:
            for opened, evenly in zip(lenses, places, strict=True):
                sweep = Sweep(float(opened.f_number), camera.crop_size[::-1], file)
                for place in evenly:
                    with step_progress(report, f"f/{opened.f_number:g}", done, count):
                        sweep.add(place, self.formed(opened, place))
                    done += 1
                for _ in range(HALVINGS):
                    for place in sweep.gaps(error):
                        with progress(lambda text, share: report("Between", done / count)):  # noqa: B023
                            sweep.add(place, self.formed(opened, place))
                found.append(sweep)
            report("Compressing", 1.0)
        return found

    def formed(self, lens: ThinLens, place: float) -> np.ndarray:
        """The picture through a lens whose focus is at a place, uint8 (H, W, 3)."""
        focused = lens.replace(focus_distance=self._focused.distance_at(place))
        picture = np.array(self._session.focus(focused, **self._picture))
        return in_srgb(picture[..., :3], "8")
