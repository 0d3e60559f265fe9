"""``potmesil animate``: frames in files, from scenes and from samples, by parts and once more."""

import os
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi.animation import movie
from potmesil_mi.animation.frames import FrameFiles
from potmesil_mi.tracing import hidden_surface
from scenes import SCENES

pytestmark = pytest.mark.usefixtures("variant_llvm")

FIGURE = str(SCENES / "figure11.xml")
SMALL = ["-D", "res=24", "-D", "spp=4"]
PULL = """
frames = 4
[lens]
focus_distance = [[0, 290], [3, 2000]]
f_number = [[0, 5.6], [3, 2.8]]
"""


@pytest.fixture
def pull(tmp_path):
    path = tmp_path / "pull.toml"
    path.write_text(PULL, encoding="utf-8")
    return str(path)


@pytest.fixture
def kept(tmp_path, pull):
    """A file of samples of the scene, as the animation needs them."""
    path = tmp_path / "kept.samples"
    arguments = ["render", FIGURE, *SMALL, "--min-f-number", "2.8", "-o", str(tmp_path / "one.exr")]
    assert cli.main([*arguments, "--samples", str(path)]) == 0
    return str(path)


def frames_in(folder):
    return {path.name: np.array(mi.Bitmap(str(path))) for path in sorted(folder.iterdir())}


def animate(folder, source, pull, *more):
    folder.mkdir(exist_ok=True)
    return cli.main(["animate", source, pull, "-o", str(folder / "f_{:02d}.exr"), *more])


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name, picture in expected.items():
        np.testing.assert_allclose(found[name], picture, rtol=1e-5, atol=1e-6)


def test_a_scene_is_sampled_once_for_all_frames(tmp_path, pull, monkeypatch):
    asked = []
    render = hidden_surface.render_samples

    def counted(*arguments, **options):
        asked.append(options["sampling"])
        return render(*arguments, **options)

    monkeypatch.setattr(hidden_surface, "render_samples", counted)
    kept = tmp_path / "kept.samples"
    assert animate(tmp_path / "frames", FIGURE, pull, *SMALL, "--samples", str(kept)) == 0
    (sampling,) = asked
    assert sampling.min_f_number == pytest.approx(2.8)
    assert sampling.focus_range == (290, 2000)
    found = frames_in(tmp_path / "frames")
    assert list(found) == [f"f_{frame:02d}.exr" for frame in range(4)]
    samples = pm.PointSamples.load(kept)
    rfilter = mi.load_file(FIGURE).sensors()[0].film().rfilter()
    lens = samples.lens.replace(focus_distance=2000, f_number=2.8)
    expected = np.array(pm.focus(samples, lens, rfilter=rfilter))
    np.testing.assert_allclose(found["f_03.exr"], expected, rtol=1e-5, atol=1e-6)


def test_each_frame_says_its_own_lens_and_is_kept_as_asked(tmp_path, pull, kept):
    assert animate(tmp_path / "frames", kept, pull, "--bit-depth", "half") == 0
    found = []
    for path in sorted((tmp_path / "frames").iterdir()):
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())
            assert file.channels()["R"].pixels.dtype == np.float16
        found.append((header["potmesil:focus_distance"], header["potmesil:f_number"]))
        assert '"scene": "figure11.xml"' in header["potmesil:provenance"]
    assert found[0] == pytest.approx((290, 5.6))
    assert found[3] == pytest.approx((2000, 2.8))


def test_what_the_options_say_of_the_sampling_stays(tmp_path, pull, monkeypatch):
    asked = []
    monkeypatch.setattr(
        hidden_surface, "render_samples", lambda *_, **options: asked.append(options["sampling"])
    )
    options = ["--min-f-number", "2", "--focus-range", "300/400"]
    # There are no samples then.
    assert animate(tmp_path / "frames", FIGURE, pull, *SMALL, *options) == 1
    assert (asked[0].min_f_number, asked[0].focus_range) == (2, (300, 400))


