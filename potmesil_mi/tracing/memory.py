"""Memory: what sampling takes at its largest, told before it begins."""

from __future__ import annotations

import numpy as np

from ..samples.columns import COLUMNS, is_optional
from ..samples.raster import Window
from .passes import WAVEFRONT
from .patterns import visible_count
from .sampling import Sampling

BYTES_AT_LEAST = 300e6
"""What Dr.Jit's kernels take, and rooms whose size does not depend on the film."""

BYTES_OF_RAY = 70.0
"""What each ray of a pass takes while it is traced."""

USUALLY_HIDDEN = 0.07
"""Hidden samples for each that the pinhole sees. Crowded scenes have up to one, and more."""

BYTES_OF_HIDDEN = 100.0
"""What a hidden sample takes, beside its columns, until it is added."""

BYTES_OF_WINDOWS = 40.0
"""What is found out of a sample where there are mirrors and glass, beside its columns."""


def memory_of_sampling(
    crop: Window,
    window: Window,
    spp: int,
    sampling: Sampling,
    follows_windows: bool,
    aovs: int = 0,
) -> float:
    """Bytes that sampling takes at its largest, beside the scene, of scenes that are not crowded.

    ``window`` is what is sampled around the ``crop`` window, with ``spp`` samples a pixel;
    ``follows_windows`` tells whether there may be mirrors or glass, ``aovs`` the number of AOVs.
    """
    features = ("albedo", "normal") if sampling.features else ()
    of_sample = sum(
        field.metadata["dtype"]().itemsize * max(field.metadata["channels"], 1)
        for field in COLUMNS
        if not is_optional(field) or field.name in features
    )
    of_aovs = np.dtype(np.float32).itemsize * aovs
    of_sample += of_aovs
    if follows_windows:
        of_sample += BYTES_OF_WINDOWS
    each = of_sample
    if sampling.layers > 1:
        each += USUALLY_HIDDEN * (of_sample + BYTES_OF_HIDDEN)
    count = visible_count(crop, window, spp, sampling)
    at_once = (BYTES_OF_RAY + of_aovs) * min(count, WAVEFRONT)
    return BYTES_AT_LEAST + at_once + each * count
