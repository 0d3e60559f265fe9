"""Refinement: where more samples lower the error of the pictures that will be formed.

A sample of a pixel whose radiance has the variance s², spread over a circle of A pixels, leaves a
squared error of s²/(n A) in the picture with n of them in the pixel. With so many samples in all
the sum is least where n goes as the root of s²/A. The variances are those of the samples that
there are, which are the same for all pixels.

Nothing may depend on what a pixel's own samples are: one that is by chance bright would call for
more, which then count it less, and the mean of all pictures would be too dark. So a pixel is told
by those around it.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.ndimage

MOST_SETS = 16
"""Most further sets of samples that a pixel gets; one is as many as each pixel has."""

LEAST_RANGE = 1e-3
"""Foci are one where the radius of circles differs by less, in pixels over the root of pi."""

LEAST_WANTED = 1e-9
"""Pixels that want so small a part of what others do get nothing."""

STEPS = 24
"""Bisections by which the number of samples is met."""

ENOUGH_PIXELS = 1 << 16
"""So many pixels, from all over the picture, tell how many samples all of them get."""

R2 = (0.7548776662466927, 0.5698402909980532)
"""Steps across and down of a sequence that fills the unit square evenly: the powers of the inverse
of 1.3247, the root of x³ = x + 1 (Roberts 2018)."""


def mean_sharpness(
    z: np.ndarray, scale: float, focus_range: tuple[float, float] | None
) -> np.ndarray:
    """The mean of 1/A over foci, of A pixels that the circle of confusion covers, as ``z`` is.

    ``z`` are depths, ``scale`` is the circle's radius r in pixels for each unit of 1/z - 1/U. The
    foci U are those of the range, evenly in 1/U; without one anything may be in focus, and it is 1.
    A is taken for 1 + pi r².
    """
    if focus_range is None or scale == 0:
        return np.ones(z.shape)
    scale *= math.sqrt(math.pi)
    near, far = (scale * (1 / z - 1 / focus) for focus in focus_range)
    apart = scale * (1 / focus_range[0] - 1 / focus_range[1])
    if apart < LEAST_RANGE:
        return 1 / (1 + near**2)
    return (np.arctan(far) - np.arctan(near)) / apart


def pixel_score(rgb: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """s²/A of pixels, (N,): of their samples' radiance, (N, n, 3), and 1/A, (N, n).

    s² is the sum over the colours. It is not finite where radiance is not.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # Infinite radiance is dropped later.
        # Sums by einsum take a tenth of the time of means.
        count = rgb.shape[1]
        apart = rgb - np.einsum("nsc->nc", rgb)[:, None] / count
        return np.einsum("nsc,nsc,ns->n", apart, apart, sharpness) / count


def further_sets(score: np.ndarray, share: float) -> np.ndarray:
    """How many further sets of samples each pixel gets, int (H, W).

    ``score``, (H, W), is s²/A of each pixel, and ``share`` how many sets there are for each pixel
    on the average, or fewer where nothing varies. A pixel has none, or a power of 2 up to
    ``MOST_SETS``.
    """
    score = np.nan_to_num(np.asarray(score, np.float64), nan=0, posinf=0)
    around = np.ones((3, 3))
    around[1, 1] = 0
    known = scipy.ndimage.correlate(np.ones(score.shape), around, mode="constant")
    wanted = scipy.ndimage.correlate(score, around, mode="constant") / np.maximum(known, 1)
    wanted = np.sqrt(np.maximum(wanted, 0))
    least = wanted.max() * LEAST_WANTED
    if not least > 0:
        return np.zeros(score.shape, np.int64)
    # What is wanted between two numbers of sets is one of them, by a threshold without a pattern.
    row, column = np.indices(score.shape)
    threshold = ((row * R2[0] + column * R2[1]) % 1).ravel()
    wanted = wanted.ravel()

    def sets(scale: float, some: slice) -> np.ndarray:
        more = np.clip(scale * wanted[some] - 1, 0, MOST_SETS)
        below = np.where(more < 1, 0, 2 ** np.floor(np.log2(np.maximum(more, 1))))
        part = (more - below) / np.maximum(below, 1)
        return np.where(part > threshold[some], np.maximum(2 * below, 1), below).astype(np.int64)

    # Numbers whose ratio is halved as a sum is.
    low, high = 1 / wanted.max(), (1 + MOST_SETS) / least
    step = -(-score.size // ENOUGH_PIXELS)
    while math.gcd(step, score.shape[1]) > 1:  # Else some columns alone would tell.
        step += 1
    some = slice(None, None, step)
    for _ in range(STEPS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if sets(middle, some).mean() <= share else (low, middle)
    return sets(low, slice(None)).reshape(score.shape)
