"""Half-transparent surfaces and media: what shines through and what does not, each at its depth."""

import itertools

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples.columns import TWINS
from potmesil_mi.tracing.transmission import VeilKinds, veil_kinds
from scenes import diffuse

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE, SPP = 16, 16
VOLPATH = {"type": "volpath", "max_depth": 6}


def place(z, size=4.0, x=0.0):
    """Of a square at (x, 0, z) that is turned to the camera, which looks along +z."""
    turned = mi.ScalarTransform4f().translate([x, 0, z]).rotate([0, 1, 0], 180)
    return turned.scale(size)


def wall(z=4.0):
    """It glows in stripes, whatever is before it."""
    stripes = {
        "type": "checkerboard",
        "color0": {"type": "rgb", "value": [0.1, 0.4, 0.9]},
        "color1": {"type": "rgb", "value": [0.9, 0.6, 0.3]},
        "to_uv": mi.ScalarTransform4f().scale([20, 1, 1]),
    }
    glow = {"type": "area", "radiance": stripes}
    return {"type": "rectangle", "to_world": place(z), "bsdf": diffuse(0, 0, 0), "e": glow}


def pane(z, opacity, size=4.0, x=0.0, bsdf=None):
    """A pane that keeps back a part of what is behind it."""
    mask = {"type": "mask", "opacity": opacity, "bsdf": bsdf or diffuse(0, 0, 0)}
    return {"type": "rectangle", "to_world": place(z, size, x), "bsdf": mask}


def medium(extinction, albedo=0.6, scale=1.0):
    return {"type": "homogeneous", "sigma_t": extinction, "albedo": albedo, "scale": scale}


def slab(inside, near=1.0, far=2.0):
    """A medium between two depths."""
    half = (far - near) / 2
    box = mi.ScalarTransform4f().translate([0, 0, near + half]).scale([4, 4, half])
    return {"type": "cube", "to_world": box, "bsdf": {"type": "null"}, "interior": inside}


def scene(integrator=None, sensor=None, **shapes):
    camera = {"type": "thinlens", "fov": 20, "aperture_radius": 0.03, "focus_distance": 4.0}
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "path", "max_depth": 4},
            "sensor": {
                **camera,
                "film": {**film, "pixel_format": "rgba", "component_format": "float32"},
                "sampler": {"type": "independent", "sample_count": SPP},
                **(sensor or {}),
            },
            **shapes,
        }
    )


def sampled(shown, **options):
    options = {"overscan": 0, **options}
    return pm.render_samples(shown, sampling=pm.Sampling(refine=0, **options), seed=3)


def shares(samples, layer=0):
    """The share of the picture that each surface has in a layer."""
    there = samples.layer == layer
    totals = np.bincount(samples.surface[there], samples.weight[there]) / SIZE**2
    return {samples.surfaces.get(i, "none"): share for i, share in enumerate(totals) if share > 0}


def pinhole(samples):
    """RGB and alpha of what the pinhole sees."""
    seen = samples.visible()
    light = np.concatenate([seen.rgb, seen.alpha[:, None]], axis=1) * seen.weight[:, None]
    sums = [np.bincount(seen.pixel(), column, SIZE**2) for column in light.T]
    return np.stack(sums, axis=1).reshape(SIZE, SIZE, 4)


def of_pinhole(shown):
    """The same by the nested integrator, with the same random numbers."""
    return np.array(mi.render(shown, sensor=pm.potmesil_sensor(shown.sensors()[0]), seed=3))


def cloud(value):
    """A heterogeneous medium of one extinction."""
    grid = mi.VolumeGrid(np.full((2, 2, 2, 1), value, "f"))
    place = mi.ScalarTransform4f().translate([-4, -4, 1]).scale([8, 8, 1])
    volume = {"type": "gridvolume", "grid": grid, "to_world": place}
    return {"type": "heterogeneous", "sigma_t": volume, "albedo": 0.6}


# ---------------------------------------------------------------- shares


def test_together_the_shares_are_the_nested_integrators_picture():
    glow = {"type": "area", "radiance": 0.3}
    lit = {"ball": {"type": "sphere", "center": [0.1, 0, 3], "radius": 0.2, "emitter": glow}}
    scenes = [
        scene(pane=pane(1.5, 0.3, 0.2, 0.2, diffuse(0.5, 0.2, 0.1)), **lit),
        scene(VOLPATH, smoke=slab(medium(1.5)), wall=wall(), **lit),
        scene(VOLPATH, sensor={"medium": medium(0.3)}, pane=pane(1.5, 0.6, 0.2), wall=wall()),
    ]
    for shown in scenes:
        samples = sampled(shown)
        assert len(samples.visible()) > 1.1 * SPP * SIZE**2
        np.testing.assert_allclose(pinhole(samples), of_pinhole(shown), atol=2e-5)
        assert samples.spp == SPP


