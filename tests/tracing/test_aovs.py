"""AOVs of samples are those that the integrator gives the rays of these."""

import mitsuba as mi
import numpy as np
import pytest
from specular import before_lens, cube, lamp, plane

import potmesil_mi as pm
from potmesil_mi.tracing.aovs import Aovs
from scenes import still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

SHOWN = "dd:depth,nn:sh_normal,al:albedo,pp:position,si:shape_index"
NAMES = ("dd.T", "nn.X", "nn.Y", "nn.Z", "al.R", "al.G", "al.B", "pp.X", "pp.Y", "pp.Z", "si.I")
AOV = {"type": "aov", "aovs": SHOWN, "image": {"type": "path", "max_depth": 3}}
ONLY_VISIBLE = pm.Sampling(refine=0, layers=1, overscan=0)


def columns(samples, first):
    """The AOVs whose names begin so."""
    return samples.aovs[:, [name.startswith(first) for name in samples.aov_names]]


def along_rays(samples):
    """How far from the near plane what samples show is, along the rays through their places."""
    camera, places = samples.camera, np.stack([samples.x, samples.y], axis=1).astype(np.float64)
    ends = [
        np.asarray(camera.world_from_pixel(places, depth))
        for depth in (np.full(len(samples), camera.near_clip), samples.z.astype(np.float64))
    ]
    return np.linalg.norm(ends[1] - ends[0], axis=1)


def test_what_the_pinhole_sees_has_the_aovs_of_the_bare_integrator():
    scene = still_life(AOV, spp=1)
    samples = pm.render_samples(scene, spp=1, seed=3, sampling=ONLY_VISIBLE)
    assert samples.aov_names == NAMES
    assert samples.aovs.dtype == np.float32
    expected = np.array(mi.render(scene, spp=1, seed=3))[..., 3:]
    np.testing.assert_allclose(samples.aovs.reshape(16, 24, 11), expected, atol=1e-5)
    assert len(np.unique(columns(samples, "si"))) == 3


def test_aovs_change_nothing_else():
    plain, samples = (pm.render_samples(still_life(of), seed=2) for of in (AOV["image"], AOV))
    assert plain.aovs is None
    assert plain.aov_names == ()
    for name in ("x", "y", "rgb", "alpha", "z", "surface", "weight", "layer"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(plain, name))


def test_hidden_samples_have_their_own():
    samples = pm.render_samples(still_life(AOV))
    wall = next(id_ for id_, name in samples.surfaces.items() if name == "wall")
    hidden = samples.chosen((samples.layer > 0) & (samples.surface == wall))
    assert len(hidden) > 50
    np.testing.assert_allclose(columns(hidden, "al"), [[0.2, 0.4, 0.7]] * len(hidden), rtol=1e-5)
    np.testing.assert_allclose(columns(hidden, "nn"), [[0, 0, -1]] * len(hidden), atol=1e-6)
    np.testing.assert_allclose(columns(hidden, "pp")[:, 2], hidden.z, rtol=1e-5)
    # The rays begin behind the ball, and distances do not.
    np.testing.assert_allclose(columns(hidden, "dd")[:, 0], along_rays(hidden), rtol=1e-5)
    nothing = samples.chosen((samples.layer > 0) & (samples.surface == 0))
    assert len(nothing) > 50
    np.testing.assert_array_equal(columns(nothing, "dd"), 0)


def test_points_of_a_grid_do_not_mix_ids():
    samples = pm.render_samples(still_life(AOV), spp=3, sampling=pm.Sampling("uniform"))
    ids = columns(samples, "si")
    np.testing.assert_array_equal(ids, np.rint(ids))
    assert len(np.unique(ids)) == 3


def at_same_places(samples):
    """How far the AOVs of visible samples of one place are apart, and how many places have some."""
    samples = samples.visible()
    _, place = np.unique(samples.x + 1j * samples.y, return_inverse=True)
    order = np.argsort(place, kind="stable")
    same = place[order][1:] == place[order][:-1]
    apart = np.abs(np.diff(samples.aovs[order], axis=0))[same]
    return float(apart.max(initial=0)), int(same.sum())


def test_the_parts_of_a_ray_that_a_veil_splits_have_its_aovs():
    veil = {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}
    scene = still_life(AOV, veil=plane(1.5, size=0.3, bsdf=veil))
    apart, count = at_same_places(pm.render_samples(scene, sampling=pm.Sampling(refine=0)))
    assert count > 100
    assert apart == 0


def test_the_parts_of_a_ray_that_glass_parts_have_its_aovs():
    """So do images that only other points of the lens see: of what shows them."""
    shapes = {"wall": lamp(4), "street": lamp(-0.5, 8.0, facing=1), "pane": cube(1, 0.01, size=0.2)}
    scene = before_lens(size=12, spp=16, radius=0.06, focus=4.0, **shapes)
    aov = mi.load_dict(AOV)
    samples = pm.render_samples(scene, integrator=aov, sampling=pm.Sampling(refine=0))
    assert samples.through is not None
    apart, count = at_same_places(samples)
    assert count > 100
    assert apart < 1e-6
    elsewhere = samples.chosen(samples.layer == 255)
    assert len(elsewhere) > 10
    np.testing.assert_allclose(columns(elsewhere, "pp")[:, 2], 0.99, atol=1e-5)


def test_samples_of_an_exposure_have_them():
    move = pm.ShapeMove(translate=pm.VectorTrack.of([[0, [0, 0, 0]], [1, [0.5, 0, 0]]]))
    motion = pm.Motion(shapes={"ball": move}, shutter=pm.Shutter(instants=2))
    samples = pm.render_samples(still_life(AOV), motion=motion)
    assert samples.moves
    assert samples.aov_names == NAMES
    assert samples.aovs.shape == (len(samples), 11)


@pytest.mark.parametrize(
    ("integrator", "names"),
    [
        ({"type": "path"}, ()),
        ({"type": "aov", "aovs": "d:depth"}, ("d.T",)),
        ({"type": "aov", "aovs": "a:albedo,d:depth"}, ("a.R", "a.G", "a.B", "d.T")),
        (
            {"type": "aov", "aovs": "d:depth", "a": {"type": "path"}, "b": {"type": "direct"}},
            ("b.R", "b.G", "b.B", "b.A", "d.T"),
        ),
        (
            {"type": "moment", "a": {"type": "path"}},
            ("a.X", "a.Y", "a.Z", "m2_a.X", "m2_a.Y", "m2_a.Z"),
        ),
    ],
)
def test_what_is_the_picture_itself_is_no_aov(integrator, names):
    assert Aovs.of(mi.load_dict(integrator)).names == names


def test_aovs_of_one_name_are_refused_before_anything_is_traced():
    twice = {"type": "aov", "aovs": "d:depth,d:depth", "a": {"type": "path"}}
    with pytest.raises(ValueError, match=r"aov_names=.*: 'd.T' is there twice"):
        pm.render_samples(still_life(twice))