def test_an_animation_that_was_interrupted_goes_on_and_ends_with_the_same_frames(
    tmp_path, pull, kept, monkeypatch, capsys
):
    assert animate(tmp_path / "whole", kept, pull) == 0
    write = FrameFiles.write

    def interrupted(files, frame, picture, said):
        if frame == 2:
            raise KeyboardInterrupt
        write(files, frame, picture, said)

    monkeypatch.setattr(FrameFiles, "write", interrupted)
    assert animate(tmp_path / "parts", kept, pull) == 130
    assert len(frames_in(tmp_path / "parts")) == 2
    monkeypatch.setattr(FrameFiles, "write", write)
    before = (tmp_path / "parts" / "f_00.exr").stat().st_mtime_ns
    assert animate(tmp_path / "parts", kept, pull) == 0
    assert "2 of 4 frames are there already and stay" in capsys.readouterr().err
    assert (tmp_path / "parts" / "f_00.exr").stat().st_mtime_ns == before
    assert_same(frames_in(tmp_path / "parts"), frames_in(tmp_path / "whole"))


def test_shards_and_ranges_make_what_one_run_makes(tmp_path, pull, kept):
    assert animate(tmp_path / "whole", kept, pull) == 0
    for shard in ("1/3", "3/3", "2/3"):
        assert animate(tmp_path / "shards", kept, pull, "--shard", shard) == 0
    assert_same(frames_in(tmp_path / "shards"), frames_in(tmp_path / "whole"))
    assert animate(tmp_path / "range", kept, pull, "--frames", "1-2") == 0
    assert list(frames_in(tmp_path / "range")) == ["f_01.exr", "f_02.exr"]


@pytest.mark.filterwarnings("always:.*are older than")
def test_frames_older_than_what_they_were_made_of_are_told_and_made_anew_if_asked(
    tmp_path, pull, kept, capsys
):
    folder = tmp_path / "frames"
    assert animate(folder, kept, pull) == 0
    first = frames_in(folder)
    with open(pull, "a", encoding="utf-8") as file:
        file.write("\n[[filters]]\nname = 'fade'\namount = 1\n")
    for path in folder.iterdir():
        os.utime(path, (1e9, 1e9))
    capsys.readouterr()
    assert animate(folder, kept, pull, "--frames", "0-2") == 0
    told = capsys.readouterr().err
    assert "3 files of frames, such as" in told
    assert "f_00.exr, are older than" in told
    assert "--overwrite makes them anew" in told
    assert_same(frames_in(folder), first)
    assert animate(folder, kept, pull, "--overwrite") == 0
    assert "are older than" not in capsys.readouterr().err
    assert not any(picture.any() for picture in frames_in(folder).values())


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--refine", "0"], "refine=0.0: is for a scene, and"),
        (["--spp", "4"], "spp=4: is for a scene"),
        (["-D", "res=3"], "define="),
        (["--shard", "4/3"], "shard='4/3'"),
        (["--frames", "9"], "frames='9': must be among 0-3"),
        (["--f-number", "-1"], "--f-number=-1"),
        (["--method", "fast"], "--method='fast'"),
    ],
)
def test_what_does_not_fit_is_named_before_the_first_frame(
    tmp_path, pull, kept, capsys, more, message
):
    assert animate(tmp_path / "frames", kept, pull, *more) == 1
    assert message in capsys.readouterr().err
    assert not list((tmp_path / "frames").iterdir())


def test_frames_do_not_take_the_place_of_samples(tmp_path, pull, kept, capsys):
    samples = tmp_path / "f_01.exr"
    pm.PointSamples.load(kept).save(samples)
    before = samples.read_bytes()
    assert animate(tmp_path, str(samples), pull, "--overwrite") == 1
    assert "f_01.exr: a frame must not take its place" in capsys.readouterr().err
    assert animate(tmp_path, FIGURE, pull, *SMALL, "--samples", str(samples)) == 1
    assert "f_01.exr: a frame must not take its place" in capsys.readouterr().err
    assert samples.read_bytes() == before


