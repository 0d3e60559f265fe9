"""The depth of what is seen through glass, against the closed forms of images."""

import numpy as np
import pytest
from specular import (
    GLASS,
    MIRROR,
    WALL,
    N,
    ball,
    bulge,
    cube,
    fan,
    loaded,
    looked_at,
    mesh,
    plane,
    visible_in,
)

from potmesil_mi.tracing.virtual_depth import NEAREST_IMAGE

pytestmark = pytest.mark.usefixtures("variant_llvm")

IMAGE = 5e-4
"""Relative: a refracted ray starts 9e-5 of its distance away from the surface, and curvature is
measured over 1e-3 of it."""


def axial_image(surfaces, wall):
    """Depth of the paraxial image of a ``wall`` on the axis; ``inf`` beyond infinity.

    ``surfaces`` are (depth, radius, index before, index beyond), the nearest first; the radius
    is positive where the centre is beyond. Vergences go from the wall to the pinhole.
    """
    vergence, place = None, wall
    for z, radius, before, beyond in reversed(surfaces):
        if vergence is None:
            vergence = -beyond / (wall - z)
        else:
            vergence /= 1 - vergence * (place - z) / beyond
        vergence += (before - beyond) / -radius
        place = z
    depth = place - 1 / vergence
    return depth if depth > 0 else np.inf


def ball_of_glass(z, radius, n=N):
    return [(z - radius, radius, 1, n), (z + radius, -radius, n, 1)]


def mean_depth(*depths):
    """That of the mean of 1/depth."""
    return 1 / np.mean([1 / depth for depth in depths], axis=0)


def angles(directions):
    """Cosines of the angles to the axis, in air and in glass."""
    cosine = directions[2] / np.linalg.norm(directions, axis=0)
    return cosine, np.sqrt(1 - (1 - cosine**2) / N**2)


@pytest.mark.parametrize("half", [1.0, 0.01])
def test_a_window_brings_nearer_what_is_behind_it(half):
    depth, names, turned = looked_at(slab=cube(3, half), wall=plane(7))
    np.testing.assert_allclose(depth, 7 - 2 * half * (1 - 1 / N), rtol=IMAGE)
    assert turned.all()
    assert names.tolist() == ["wall"]


def test_a_window_seen_from_the_side_is_astigmatic():
    directions = fan()
    depth, _, _ = looked_at(directions, slab=cube(3, 1), wall=plane(7))
    air, glass = angles(directions)
    sagittal = 5 + 2 / N * air / glass
    tangential = 5 + 2 / N * (air / glass) ** 3
    np.testing.assert_allclose(depth, mean_depth(sagittal, tangential), rtol=IMAGE)


