import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.tracing import hidden_surface
from scenes import papers_scene, pinhole_mean, still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

PATH = {"type": "path", "max_depth": 3}

PRIMARY = {"layers": 1, "overscan": 0}
"""Sampling of what the pinhole sees of the film, and no more."""


def rendered(scene, **options):
    return np.array(mi.render(scene, integrator=mi.load_dict(PATH), **options))


@pytest.mark.parametrize("sampler", ["independent", "stratified", "multijitter", "orthogonal"])
def test_the_samples_are_those_of_mi_render(sampler):
    scene = still_life(sampler=sampler, spp=9)
    samples = pm.render_samples(scene, seed=5)
    np.testing.assert_allclose(pinhole_mean(samples), rendered(scene, seed=5), atol=1e-6)


def test_the_samples_are_those_of_mi_render_in_a_crop_window():
    crop = {"crop_offset_x": 7, "crop_offset_y": 4, "crop_width": 11, "crop_height": 9}
    scene = still_life(film=crop, spp=8)
    samples = pm.render_samples(scene, seed=2)
    assert samples.camera.crop_offset == (7, 4)
    first = slice(0, 11 * 9 * 8)
    np.testing.assert_array_equal(
        np.floor(samples.x[first]), np.tile(np.repeat(np.arange(7, 18), 8), 9)
    )
    np.testing.assert_array_equal(np.floor(samples.y[first]), np.repeat(np.arange(4, 13), 11 * 8))
    assert (samples.layer[first] == 0).all()
    np.testing.assert_allclose(pinhole_mean(samples), rendered(scene, seed=2), atol=1e-6)


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_other_variants_give_the_radiance_of_mi_render(variant):
    mi.set_variant(variant)
    film = {"pixel_format": "luminance"} if variant == "llvm_ad_mono" else {}
    scene = still_life(spp=8, film=film)
    expected = rendered(scene, seed=1)
    if expected.shape[-1] == 1:
        expected = np.repeat(expected, 3, axis=-1)
    samples = pm.render_samples(scene, seed=1)
    np.testing.assert_allclose(pinhole_mean(samples), expected, atol=1e-5)


@pytest.mark.parametrize("pixels", [1, 7, 24 * 3])
def test_passes_of_some_pixels_sample_the_same_film(monkeypatch, pixels):
    scene = still_life(spp=64)
    whole = pm.render_samples(scene)
    monkeypatch.setattr(hidden_surface, "WAVEFRONT", 64 * pixels)
    in_passes = pm.render_samples(scene)
    assert in_passes.window == whole.window
    np.testing.assert_array_equal(in_passes.visible().pixel(), whole.visible().pixel())
    difference = pinhole_mean(in_passes) - pinhole_mean(whole)
    assert np.abs(difference).mean() < 0.01
    jitter = in_passes.x[: 16 * 24 * 64].reshape(16, 24 * 64) % 1
    assert not np.array_equal(jitter[0], jitter[3]), "every pass must have jitter of its own"


def test_depth_is_along_the_axis_and_not_along_the_ray():
    scene = still_life(spp=16)
    samples = pm.render_samples(scene)
    names = samples.surfaces
    wall = np.array([names.get(i) == "wall" for i in samples.surface])
    assert wall.any()
    np.testing.assert_allclose(samples.z[wall], 4, rtol=1e-5)


def test_a_moved_and_turned_camera_sees_the_same_depths():
    placed = {"to_world": mi.ScalarTransform4f().rotate([0.6, 0, 0.8], 50).translate([4, 5, 6])}
    samples = pm.render_samples(still_life(spp=4))
    matrix = placed["to_world"]
    scene = still_life(spp=4)
    ball = {"type": "sphere", "to_world": matrix.translate([0, 0, 2.3]).scale(0.3)}
    moved = still_life(spp=4, sensor=placed, ball=ball, wall={"type": "sphere", "radius": 1e-3})
    ball_depths = samples.z[samples.surface == 1]
    again = pm.render_samples(moved)
    moved_depths = again.z[again.surface == 1]
    assert scene.sensors()[0].lens() == moved.sensors()[0].lens()
    np.testing.assert_allclose(np.sort(moved_depths), np.sort(ball_depths), rtol=1e-4)


def test_rays_that_hit_nothing_are_at_infinity_with_id_0():
    samples = pm.render_samples(still_life(spp=4))
    missed = samples.surface == 0
    assert 0.1 < missed.mean() < 0.9
    assert np.isinf(samples.z[missed]).all()
    assert np.isfinite(samples.z[~missed]).all()
    assert (samples.alpha == ~missed).all()


def test_positions_stay_in_their_pixel_on_a_wide_film():
    scene = still_life(film={"width": 3000, "height": 2}, spp=256)
    depth = mi.load_dict({"type": "depth"})
    samples = pm.render_samples(scene, integrator=depth, sampling=pm.Sampling(**PRIMARY))
    pixels = np.repeat(np.arange(3000 * 2), 256)
    np.testing.assert_array_equal(samples.pixel(), pixels)


# ---------------------------------------------------------------- surfaces


