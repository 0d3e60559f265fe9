import mitsuba as mi
import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from scenes import LENS, papers_scene, still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

PATH = {"type": "path", "max_depth": 3}
FOCUS = {"type": "focus", "nested": PATH}
EVEN = {**FOCUS, "refine": 0.0}
METHODS = [
    {"method": "paper", "inverse_square": False},
    {"method": "layered"},
    {"method": "lightfield"},
]
POINT_SAMPLES = {"type": "point_samples", "nested": PATH}


# ---------------------------------------------------------------- focus


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"method": "layered", "squares": 2},
        {"method": "lightfield"},
        {"method": "paper", "tables": 20, "inverse_square": False},
    ],
    ids=lambda options: options.get("method", "default"),
)
def test_focus_renders_what_the_two_stages_give(options):
    scene = still_life({**FOCUS, **options}, spp=8)
    image = np.array(mi.render(scene, seed=3))
    samples = pm.render_samples(scene, seed=3)
    expected = np.array(pm.focus(samples, **options))
    np.testing.assert_allclose(image, expected, atol=1e-5)
    path = np.array(mi.render(scene, integrator=mi.load_dict(PATH), seed=3))
    assert np.abs(image - path).max() > 0.02, "the lens must blur something"


def test_focus_denoises_the_samples_where_it_is_told_to():
    pytest.importorskip("mitsuba_oidn", reason="needs mitsuba-oidn: pip install '.[denoise]'")
    scene = still_life({**FOCUS, "denoise": True}, spp=4)
    samples = pm.render_samples(scene)
    np.testing.assert_allclose(
        np.array(mi.render(scene)), np.array(pm.focus(samples.denoised())), atol=1e-5
    )
    with pytest.raises(RuntimeError, match="denoise=1: must be true or false"):
        still_life({**FOCUS, "denoise": 1})


@pytest.mark.parametrize("plugin", ["focus", "point_samples"])
def test_a_file_tells_what_moves(plugin, tmp_path):
    path = tmp_path / "motion.toml"
    path.write_text(
        "[shapes.ball]\ntranslate = [[0, [-0.3, 0, 0]], [1, [0.3, 0, 0]]]\n[shutter]\nclose = 1\n",
        encoding="utf-8",
    )
    scene = still_life({"type": plugin, "nested": PATH, "motion": str(path)}, spp=8)
    picture = np.array(mi.render(scene, seed=3))[..., :3]
    motion = pm.Motion.load(path)
    samples = pm.render_samples(still_life(spp=8), seed=3, motion=motion)
    assert samples.moves
    if plugin == "focus":
        np.testing.assert_allclose(picture, np.array(pm.focus(samples)), atol=1e-5)
    still = np.array(mi.render(still_life({"type": plugin, "nested": PATH}, spp=8), seed=3))
    assert np.abs(picture - still[..., :3]).max() > 0.02
    # What is given in Python counts.
    again = pm.render_samples(scene, seed=3, motion=pm.Motion(shutter=pm.Shutter(0, 0)))
    assert not again.moves
    with pytest.raises(RuntimeError, match="motion=3: must be the name of a file"):
        still_life({"type": plugin, "nested": PATH, "motion": 3})
    with pytest.raises(RuntimeError, match=r"no\.toml"):
        still_life({"type": plugin, "nested": PATH, "motion": str(tmp_path / "no.toml")})


def test_focus_obeys_spp_and_seed():
    scene = still_life(FOCUS, lamp={"type": "constant"})
    few, again, other = (np.array(mi.render(scene, spp=1, seed=s)) for s in (1, 1, 2))
    np.testing.assert_allclose(few, again, atol=1e-5)
    assert np.abs(few - other).max() > 1e-3


@pytest.mark.parametrize(
    ("pixel_format", "channels"), [("rgb", "RGB"), ("rgba", "RGBA"), ("luminance", "Y")]
)
def test_focus_puts_the_picture_into_the_film(tmp_path, pixel_format, channels):
    scene = still_life(FOCUS, film={"pixel_format": pixel_format})
    image = np.array(mi.render(scene))
    assert image.shape == (16, 24, len(channels))
    film = scene.sensors()[0].film()
    np.testing.assert_allclose(np.array(film.bitmap()).reshape(image.shape), image, atol=1e-6)
    film.write(str(tmp_path / "out.exr"))
    with OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True) as file:
        assert set(file.channels()) == set(channels)