def test_a_fish_is_nearer_than_it_is():
    directions = fan()
    depth, names, _ = looked_at(directions, face=plane(3, bsdf=GLASS), fish=plane(7))
    air, glass = angles(directions)
    # Coddington's equations.
    along = 4 / glass
    images = [3 + air * along / N, 3 + air * along / N * (air / glass) ** 2]
    np.testing.assert_allclose(depth, mean_depth(*images), rtol=IMAGE)
    np.testing.assert_allclose(depth[len(depth) // 2], 3 + 4 / N, rtol=IMAGE)
    assert (names == "fish").all()


@pytest.mark.parametrize(
    ("wall", "real"), [(4.6, False), (23.5, True)], ids=["virtual", "real, before the ball"]
)
def test_a_ball_is_a_lens(wall, real):
    depth, names, _ = looked_at(ball=ball(4, 0.5, GLASS), wall=plane(wall))
    expected = axial_image(ball_of_glass(4, 0.5), wall)
    np.testing.assert_allclose(depth, expected, rtol=2 * IMAGE)
    assert (depth < 3.5).all() == real
    assert names.tolist() == ["wall"]


def test_an_image_behind_the_camera_is_at_infinity():
    surfaces = ball_of_glass(1, 0.5)
    assert axial_image(surfaces, 1.8) == np.inf
    depth, _, _ = looked_at(ball=ball(1, 0.5, GLASS), wall=plane(1.8))
    assert np.isposinf(depth).all()


def test_the_sky_through_a_ball_is_at_its_focus():
    depth, names, turned = looked_at(ball=ball(4, 0.5, GLASS), sky={"type": "constant"})
    np.testing.assert_allclose(depth, 4 - 0.5 * N / (2 * (N - 1)), rtol=2 * IMAGE)
    assert turned.all()
    assert names.tolist() == [""]


def test_glass_with_water_in_it():
    water = {"type": "dielectric", "int_ior": 1.33, "ext_ior": N}
    depth, names, _ = looked_at(
        glass=ball(4, 0.5, GLASS), water=ball(4, 0.4, water), wall=plane(4.7)
    )
    surfaces = [(3.5, 0.5, 1, N), (3.6, 0.4, N, 1.33), (4.4, -0.4, 1.33, N), (4.5, -0.5, N, 1)]
    np.testing.assert_allclose(depth, axial_image(surfaces, 4.7), rtol=2 * IMAGE)
    assert names.tolist() == ["wall"]


@pytest.mark.parametrize("texcoords", [False, True])
def test_a_mesh_with_smooth_normals_is_a_lens(texcoords):
    face = mesh(3, bulge, texcoords, bsdf=GLASS)
    depth, _, _ = looked_at([0.01, 0.005, 1], face=face, wall=plane(5))
    # Between vertices 1/128 of the radius apart, and 1/100 off the axis.
    np.testing.assert_allclose(depth, axial_image([(3, 4, 1, N)], 5), rtol=2e-3)


def test_a_prism_reflects_all_and_unfolds():
    shapes = {
        "front": plane(3, size=1, bsdf=GLASS),
        "across": plane(4, turn=45, facing=1, size=1.4, bsdf=GLASS),
        "side": plane(4, turn=-90, x=-1, facing=1, size=1, bsdf=GLASS),
        "wall": plane(4, turn=90, x=-3),
    }
    _, visible = visible_in(loaded(**shapes), fan() * [[0.1], [0.1], [1]])
    np.testing.assert_allclose(visible.depth[12], 3 + 2 / N + 2, rtol=IMAGE)
    assert (np.array(visible.turns) == 3).all()
    assert (np.array(visible.lobes) == 0b010).all()


def test_glass_at_a_grazing_angle_is_a_mirror():
    depth, _, turned = looked_at(face=plane(3, turn=88, bsdf=GLASS), wall=plane(7))
    np.testing.assert_allclose(depth, 3 + 4 / np.cos(np.radians(4)), rtol=IMAGE)
    assert turned.all()


def test_a_mirror_behind_a_window():
    depth, _, _ = looked_at(slab=cube(2, 0.5), mirror=plane(3, bsdf=MIRROR), wall=plane(-2))
    np.testing.assert_allclose(depth, 8 - 2 * (1 - 1 / N), rtol=IMAGE)


def test_glass_that_does_not_refract_turns_nothing():
    air = {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0}
    _, visible = visible_in(loaded(slab=cube(3, 1, air), wall=plane(7)), fan())
    np.testing.assert_allclose(visible.depth, 7, rtol=1e-5)
    assert not np.array(visible.turns).any()
    assert not np.array(visible.through_window).any()


def test_what_is_dull_in_glass_is_seen_in_it():
    depth, names, _ = looked_at(slab=cube(3, 1), coin=plane(3, size=1, bsdf=WALL))
    np.testing.assert_allclose(depth, 2 + 1 / N, rtol=IMAGE)
    assert names.tolist() == ["coin"]


def test_images_before_glass_are_no_nearer_than_a_quarter_of_its_depth():
    # So near the ball has its image of the wall next to the pinhole.
    x = np.linspace(0, 0.8, 400)
    scene = loaded(ball=ball(1.5, 1, GLASS), wall=plane(90))
    _, visible = visible_in(scene, np.stack([x, 0 * x, np.ones_like(x)]))
    depth, shown = np.array(visible.depth), np.array(visible.through_window)
    # Where the rays of the pinhole meet the ball.
    first = (1.5 - np.sqrt(1.5**2 - (1 + x**2) * (1.5**2 - 1))) / (1 + x**2)
    assert shown.sum() > 300
    assert (depth[shown] > NEAREST_IMAGE * first[shown] * (1 - 1e-4)).all()
    assert (depth[shown] < NEAREST_IMAGE * first[shown] * (1 + 1e-4)).any()


@pytest.mark.parametrize("opacity", [0.4999, 0.5, 0.5001])
def test_a_mask_of_about_one_half_is_passed_behind_a_mirror(opacity):
    mask = {"type": "mask", "opacity": opacity, "bsdf": WALL}
    scene = loaded(mirror=plane(3, bsdf=MIRROR), mask=plane(-1, bsdf=mask), wall=plane(-2))
    _, visible = visible_in(scene, [0.1, 0, 1])
    np.testing.assert_allclose(visible.depth, 3 + 5, rtol=1e-4)