def test_surface_ids_are_stable_from_load_to_load():
    first, second = (pm.render_samples(papers_scene(16, spp=1)).replace() for _ in range(2))
    assert first.surfaces == {1: "background", 2: "cube", 3: "sphere"}
    assert second.surfaces == first.surfaces
    np.testing.assert_array_equal(first.surface, second.surface)


def test_shapes_without_names_are_told_apart_by_their_place():
    text = """<scene version="3.0.0"><integrator type="depth"/>
        <sensor type="potmesil"><float name="f_number" value="2"/></sensor>
        <shape type="sphere"><point name="center" x="{}" y="0" z="9"/></shape>
        <shape type="sphere"><point name="center" x="{}" y="0" z="9"/></shape></scene>"""
    columns = [
        pm.render_samples(mi.load_string(text.format(*x)), spp=1) for x in ((-2, 2), (2, -2))
    ]
    assert columns[0].surfaces == {1: "Sphere_1", 2: "Sphere_2"}
    np.testing.assert_array_equal(columns[0].surface, columns[1].surface)


def test_an_instance_is_one_surface():
    scene = still_life(
        spp=4,
        group={"type": "shapegroup", "a": {"type": "sphere", "radius": 0.2}},
        ball={
            "type": "instance",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 2]),
            "shapegroup": {"type": "ref", "id": "group"},
        },
    )
    samples = pm.render_samples(scene)
    seen = {samples.surfaces[i] for i in np.unique(samples.surface[samples.surface > 0])}
    assert seen == {"ball", "wall"}


# ---------------------------------------------------------------- patterns


@pytest.mark.parametrize("margin", [0, 3])
def test_the_papers_grid_has_corners_edges_and_centres(margin):
    sampling = pm.Sampling("uniform", layers=1, overscan=margin)
    samples = pm.render_samples(still_life(spp=1), sampling=sampling)
    columns, rows = 2 * (24 + 2 * margin) + 1, 2 * (16 + 2 * margin) + 1
    assert len(samples) == columns * rows
    assert set(np.unique(samples.x)) == set(np.arange(columns) / 2 - margin)
    assert set(np.unique(samples.y)) == set(np.arange(rows) / 2 - margin)
    assert (samples.weight == 0.25).all()


def test_many_paths_at_a_point_of_the_grid_are_averaged():
    scene = still_life(lamp={"type": "constant"})
    grid = pm.Sampling("uniform", **PRIMARY)
    spread = [pm.render_samples(scene, spp=spp, sampling=grid).rgb[:, 0].std() for spp in (1, 256)]
    few, many = (pm.render_samples(scene, spp=spp, sampling=grid) for spp in (1, 256))
    assert len(few) == len(many)
    np.testing.assert_array_equal(few.z, many.z)
    assert spread[1] < spread[0]


def test_adaptive_subdivision_goes_where_intensities_differ():
    scene = papers_scene(48, spp=1)
    sampling = pm.Sampling("adaptive", subdivisions=2, **PRIMARY)
    samples = pm.render_samples(scene, sampling=sampling)
    corners, all_points = 49 * 49, (4 * 48 + 1) ** 2
    assert corners < len(samples) < all_points / 3
    level = np.where((samples.x % 1 == 0) & (samples.y % 1 == 0), 0, 1)
    on_background = samples.surface == 1
    assert level[~on_background].mean() > level[on_background].mean()
    assert len(np.unique(np.stack([samples.x, samples.y]), axis=1).T) == len(samples)


@pytest.mark.parametrize(("threshold", "lattice"), [(0.0, 4), (2.0, 1)])
def test_the_threshold_decides_on_subdivision(threshold, lattice):
    scene = still_life(spp=4, lamp={"type": "constant"}, integrator={"type": "direct"})
    sampling = pm.Sampling("adaptive", threshold=threshold, subdivisions=2, **PRIMARY)
    samples = pm.render_samples(scene, sampling=sampling)
    if threshold > 1:
        assert len(samples) == 25 * 17
    else:
        assert len(samples) > 25 * 17 * lattice


@pytest.mark.parametrize("margin", [0, 5])
def test_adaptive_weights_add_up_to_the_film(margin):
    sampling = pm.Sampling("adaptive", layers=1, overscan=margin)
    samples = pm.render_samples(papers_scene(32, spp=1), sampling=sampling)
    border_x = np.isin(samples.x, (-margin, 32 + margin))
    border_y = np.isin(samples.y, (-margin, 32 + margin))
    inside = samples.weight / (1 + border_x) / (1 + border_y)
    assert inside.sum() == pytest.approx((32 + 2 * margin) ** 2, rel=1e-5)


@pytest.mark.parametrize("method", ["paper", "layered", "lightfield"])
def test_adaptive_pictures_come_close_to_many_samples_with_few(method):
    scene = papers_scene(48, spp=256)
    reference = pinhole_mean(pm.render_samples(scene, sampling=pm.Sampling(**PRIMARY)))
    options = {"inverse_square": False} if method == "paper" else {}
    errors = []
    for subdivisions in (0, 3):
        sampling = pm.Sampling("adaptive", threshold=0.02, subdivisions=subdivisions)
        samples = pm.render_samples(scene, spp=1, sampling=sampling)
        pinhole = samples.lens.replace(f_number=np.inf)
        image = np.array(pm.focus(samples, pinhole, method=method, **options))
        errors.append(np.sqrt(np.mean((image - reference) ** 2)))
    assert errors[1] < errors[0] / 1.5


