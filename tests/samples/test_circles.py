import math

import numpy as np
import pytest

from potmesil_mi.samples.circles import (
    DepthRange,
    advice,
    circle_colors,
    circle_diameter,
    largest_circle,
    sharp_range,
    surface_depths,
)
from scenes import synthetic

SAMPLES = synthetic(2000, size=(200, 140))
CAMERA, LENS = SAMPLES.camera, SAMPLES.lens.replace(f_number=1.0)


def told(samples, lens):
    return advice(DepthRange.of(samples), lens, samples.camera)


def test_the_diameter_in_pixels_is_that_of_the_lens_on_its_film():
    depths = np.array([0.5, 1, 2, 5, math.inf])
    on_film = LENS.circle_of_confusion(depths)  # mm
    pixels_per_mm = CAMERA.focal_length_pixels / LENS.film_distance
    np.testing.assert_allclose(
        circle_diameter(LENS, CAMERA, depths), on_film * pixels_per_mm, rtol=1e-9
    )


def test_depths_are_of_what_the_pinhole_sees_in_the_picture():
    z = SAMPLES.z.copy()
    z[:5], z[5:9] = np.inf, 0.01
    layer = np.zeros(len(z), np.uint8)
    layer[5:9] = 1
    found = DepthRange.of(SAMPLES.replace(z=z, layer=layer))
    assert (found.nearest, found.farthest) == (z[9:].min(), z[9:].max())
    assert found.has_sky
    assert DepthRange.of(SAMPLES.replace(z=np.full(len(z), np.inf))) == DepthRange(None, None, True)


def test_the_largest_circle_is_that_of_an_end_of_the_depths():
    samples = SAMPLES.replace(lens=LENS)
    every = np.abs(circle_diameter(LENS, CAMERA, samples.z.astype(float)))
    assert largest_circle(DepthRange.of(samples), LENS, CAMERA) == pytest.approx(every.max())


@pytest.mark.parametrize("diameter", [1.0, 3.0, 1e6])
def test_at_both_ends_of_what_is_sharp_circles_have_the_diameter(diameter):
    near, far = sharp_range(LENS, CAMERA, diameter)
    assert near < LENS.focus_distance < far
    assert circle_diameter(LENS, CAMERA, near) == pytest.approx(diameter)
    if math.isfinite(far):
        assert circle_diameter(LENS, CAMERA, far) == pytest.approx(-diameter)
    else:
        assert abs(circle_diameter(LENS, CAMERA, math.inf)) <= diameter


def test_a_pinhole_makes_everything_sharp():
    assert sharp_range(LENS.replace(f_number=math.inf), CAMERA) == (0, math.inf)


def test_a_lens_that_blurs_and_is_focused_on_something_needs_no_advice():
    assert told(SAMPLES, LENS) == {}
    assert told(SAMPLES, LENS.replace(f_number=math.inf, focus_distance=99)) == {}


def test_a_scene_in_centimetres_taken_for_metres_is_told():
    lens = LENS.replace(focus_distance=200)
    in_cm = SAMPLES.replace(z=100 * SAMPLES.z)
    found = told(in_cm, lens)["sharp"]
    assert "largest circle of confusion is 0." in found
    assert "a scene unit is taken for 1000 mm (--units, units of a recipe" in found
    assert told(in_cm, lens.in_units(1000).replace(millimeters_per_unit=10)) == {}


@pytest.mark.parametrize("distance", [0.5, 7.0, math.inf])
def test_a_focus_where_nothing_is_is_told_with_what_there_is(distance):
    found = told(SAMPLES, LENS.replace(focus_distance=distance))
    assert f"focus_distance={distance:g}: nothing is there" in found["focus"]
    assert " m to 4.999 m" in found["focus"]


def test_the_sky_is_something_to_focus_on():
    z = SAMPLES.z.copy()
    z[:5] = np.inf
    assert told(SAMPLES.replace(z=z), LENS.replace(focus_distance=math.inf)) == {}


def test_surfaces_have_their_share_of_the_picture_and_their_depths():
    samples = synthetic(3, size=(4, 1), x=[0.5, 1.5, 2.5], y=[0.5] * 3, z=[2, 4, 3])
    samples = samples.replace(surface=np.array([1, 2, 2]), weight=np.ones(3))
    first, second = surface_depths(samples)
    assert (first.name, first.share) == ("two", 0.5)
    assert (first.nearest, first.median, first.farthest) == (3, 3.5, 4)
    assert (second.name, second.share, second.median, second.circle) == ("one", 0.25, 2, 0)
    assert first.circle < 0


def test_colours_of_circles_tell_nearer_beyond_and_sharp():
    nearer, sharp, beyond = circle_colors(np.array([[10.0, 0.5, -10.0]]))[0]
    assert nearer[0] > 2 * nearer[2]
    assert beyond[2] > 2 * beyond[0]
    assert np.ptp(sharp) == 0
    stronger = circle_colors(np.array([[np.inf, 60.0, 2.0]]))[0]
    assert (np.diff(stronger[:, 0]) < 0).any()
    assert np.isfinite(stronger).all()