@pytest.mark.parametrize("options", METHODS, ids=lambda options: options["method"])
def test_focus_fills_the_crop_window(options):
    crop = {"crop_offset_x": 7, "crop_offset_y": 4, "crop_width": 11, "crop_height": 9}
    closed = {"f_number": 1e6}
    scene = still_life({**EVEN, **options}, film=crop, sensor=closed, spp=8)
    image = np.array(mi.render(scene, seed=1))
    assert image.shape == (9, 11, 3)
    assert list(scene.sensors()[0].film().bitmap().size()) == [11, 9]
    path = np.array(mi.render(scene, integrator=mi.load_dict(PATH), seed=1))
    np.testing.assert_allclose(image, path, atol=1e-4)


@pytest.mark.parametrize("options", METHODS, ids=lambda options: options["method"])
def test_alpha_is_blurred_like_the_colours(options):
    rgba = {"pixel_format": "rgba"}
    scene = still_life({**FOCUS, **options}, film=rgba, sensor={"f_number": 0.5}, spp=16)
    alpha = np.array(mi.render(scene))[..., 3]
    assert alpha.min() >= 0
    # The new methods add up in single precision.
    assert alpha.max() <= (1 if options["method"] == "paper" else 1 + 1e-6)
    assert ((alpha > 0.02) & (alpha < 0.98)).any()


@pytest.mark.parametrize("options", METHODS, ids=lambda options: options["method"])
@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_focus_works_in_other_variants(variant, options):
    mi.set_variant(variant)
    scene = still_life({**EVEN, **options}, sensor={"f_number": 1e6}, spp=8)
    image = np.array(mi.render(scene, seed=1))
    path = np.array(mi.render(scene, integrator=mi.load_dict(PATH), seed=1))
    assert image.shape == path.shape
    np.testing.assert_allclose(image, path, atol=1e-4)


def test_a_thinlens_scene_is_focused_with_its_aperture_and_focus():
    lens = pm.ThinLens(**LENS, millimeters_per_unit=1000.0)
    scene = still_life(FOCUS, spp=8)
    builtin = mi.load_dict(
        {
            **lens.to_thinlens(),
            "film": scene.sensors()[0].film(),
            "sampler": scene.sensors()[0].sampler(),
        }
    )
    expected = np.array(mi.render(scene, seed=1))
    image = np.array(mi.render(scene, sensor=builtin, seed=1))
    np.testing.assert_allclose(image, expected, atol=1e-4)


def test_a_thinlens_focused_on_something_small_is_rendered():
    scene = still_life(FOCUS, sensor={"type": "thinlens", "fov": 20.0, "aperture_radius": 0.001,
                                      "focus_distance": 0.08}, spp=1)  # fmt: skip
    lens = pm.render_samples(scene).lens
    assert lens.aperture_radius == pytest.approx(0.001)
    assert lens.focus_distance == pytest.approx(0.08)
    assert lens.fov == pytest.approx(20, abs=1e-4)
    assert np.isfinite(np.array(mi.render(scene))).all()


def test_an_update_of_the_lens_takes_effect():
    scene = still_life(FOCUS, spp=8)
    before = np.array(mi.render(scene))
    parameters = mi.traverse(scene)
    key = next(name for name in parameters.keys() if name.endswith("focus_distance"))  # noqa: SIM118
    parameters[key] = 4.0
    parameters.update()
    after = np.array(mi.render(scene))
    samples = pm.render_samples(scene)
    assert samples.lens.focus_distance == 4
    assert np.abs(after - before).max() > 0.01


def test_a_sensor_without_a_lens_is_refused():
    scene = still_life(FOCUS, sensor={"type": "perspective"})
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene)
    assert "focus: needs a potmesil or thinlens sensor" in str(caught.value.__cause__)


# ---------------------------------------------------------------- point_samples


def test_point_samples_gives_the_pinhole_picture_and_named_channels():
    scene = still_life(POINT_SAMPLES, spp=8)
    image = np.array(mi.render(scene, seed=4))
    names = [field.name for field in scene.sensors()[0].film().bitmap().struct_()]
    assert names == ["R", "G", "B", "x", "y", "z", "id", "weight"]
    path = np.array(mi.render(scene, integrator=mi.load_dict(PATH), seed=4))
    np.testing.assert_allclose(image[..., :3], path, atol=1e-5)


