"""The camera's description, its fields of view, and the matrices and pixels that follow from it."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from potmesil_mi import Camera
from potmesil_mi.optics import camera as cam
from potmesil_mi.optics.camera import FOV_AXES, horizontal_fov

# ---------------------------------------------------------------- fields of view


@pytest.mark.parametrize("axis", FOV_AXES)
@given(st.floats(0.5, 175), st.floats(0.2, 5))
def test_horizontal_fov_follows_from_the_distance_of_the_film(axis, fov, aspect):
    """A film of height 1 stands where its side (or diagonal) fills the field of view."""
    sides = {"x": aspect, "y": 1.0, "diagonal": math.sqrt(aspect * aspect + 1)}
    sides |= {"smaller": min(aspect, 1.0), "larger": max(aspect, 1.0)}
    distance = sides[axis] / 2 / math.tan(math.radians(fov) / 2)
    expected = 2 * math.degrees(math.atan2(aspect / 2, distance))
    assert horizontal_fov(fov, axis, aspect) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("axis", ["smaller", "larger", "x", "y"])
def test_every_side_of_a_square_film_has_the_same_field_of_view(axis):
    assert horizontal_fov(40, axis, 1.0) == pytest.approx(40, rel=1e-14)


@pytest.mark.parametrize("fov", [0, 180, -1, 400, math.nan])
def test_impossible_fields_of_view_are_refused(fov):
    with pytest.raises(ValueError, match=f"^fov={fov}: "):
        horizontal_fov(fov, "x", 1.5)


def test_unknown_axes_are_refused_and_the_known_ones_named():
    with pytest.raises(ValueError, match=r"^fov_axis='z': .*x, y, diagonal, smaller, larger"):
        horizontal_fov(40, "z", 1.5)


# ---------------------------------------------------------------- the camera's description


def camera():
    return Camera(
        film_size=(320, 200),
        crop_offset=(10, 20),
        crop_size=(100, 50),
        x_fov=39.6,
        to_world=tuple(map(tuple, np.arange(16.0).reshape(4, 4).tolist())),
        near_clip=0.1,
        far_clip=77.0,
        principal_point_offset=(0.25, -0.125),
        shutter_open=0.5,
        shutter_close=1.5,
    )


def test_camera_survives_json_unchanged():
    restored = Camera.from_dict(json.loads(json.dumps(camera().to_dict())))
    assert restored == camera()
    assert hash(restored) == hash(camera())  # lists have become tuples, all the way down


def test_numbers_of_numpy_become_those_of_python():
    plain = camera()
    values = plain.to_dict()
    for name, kind in (("film_size", np.int64), ("crop_offset", np.uint8), ("crop_size", np.int32)):
        values[name] = tuple(map(kind, values[name]))
    values["to_world"] = tuple(tuple(map(np.float32, row)) for row in values["to_world"])
    values["principal_point_offset"] = tuple(map(np.float64, values["principal_point_offset"]))
    values |= {"far_clip": np.float32(77), "shutter_close": np.float16(1.5)}
    numpys = Camera(**values)
    assert numpys == plain
    assert hash(numpys) == hash(plain)
    assert json.dumps(numpys.to_dict()) == json.dumps(plain.to_dict())
    assert type(numpys.principal_point_offset[0]) is float
    assert dataclasses.replace(plain, x_fov=np.float32(40)) == dataclasses.replace(plain, x_fov=40)
    assert dataclasses.replace(plain, far_clip=np.float32(np.inf)).far_clip == math.inf


def test_camera_refuses_unknown_fields():
    with pytest.raises(TypeError, match="aperture"):
        Camera.from_dict({**camera().to_dict(), "aperture": 1})


def test_camera_cannot_be_changed_under_the_samples_it_took():
    with pytest.raises(dataclasses.FrozenInstanceError):
        camera().x_fov = 10


@pytest.mark.parametrize(("fov", "pixels"), [(90, 160), (2 * math.degrees(math.atan(0.5)), 320)])
def test_focal_length_in_pixels_is_that_of_the_whole_film(fov, pixels):
    whole = dataclasses.replace(camera(), x_fov=fov)
    assert whole.focal_length_pixels == pytest.approx(pixels, rel=1e-14)
    assert dataclasses.replace(whole, crop_size=(1, 1)).focal_length_pixels == pytest.approx(pixels)


@pytest.mark.parametrize(
    ("field", "value", "error", "text"),
    [
        ("film_size", (320,), TypeError, r"film_size=\(320,\): must be a tuple of 2"),
        ("film_size", (320, 0), ValueError, r"film_size\[1\]=0: must be 1 to"),
        ("film_size", (320.0, 200), TypeError, r"film_size\[0\]=320.0: must be a whole number"),
        ("crop_offset", (-1, 0), ValueError, r"crop_offset\[0\]=-1"),
        ("crop_offset", 3, TypeError, "crop_offset=3: must be a tuple of 2"),
        ("crop_size", (311, 50), ValueError, "crop window must lie in the film of 320 pixels"),
        ("crop_size", (100, True), TypeError, r"crop_size\[1\]=True"),
        ("x_fov", 0, ValueError, "x_fov=0: must be > 0 and < 180"),
        ("x_fov", 180.0, ValueError, "x_fov=180.0"),
        ("x_fov", math.nan, ValueError, "x_fov=nan"),
        ("x_fov", 10**400, ValueError, "x_fov=1000"),
        ("x_fov", "40", TypeError, "x_fov='40': must be a number"),
        ("to_world", ((1.0,) * 4,) * 3, TypeError, "to_world=.*must be a tuple of 4"),
        ("to_world", ((1.0,) * 3,) * 4, TypeError, r"to_world\[0\]=.*must be a tuple of 4"),
        ("to_world", ((math.inf,) * 4,) * 4, ValueError, r"to_world\[0\]\[0\]=inf"),
        ("near_clip", 0.0, ValueError, "near_clip=0.0, far_clip=77.0: must be > 0"),
        ("far_clip", 0.05, ValueError, "near_clip=0.1, far_clip=0.05"),
        ("far_clip", math.nan, ValueError, "far_clip=nan"),
        ("principal_point_offset", (0, math.inf), ValueError, r"principal_point_offset\[1\]=inf"),
        ("shutter_close", 0.25, ValueError, "shutter_close=0.25: must be >= 0.5"),
        ("shutter_open", None, TypeError, "shutter_open=None: must be a number"),
    ],
)
def test_a_bad_field_of_a_camera_is_named(field, value, error, text):
    with pytest.raises(error, match=text):
        dataclasses.replace(camera(), **{field: value})


def test_the_far_plane_may_be_at_infinity():
    assert dataclasses.replace(camera(), far_clip=math.inf).far_clip == math.inf


def test_a_missing_field_is_named():
    values = camera().to_dict()
    del values["x_fov"]
    with pytest.raises(TypeError, match="x_fov: must be given"):
        Camera.from_dict(values)


# ---------------------------------------------------------------- matrices and pixels


def off_axis(**fields):
    """A camera whose principal point is off the middle, seen from a place of no symmetry."""
    return Camera.looking_at(
        (1, 2, 3),
        (-4, 1, 7),
        (0.1, 1, 0.2),
        film_size=(320, 200),
        x_fov=70,
        near_clip=0.5,
        far_clip=40.0,
        principal_point_offset=(0.1, -0.05),
        **fields,
    )


POINTS = np.random.default_rng(11).normal([-4, 1, 7], 1, (50, 3))


def test_the_target_is_seen_at_the_principal_point():
    pixel = off_axis().pixel_from_world((-4, 1, 7))
    np.testing.assert_allclose(pixel, off_axis().principal_point, atol=1e-12)
    assert off_axis().principal_point == pytest.approx((0.4 * 320, 0.55 * 200))


def test_a_camera_that_looks_at_something_covers_the_whole_film():
    camera = off_axis()
    assert camera.crop_size == camera.film_size == (320, 200)
    assert off_axis(crop_offset=(1, 2), crop_size=(3, 4)).crop_size == (3, 4)


def test_pixels_and_depths_give_the_points_back():
    camera = off_axis()
    pixels, depth = camera.pixel_from_world(POINTS), camera.depth_from_world(POINTS)
    np.testing.assert_allclose(camera.world_from_pixel(pixels, depth), POINTS, atol=1e-12)


def test_pixels_are_those_of_clip_space_and_viewport():
    camera = off_axis()
    clip = cam.multiply(camera.clip_from_world(), cam.homogeneous(POINTS))
    expected = cam.pixel_from_ndc(cam.perspective_divide(clip), 320, 200)
    np.testing.assert_allclose(camera.pixel_from_world(POINTS), expected, atol=1e-11)


def test_the_clipping_planes_become_minus_1_and_1():
    for depth, expected in ((0.5, -1), (40.0, 1)):
        point = off_axis().camera_from_pixel((10, 20), depth)
        clip = cam.multiply(off_axis().clip_from_camera(), cam.homogeneous(point))
        assert cam.perspective_divide(clip)[2] == pytest.approx(expected, abs=1e-12)


def test_both_conventions_of_axes_see_the_same():
    camera = off_axis()
    ours = cam.transform_points(camera.camera_from_world("opengl"), POINTS)
    theirs = cam.transform_points(camera.camera_from_world(), POINTS)
    assert (ours[:, 2] < 0).all()
    assert (theirs[:, 2] > 0).all()
    np.testing.assert_allclose(cam.convert_axes(ours), theirs, atol=1e-12)
    np.testing.assert_allclose(
        camera.pixel_from_camera(ours, "opengl"), camera.pixel_from_camera(theirs), atol=1e-11
    )
    pixels = camera.pixel_from_world(POINTS)
    np.testing.assert_allclose(
        camera.camera_from_pixel(pixels, theirs[:, 2], "opengl"), ours, atol=1e-12
    )
    np.testing.assert_allclose(
        camera.clip_from_camera("opengl") @ camera.camera_from_world("opengl"),
        camera.clip_from_world(),
        atol=1e-12,
    )


def test_the_frustum_of_a_camera_has_its_matrix():
    camera = dataclasses.replace(off_axis(), principal_point_offset=(0.0, 0.0))
    np.testing.assert_allclose(
        camera.frustum.clip_from_camera("mitsuba"), camera.clip_from_camera(), atol=1e-12
    )
    assert camera.frustum.x_fov == pytest.approx(70, rel=1e-14)


def test_a_frustum_askew_is_refused():
    with pytest.raises(ValueError, match=r"^principal_point_offset=\(0.1, -0.05\): must be"):
        off_axis().frustum  # noqa: B018


def test_points_behind_a_camera_are_refused_or_flagged():
    camera = off_axis()
    behind = camera.world_from_pixel([(5, 5), (6, 6)], [3.0, -3.0])
    with pytest.raises(ValueError, match=r"^clip=\(.*\): must be in front of the camera"):
        camera.pixel_from_world(behind)
    pixels = camera.pixel_from_world(behind, behind="nan")
    np.testing.assert_allclose(pixels[0], [5, 5], atol=1e-12)
    assert np.isnan(pixels[1]).all()


def test_a_camera_without_an_inverse_is_named():
    with pytest.raises(ValueError, match=r"^to_world=.*: must be invertible"):
        camera().camera_from_world()


def test_a_far_plane_at_infinity_has_pixels():
    camera = dataclasses.replace(off_axis(), far_clip=math.inf)
    np.testing.assert_allclose(
        camera.pixel_from_world(POINTS), off_axis().pixel_from_world(POINTS), atol=1e-11
    )
