"""What moves, and when the shutter is open."""

import dataclasses

import numpy as np
import pytest

import potmesil_mi as pm
from scenes import synthetic

FILE = """
[camera]
pan = [[0, 178], [1, 182]]

[shapes.ball]
translate = [[0, [0, 0, 0]], [1, [1, 0, 0]]]

[shutter]
open = -0.25
close = 0.25
profile = "triangle"
"""


def test_a_file_tells_what_moves_and_when(tmp_path):
    path = tmp_path / "motion.toml"
    path.write_text(FILE, encoding="utf-8")
    motion = pm.Motion.load(path)
    assert motion.shutter == pm.Shutter(-0.25, 0.25, "triangle")
    moved = motion.transforms_at({"ball": np.zeros(3)}, 0.5)["ball"]
    np.testing.assert_allclose(moved[:3, 3], [0.5, 0, 0])
    camera = synthetic(1).camera
    axis = motion.camera_at(camera, 0.5).world_from_camera()[:3, 2]
    np.testing.assert_allclose(axis, [0, 0, -1], atol=1e-12)


def test_without_a_shutter_of_its_own_a_motion_has_that_of_the_camera():
    camera = dataclasses.replace(synthetic(1).camera, shutter_open=0.5, shutter_close=2.0)
    assert pm.Motion().shutter_of(camera) == pm.Shutter(0.5, 2.0)
    assert pm.Motion(shutter=pm.Shutter(0, 0.1)).shutter_of(camera) == pm.Shutter(0, 0.1)


@pytest.mark.parametrize("profile", ["box", "triangle"])
def test_a_shutter_tells_when_a_part_of_the_light_is_in(profile):
    shutter = pm.Shutter(2.0, 4.0, profile)
    light = np.linspace(0, 1, 101)
    frames = np.array([shutter.frame_when(part) for part in light])
    assert frames[0] == 2
    assert frames[-1] == pytest.approx(4)
    assert frames[50] == pytest.approx(3)
    assert (np.diff(frames) > 0).all()
    # How far it is open is how quickly light comes in.
    open_ = 0.01 / np.diff(frames)
    middle = (frames[1:] + frames[:-1]) / 2
    expected = np.full(100, 0.5) if profile == "box" else 1 - np.abs(middle - 3)
    np.testing.assert_allclose(open_, expected, atol=0.03)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"open": 1.0, "close": 0.5}, "close=0.5: must be >= 1"),
        ({"profile": "round"}, "profile='round': must be one of box, triangle"),
        ({"instants": 0}, "instants=0: must be 1 to 256"),
        ({"angle": 180}, "angle: unknown, must be one of open, close, profile, instants"),
        ({"open": float("nan")}, "open=nan: must be finite"),
    ],
)
def test_a_wrong_shutter_is_named(values, message):
    with pytest.raises(ValueError, match=f"shutter: {message}"):
        pm.Motion.from_dict({"shutter": values})


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"frames": 3}, ValueError, "frames: unknown, must be one of camera, shapes, shutter"),
        ({"camera": 3}, TypeError, "camera=3: must be a table"),
        ({"shapes": {"ball": 3}}, TypeError, "shapes.ball: 3: must be a table"),
        ({"shapes": {"ball": {"jump": 3}}}, ValueError, "shapes.ball: jump: unknown"),
        ({"camera": {"pan": "left"}}, TypeError, "camera: pan: 'left': must be a number"),
    ],
)
def test_a_wrong_motion_is_named(values, error, message):
    with pytest.raises(error, match=message):
        pm.Motion.from_dict(values)


def test_a_file_that_is_no_motion_is_named(tmp_path):
    path = tmp_path / "motion.toml"
    path.write_text("[camera", encoding="utf-8")
    with pytest.raises(ValueError, match=r"motion.toml: is not TOML"):
        pm.Motion.load(path)
    path.write_text("[shutter]\nopen = 'now'", encoding="utf-8")
    with pytest.raises(TypeError, match=r"motion.toml: shutter: open='now': must be a number"):
        pm.Motion.load(path)


def test_an_animation_is_exposed_around_each_of_its_frames():
    values = {
        "frames": 4,
        "shutter": {"open": 0, "close": 0.5},
        "camera": {"pan": [[0, 0], [4, 8]]},
    }
    animation = pm.Animation.from_dict(values)
    motion = animation.motion_at(2)
    assert motion.frame == 2
    assert motion.shutter == pm.Shutter(0, 0.5)
    assert motion.camera is animation.camera
