"""What the lens sees: its points, and what the rim cuts."""

import dataclasses
import itertools

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing import lens_view
from potmesil_mi.focusing.gathering import gather
from potmesil_mi.focusing.lens_points import LensPoints
from potmesil_mi.focusing.lens_view import LensView, ViewPyramid
from scenes import overscanned, synthetic

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


def assert_same_bins(part, whole, bins):
    """The fragments of some bins are the same in both."""
    ours, theirs = (of.between(bins.start, bins.stop) for of in (part, whole))
    assert ours.stop > ours.start
    for name in ("x", "y", "bin", "vergence", "values"):
        np.testing.assert_array_equal(getattr(part, name)[ours], getattr(whole, name)[theirs])


def test_parts_of_a_coarser_view_are_as_in_the_whole_which_is_made_where_many_are_asked_for():
    samples = overscanned(5000)
    fragments = gather(samples, 2, 20.0)
    view = LensView.of(fragments, 20.0, lens_points(samples))
    whole = view.coarser(2)
    views = ViewPyramid(view, None, None)
    last = int(fragments.bin.max()) + 1
    ends = np.linspace(0, last, lens_view.COARSER_PARTS + 2).astype(int)
    parts = [range(int(a), int(b)) for a, b in itertools.pairwise(ends)]
    made = [views.at(2, bins) for bins in parts]
    assert views.at(1, parts[0]) is view
    for bins, part in zip(parts, made, strict=True):
        coarse = range(bins.start // 2, -(-bins.stop // 2))
        assert_same_bins(part.unoccluded, whole.unoccluded, coarse)
        assert_same_bins(part.occluded.fragments, whole.occluded.fragments, coarse)
    assert views.at(2, range(parts[0].start, parts[0].stop)) is made[-1]
    assert len(made[-1].unoccluded) == len(whole.unoccluded) > len(made[0].unoccluded)
    assert views.nbytes > 2 * whole.unoccluded.nbytes
