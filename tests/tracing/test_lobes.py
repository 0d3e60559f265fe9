"""Panes and solids of glass part the light of a ray: what they reflect is a sample of its own."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from specular import (
    GLASS,
    MIRROR,
    WALL,
    N,
    before_lens,
    cube,
    lamp,
    loaded,
    plane,
    visible_in,
)

import potmesil_mi as pm
from potmesil_mi.tracing.virtual_depth import trace_visible
from potmesil_mi.tracing.windows import Chain, meets_end

pytestmark = pytest.mark.usefixtures("variant_llvm")

F = ((N - 1) / (N + 1)) ** 2
"""Share of light that a face of glass reflects where it is met at a right angle."""

EVEN = pm.Sampling(refine=0)
"""Sampling of each pixel as often as of any other."""

THIN = {"type": "thindielectric", "int_ior": N, "ext_ior": 1.0}
OF_THIN = 2 * F / (1 + F)
"""Share of light that a pane with two faces reflects."""


def scene_with(thing, *, size=12, spp=16, radius=0.06, integrator="path", **more):
    """``thing`` 1 in front of a lens, a wall of radiance 1 at 4 and one of radiance 8 at -0.5."""
    shapes = {"wall": lamp(4), "street": lamp(-0.5, 8.0, facing=1), "thing": thing, **more}
    options = {"radius": radius, "focus": 4.0, "integrator": integrator, "max_depth": 8}
    return before_lens(size=size, spp=spp, **options, **shapes)


def light(samples, chosen=None):
    """The light of each place of samples, in the order of their places."""
    chosen = samples.layer == 0 if chosen is None else chosen
    place = samples.x[chosen] + 1j * samples.y[chosen]
    _, index = np.unique(place, return_inverse=True)
    rgb = samples.rgb[chosen] * samples.weight[chosen, None]
    return np.stack([np.bincount(index, column) for column in rgb.T.astype(np.float64)], axis=1)


def pane():
    return plane(1, size=0.2, bsdf=THIN)


def slab():
    return cube(1, 0.01, size=0.2)


@pytest.mark.parametrize("thing", [pane, slab])
@pytest.mark.parametrize("layers", [1, 16])
def test_the_picture_of_the_pinhole_is_the_integrators_own(thing, layers):
    scene = scene_with(thing())
    whole = pm.render_samples(scene, sampling=pm.Sampling(virtual_depth=False, layers=1, refine=0))
    parted = pm.render_samples(scene, sampling=pm.Sampling(layers=layers, overscan=0, refine=0))
    inside = (whole.x >= 0) & (whole.x < 12) & (whole.y >= 0) & (whole.y < 12)
    np.testing.assert_allclose(light(parted), light(whole, inside), rtol=1e-4, atol=1e-5)
    assert parted.layer.max() == 0 or layers > 1


def at_depth(samples, z):
    """The samples of what the pinhole sees at about a depth."""
    return (samples.layer == 0) & np.isclose(samples.z, z, rtol=0.01)


def test_a_pane_is_two_samples_with_their_shares():
    samples = pm.render_samples(scene_with(pane(), radius=0.02, spp=16), sampling=EVEN)
    middle = (np.abs(samples.x - 6) < 1) & (np.abs(samples.y - 6) < 1)
    through, reflected = (middle & at_depth(samples, z) for z in (4, 2.5))
    assert reflected.sum() == through.sum() > 0
    np.testing.assert_allclose(samples.weight[reflected] * 16, OF_THIN, rtol=0.02)
    np.testing.assert_allclose(samples.weight[through] * 16, 1 - OF_THIN, rtol=0.02)
    np.testing.assert_allclose(samples.rgb[reflected], 8, rtol=1e-4)
    np.testing.assert_allclose(samples.rgb[through].mean(), 1, rtol=0.2)
    # The reflection is seen in the pane, and what is behind it through nothing.
    np.testing.assert_allclose(samples.through[reflected], 1, rtol=1e-5)
    assert not samples.through[through].any()


def test_a_slab_reflects_with_both_faces_at_their_depths():
    samples = pm.render_samples(scene_with(slab(), radius=0.02, spp=16), sampling=EVEN)
    middle = (np.abs(samples.x - 6) < 1) & (np.abs(samples.y - 6) < 1)
    near, far = 2 * 0.99 + 0.5, 2 * 0.99 + 0.5 + 2 * 0.02 / N
    shares = [
        samples.weight[middle & (samples.layer == 0) & np.isclose(samples.z, z, rtol=2e-3)]
        for z in (near, far)
    ]
    np.testing.assert_allclose(shares[0] * 16, F, rtol=0.02)
    np.testing.assert_allclose(shares[1] * 16, (1 - F) ** 2 * F, rtol=0.02)


def test_what_is_behind_a_pane_shows_whole_beside_it():
    samples = pm.render_samples(scene_with(pane()), sampling=EVEN)
    behind = np.isclose(samples.z, 4, rtol=0.01)
    place = samples.x[behind] + 1j * samples.y[behind]
    _, index = np.unique(place, return_inverse=True)
    weight = np.bincount(index, samples.weight[behind])
    np.testing.assert_allclose(weight * 16, 1, rtol=1e-5)


@pytest.mark.parametrize("bsdf", [MIRROR, WALL])
def test_what_reflects_all_or_nothing_is_one_sample(bsdf):
    scene = scene_with(plane(1, size=0.2, bsdf=bsdf))
    samples = pm.render_samples(scene, sampling=pm.Sampling(layers=1))
    first = samples.layer == 0
    assert len(np.unique(samples.x[first] + 1j * samples.y[first])) == first.sum()


def test_panes_in_media_are_left_whole():
    fog = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.1}
    ball = {"type": "sphere", "center": [0, 0, 3], "radius": 0.1, "bsdf": {"type": "null"}}
    scene = scene_with(pane(), integrator="volpath", ball={**ball, "interior": fog})
    samples = pm.render_samples(scene, sampling=pm.Sampling(layers=1))
    assert not at_depth(samples, 2.5).any()


@pytest.mark.parametrize(("number", "depth", "parted"), [(0, 2.5, True), (1, 4, False)])
def test_the_lesser_lobe_of_a_pane_is_followed(number, depth, parted):
    scene = loaded(pane=plane(1, bsdf=THIN), wall=plane(4), behind=plane(-0.5))
    _, visible = visible_in(scene, lesser=number)
    np.testing.assert_allclose(visible.depth, depth, rtol=1e-5)
    assert np.array(visible.by_lesser).tolist() == [parted]
    expected = OF_THIN if parted else 1 - OF_THIN
    np.testing.assert_allclose(np.array(visible.throughput)[0], expected, rtol=1e-4)


def test_at_a_grazing_angle_the_lesser_lobe_is_what_shows_through():
    turned = plane(3, bsdf=THIN, turn=85)
    shapes = {"pane": turned, "wall": plane(9), "side": plane(0, x=-15, turn=90)}
    _, visible = visible_in(loaded(**shapes), lesser=0)
    assert np.array(visible.by_lesser).tolist() == [True]
    assert np.array(visible.turns).tolist() == [0]
    np.testing.assert_allclose(visible.depth, 9, rtol=1e-5)
    assert 1 / 64 < np.array(visible.throughput)[0, 0] < 0.5


def test_what_is_behind_a_veil_is_not_parted():
    veil = {"type": "mask", "opacity": 0.25, "bsdf": {"type": "twosided", "b": {"type": "diffuse"}}}
    shapes = {"veil": plane(1, bsdf=veil), "pane": plane(2, bsdf=GLASS), "wall": plane(4)}
    _, visible = visible_in(loaded(**shapes), lesser=0)
    assert np.array(visible.by_lesser).tolist() == [False]


def test_points_of_the_lens_see_a_reflection_as_far_as_the_pane_goes():
    scene = loaded(pane=plane(1, size=0.1, bsdf=THIN), wall=plane(4), behind=plane(-0.5, facing=1))
    _, visible = visible_in(scene, lesser=0)
    points = np.linspace(-0.3, 0.3, 31)
    origin = np.stack([points, 0 * points, 0 * points])
    toward = np.array([[0], [0], [2.5]]) - origin
    toward /= np.linalg.norm(toward, axis=0)
    ray = mi.Ray3f(mi.Point3f(origin.astype("f")), mi.Vector3f(toward.astype("f")))
    sees = np.array(meets_end(scene, ray, Chain.of(visible), 0.004))
    # Rays from u to the image at 2.5 pass the pane, at 1, at 0.6 u.
    np.testing.assert_array_equal(sees, np.abs(points) * 0.6 < 0.1)


def test_without_asking_for_it_no_lobe_is_lesser():
    scene = loaded(pane=plane(1, bsdf=THIN), wall=plane(4))
    ray, visible = visible_in(scene)
    again = trace_visible(scene, [0, 0, 0], ray, scene.ray_intersect(ray), (0, 0, 1))
    assert not np.array(visible.by_lesser | again.by_lesser).any()


@pytest.mark.parametrize(
    ("lesser", "error"), [(-1, ValueError), (2**31, ValueError), (1.5, TypeError)]
)
def test_bad_numbers_of_lobes_are_named(lesser, error):
    with pytest.raises(error, match=r"lesser=.*must be"):
        visible_in(loaded(pane=plane(1, bsdf=THIN)), lesser=lesser)


@pytest.mark.parametrize("thing", [slab, pane])
def test_another_run_compiles_nothing_anew(thing):
    # How many samples there are differs from run to run, and may be in no kernel. Dr.Jit may order
    # the variables of a loop anew, and so compile it once more, but not each time.
    scene = scene_with(thing(), size=16, spp=4)
    compiled = []
    for seed in range(5):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            pm.render_samples(scene, seed=seed)
            history = dr.kernel_history([dr.KernelType.JIT])
        assert len(history) > 10
        compiled.append(sum(not kernel["cache_hit"] for kernel in history))
    assert 0 in compiled[1:]
