"""Chains of surfaces that turn rays, and the rays of a lens that follow them."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from specular import GLASS, MIRROR, N, ball, cube, loaded, plane, visible_in

from potmesil_mi.tracing.windows import Chain, meets_end

pytestmark = pytest.mark.usefixtures("variant_llvm")

PIXEL = 1 / 500
"""That of a camera with a focal length of 500 pixels, at depth 1."""

F = ((N - 1) / (N + 1)) ** 2
"""Share of light that glass reflects where it is met at a right angle."""


# ---------------------------------------------------------------- the light of a chain

PLAIN = {"type": "conductor", "material": "none"}
THIN = {"type": "thindielectric", "int_ior": N, "ext_ior": 1.0}
LAMP = {"emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1, 2, 4]}}}

CHAINS = {
    "mirror": (lambda: plane(3, bsdf=PLAIN), 1, -2, 1),
    "window": (lambda: cube(3, 1), 2, 7, (1 - F) ** 2),
    "water": (lambda: plane(3, bsdf=GLASS), 1, 7, (1 - F) / N**2),
    "out of water": (lambda: plane(3, facing=1, bsdf=GLASS), 1, 7, (1 - F) * N**2),
    "thin glass": (lambda: plane(3, bsdf=THIN), 1, 7, 1 - 2 * F / (1 + F)),
    "mask": (lambda: plane(3, bsdf={"type": "mask", "opacity": 0.25, "bsdf": PLAIN}), 1, 7, 0.75),
    "holes": (lambda: plane(3, bsdf={"type": "mask", "opacity": 0.75, "bsdf": PLAIN}), 1, -2, 0.75),
}
"""What stands before a lamp, at how many surfaces the chain goes on, where the lamp is, and the
throughput."""


@pytest.mark.parametrize("name", CHAINS)
def test_the_light_of_a_chain_is_throughput_times_radiance(name):
    shape, surfaces, z, expected = CHAINS[name]
    scene = loaded(shape=shape(), lamp={**plane(z, facing=-np.sign(z)), **LAMP})
    ray, visible = visible_in(scene, np.tile([[0.0], [0], [1]], 1 << 14))
    np.testing.assert_allclose(np.array(visible.throughput)[0, 0], expected, rtol=1e-5)
    rest = radiance(scene, mi.RayDifferential3f(visible.last), 1)
    np.testing.assert_allclose(rest, [1, 2, 4], rtol=1e-5)
    # Of longer paths some are reflected in between.
    whole = radiance(scene, mi.RayDifferential3f(ray), surfaces + 1)
    np.testing.assert_allclose(whole, expected * rest, rtol=0.02)


def test_what_is_met_first_has_all_its_light():
    ray, visible = visible_in(loaded(wall=plane(7), mirror=plane(9, bsdf=MIRROR)))
    assert np.array(visible.throughput).ravel().tolist() == [1, 1, 1]
    assert np.array(visible.turns).tolist() == [0]
    assert np.array(visible.last.o).tolist() == np.array(ray.o).tolist()


def radiance(scene, ray, max_depth):
    """Mean radiance along rays, of paths of so many segments."""
    path = mi.load_dict({"type": "path", "max_depth": max_depth, "rr_depth": 100})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, dr.width(ray.d))
    return np.array(path.sample(scene, sampler, ray)[0]).mean(axis=1)


def test_a_chain_ends_in_its_last_ray():
    scene = loaded(slab=cube(3, 1), mirror=plane(5, bsdf=MIRROR), wall=plane(-2))
    _, visible = visible_in(scene, [0.2, 0, 1])
    assert np.array(visible.turns).tolist() == [5]
    assert np.array(visible.lobes).tolist() == [0b00100]
    last = visible.last
    np.testing.assert_allclose(last.o.z, 2, rtol=5e-4)
    apart = np.array(visible.hit.p - last.o).ravel()
    np.testing.assert_allclose(apart / np.linalg.norm(apart), np.array(last.d).ravel(), atol=1e-6)
    np.testing.assert_allclose(visible.hit.p.z, -2, rtol=1e-5)


@pytest.mark.parametrize(("bsdf", "wall"), [(None, 7), (MIRROR, -2), (GLASS, 7)])
def test_the_spread_is_how_far_the_end_moves(bsdf, wall):
    shapes = {"ball": ball(4, 0.5, bsdf)} if bsdf else {}
    scene = loaded(**shapes, wall=plane(wall))
    step = 1e-3
    _, visible = visible_in(scene, [[0, step], [0, 0], [1, 1]])
    moved = np.ptp(np.array(visible.hit.p.x)) / step
    np.testing.assert_allclose(visible.spread, moved, rtol=2e-3)


# ---------------------------------------------------------------- rays of the lens

LENS = np.array([[0.06, -0.06, 0, 0, 0.03, 0], [0, 0, 0.06, -0.06, -0.03, 0], [0, 0, 0, 0, 0, 0]])


def met_from_the_lens(scene, seen=(0, 0, 1), tolerance=2 * PIXEL, **changes):
    """Which rays of the lens, aimed at the image of what is seen in a direction, meet its end."""
    _, visible = visible_in(scene, seen)
    chain = Chain.of(visible)
    for name, change in changes.items():
        setattr(chain, name, change(getattr(chain, name)))
    depth = float(visible.depth[0])
    lens = mi.Point3f(LENS.astype("f"))
    if np.isfinite(depth):
        aim = depth / seen[2] * mi.Vector3f(*seen) - mi.Vector3f(lens)
    else:
        aim = mi.Vector3f(*seen)
    return np.array(meets_end(scene, mi.Ray3f(lens, dr.normalize(aim)), chain, tolerance))


def test_rays_aimed_at_the_image_in_a_plane_mirror_meet():
    scene = loaded(mirror=plane(3, bsdf=MIRROR), wall=plane(-2))
    assert met_from_the_lens(scene, (0.2, 0.1, 1), tolerance=1e-4).all()


def test_rays_beside_the_mirror_do_not():
    scene = loaded(mirror=plane(3, x=1.02, size=1, bsdf=MIRROR), wall=plane(-2), beside=plane(9))
    # The rim is at x = 0.02; the ray from x = -0.06 towards 0.088 passes it at -0.005.
    assert met_from_the_lens(scene, (0.011, 0, 1)).tolist() == [True, False, True, True, True, True]


def test_what_is_before_the_end_blocks():
    shapes = {"mirror": plane(3, bsdf=MIRROR), "wall": plane(-2)}
    met = met_from_the_lens(loaded(post=plane(1, x=-0.055, size=0.02), **shapes))
    assert met.tolist() == [True, False, True, True, True, True]
    # The ray from x = 0.06 passes z = 2 at 0.045, and comes back at 0.03.
    met = met_from_the_lens(loaded(post=plane(2, x=0.03, size=0.005), **shapes))
    assert met.tolist() == [False, True, True, True, True, True]


@pytest.mark.parametrize("direction", [(0, 0, 1), (0.4, 0.2, 1)])
def test_rays_aimed_at_the_image_behind_a_window_meet(direction):
    scene = loaded(slab=cube(1, 0.01, size=1), wall=plane(4))
    assert met_from_the_lens(scene, direction, tolerance=0.1 * PIXEL).all()
    assert not met_from_the_lens(scene, direction, turns=lambda turns: turns + 1).any()
    assert not met_from_the_lens(scene, direction, lobes=lambda lobes: lobes | 2).any()
    assert not met_from_the_lens(scene, direction, point=lambda point: point + 0.1).any()


@pytest.mark.parametrize("wall", [4.6, 20.0])
def test_rays_aimed_at_the_image_in_a_ball_meet(wall):
    scene = loaded(ball=ball(4, 0.5, GLASS), wall=plane(wall))
    assert met_from_the_lens(scene).all()
    assert not met_from_the_lens(scene, tolerance=1e-7)[:4].any()


def test_rays_meet_the_sky_in_the_direction_of_the_last():
    sky = {"type": "constant"}
    for shapes in ({"mirror": plane(3, bsdf=MIRROR)}, {"ball": ball(4, 0.5, GLASS)}):
        scene = loaded(**shapes, sky=sky)
        assert met_from_the_lens(scene).all()
        assert not met_from_the_lens(scene, direction=lambda direction: direction + 0.1).any()


def test_a_ray_takes_the_lobe_of_the_chain_and_not_its_own():
    """At 79.5 degrees glass reflects as much as it lets pass: one side of the lens sees more."""
    scene = loaded(face=plane(1, turn=84.2, bsdf=GLASS), wall=plane(3))
    _, visible = visible_in(scene)
    print(visible.lobes, visible.throughput)
    assert met_from_the_lens(scene).all()


def test_a_pane_or_none_makes_no_difference():
    pane = plane(2, x=1, size=1, bsdf={"type": "thindielectric"})
    scene = loaded(pane=pane, mirror=plane(3, bsdf=MIRROR), wall=plane(-2))
    assert met_from_the_lens(scene, (0.005, 0, 1), tolerance=1e-4).all()