def test_two_panes_keep_back_their_parts_one_after_the_other():
    shown = scene(first=pane(1.0, 0.3), second=pane(2.0, 0.5), wall=wall())
    samples = sampled(shown)
    near = np.isclose(samples.z, 1) | np.isclose(samples.z, 2) | np.isclose(samples.z, 4)
    assert near.all()
    visible, hidden = shares(samples), shares(samples, TWINS + 1)
    assert visible == pytest.approx({"first": 0.3, "second": 0.35, "wall": 0.35})
    # The panes before it hide the rest of each.
    assert hidden["second"] == pytest.approx(0.15)
    assert shares(samples, TWINS + 2)["wall"] == pytest.approx(0.65)
    # Such twins are of what is seen: the scene is not crowded.
    assert not samples.is_crowded
    dark = samples.rgb[samples.surface != samples.surface.max()]
    assert np.abs(dark.mean(axis=0)).max() < 0.02


def test_with_one_layer_a_pane_is_told_apart_and_hides_nothing():
    shown = scene(pane=pane(1.0, 0.3), wall=wall())
    samples = sampled(shown, layers=1)
    assert shares(samples) == pytest.approx({"pane": 0.3, "wall": 0.7})
    assert samples.layer.max() == 0


def test_a_mask_is_a_veil_as_its_texture_tells():
    bitmap = mi.Bitmap(np.array([[[0.0], [0.25]], [[0.75], [1.0]]], "f"))
    texture = {"type": "bitmap", "raw": True, "filter_type": "nearest", "bitmap": bitmap}
    samples = sampled(scene(pane=pane(1.0, texture, 0.2), wall=wall()))
    seen = samples.visible()
    x, y = (np.floor(of / (SIZE / 2)).astype(int) for of in (seen.x, seen.y))
    of_pane = np.isclose(seen.z, 1)
    found = sorted(
        (seen.weight[here & of_pane].sum() / seen.weight[here].sum()).round(2)
        for here in ((x == i) & (y == j) for i, j in itertools.product((0, 1), (0, 1)))
    )
    # It is a little larger than what the camera sees.
    np.testing.assert_allclose(found, [0, 0.25, 0.75, 1], atol=0.01)


def test_of_a_blend_with_nothing_the_rest_is_seen():
    blend = {"type": "blendbsdf", "weight": 0.25, "a": diffuse(0, 0, 0), "b": {"type": "null"}}
    shown = {"type": "rectangle", "to_world": place(1.0), "bsdf": blend}
    assert shares(sampled(scene(pane=shown, wall=wall()))) == pytest.approx(
        {"pane": 0.75, "wall": 0.25}
    )


def test_behind_coloured_smoke_things_have_its_colour():
    extinction = {"type": "rgb", "value": [0.1, 0.5, 1.0]}
    shown = scene(VOLPATH, smoke=slab(medium(extinction, albedo=0.0)), wall=wall())
    samples = sampled(shown)
    through = np.exp([-0.1, -0.5, -1.0])
    seen = samples.surface == 2
    share = samples.weight[seen & (samples.layer == 0)].sum() / SIZE**2
    assert share == pytest.approx(through.mean(), abs=0.005)
    colours = samples.rgb[seen & (samples.layer == 0)] / (through / through.mean())
    bright = colours[:, 0] > 0.5
    np.testing.assert_allclose(colours[bright].mean(axis=0), [0.9, 0.6, 0.3], rtol=0.02)


# ---------------------------------------------------------------- media


@pytest.mark.parametrize("inside", ["homogeneous", "heterogeneous"])
def test_smoke_is_at_the_depths_where_it_scatters(inside):
    extinction = 2.0
    inside = medium(extinction) if inside == "homogeneous" else cloud(extinction)
    samples = sampled(scene(VOLPATH, smoke=slab(inside), wall=wall()), layers=1)
    smoke = samples.surface == 1
    assert samples.surfaces[1] == "smoke"
    z, weight = samples.z[smoke], samples.weight[smoke]
    assert z.min() >= 1
    assert z.max() <= 2.0001
    assert weight.sum() / SIZE**2 == pytest.approx(1 - np.exp(-extinction), abs=0.01)
    for depth in (1.1, 1.25, 1.5, 1.75):
        expected = 1 - np.exp(-extinction * (depth - 1))
        assert weight[z < depth].sum() / SIZE**2 == pytest.approx(expected, abs=0.015)


