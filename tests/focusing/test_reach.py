"""Depths from next to the lens to infinitely far away in one picture."""

import itertools
import time

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing.memo import Memo
from potmesil_mi.focusing.reach import MOST_FRAMES, within_reach
from potmesil_mi.optics.blur import Blur
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (32, 24)


def two_planes(**changes):
    """The left half at 2, the right half at 5, dark beside bright."""
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])))
    left = x < SIZE[0] / 2
    columns = {
        "x": x,
        "y": y,
        "z": np.where(left, 2.0, 5.0),
        "rgb": np.where(left, 0.25, 1.0)[:, None] * np.ones(3),
        "weight": np.ones(len(x)),
    }
    made = synthetic(len(x), size=SIZE, **columns)
    return made.replace(lens=made.lens.replace(f_number=1.0, focus_distance=3.0, **changes))


def with_one_at(samples, z, **changes):
    depths = samples.z.copy()
    depths[len(depths) // 2 + 5] = z
    return samples.replace(z=depths, **changes)


@pytest.mark.parametrize(
    ("method", "z"),
    [
        *itertools.product(("layered", "lightfield"), [1e-6, 1e-20, 1e7, 3e38]),
        *itertools.product(("paper",), [1e4, 1e7, 1e9, 3e38]),
    ],
)
def test_one_sample_anywhere_changes_the_picture_at_most_where_it_is(method, z):
    samples = two_planes()
    usual = np.array(pm.focus(samples, method=method))
    picture = np.array(pm.focus(with_one_at(samples, z), method=method))
    off = np.abs(picture - usual).max(axis=2)
    assert np.count_nonzero(off > 0.02) <= 9
    assert np.isfinite(picture).all()
    assert picture.min() > 0.2


@pytest.mark.parametrize("z", [1e-6, 1e-20, 1e-38])
def test_equation_20_has_no_black_hole_where_a_sample_is_next_to_the_lens(z):
    """By the inverse square of its distance such a sample outshines all others."""
    picture = np.array(pm.focus(with_one_at(two_planes(), z), method="paper"))
    assert picture.min() > 0.2
    assert np.isfinite(picture).all()


@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_a_sample_next_to_the_lens_takes_no_longer_the_nearer_it_is(method):
    """Memory would fail at once: a frame of its parallax has more than 10^12 pixels."""
    samples = two_planes()
    pm.focus(with_one_at(samples, 1e-3), method=method)
    start = time.perf_counter()
    assert np.isfinite(np.array(pm.focus(with_one_at(samples, 1e-9), method=method))).all()
    assert time.perf_counter() - start < 60  # For ever, without a bound.


def test_what_is_within_reach_stays_as_it_is_and_shares_what_is_kept():
    samples, memo = two_planes(), Memo()
    blur = Blur.of(samples.lens, samples.camera)
    assert within_reach(samples, blur, memo) == (samples, memo)
    assert within_reach(with_one_at(samples, np.inf), blur, memo)[1] is memo
    closed = Blur.of(samples.lens.replace(f_number=np.inf), samples.camera)
    assert within_reach(with_one_at(samples, 1e-9), closed, memo)[1] is memo


def test_the_farther_side_is_moved_where_the_lens_is_focused_next_to_it():
    samples = with_one_at(two_planes(), 1e-6)
    per_vergence = Blur.of(samples.lens, samples.camera).radius_per_vergence
    reach = MOST_FRAMES * np.hypot(*SIZE)
    usual, _ = within_reach(samples, Blur(per_vergence, 1 / 3), Memo())
    np.testing.assert_allclose(usual.z.max(), 5.0)
    assert per_vergence * (1 / usual.z.min() - 1 / 5) == pytest.approx(reach, rel=1e-4)
    close, _ = within_reach(samples, Blur(per_vergence, 1e6), Memo())
    np.testing.assert_allclose(close.z.min(), 1e-6)
    assert per_vergence * (1e6 - 1 / close.z.max()) == pytest.approx(reach, rel=1e-2)


def test_all_next_to_the_lens_and_the_focus_there_is_sharp():
    samples = two_planes()
    near = samples.replace(z=samples.z * np.float32(1e-4))
    lens = samples.lens.replace(focus_distance=2.0)
    near_lens = lens.replace(focus_distance=2e-4, millimeters_per_unit=1e7)
    picture = np.array(pm.focus(samples.replace(lens=lens), lens))
    in_other_units = samples.replace(z=near.z, lens=near_lens)
    np.testing.assert_allclose(np.array(pm.focus(in_other_units)), picture, atol=1e-3)


@pytest.mark.parametrize("f_number", [1e4, 1e12, np.inf])
def test_equation_20_through_a_hole_shows_what_is_near_and_what_is_far(f_number):
    samples = with_one_at(two_planes(), 1e9)
    lens = samples.lens.replace(f_number=f_number)
    picture = np.array(pm.focus(samples, lens, method="paper"))
    np.testing.assert_allclose(picture.reshape(-1, 3), samples.rgb, atol=1e-3)


@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_where_all_is_next_to_the_lens_the_picture_is_even(method):
    samples = two_planes()
    samples = samples.replace(z=samples.z * np.float32(1e-20))
    picture = np.array(pm.focus(samples, method=method))
    assert np.ptp(picture) < 0.05
    assert picture.mean() == pytest.approx(samples.rgb.mean(), abs=0.05)
