"""Samples of a smaller film: the same picture in larger pixels."""

import dataclasses

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.evaluation import metrics
from potmesil_mi.samples.smaller import smaller
from scenes import evenly_spread, overscanned, synthetic


def box_mean(picture, times):
    height, width, channels = picture.shape
    blocks = picture.reshape(height // times, times, width // times, times, channels)
    return blocks.mean(axis=(1, 3))


def smooth(samples):
    """Samples whose colour changes slowly, so that chance counts little, at two depths."""
    rgb = np.stack([samples.x / 48, samples.y / 32, np.full(len(samples), 0.3)], axis=1)
    left = samples.x < 20
    return samples.replace(rgb=rgb, z=np.where(left, 1.5, 4.0), surface=np.where(left, 1, 2))


def test_a_lens_forms_the_same_picture_in_larger_pixels(variant_llvm):
    samples = smooth(evenly_spread((48, 32)))
    lens = pm.ThinLens(50.0, 2.0, 2.0, millimeters_per_unit=1000.0)
    whole = box_mean(np.array(pm.focus(samples, lens)), 2)
    small = np.array(pm.focus(smaller(samples, 2), lens))
    assert small.shape == (16, 24, 3)
    assert metrics.psnr(small, whole) > 40


@pytest.mark.parametrize("times", [1, 2, 3, 5])
def test_circles_are_as_many_times_smaller_and_the_middle_stays(times):
    samples = overscanned()
    camera = dataclasses.replace(samples.camera, principal_point_offset=(0.1, -0.2))
    small = smaller(samples.replace(camera=camera), times).camera
    assert small.focal_length_pixels * times == pytest.approx(camera.focal_length_pixels)
    assert np.multiply(small.principal_point, times) == pytest.approx(camera.principal_point)


def test_the_crop_window_grows_to_whole_pixels_and_samples_stay_in_the_window():
    samples = overscanned(film=(41, 31), crop=(3, 5, 20, 14))
    small = smaller(samples, 3)
    assert small.camera.film_size == (14, 11)
    assert (*small.camera.crop_offset, *small.camera.crop_size) == (1, 1, 7, 6)
    assert small.window.contains(small.x, small.y).all()


def test_chance_chooses_among_many_samples_and_their_area_stays():
    samples = evenly_spread((40, 40), 4)
    small = smaller(samples, 4)
    assert 12 < small.spp < 20
    assert small.weight.sum() == pytest.approx(100, rel=0.1)
    again = smaller(samples, 4)
    assert np.array_equal(small.x, again.x)


def test_what_moves_moves_by_fewer_pixels_and_as_deep():
    motion = np.tile(np.float32([4, 2, 0.5]), (50, 1))
    small = smaller(synthetic(50, motion=motion, time=np.full(50, 0.5)), 2)
    assert np.array_equal(small.motion[0], np.float32([2, 1, 0.5]))


def test_an_orthographic_film_keeps_its_scale():
    camera = dataclasses.replace(
        synthetic(1).camera, projection="orthographic", x_fov=0.0, film_width=5.0
    )
    samples = synthetic(100, camera=camera, lens=pm.TelecentricLens(5.0, 2.0))
    small = smaller(samples, 3).camera
    assert small.pixels_per_unit * 3 == pytest.approx(camera.pixels_per_unit)


@pytest.mark.parametrize("times", [0, 65])
def test_a_film_of_no_pixels_is_refused(times):
    with pytest.raises(ValueError, match=f"times={times}: must be 1 to 64"):
        smaller(synthetic(5), times)
