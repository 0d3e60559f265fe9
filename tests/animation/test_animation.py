"""Lenses and filters that change from frame to frame, and their pictures."""

import dataclasses
import math

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.animation.frames import FrameFiles, chosen_frames
from potmesil_mi.optics.camera import angles_of, look_at, orientation
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

PULL = """
frames = [3, 6]

[lens]
focus_distance = [[3, 2.0], [6, inf]]
f_number = [[3, 4.0], [5, 8]]
aperture = "polygon:blades=6"

[[filters]]
name = "fade"
amount = [[3, 1], [5, 0]]
color = [1, 0.5, 0]
"""


def loaded(tmp_path, text=PULL):
    path = tmp_path / "pull.toml"
    path.write_text(text, encoding="utf-8")
    return pm.Animation.load(path)


def test_a_file_says_what_lens_and_filters_each_frame_has(tmp_path):
    animation = loaded(tmp_path)
    assert animation.frames == range(3, 7)
    lens = animation.lens_at(synthetic(1).lens, 5)
    assert lens.f_number == 8
    assert lens.focus_distance == pytest.approx(6)
    assert lens.aperture == pm.Polygon(6)
    assert animation.lens_at(lens, 6).focus_distance == math.inf
    assert animation.filters_at(4) == (pm.Fade(0.5, (1, 0.5, 0)),)


def test_lens_tracks_may_have_units():
    texts = {
        "focus_distance": [[0, "50cm"], [2, "2m", "hold"], [3, math.inf]],
        "f_number": [[0, "f/2"], [2, "f/8"]],
        "focal_length": "5cm",
    }
    animation = pm.Animation.from_dict({"frames": 4, "lens": texts})
    lens = pm.ThinLens(35, 2.8, 100, millimeters_per_unit=10)
    found = [animation.lens_at(lens, frame) for frame in range(4)]
    assert [one.focus_distance for one in found] == pytest.approx([50, 80, 200, math.inf])
    assert [one.f_number for one in found] == pytest.approx([2, 4, 8, 8])
    assert {one.focal_length for one in found} == {50}
    for wrong in ([[0, "50cm"], [2, 2.0]], "far"):
        with pytest.raises(ValueError, match=r"lens.focus_distance: value=.*: must"):
            pm.Animation.from_dict({"frames": 4, "lens": {"focus_distance": wrong}})


def test_focus_distances_of_a_telecentric_lens_change_evenly_and_may_be_negative():
    animation = pm.Animation.from_dict({"frames": 3, "lens": {"focus_distance": [[0, 2], [2, 10]]}})
    lens = pm.TelecentricLens(5, 2)
    assert animation.lens_at(lens, 1).focus_distance == 6
    assert animation.lens_at(synthetic(1).lens, 1).focus_distance == pytest.approx(1 / 0.3)
    behind = pm.Animation.from_dict({"frames": 3, "lens": {"focus_distance": [[0, -1], [2, 3]]}})
    assert behind.lens_at(lens, 1).focus_distance == 1
    with pytest.raises(ValueError, match="frame 0: focus_distance=-1"):
        behind.lens_at(synthetic(1).lens, 0)


def test_pictures_are_those_of_the_lens_of_each_frame(tmp_path):
    animation, samples = loaded(tmp_path), synthetic(500)
    pictures = dict(animation.pictures(samples, [4, 6]))
    assert list(pictures) == [4, 6]
    for frame, picture in pictures.items():
        lens, filters = animation.lens_at(samples.lens, frame), animation.filters_at(frame)
        expected = pm.focus(samples, lens, filters=filters)
        np.testing.assert_allclose(np.array(picture), np.array(expected), rtol=1e-5, atol=1e-6)


