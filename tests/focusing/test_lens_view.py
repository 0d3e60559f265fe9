"""What the lens sees: its points, and what the rim cuts."""

import dataclasses

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing.lens_view import LensPoints
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


def lens_points(samples, aperture=None, *, vignetting=0.0, count=8, subpixels=2):
    lens = samples.lens.replace(vignetting=vignetting)
    return LensPoints.of(aperture or pm.Disc(), lens, samples, count, subpixels)


def test_lens_points_are_equal_where_all_their_points_are():
    samples = synthetic(100)
    assert lens_points(samples) == lens_points(samples)
    assert hash(lens_points(samples)) == hash(lens_points(samples, pm.Disc()))
    assert lens_points(samples) != lens_points(samples, pm.Polygon(6))
    assert lens_points(samples) != lens_points(samples, vignetting=0.5)
    one = lens_points(samples)
    other = dataclasses.replace(one, highlight_points=one.highlight_points * 0.3)
    assert one != other


def test_the_rim_is_centred_where_the_camera_looks():
    samples = synthetic(20 * 14, x=np.tile(np.arange(20) + 0.5, 14), y=np.repeat(np.arange(14), 20))
    camera = dataclasses.replace(samples.camera, principal_point_offset=(0.2, -0.1))
    shifted = samples.replace(camera=camera)
    # Mitsuba's perspective looks along the pixel (0.5 - offset) times the film's size.
    expected = (0.3 * 20 * 2, 0.6 * 14 * 2)
    assert lens_points(shifted, vignetting=0.5).middle == pytest.approx(expected)