@pytest.mark.parametrize("rfilter", ["gaussian", "tent", "mitchell"])
def test_point_samples_honours_the_films_filter(rfilter):
    scene = still_life(POINT_SAMPLES, film={"rfilter": {"type": rfilter}}, spp=8)
    image = np.array(mi.render(scene, seed=4))
    path = np.array(mi.render(scene, integrator=mi.load_dict(PATH), seed=4))
    np.testing.assert_allclose(image[..., :3], path, atol=1e-4)


def test_depth_and_id_are_those_of_one_sample_and_not_blended():
    scene = still_life(POINT_SAMPLES, film={"rfilter": {"type": "gaussian"}}, spp=16)
    image = np.array(mi.render(scene))
    x, y, z, surface, weight = np.moveaxis(image[..., 3:], -1, 0)
    assert set(np.unique(surface)) == {0, 1, 2}
    assert np.isinf(z[surface == 0]).all()
    np.testing.assert_allclose(z[surface == 2], 4, rtol=1e-4)
    assert (z[surface == 1] < 2.31).all()
    np.testing.assert_allclose(weight, 1, rtol=1e-5)
    row, column = np.mgrid[:16, :24]
    assert np.abs(x - column - 0.5).max() < 0.5
    assert np.abs(y - row - 0.5).max() < 0.5


@pytest.mark.parametrize("pattern", ["uniform", "adaptive"])
def test_point_samples_renders_the_papers_patterns(pattern):
    scene = papers_scene(32, spp=1)
    integrator = mi.load_dict(
        {"type": "point_samples", "pattern": pattern, "nested": scene.integrator().nested}
    )
    image = np.array(mi.render(scene, integrator=integrator))
    reference = np.array(mi.render(scene, integrator=scene.integrator().nested, spp=64))
    assert np.sqrt(np.mean((image[..., :3] - reference) ** 2)) < 0.03


# ---------------------------------------------------------------- what is nested


@pytest.mark.parametrize("plugin", ["focus", "point_samples"])
@pytest.mark.parametrize(
    ("nested", "text"),
    [
        ({}, "needs exactly one nested integrator, 0 were given"),
        ({"a": PATH, "b": PATH}, "needs exactly one nested integrator, 2 were given"),
        ({"a": {"type": "ptracer"}}, "must be a sampling integrator"),
        ({"a": FOCUS}, "must be a sampling integrator"),
        ({"a": PATH, "pattern": "spiral"}, "pattern='spiral'"),
        ({"a": PATH, "unknown": 3}, "unknown"),
    ],
)
def test_what_is_wrong_with_a_wrapped_integrator_is_named(plugin, nested, text):
    with pytest.raises((ValueError, TypeError, RuntimeError), match=text):
        mi.load_dict({"type": plugin, **nested})


@pytest.mark.parametrize(
    ("option", "text"),
    [
        ({"method": "bokeh"}, "method='bokeh'"),
        ({"tables": 1}, "tables=1"),
        ({"squares": 99}, "99"),
        ({"overscan": -1}, "overscan=-1"),
        ({"refine": -0.5}, r"refine=-0\.5"),
        ({"refine": 17.0}, r"refine=17"),
        ({"clamp": 0.0}, r"clamp=0"),
        ({"focus_range": "3/1"}, "focus_range='3/1': must be two distances"),
        ({"focus_range": "near"}, "focus_range='near': must be two distances"),
        ({"focus_range": 2.0}, r"focus_range=2\.0: must be two distances"),
        ({"layers": 0}, "layers=0"),
    ],
)
def test_a_bad_option_of_focus_is_named_when_the_scene_is_loaded(option, text):
    with pytest.raises((ValueError, RuntimeError), match=text):
        mi.load_dict({**FOCUS, **option})


@pytest.mark.parametrize("plugin", ["focus", "point_samples"])
def test_scalar_variants_are_told_what_to_do(plugin):
    mi.set_variant("scalar_rgb")
    with pytest.raises(RuntimeError, match=r"needs a vectorised variant.*llvm_ad_rgb"):
        mi.load_dict({"type": plugin, "nested": PATH})
