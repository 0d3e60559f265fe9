"""How far a picture is from a reference: PSNR, SSIM and FLIP of linear RGB.

Pictures are arrays of linear RGB, (height, width, 3), or with further channels, which are left
out: NumPy's or Mitsuba's. All of them are clipped to [0, 1], as a screen clips them. SSIM and
FLIP need the extra ``compare``.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from .._image import srgb_from_linear

PIXELS_PER_DEGREE = 67.0
"""Pixels of the screen in a degree of the viewer's sight, for FLIP: its authors' default."""

BLOCK = 16
"""Pixels on a side of a block that has noise of its own."""

SSIM_WINDOW = 11
"""Pixels on a side of the window of SSIM, which a picture must cover."""


def mean_square(picture: Any, reference: Any) -> float:
    """Mean squared difference, whole frame, all channels alike."""
    a, b = _clipped(picture, reference)
    return float(np.mean(np.square(a - b)))


def mean_product(pictures: tuple[Any, Any], references: tuple[Any, Any]) -> tuple[float, float]:
    """The mean squared error that two pictures have in common, and its standard error.

    The pictures differ by noise alone, and so do the references, all of it independent: the mean
    of (a - r)(b - s) is free of it. It may be negative.
    """
    products = [
        np.multiply(*(np.subtract(*_clipped(*pair)) for pair in zip(pictures, order, strict=True)))
        for order in (references, references[::-1])
    ]
    mean = np.mean(products, axis=(0, 3))
    # Noise is alike in pixels next to each other: means of blocks are independent.
    rows, columns = (range(0, side, BLOCK) for side in mean.shape)
    blocks = [mean[row : row + BLOCK, at : at + BLOCK].mean() for row in rows for at in columns]
    return float(mean.mean()), float(np.std(blocks)) / math.sqrt(max(len(blocks) - 1, 1))


def decibels(mean_squared_error: float) -> float:
    """PSNR in dB of a mean squared error on a scale of 0 to 1; ``inf`` for 0."""
    return -10 * math.log10(mean_squared_error) if mean_squared_error != 0 else math.inf


def psnr(picture: Any, reference: Any) -> float:
    """Peak signal-to-noise ratio in dB; ``inf`` for equal pictures."""
    return decibels(mean_square(picture, reference))


def ssim(picture: Any, reference: Any) -> float:
    """Structural similarity of the sRGB pictures, at most 1, which equal pictures have.

    The mean over the channels, with the Gaussian window (sigma 1.5) and the constants of Wang et
    al. (2004). Raises ``ValueError`` for pictures smaller than 11x11, ``ImportError`` without
    scikit-image.
    """
    a, b = _clipped(picture, reference)
    if min(a.shape[:2]) < SSIM_WINDOW:
        raise ValueError(
            f"picture: has {a.shape[1]}x{a.shape[0]} pixels, must have at least "
            f"{SSIM_WINDOW}x{SSIM_WINDOW} for SSIM"
        )
    similarity = _optional("skimage.metrics", "scikit-image").structural_similarity
    return float(
        similarity(
            srgb(a),
            srgb(b),
            channel_axis=-1,
            data_range=1.0,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )


def flip(picture: Any, reference: Any, *, pixels_per_degree: float = PIXELS_PER_DEGREE) -> float:
    """Mean FLIP error of the sRGB pictures (Andersson et al. 2020, for LDR), 0 to 1.

    0 for equal pictures. ``pixels_per_degree`` of the viewer's sight, > 0: by default 67, a
    screen 0.7 m wide with 3840 pixels seen from 0.7 m. Raises ``ImportError`` without
    flip-evaluator.
    """
    if not pixels_per_degree > 0:
        raise ValueError(f"pixels_per_degree={pixels_per_degree}: must be > 0")
    a, b = _clipped(picture, reference)
    evaluate = _optional("flip_evaluator", "flip-evaluator").evaluate
    _, error, _ = evaluate(
        srgb(b).astype(np.float32),
        srgb(a).astype(np.float32),
        "LDR",
        inputsRGB=True,
        applyMagma=False,
        computeMeanError=True,
        parameters={"ppd": float(pixels_per_degree)},
    )
    return float(error)


def srgb(linear: Any) -> np.ndarray:
    """The sRGB encoding, 0 to 1, of linear values, which are clipped to [0, 1]."""
    return srgb_from_linear(np.clip(np.asarray(linear, dtype=np.float64), 0, 1))


def require_extra() -> None:
    """Raise ``ImportError`` unless SSIM and FLIP can be had."""
    _optional("skimage.metrics", "scikit-image")
    _optional("flip_evaluator", "flip-evaluator")


def _clipped(picture: Any, reference: Any) -> tuple[np.ndarray, np.ndarray]:
    a, b = (np.array(image, dtype=np.float64) for image in (picture, reference))
    for name, image in (("picture", a), ("reference", b)):
        if image.ndim != 3 or image.shape[2] < 3 or image.size == 0:
            raise ValueError(f"{name}: has shape {image.shape}, must be (height, width, 3 or more)")
    if a.shape[:2] != b.shape[:2]:
        raise ValueError(
            f"picture: has {a.shape[1]}x{a.shape[0]} pixels, the reference has "
            f"{b.shape[1]}x{b.shape[0]}"
        )
    return np.clip(a[..., :3], 0, 1), np.clip(b[..., :3], 0, 1)


def _optional(module: str, package: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{package} cannot be imported ({error}); SSIM and FLIP need it: "
            "pip install 'potmesil_mi[compare]'"
        ) from None