@pytest.mark.filterwarnings("always:samples=")
def test_samples_that_are_not_taken_are_told(tmp_path, pull, kept, capsys):
    assert animate(tmp_path / "frames", kept, pull) == 0
    samples = tmp_path / "more.samples"
    assert animate(tmp_path / "frames", FIGURE, pull, *SMALL, "--samples", str(samples)) == 0
    assert "more.samples: are not taken, for all frames are there" in capsys.readouterr().err
    assert not samples.exists()


def test_a_scene_without_a_lens_has_that_of_the_animation(tmp_path, capsys):
    scene, pull = tmp_path / "ball.xml", tmp_path / "pull.toml"
    pinhole = BALL.replace("thinlens", "perspective").replace(
        '<float name="aperture_radius" value="0.1"/>', ""
    )
    scene.write_text(pinhole, encoding="utf-8")
    pull.write_text("frames = 1\n[lens]\nfocus_distance = 5", encoding="utf-8")
    assert animate(tmp_path / "frames", str(scene), str(pull), "-D", "x=0") == 1
    assert "has no lens; describe one with --f-number" in capsys.readouterr().err
    pull.write_text("frames = 1\n[lens]\nfocus_distance = 3\nf_number = 0.2", encoding="utf-8")
    options = ["-D", "x=0", "--refine", "0"]
    assert animate(tmp_path / "frames", str(scene), str(pull), *options) == 0
    blurred = frames_in(tmp_path / "frames")["f_00.exr"]
    options += ["--f-number", "5", "--overwrite"]
    assert animate(tmp_path / "frames", str(scene), str(pull), *options) == 0
    again = frames_in(tmp_path / "frames")["f_00.exr"]
    np.testing.assert_allclose(again, blurred, atol=1e-3)


def test_files_that_are_not_there_are_named(tmp_path, pull, kept, capsys):
    assert animate(tmp_path / "frames", kept, str(tmp_path / "absent.toml")) == 1
    assert "absent.toml" in capsys.readouterr().err
    assert animate(tmp_path / "frames", str(tmp_path / "absent.samples"), pull) == 1
    assert "absent.samples" in capsys.readouterr().err
    assert cli.main(["animate", kept, pull, "-o", "/dev/null/f_{}.exr"]) == 1
    assert "is in a file, not a folder" in capsys.readouterr().err


def test_a_movie_is_made_of_all_frames_when_they_are_there(tmp_path, pull, kept, monkeypatch):
    pytest.importorskip("imageio_ffmpeg")
    made = []
    monkeypatch.setattr(movie, "write_movie", lambda *arguments: made.append(arguments))
    assert animate(tmp_path / "frames", kept, pull, "--frames", "2-3") == 0
    path = tmp_path / "pull.mp4"
    assert animate(tmp_path / "frames", kept, pull, "-o", str(path)) == 0
    ((of, frames, fps),) = made
    assert (of, fps) == (str(path), 24)
    assert [frame.name for frame in frames] == sorted(frames_in(tmp_path / "frames"))
    assert len(frames) == 4


# ---------------------------------------------------------------- cameras that move

PAN = """
frames = [5, 6]
[camera]
origin = [[5, [0, 0, 0]], [6, [30, 0, 0]]]
pan = [[5, 180], [6, 184]]
"""


@pytest.fixture
def pan(tmp_path):
    path = tmp_path / "pan.toml"
    path.write_text(PAN, encoding="utf-8")
    return str(path)