def test_pictures_are_formed_by_a_session_with_filters_before_the_animations(tmp_path):
    animation, samples = loaded(tmp_path), synthetic(500)
    session = pm.FocusSession(samples, "paper")
    lens = samples.lens.replace(squeeze=1.5)
    ((_, picture),) = animation.pictures(
        session, [4], lens=lens, filters=[pm.Fade(1.0, (0, 1, 0))], alpha=True
    )
    assert picture.shape[-1] == 4
    # Green by the first, then half of the way to orange.
    coverage = np.array(picture)[..., 3:]
    np.testing.assert_allclose(np.array(picture)[..., :3], coverage * [0.5, 0.75, 0], atol=1e-6)


def test_progress_is_that_of_all_frames(tmp_path):
    told = []
    animation = loaded(tmp_path)
    with pm.progress(lambda text, share: told.append((text, share))):
        list(animation.pictures(synthetic(500)))
    assert [text for text, _ in told] == sorted(text for text, _ in told)
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0, 1)
    assert {text for text, _ in told} == {f"Frame {number}" for number in range(3, 7)}


def test_wrong_frames_are_refused_before_the_first_picture(tmp_path):
    animation, samples = loaded(tmp_path), synthetic(50)
    with pytest.raises(ValueError, match="frames=7: must be 3 to 6"):
        animation.pictures(samples, [3, 7])
    wide = pm.Animation.from_dict({"frames": 3, "lens": {"vignetting": [[0, 0.5], [2, 9]]}})
    with pytest.raises(ValueError, match="frame 1: vignetting="):
        wide.pictures(samples)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frames = ", ": is not TOML"),
        ("", "frames: must be given"),
        ("frames = 0", "frames=0: must be 1 to"),
        ("frames = [5, 3]", r"frames=\[5, 3\]: the last must not come before"),
        ("frames = [1, 2, 3]", r"must be a number, or \[first, last\]"),
        ("frames = 2.5", "frames=2.5: must be a whole number"),
        ("frames = 2\nspeed = 3", "speed: unknown, must be one of frames, fps, lens, filters"),
        ("frames = 2\nfps = 0", "fps=0: must be 0.01 to 1000"),
        ("frames = 2\nfps = true", "fps=True: must be a number"),
        ("frames = 2\nlens = 3", "lens=3: must be a table"),
        ("frames = 2\nfilters = 3", "filters=3: must be tables"),
        ("frames = 2\n[lens]\nfocus = 3", "lens.focus: unknown, must be one of focus_distance"),
        ("frames = 2\n[lens]\nfocus_distance = nan", "lens.focus_distance: keys.*value=nan"),
        ("frames = 2\n[lens]\nf_number = 0", "lens.f_number: keys.*must be > 0"),
        ("frames = 2\n[lens]\nf_number = 1" + 400 * "0", "lens.f_number: keys.*must be finite"),
        ("frames = 2\n[lens]\naperture = 'star'", "lens.aperture: aperture='star': must be one of"),
        ("frames = 2\n[[filters]]\namount = 1", r"filters\[0\]: name=None: must be given"),
        ("frames = 2\n[[filters]]\nname = 'fad'", r"filters\[0\]: filter='fad': must be one of"),
        ("frames = 2\n[[filters]]\nname = 'fade'", r"frame 0: filters\[0\]: .*needs amount"),
        ("frames = 2\n[[filters]]\nname = 'fade'\namout = 1", r"amout: not a parameter of .*fade"),
        (
            "frames = 3\n[[filters]]\nname = 'fade'\namount = [[0, 0], [1, 2]]",
            r"frame 1: filters\[0\]: amount=2",
        ),
        (
            "frames = 90\n[[filters]]\nname = 'fade'\namount = [[0, 0], [40, 2], [50, 0]]",
            r"frame 40: filters\[0\]: amount=2",
        ),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path, text, message):
    with pytest.raises((ValueError, TypeError), match=f"(?s)pull.toml.*{message}"):
        loaded(tmp_path, text)


def test_text_of_another_encoding_is_no_animation(tmp_path):
    path = tmp_path / "pull.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"pull\.toml: is not TOML"):
        pm.Animation.load(path)