def test_smoke_without_end_is_all_that_is_seen():
    samples = sampled(scene(VOLPATH, sensor={"medium": medium(2.0)}, wall=wall(1e4)))
    assert np.isfinite(samples.z).all()
    assert shares(samples) == pytest.approx({"none": 1}, abs=1e-5)


def test_what_dense_smoke_hides_is_known():
    samples = sampled(scene(VOLPATH, smoke=slab(medium(20.0)), wall=wall()))
    assert shares(samples) == pytest.approx({"smoke": 1}, abs=1e-5)
    behind = samples.chosen((samples.surface == 2) & (samples.layer > 0))
    assert behind.weight.sum() / SIZE**2 == pytest.approx(1)
    np.testing.assert_allclose(behind.rgb.max(axis=0), [0.9, 0.6, 0.9], rtol=1e-5)


# ---------------------------------------------------------------- where there are none


def kinds(shown):
    return veil_kinds(shown, shown.sensors()[0], shown.integrator())


def test_scenes_without_veils_are_told_before_any_ray_is_traced():
    assert kinds(scene(wall=wall())) == VeilKinds(False, False)
    glass = {"type": "rectangle", "to_world": place(1.0), "bsdf": {"type": "thindielectric"}}
    assert kinds(scene(glass=glass, wall=wall())) == VeilKinds(False, False)
    # An integrator that knows no media sees none.
    assert kinds(scene(smoke=slab(medium(1.0)), wall=wall())) == VeilKinds(False, False)
    assert kinds(scene(VOLPATH, smoke=slab(medium(1.0)))) == VeilKinds(False, True)
    assert kinds(scene(pane=pane(1.0, 0.5))) == VeilKinds(True, False)


def test_a_mask_that_is_opaque_or_all_hole_leaves_the_samples_as_they_are():
    plain = sampled(scene(wall=wall()))
    hole = sampled(scene(pane=pane(1.0, 0.0), wall=wall()))
    np.testing.assert_allclose(plain.z, hole.z, rtol=1e-6)
    np.testing.assert_allclose(plain.rgb, hole.rgb, atol=1e-6)
    assert shares(sampled(scene(pane=pane(1.0, 1.0), wall=wall()))) == {"pane": 1}


# ---------------------------------------------------------------- files and pictures


def test_a_file_keeps_veils(tmp_path):
    shown = scene(VOLPATH, smoke=slab(medium(1.0)), pane=pane(0.8, 0.5, 0.1), wall=wall())
    samples = sampled(shown)
    samples.save(tmp_path / "veils.exr")
    loaded = pm.PointSamples.load(tmp_path / "veils.exr")
    assert loaded.spp == samples.spp
    np.testing.assert_allclose(pinhole(loaded), pinhole(samples), atol=1e-4)
    assert shares(loaded) == pytest.approx(shares(samples))


@pytest.mark.parametrize("focus", [1.0, 4.0])
@pytest.mark.parametrize("name", ["pane", "smoke", "two panes"])
def test_pictures_are_those_of_a_ray_traced_lens(name, focus):
    things = {
        "pane": {"pane": pane(1.0, 0.6, 0.1, 0.08)},
        "two panes": {"a": pane(1.0, 0.5, 0.1, 0.08), "b": pane(2.0, 0.5, 0.2, 0.1)},
        "smoke": {
            "smoke": {
                "type": "sphere",
                "center": [0, 0, 1.1],
                "radius": 0.12,
                "bsdf": {"type": "null"},
                "interior": medium(6.0, albedo=0.0),
            }
        },
    }
    lens = {"focus_distance": focus, "sampler": {"type": "multijitter", "sample_count": 64}}
    shown = scene(VOLPATH, sensor=lens, wall=wall(), **things[name])
    expected = np.array(mi.render(shown, spp=512))[..., :3]
    traced = np.array(mi.render(shown, spp=64))[..., :3]
    formed = np.array(pm.focus(pm.render_samples(shown, spp=64)))[..., :3]
    error, own = (np.mean((picture - expected) ** 2) for picture in (formed, traced))
    # As good as so many samples of the lens itself, within 1 dB, or 34 dB.
    assert error < max(1.26 * own, 10**-3.4)