@pytest.mark.parametrize(
    ("sampling", "text"),
    [
        ({"pattern": "hexagonal"}, "pattern='hexagonal'.*sampler, uniform, adaptive"),
        ({"threshold": -0.1}, "threshold=-0.1"),
        ({"threshold": "low"}, "threshold='low'"),
        ({"threshold": np.nan}, "threshold=nan"),
        ({"subdivisions": 9}, "subdivisions=9"),
        ({"subdivisions": 1.5}, r"subdivisions=1\.5"),
        ({"layers": 0}, "layers=0.*1 to 16"),
        ({"layers": 17}, "layers=17"),
        ({"layers": 1.5}, r"layers=1\.5"),
        ({"overscan": -1}, "overscan=-1"),
        ({"overscan": 2.5}, r"overscan=2\.5"),
        ({"min_f_number": 0}, "min_f_number=0"),
        ({"min_f_number": np.nan}, "min_f_number=nan"),
        ({"min_f_number": "wide"}, "min_f_number='wide'"),
        ({"virtual_depth": 1}, "virtual_depth=1"),
    ],
)
def test_a_bad_pattern_is_named(sampling, text):
    with pytest.raises((ValueError, TypeError), match=text):
        pm.Sampling(**sampling)


# ---------------------------------------------------------------- what cannot be sampled


def test_an_empty_scene_is_refused():
    scene = mi.load_dict(
        {"type": "scene", "sensor": {"type": "potmesil", "f_number": 2.0}, "i": PATH}
    )
    with pytest.raises(ValueError, match="scene: is empty"):
        pm.render_samples(scene)


def test_a_film_of_one_pixel_is_refused():
    with pytest.raises(ValueError, match="film: its crop window has 1x1 pixels"):
        pm.render_samples(still_life(film={"width": 1, "height": 1}))


def test_a_missing_sensor_and_a_negative_count_are_named():
    scene = still_life()
    with pytest.raises(ValueError, match="sensor=3: the scene has 1"):
        pm.render_samples(scene, 3)
    with pytest.raises(ValueError, match="spp=-1"):
        pm.render_samples(scene, spp=-1)
    with pytest.raises(TypeError, match=r"spp=4\.5"):
        pm.render_samples(scene, spp=4.5)
    with pytest.raises(ValueError, match="seed=-1"):
        pm.render_samples(scene, seed=-1)


def test_what_cannot_give_samples_is_named():
    scene = still_life()
    with pytest.raises(TypeError, match=r"ParticleTracerIntegrator.*must be a sampling integrator"):
        pm.render_samples(scene, integrator=mi.load_dict({"type": "ptracer"}))


def test_a_film_of_spectral_bands_is_refused():
    mi.set_variant("llvm_ad_spectral")
    special = mi.load_dict(
        {
            "type": "potmesil",
            "f_number": 2.0,
            "film": {
                "type": "specfilm",
                "band": {"type": "spectrum", "value": [(400, 1.0), (700, 1.0)]},
            },
        }
    )
    with pytest.raises(TypeError, match="film: must be"):
        pm.render_samples(still_life(), special)


def test_infinite_radiance_is_dropped_with_a_warning():
    glow = {"type": "area", "radiance": {"type": "rgb", "value": float("inf")}}
    ball = {"type": "sphere", "center": [0, 0, 2.3], "radius": 0.3, "emitter": glow}
    scene = still_life(spp=4, ball=ball)
    with pytest.warns(RuntimeWarning, match="dropped"):
        samples = pm.render_samples(scene)
    assert np.isfinite(np.array(pm.focus(samples))).all()


def test_hidden_emitters_have_no_depth():
    ball = {"type": "sphere", "center": [0, 0, 2.3], "radius": 0.3, "emitter": {"type": "area"}}
    scene = still_life({**PATH, "hide_emitters": True}, ball=ball)
    samples = pm.render_samples(scene)
    assert set(np.unique(samples.surface)) == {0, 2}
    assert np.isclose(samples.z[samples.surface == 2], 4).all()


def test_the_medium_around_the_camera_is_seen_through():
    fog = {"type": "homogeneous", "albedo": 0.0, "sigma_t": 0.3}
    scene = still_life(
        {"type": "volpath", "max_depth": 4},
        spp=64,
        sensor={"medium": fog, "f_number": 2.0},
    )
    clear = pm.render_samples(still_life({"type": "volpath", "max_depth": 4}, spp=64))
    foggy = pm.render_samples(scene)
    expected = np.array(mi.render(scene))
    np.testing.assert_allclose(pinhole_mean(foggy), expected, atol=1e-5)
    assert foggy.rgb.mean() < 0.5 * clear.rgb.mean()