def test_an_animation_has_frames():
    with pytest.raises(ValueError, match="frames=range"):
        pm.Animation(range(0))
    assert dataclasses.replace(pm.Animation(range(2)), frames=range(5)).frames.stop == 5
    with pytest.raises(ValueError, match=r"lens\.speed: unknown, must be one of focus_dist"):
        pm.Animation(range(2), {"speed": pm.Track.of(2)})


# ---------------------------------------------------------------- cameras


def turned(camera, **angles):
    """Where the camera stands, turned by some of the paper's angles."""
    matrix = np.eye(4)
    matrix[:3, :3] = orientation(*(angles.get(name, 0.0) for name in ("pan", "tilt", "swing")))
    matrix[:3, 3] = camera.world_from_camera()[:3, 3]
    return matrix


def test_a_camera_turns_and_goes_where_it_is_told():
    camera = synthetic(1).camera
    move = {"origin": [[0, [0, 0, 0]], [4, [4, 8, 0], "ease"]], "pan": [[0, 0], [4, 20]]}
    animation = pm.Animation.from_dict({"frames": 5, "camera": move})
    there = animation.camera_at(camera, 2).world_from_camera()
    np.testing.assert_allclose(there[:3, 3], [2, 4, 0])
    own = angles_of(camera.world_from_camera()[:3, :3])
    expected = turned(camera, pan=10, tilt=float(own.tilt), swing=float(own.swing))
    np.testing.assert_allclose(there[:3, :3], expected[:3, :3], atol=1e-12)
    still = pm.Animation.from_dict({"frames": 5, "camera": {}}).camera_at(camera, 2)
    np.testing.assert_allclose(still.world_from_camera(), camera.world_from_camera(), atol=1e-12)


def test_a_camera_looks_at_its_target():
    camera = synthetic(1).camera
    move = {"target": [1, 2, 30], "up": [1, 0, 0], "origin": [0, 0, -5]}
    animation = pm.Animation.from_dict({"frames": 1, "camera": move})
    there = animation.camera_at(camera, 0)
    expected = look_at([0, 0, -5], [1, 2, 30], [1, 0, 0], axes="mitsuba")
    np.testing.assert_allclose(there.world_from_camera(), expected, atol=1e-12)
    np.testing.assert_allclose(there.pixel_from_world([1, 2, 30]), there.principal_point)


def test_a_scaled_camera_keeps_its_scale():
    scaled = np.diag([2.0, 3.0, 1.0, 1.0])
    camera = dataclasses.replace(synthetic(1).camera, to_world=tuple(map(tuple, scaled.tolist())))
    animation = pm.Animation.from_dict({"frames": 1, "camera": {"swing": 90}})
    there = animation.camera_at(camera, 0).world_from_camera()[:3, :3]
    np.testing.assert_allclose(np.linalg.norm(there, axis=0), [2, 3, 1])


@pytest.mark.parametrize(
    ("move", "message"),
    [
        (3, "camera=3: must be a table"),
        ({"roll": 3}, "camera: roll: unknown, must be one of origin"),
        ({"zoom": 0}, "camera: zoom=0: must be > 0"),
        ({"pan": [1, 2]}, "camera: pan: .*must be a number, or a list of keys"),
        ({"origin": 3}, "camera: origin: 3: must be three numbers"),
        ({"origin": [1, 2]}, "camera: origin: .*must be three numbers"),
        ({"origin": [[0, 1]]}, "camera: origin: .*must be three numbers"),
        ({"origin": [[0, [1, 2]]]}, "camera: origin: .*must be three numbers"),
        ({"origin": [[0, [1, 2, math.nan]]]}, r"camera: origin: keys\[0\]: value=nan"),
        ({"up": [0, 1, 0]}, "camera: up: must be given with target"),
        ({"target": [0, 1, 0], "tilt": 3}, "camera: tilt: must not be given with target"),
    ],
)
def test_what_is_wrong_in_a_camera_move_is_named(move, message):
    with pytest.raises((ValueError, TypeError), match=message):
        pm.Animation.from_dict({"frames": 2, "camera": move})


