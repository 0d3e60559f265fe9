"""Equation 20 evaluated sample by sample in double precision: the judge of the fast methods."""

import numpy as np

from potmesil_mi.optics.aperture import SHARP
from potmesil_mi.optics.disc import disc_corner_area


def equation_20(samples, lens, pixels, *, squares=2, inverse_square=True):
    """Q, float64 (P, 3), of the ``pixels`` (P, 2), columns and rows of the crop window.

    No tables, no classes, no convolution: every sample has its own circle and its own place.
    Of what is hidden equation 20 knows nothing.
    """
    samples = samples.visible()
    camera = samples.camera
    z = samples.z.astype(np.float64)
    pixels_per_mm = camera.focal_length_pixels / lens.film_distance
    radius = np.abs(lens.circle_of_confusion(z)) / 2 * pixels_per_mm * squares
    radius = np.maximum(radius, SHARP)
    finite = z[np.isfinite(z)]
    farthest = finite.max() if len(finite) else 1.0
    weight = samples.weight.astype(np.float64)
    light = weight / np.minimum(z, farthest) ** 2 if inverse_square else weight
    x = (samples.x.astype(np.float64) - camera.crop_offset[0]) * squares
    y = (samples.y.astype(np.float64) - camera.crop_offset[1]) * squares
    rgb = samples.rgb.astype(np.float64)

    def covered(i, left, top):
        """Shares of samples' circles in the squares of a pixel: (squares, squares, len(i))."""
        edges = np.arange(squares + 1)[:, None]
        across, down = (left + edges - x[i]) / radius[i], (top + edges - y[i]) / radius[i]
        corners = disc_corner_area(across[None], down[:, None])
        return np.diff(np.diff(corners, axis=0), axis=1) / np.pi

    result = np.zeros((len(pixels), 3))
    for p, (column, row) in enumerate(pixels):
        total = 0.0
        left, top = column * squares, row * squares
        near = np.flatnonzero(
            (x >= left - radius)
            & (x <= left + squares + radius)
            & (y >= top - radius)
            & (y <= top + squares + radius)
        )
        values, shares = [], []
        for share in covered(near, left, top).reshape(squares**2, -1):
            f = light[near] * share
            if f.sum() <= 0:
                continue
            values.append(f @ rgb[near] / f.sum())
            shares.append(1.0 if samples.lattice else weight[near] @ share)
        for value, share in zip(values, shares, strict=True):
            result[p] += share * value
            total += share
        result[p] /= total
    return result
