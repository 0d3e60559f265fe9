import dataclasses
import math

import numpy as np
import pytest

import potmesil_mi as pm
from scenes import synthetic

WALL, TEAPOT = 1, 2


def two_things(**fields):
    """A wall at 4, in front of the right half of it a teapot at 2, and sky at the top."""
    samples = synthetic(20 * 14 * 16)
    right, top = samples.x > 10, samples.y < 3
    z = np.where(right, 2.0, 4.0)
    surface = np.where(right, TEAPOT, WALL)
    columns = {"z": np.where(top, np.inf, z), "surface": np.where(top, 0, surface), **fields}
    return samples.replace(surfaces={WALL: "wall", TEAPOT: "teapot"}, **columns)


@pytest.mark.parametrize(
    ("x", "y", "depth"), [(2.5, 8.5, 4), (15, 10, 2), (5.5, 1.5, math.inf), (20, 14, 2), (0, 14, 4)]
)
def test_a_place_has_the_depth_of_what_it_shows(x, y, depth):
    assert pm.focus_distance_at(two_things(), x, y) == depth


def test_a_pixel_on_a_silhouette_has_the_depth_of_what_most_of_it_shows():
    samples = synthetic(3, x=[5.1, 5.2, 5.9], y=[5.5] * 3, z=[1, 1, 3], surface=[1, 1, 2])
    samples = samples.replace(weight=np.array([0.2, 0.2, 0.6]))
    assert pm.focus_distance_at(samples, 5.5, 5.5) == 3
    samples = samples.replace(weight=np.array([0.3, 0.3, 0.4]))
    assert pm.focus_distance_at(samples, 5.5, 5.5) == 1


def test_what_is_hidden_is_not_focused_on():
    samples = synthetic(2, x=[5.5, 5.5], y=[5.5, 5.5], z=[1, 3])
    samples = samples.replace(layer=np.array([0, 1]), weight=np.array([0.1, 1]))
    assert pm.focus_distance_at(samples, 5.5, 5.5) == 1


def test_a_place_is_of_the_whole_film_where_the_picture_is_a_part_of_it():
    whole = two_things()
    part = whole.crop(pm.Window(8, 4, 6, 6))
    assert pm.focus_distance_at(part, 12.5, 5.5) == pm.focus_distance_at(whole, 12.5, 5.5)
    with pytest.raises(ValueError, match=r"x=1, y=5: must be in the picture, 8 to 14 across"):
        pm.focus_distance_at(part, 1, 5)


@pytest.mark.parametrize(("x", "y"), [(-1, 3), (21, 3), (3, 14.1), (math.nan, 3)])
def test_a_place_outside_of_the_picture_is_refused(x, y):
    with pytest.raises(ValueError, match=r"x=.*y=|^y=|^x="):
        pm.focus_distance_at(two_things(), x, y)


@pytest.mark.parametrize(("name", "depth"), [("teapot", 2), ("wall", 4), ("center", 2)])
def test_a_name_has_the_depth_of_the_thing(name, depth):
    assert pm.focus_distance_of(two_things(), name) == depth


def test_the_depth_of_a_thing_is_the_median_of_its_area():
    samples = synthetic(4, z=[1.0, 2, 3, 9], surface=[1, 1, 1, 2])
    samples = samples.replace(weight=np.array([1.0, 1, 2.5, 1]))
    assert pm.focus_distance_of(samples, "one") == 3


def test_an_unknown_name_is_told_those_like_it():
    with pytest.raises(ValueError, match="name='taepot': is not in the scene; did you mean 'tea"):
        pm.focus_distance_of(two_things(), "taepot")
    with pytest.raises(ValueError, match="must be center or one of 'teapot', 'wall'"):
        pm.focus_distance_of(two_things(), "xyz")


def test_a_thing_out_of_sight_is_told_what_is_in_sight():
    samples = two_things(surface=np.ones(20 * 14 * 16, np.uint32))
    with pytest.raises(ValueError, match="sees nothing of it; in sight are 'wall'"):
        pm.focus_distance_of(samples, "teapot")


def test_the_lens_focused_there_makes_it_sharp():
    samples = two_things()
    distance = pm.focus_distance_of(samples, "teapot")
    lens = samples.lens.replace(focus_distance=distance)
    circles = pm.circle_map(samples, lens)
    assert np.abs(circles[4:, 11:]).max() == 0
    assert circles[4:, :9].max() < 0, "what is beyond is negative"


def test_orthographic_samples_have_depths_to_focus_on():
    camera = synthetic(1).camera
    parallel = dataclasses.replace(
        camera, projection="orthographic", x_fov=0.0, film_width=2.0, near_clip=0.01
    )
    samples = two_things(camera=parallel, lens=pm.TelecentricLens(5.0, 1.0))
    assert pm.focus_distance_of(samples, "teapot") == 2