def test_a_target_where_the_camera_stands_is_named_with_its_frame():
    move = {"origin": [1, 2, 3], "target": [[0, [0, 0, 0]], [1, [1, 2, 3]]]}
    animation = pm.Animation.from_dict({"frames": 2, "camera": move})
    with pytest.raises(ValueError, match="frame 1: camera: target="):
        animation.camera_at(synthetic(1).camera, 1)


def test_samples_do_not_do_for_a_camera_that_moves():
    animation = pm.Animation.from_dict({"frames": 2, "camera": {"pan": 3}})
    with pytest.raises(ValueError, match="camera: moves, so that each frame needs samples"):
        animation.pictures(synthetic(50))


# ---------------------------------------------------------------- files


def test_frames_are_chosen_by_ranges_and_shards():
    every = range(1, 25)
    assert chosen_frames(every) == list(every)
    assert chosen_frames(every, "3, 10-12,11") == [3, 10, 11, 12]
    shards = [chosen_frames(every, None, f"{i}/5") for i in range(1, 6)]
    assert sorted(frame for shard in shards for frame in shard) == list(every)
    assert chosen_frames(every, "10-20", "2/3") == [11, 14, 17, 20]
    assert chosen_frames(range(2), None, "3/3") == []


@pytest.mark.parametrize(
    ("frames", "shard", "message"),
    [
        ("5-3", None, "frames='5-3': must be such as 10-20"),
        ("a", None, "frames='a': must be such as"),
        ("0", None, "frames='0': must be among 1-24"),
        ("20-25", None, "frames='20-25': must be among 1-24"),
        (None, "0/4", "shard='0/4': must be such as 3/64"),
        (None, "5/4", "shard='5/4'"),
        (None, "2", "shard='2'"),
    ],
)
def test_wrong_choices_of_frames_are_named(frames, shard, message):
    with pytest.raises(ValueError, match=message):
        chosen_frames(range(1, 25), frames, shard)


@pytest.mark.parametrize(
    "pattern",
    [
        *(
            "a.exr",
            "a_{}_{}.exr",
            "a_{name}.exr",
            "a_{0}.exr",
            "a_{.exr",
            "a_{:q}.exr",
            "a_{:c}.exr",
        ),
        *("a_{:{w}d}.exr", "a_{:.0e}.exr", "a_{:099999999d}.exr", "a_{{}}.exr", "a_{}}.exr"),
    ],
)
def test_names_of_frames_have_one_place_for_their_number(tmp_path, pattern):
    with pytest.raises(ValueError, match=r"output='.*a.*exr': must have"):
        FrameFiles([str(tmp_path / pattern)])


def test_folders_and_sources_are_looked_at_for_all_frames_that_are_asked_for(tmp_path):
    files = FrameFiles([str(tmp_path / "d_{}" / "f.exr")])
    (tmp_path / "d_3").mkdir()
    files.check([3], [])
    (tmp_path / "d_4").touch()
    with pytest.raises(NotADirectoryError, match=r"d_4 is in a file, not a folder"):
        files.check([3, 4], [])
    with pytest.raises(ValueError, match=r"d_3/f.exr: a frame must not take its place"):
        files.check([3], [str(tmp_path / "d_3" / ".." / "d_3" / "f.exr")])
    with pytest.raises(ValueError, match=r"a_3.gif: the name must end in"):
        FrameFiles([str(tmp_path / "a_{}.gif")]).check([3], [])


def test_what_a_program_that_was_killed_left_goes_with_the_frame(tmp_path):
    files = FrameFiles([str(tmp_path / "f[1]_{:02d}.exr")])
    (path,) = files.of(7)
    left = [tmp_path / ".f[1]_07.123.exr", tmp_path / ".f[1]_08.123.exr"]
    for one in left:
        one.write_bytes(b"half")
    files.write(7, np.zeros((4, 4, 3)))
    assert [one.exists() for one in (path, *left)] == [True, False, True]
    assert files.are_there(7)
    assert not files.are_there(8)
