"""Samples of an exposure during which things move."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from scenes import still_life, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

NO_MORE = pm.Sampling(layers=1, overscan=0, refine=0)


def motion(**tables):
    return pm.Motion.from_dict({"shutter": {"open": 0, "close": 1}, **tables})


def crossing(distance=0.4, **shutter):
    values = {"shapes": {"ball": {"translate": [[0, [-distance, 0, 0]], [1, [distance, 0, 0]]]}}}
    return motion(**values, shutter={"open": 0, "close": 1, **shutter})


def surfaces(samples, name):
    id_ = next(key for key, value in samples.surfaces.items() if value == name)
    return samples.surface == id_


@pytest.mark.parametrize(
    "still",
    [
        {"shapes": {"ball": {"translate": [0, 0, 0]}}},
        {"camera": {}},
        {"shapes": {"ball": {"angle": 0}, "wall": {"scale": 1}}},
        {},
    ],
)
def test_what_does_not_move_has_the_samples_of_a_scene_that_stands_still(still):
    expected = pm.render_samples(still_life(), seed=3)
    samples = pm.render_samples(still_life(), seed=3, motion=motion(**still))
    assert samples.motion is None
    assert samples.time is None
    assert not samples.moves
    for name in ("x", "y", "rgb", "z", "surface", "weight", "layer"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(expected, name))


def test_a_shape_moves_its_samples_by_what_it_moves_in_the_picture():
    scene = still_life(spp=16)
    samples = pm.render_samples(scene, motion=crossing(instants=4), sampling=NO_MORE)
    ball, wall = surfaces(samples, "ball"), surfaces(samples, "wall")
    assert ball.any()
    assert samples.instants == 4
    assert samples.provenance["instants"] == 4
    assert (samples.provenance["spp"], samples.provenance["seed"]) == (16, 0)
    np.testing.assert_allclose(np.unique(samples.time), [0.125, 0.375, 0.625, 0.875])
    # A quarter of 0.8 m; the camera looks along +z with +x to the left.
    expected = -samples.camera.focal_length_pixels * 0.2 / samples.z[ball]
    np.testing.assert_allclose(samples.motion[ball, 0], expected, rtol=1e-4)
    np.testing.assert_allclose(samples.motion[ball, 1:], 0, atol=1e-5)
    assert not samples.motion[wall].any()
    # It is where its part of the exposure is half over.
    middles = [samples.x[ball & (samples.time == time)].mean() for time in np.unique(samples.time)]
    steps = np.diff(middles)
    np.testing.assert_allclose(steps, samples.motion[ball, 0].mean(), rtol=0.15)


def test_a_camera_that_turns_moves_all_of_the_picture_and_the_sky():
    scene = still_life(spp=16, sky={"type": "constant"})
    focal_length = scene.sensors()[0].camera().focal_length_pixels
    turning = motion(camera={"pan": [[0, -1], [1, 1]]}, shutter={"instants": 2})
    samples = pm.render_samples(scene, motion=turning, sampling=NO_MORE)
    sky = ~np.isfinite(samples.z)
    assert 0 < sky.sum() < len(sky)
    # However far things are: tan(a) changes by 1 + tan(a)^2 for a radian.
    slope = (samples.x - 12) / focal_length
    expected = focal_length * (1 + slope**2) * np.deg2rad(1)
    np.testing.assert_allclose(np.abs(samples.motion[:, 0]), expected, rtol=1e-3)
    np.testing.assert_array_equal(samples.motion[sky, 2], 0)


def test_a_camera_that_comes_nearer_moves_samples_outwards_and_changes_depth():
    nearer = motion(camera={"origin": [[0, [0, 0, 0]], [1, [0, 0, 0.5]]]})
    samples = pm.render_samples(still_life(spp=16), motion=nearer, sampling=NO_MORE)
    hit = np.isfinite(samples.z)
    along = 0.5 / samples.instants
    np.testing.assert_allclose(samples.motion[hit, 2], -along, rtol=1e-3)
    outwards = (samples.x[hit] - 12) * along / samples.z[hit]
    np.testing.assert_allclose(samples.motion[hit, 0], outwards, atol=0.02)


@pytest.mark.parametrize("moved", [crossing(0.8), motion(camera={"pan": [[0, -20], [1, 20]]})])
def test_the_samples_of_all_instants_fill_each_pixel_once(moved):
    samples = pm.render_samples(still_life(spp=16), motion=moved)
    visible = samples.layer == 0
    area = np.bincount(samples.pixel()[visible], samples.weight[visible], samples.window.size)
    crop = samples.crop_window.slices_in(samples.window)
    np.testing.assert_allclose(area.reshape(samples.window.shape)[crop], 1, rtol=1e-4)
    parts = samples.at_instants()
    assert len(parts) == samples.instants > 1
    assert sum(map(len, parts)) == len(samples)


def test_the_scene_and_the_sensor_are_left_as_they_were():
    scene = still_life()
    moved = motion(
        shapes={"ball": {"translate": [[0, [0, 0, 0]], [1, [0.5, 0, 0]]]}},
        camera={"pan": [[0, 0], [1, 5]]},
    )
    before = np.array(mi.render(scene, sensor=pm.potmesil_sensor(scene.sensors()[0]), seed=1))
    pm.render_samples(scene, motion=moved)
    after = np.array(mi.render(scene, sensor=pm.potmesil_sensor(scene.sensors()[0]), seed=1))
    np.testing.assert_array_equal(after, before)


def test_the_scene_is_left_as_it_was_after_an_interruption():
    scene = still_life()
    before = np.array(mi.render(scene, seed=1))

    def interrupt(text, share):
        if text == "Exposing" and share > 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), pm.progress(interrupt):
        pm.render_samples(scene, motion=crossing(instants=4))
    np.testing.assert_array_equal(np.array(mi.render(scene, seed=1)), before)


def test_the_shutter_of_the_sensor_counts_where_the_motion_has_none():
    moves = {"ball": {"translate": [[0, [-1, 0, 0]], [2, [1, 0, 0]]]}}
    sensor = {"shutter_open": 0.5, "shutter_close": 1.5}
    scene = still_life(sensor=sensor)
    own = pm.render_samples(scene, motion=pm.Motion.from_dict({"shapes": moves}), seed=1)
    told = pm.Motion.from_dict({"shapes": moves, "shutter": {"open": 0.5, "close": 1.5}})
    expected = pm.render_samples(still_life(), motion=told, seed=1)
    assert own.instants > 1
    np.testing.assert_allclose(own.motion, expected.motion, atol=1e-6)
    np.testing.assert_array_equal(own.time, expected.time)


def test_a_shutter_that_opens_and_closes_at_once_takes_a_still_picture_of_its_time():
    moves = {"ball": {"translate": [[0, [0, 0, 0]], [1, [0.3, 0, 0]]]}}
    closed = motion(shapes=moves, shutter={"open": 1, "close": 1})
    samples = pm.render_samples(still_life(), motion=closed, seed=1, sampling=NO_MORE)
    there = still_life(ball={"type": "sphere", "center": [0.3, 0, 2.3], "radius": 0.3})
    expected = pm.render_samples(there, seed=1, sampling=NO_MORE)
    assert not samples.moves
    np.testing.assert_allclose(samples.z, expected.z, rtol=1e-5)


def test_longer_paths_have_more_instants_and_no_more_than_there_are_samples():
    counts = [
        pm.render_samples(still_life(spp=spp), motion=crossing(distance)).instants
        for distance, spp in ((0.02, 16), (0.4, 16), (0.8, 16), (0.8, 2))
    ]
    assert counts[0] == 1
    assert counts[0] < counts[1] <= counts[2]
    assert counts[3] == 2


def test_a_motion_of_a_shape_that_is_not_there_is_refused():
    wrong = pm.Motion.from_dict({"shapes": {"door": {"angle": 3}}})
    with pytest.raises(ValueError, match=r"shapes.door: must be the id of one shape"):
        pm.render_samples(still_life(), motion=wrong)
    with pytest.raises(TypeError, match=r"motion='pan.toml': must be a Motion"):
        pm.render_samples(still_life(), motion="pan.toml")


@pytest.mark.parametrize("ending", ["samples", "exr"])
def test_time_and_motion_are_kept_in_files(tmp_path, ending):
    samples = pm.render_samples(still_life(spp=16), motion=crossing(instants=3), sampling=NO_MORE)
    samples.save(tmp_path / f"moving.{ending}")
    loaded = pm.PointSamples.load(tmp_path / f"moving.{ending}")
    assert loaded.instants == 3
    for name in ("time", "motion"):
        own, of_file = getattr(samples, name), getattr(loaded, name)
        assert own.dtype == of_file.dtype
        assert own.sum() == pytest.approx(of_file.sum(), rel=1e-5)
    np.testing.assert_allclose(
        np.array(pm.focus(loaded)), np.array(pm.focus(samples)), rtol=1e-3, atol=1e-4
    )


def test_samples_of_other_times_are_not_merged():
    samples = synthetic(400, time=np.tile([0.25, 0.75], 200), motion=np.ones((400, 3)))
    merged = samples.merge(tolerance=1000)
    assert merged.instants == 2
    assert len(merged) < 400
    np.testing.assert_allclose(merged.motion, 1, rtol=1e-6)


@pytest.mark.parametrize(
    ("column", "value"), [("time", -0.1), ("time", np.nan), ("motion", np.inf), ("motion", 100)]
)
def test_samples_whose_time_or_motion_is_impossible_are_dropped(column, value):
    fields = {"time": np.full(10, 0.5), "motion": np.zeros((10, 3))}
    fields[column][3] = value
    with pytest.warns(RuntimeWarning, match="dropped 1 of 10 samples"):
        assert len(synthetic(10, **fields)) == 9


def test_a_camera_that_zooms_moves_samples_outwards_and_is_put_back():
    scene = still_life(spp=16)
    before = scene.sensors()[0].camera().x_fov
    zooming = motion(camera={"zoom": [[0, 1], [1, 1.2]]}, shutter={"instants": 2})
    samples = pm.render_samples(scene, motion=zooming, sampling=NO_MORE)
    # From 1 to 1.1 and from 1.1 to 1.2; it is where it is half way.
    zoom = np.where(samples.time < 0.5, 1.05, 1.15)
    np.testing.assert_allclose(samples.motion[:, 0], (samples.x - 12) * 0.1 / zoom, atol=1e-3)
    np.testing.assert_allclose(samples.motion[:, 2], 0, atol=1e-6)
    assert scene.sensors()[0].camera().x_fov == pytest.approx(before, rel=1e-6)


def test_a_shape_without_an_id_is_called_as_the_samples_call_it():
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "potmesil",
                "f_number": 0.25,
                "focus_distance": 2.0,
                "film": {"type": "hdrfilm", "width": 24, "height": 16},
                "sampler": {"type": "independent", "sample_count": 4},
            },
            "lamp": {"type": "constant"},
            **{
                f"_unnamed_{i}": {"type": "sphere", "id": "", "center": [x, 0, 3], "radius": 0.3}
                for i, x in enumerate((-0.5, 0.5))
            },
        }
    )
    if any(shape.id().startswith("_unnamed") for shape in scene.shapes()):
        for shape in scene.shapes():
            shape.set_id("")
    still = pm.render_samples(scene, sampling=NO_MORE)
    assert sorted(still.surfaces.values()) == ["Sphere_1", "Sphere_2"]
    moves = {"Sphere_2": {"translate": [[0, [0, 0, 0]], [1, [0, 0.4, 0]]]}}
    samples = pm.render_samples(scene, motion=motion(shapes=moves), sampling=NO_MORE)
    moved = np.abs(samples.motion[:, 1]) > 0.1
    np.testing.assert_array_equal(moved, surfaces(samples, "Sphere_2"))


def test_a_shape_may_enter_the_picture_while_it_is_exposed():
    entering = {"ball": {"translate": [[0, [-3, 0, 0]], [1, [0, 0, 0]]]}}
    samples = pm.render_samples(still_life(spp=8), motion=motion(shapes=entering))
    ball = surfaces(samples, "ball")
    assert samples.instants > 3
    assert 0 < len(np.unique(samples.time[ball])) < samples.instants
    assert np.isfinite(samples.motion).all()
    assert np.isfinite(np.array(pm.focus(samples))).all()


@pytest.mark.parametrize(
    "moves",
    [
        {"shapes": {"ball": {"translate": [[0, [-1, 0, 0]], [0.5, [1, 0, 0]], [1, [-1, 0, 0]]]}}},
        {"camera": {"pan": [[0, -15], [0.5, 15], [1, -15]]}},
    ],
    ids=["shape", "camera"],
)
def test_what_comes_back_to_where_it_began_has_been_away(moves):
    samples = pm.render_samples(still_life(spp=8), motion=motion(**moves))
    assert samples.instants > 2
    assert np.abs(samples.motion[:, 0]).max() > 2


def test_paths_end_before_the_camera_and_are_no_longer_than_a_picture_or_two():
    towards = {"ball": {"translate": [[0, [0, 0, 0]], [1, [0, 0, -2.1]]]}}
    samples = pm.render_samples(still_life(), motion=motion(shapes=towards), sampling=NO_MORE)
    diagonal = np.hypot(24, 16)
    assert np.hypot(*samples.motion[:, :2].T).max() <= 2.001 * diagonal
    assert samples.window.width <= 24 + 2 * diagonal + 4
    passing = {"ball": {"translate": [[0, [0.4, 0, 0]], [1, [0.4, 0, -8]]]}}
    samples = pm.render_samples(still_life(), motion=motion(shapes=passing), sampling=NO_MORE)
    assert np.isfinite(samples.motion).all()


def test_an_orthographic_camera_may_turn_and_go_along_its_axis():
    sensor = {
        "type": "potmesil_orthographic",
        "half_angle": 3.0,
        "focus_distance": 3.0,
        "to_world": mi.ScalarTransform4f().scale([3, 3, 1]),
    }
    scene = still_life(sensor=sensor, spp=8)
    turning = motion(camera={"pan": [[0, -1], [1, 1]]}, shutter={"instants": 2})
    samples = pm.render_samples(scene, motion=turning, sampling=NO_MORE)
    assert samples.camera.film_width == pytest.approx(6)
    sky = ~np.isfinite(samples.z)
    assert 0 < sky.sum() < len(sky)
    np.testing.assert_array_equal(samples.motion[sky], 0)
    nearer = motion(camera={"origin": [[0, [0, 0, 0]], [1, [0, 0, 1]]]}, shutter={"instants": 2})
    samples = pm.render_samples(scene, motion=nearer, sampling=NO_MORE)
    assert np.abs(samples.motion[:, 2]).max() == pytest.approx(0.5, rel=1e-4)
    assert np.isfinite(np.array(pm.focus(samples))).all()  # and no sample is dropped


def test_the_camera_of_an_exposure_is_that_of_its_middle():
    zooming = motion(camera={"zoom": [[0, 1], [1, 3]]}, shutter={"instants": 2})
    scene = still_life()
    own = scene.sensors()[0].camera().focal_length_pixels
    samples = pm.render_samples(scene, motion=zooming, sampling=NO_MORE)
    assert samples.camera.focal_length_pixels == pytest.approx(2 * own, rel=1e-5)


def test_a_triangle_has_more_than_one_instant():
    short = crossing(0.05, profile="triangle")
    assert pm.render_samples(still_life(spp=16), motion=short).instants >= 4