def test_frames_of_a_moving_camera_are_those_of_a_camera_that_stands_there(tmp_path, pan):
    assert animate(tmp_path / "frames", FIGURE, pan, *SMALL, "--seed", "3") == 0
    found = frames_in(tmp_path / "frames")
    scene = mi.load_file(FIGURE, optimize=False, res=24, spp=4)
    animation = pm.Animation.load(pan)
    sensor = pm.potmesil_sensor(scene.sensors()[0])
    for frame in (5, 6):
        camera = animation.camera_at(scene.sensors()[0].camera(), frame)
        parameters = mi.traverse(sensor)
        parameters["to_world"] = mi.Transform4f(np.array(camera.to_world))
        parameters.update()
        distance = sensor.lens().focus_distance
        sampling = pm.Sampling(focus_range=(distance, distance))
        samples = pm.render_samples(scene, sensor, seed=3 + frame, sampling=sampling)
        np.testing.assert_allclose(samples.camera.to_world, camera.to_world, atol=1e-6)
        expected = np.array(pm.focus(samples, rfilter=sensor.film().rfilter()))
        np.testing.assert_allclose(found[f"f_{frame:02d}.exr"], expected, rtol=1e-4, atol=1e-5)
    assert np.abs(found["f_05.exr"] - found["f_06.exr"]).max() > 0.1


def test_a_moving_camera_asks_for_a_scene(tmp_path, pan, kept, capsys):
    assert animate(tmp_path / "frames", kept, pan) == 1
    assert "camera: moves, which asks for a scene" in capsys.readouterr().err
    assert animate(tmp_path / "frames", FIGURE, pan, "--samples", str(tmp_path / "a.samples")) == 1
    assert "must not be given where something moves" in capsys.readouterr().err


BALL = """
<scene version="3.0.0">
    <integrator type="direct"/>
    <sensor type="thinlens">
        <float name="fov" value="40"/>
        <float name="aperture_radius" value="0.1"/>
        <float name="focus_distance" value="5"/>
        <transform name="to_world"><lookat origin="0,0,-5" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="24"/><integer name="height" value="18"/>
        </film>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere" id="ball">
        <transform name="to_world"><translate value="$x, 0, 0"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.2, 0.4"/></bsdf>
    </shape>
</scene>
"""
ROLL = """
frames = 2
[shapes.ball]
translate = [[0, [0, 0, 0]], [1, [1.5, 0, 0]]]
"""


def test_frames_of_a_moving_shape_are_those_of_a_scene_that_has_it_there(tmp_path, capsys):
    scene, roll = tmp_path / "ball.xml", tmp_path / "roll.toml"
    scene.write_text(BALL, encoding="utf-8")
    roll.write_text(ROLL, encoding="utf-8")
    assert animate(tmp_path / "frames", str(scene), str(roll), "-D", "x=-1") == 0
    found = frames_in(tmp_path / "frames")
    for frame, x in enumerate((-1, 0.5)):
        output = tmp_path / f"{frame}.exr"
        arguments = ["-D", f"x={x}", "--seed", str(frame), "--focus-range", "5/5"]
        assert cli.main(["render", str(scene), *arguments, "-o", str(output)]) == 0
        expected = np.array(mi.Bitmap(str(output)))
        np.testing.assert_allclose(found[f"f_{frame:02d}.exr"], expected, rtol=1e-3, atol=1e-3)
    roll.write_text(ROLL.replace("ball", "cone"), encoding="utf-8")
    assert animate(tmp_path / "no", str(scene), str(roll), "-D", "x=0") == 1
    told = capsys.readouterr().err
    assert "shapes.cone: must be the id of one shape of the scene, which has ball" in told


def test_frames_are_exposed_while_the_shutter_is_open(tmp_path):
    scene, roll = tmp_path / "ball.xml", tmp_path / "roll.toml"
    scene.write_text(BALL, encoding="utf-8")
    roll.write_text(ROLL + "[shutter]\nopen = -0.25\nclose = 0.25\n", encoding="utf-8")
    assert animate(tmp_path / "frames", str(scene), str(roll), "-D", "x=-1") == 0
    found = frames_in(tmp_path / "frames")
    loaded = mi.load_file(str(scene), optimize=False, x=-1)
    sensor = pm.potmesil_sensor(loaded.sensors()[0])
    for frame in (0, 1):
        motion = pm.Animation.load(roll).motion_at(frame)
        sampling = pm.Sampling(focus_range=(5.0, 5.0))
        samples = pm.render_samples(loaded, sensor, seed=frame, motion=motion, sampling=sampling)
        expected = np.array(pm.focus(samples, rfilter=sensor.film().rfilter()))
        np.testing.assert_allclose(found[f"f_{frame:02d}.exr"], expected, rtol=1e-3, atol=1e-3)
        assert samples.motion is not None


def test_a_picture_is_exposed_while_things_move(tmp_path, capsys):
    scene, motion = tmp_path / "ball.xml", tmp_path / "motion.toml"
    scene.write_text(BALL, encoding="utf-8")
    motion.write_text(
        "[shapes.ball]\ntranslate = [[0, [-0.5, 0, 0]], [1, [0.5, 0, 0]]]\n[shutter]\nclose = 1\n",
        encoding="utf-8",
    )
    kept = tmp_path / "kept.samples"
    arguments = ["render", str(scene), "-D", "x=0", "--motion", str(motion)]
    output = ["-o", str(tmp_path / "ball.exr")]
    assert cli.main([*arguments, *output, "--samples", str(kept)]) == 0
    samples = pm.PointSamples.load(kept)
    pixels = samples.camera.focal_length_pixels / 5 / samples.instants
    assert np.abs(samples.motion[:, 0]).max() == pytest.approx(pixels, rel=0.3)
    motion.write_text("[shapes.cone]\nscale = 2\n[shutter]\nclose = 1\n", encoding="utf-8")
    assert cli.main([*arguments, *output]) == 1
    assert "shapes.cone: must be the id of one shape of the scene" in capsys.readouterr().err
    assert cli.main([*arguments[:-1], str(tmp_path / "no.toml"), *output]) == 1
    assert "no.toml" in capsys.readouterr().err


def test_a_scene_with_a_motion_of_its_own_is_not_animated(tmp_path, capsys):
    scene, roll, motion = (tmp_path / name for name in ("ball.xml", "roll.toml", "motion.toml"))
    motion.write_text("[shutter]\nclose = 1\n", encoding="utf-8")
    nested = f"""<integrator type="focus"><string name="motion" value="{motion}"/>
        <integrator type="direct"/></integrator>"""
    xml = BALL.replace('<integrator type="direct"/>', nested)
    scene.write_text(xml, encoding="utf-8")
    for text in (ROLL, PULL):
        roll.write_text(text, encoding="utf-8")
        assert animate(tmp_path / "frames", str(scene), str(roll), "-D", "x=0") == 1
        assert "has one, for a single picture" in capsys.readouterr().err


@pytest.mark.filterwarnings("always:.*has no effect")
def test_a_shutter_without_anything_that_moves_is_told_of(tmp_path, capsys):
    still = tmp_path / "still.toml"
    still.write_text(PULL + "[shutter]\nclose = 0.5\n", encoding="utf-8")
    assert animate(tmp_path / "frames", FIGURE, str(still), *SMALL, "--frames", "0-0") == 0
    assert "shutter: has no effect" in capsys.readouterr().err


def test_a_picture_of_another_program_is_pulled_through_its_depth(tmp_path):
    """Its samples serve the widest aperture of all frames."""
    picture = Path(__file__).parent.parent / "data" / "blender.exr"
    lens = "focus_distance = [[0, 2.2], [2, 14]]\nf_number = [[0, 4], [2, 0.2]]\n"
    (tmp_path / "pull.toml").write_text(f"frames = 3\n[lens]\n{lens}")
    options = str(picture), str(tmp_path / "pull.toml"), "--frame-width", "36"
    assert animate(tmp_path, *options, "--spp", "4") == 1
    assert animate(tmp_path, *options) == 0
    (tmp_path / "pull.toml").unlink()
    found = frames_in(tmp_path)
    lens = {"f_number": 0.2, "focus_distance": 14.0, "frame_width": 36.0}
    samples = pm.PointSamples.from_image(picture, lens=lens)
    np.testing.assert_allclose(
        found[sorted(found)[-1]], np.array(pm.focus(samples)), rtol=1e-4, atol=1e-4
    )
