"""The pinhole is at the origin and looks along +z, towards mirrors and panes."""

import mitsuba as mi
import numpy as np
import pytest
from specular import MIRROR, WALL, ball, bulge, fan, looked_at, mesh, plane

from potmesil_mi.tracing.onward import has_specular

pytestmark = pytest.mark.usefixtures("variant_llvm")

UNFOLDED = 1e-4
"""Relative: Mitsuba starts a reflected ray 9e-5 (1 + |p|) away from the surface."""

PARAXIAL = 2e-4
"""Relative: 1e-6 of a step over it of a mirror's radius, and the error of single precision."""


def test_what_a_plane_mirror_shows_is_as_far_behind_it():
    depth, names, turned = looked_at(fan(), mirror=plane(3, bsdf=MIRROR), wall=plane(-2))
    np.testing.assert_allclose(depth, 3 + 5, rtol=UNFOLDED)
    assert turned.all()
    assert (names == "wall").all()


def test_a_mirror_at_45_degrees_shows_the_wall_beside():
    shapes = {"mirror": plane(3, turn=45, size=1, bsdf=MIRROR), "wall": plane(0, turn=90, x=-2)}
    directions = fan() * [[0.2], [0.2], [1]]
    depth, names, _ = looked_at(directions, **shapes)
    np.testing.assert_allclose(depth, 3 + 2, rtol=UNFOLDED)
    assert (names == "wall").all()


def test_two_mirrors_unfold_one_after_the_other():
    shapes = {
        "low": plane(3, turn=45, size=1, bsdf=MIRROR),
        "high": plane(3, turn=45, x=-4, size=2, bsdf=MIRROR),
        "wall": plane(6),
    }
    depth, names, _ = looked_at(fan() * [[0.1], [0.1], [1]], **shapes)
    np.testing.assert_allclose(depth, 3 + 4 + 3, rtol=UNFOLDED)
    assert (names == "wall").all()
    depth, names, _ = looked_at(bounces=1, **shapes)
    np.testing.assert_allclose(depth, 3 + 4, rtol=UNFOLDED)
    assert (names == "high").all()
    depth, names, turned = looked_at(bounces=0, **shapes)
    np.testing.assert_allclose(depth, 3, rtol=UNFOLDED)
    assert (names == "low").all()
    assert not turned.any()


def test_mirrors_face_to_face_end_where_the_bounces_do():
    shapes = {"front": plane(1, bsdf=MIRROR), "back": plane(-1, bsdf=MIRROR)}
    depth, names, _ = looked_at(bounces=7, **shapes)
    np.testing.assert_allclose(depth, 1 + 7 * 2, rtol=UNFOLDED)
    assert (names == "back").all()


def test_depth_is_along_an_axis_that_the_ray_may_leave():
    axis = np.array([0.6, 0, 0.8])
    depth, _, _ = looked_at(axis=axis, mirror=plane(3, bsdf=MIRROR), wall=plane(-2))
    np.testing.assert_allclose(depth, 8 * 0.8, rtol=UNFOLDED)


def test_bumps_that_are_none_leave_a_mirror_plane():
    bumps = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(np.full((4, 4, 1), 0.5, "f"))}
    bsdf = {"type": "bumpmap", "bumps": bumps, "bsdf": {"type": "conductor"}}
    depth, _, _ = looked_at(fan(), mirror=plane(3, bsdf=bsdf), wall=plane(-2))
    np.testing.assert_allclose(depth, 8, rtol=UNFOLDED)


# ---------------------------------------------------------------- straight on

PANES = {
    "thin glass": {"type": "thindielectric"},
    "dark glass": {"type": "thindielectric", "specular_transmittance": 0.3},
    "null": {"type": "null"},
    "cut out": {"type": "mask", "opacity": 0.0, "bsdf": WALL},
    "half opaque": {"type": "mask", "opacity": 0.5, "bsdf": WALL},
    "more opaque than not": {"type": "mask", "opacity": 0.9, "bsdf": WALL},
    "twosided half opaque": {"type": "mask", "opacity": 0.5, "bsdf": MIRROR},
    "air": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0},
}


@pytest.mark.parametrize("pane", PANES.values(), ids=PANES)
def test_what_is_behind_a_pane_has_its_own_depth(pane):
    depth, names, turned = looked_at(fan(), pane=plane(3, bsdf=pane), wall=plane(7))
    np.testing.assert_allclose(depth, 7, rtol=1e-5)
    assert not turned.any()
    assert (names == "wall").all()


OPAQUE = {
    "rough mirror": {"type": "roughconductor", "alpha": 0.3},
    "plastic": {"type": "plastic"},
    "hardly transparent": {"type": "mask", "opacity": 0.999, "bsdf": WALL},
    "mirror with paint": {
        "type": "blendbsdf",
        "weight": 0.1,
        "a": {"type": "conductor"},
        "b": WALL,
    },
    "back of a mirror": {"type": "conductor"},
}


@pytest.mark.parametrize("name", OPAQUE)
def test_other_surfaces_keep_their_own_depth(name):
    facing = 1 if name == "back of a mirror" else -1
    shown = plane(3, facing=facing, bsdf=OPAQUE[name])
    depth, names, turned = looked_at(fan(), shown=shown, before=plane(-2), behind=plane(7))
    np.testing.assert_allclose(depth, 3, rtol=1e-5)
    assert not turned.any()
    assert (names == "shown").all()


def test_a_mask_is_asked_for_its_opacity_at_each_point():
    opacity = np.zeros((1, 2, 1), dtype="f")
    opacity[0, 0] = 1
    opacity = {
        "type": "bitmap",
        "raw": True,
        "filter_type": "nearest",
        "bitmap": mi.Bitmap(opacity),
    }
    pane = plane(3, size=2, bsdf={"type": "mask", "opacity": opacity, "bsdf": WALL})
    depth, names, _ = looked_at([[0.2, -0.2], [0, 0], [1, 1]], pane=pane, wall=plane(7))
    np.testing.assert_allclose(depth, [3, 7], rtol=1e-5)
    assert names.tolist() == ["pane", "wall"]


def test_a_mirror_with_holes_is_a_mirror_where_it_is_one():
    bsdf = {"type": "mask", "opacity": 0.6, "bsdf": MIRROR}
    depth, names, _ = looked_at(mirror=plane(3, bsdf=bsdf), before=plane(-2), behind=plane(7))
    np.testing.assert_allclose(depth, 8, rtol=UNFOLDED)
    assert names.tolist() == ["before"]


def test_thin_glass_at_a_grazing_angle_is_a_mirror():
    pane = plane(3, turn=88, bsdf={"type": "thindielectric"})
    depth, _, _ = looked_at(pane=pane, wall=plane(7))
    # Turned by 4 degrees at z = 3, the ray goes on to z = 7.
    np.testing.assert_allclose(depth, 3 + 4 / np.cos(np.radians(4)), rtol=UNFOLDED)


def test_a_window_and_a_mirror_behind_it():
    pane = plane(1, bsdf={"type": "thindielectric"})
    shapes = {"mirror": plane(3, bsdf=MIRROR), "wall": plane(-2)}
    depth, _, _ = looked_at(fan(), pane=pane, **shapes)
    np.testing.assert_allclose(depth, 8, rtol=UNFOLDED)


@pytest.mark.parametrize(("facing", "expected"), [(-1, 3), (1, 7)])
def test_a_lamp_on_nothing_is_seen_from_its_front(facing, expected):
    lamp = {**plane(3, facing=facing, bsdf={"type": "null"}), "emitter": {"type": "area"}}
    depth, _, _ = looked_at(fan(), lamp=lamp, wall=plane(7))
    np.testing.assert_allclose(depth, expected, rtol=1e-5)


def test_a_lamp_on_nothing_is_seen_in_a_mirror():
    lamp = {**plane(-2, facing=1, bsdf={"type": "null"}), "emitter": {"type": "area"}}
    depth, names, _ = looked_at(mirror=plane(3, bsdf=MIRROR), lamp=lamp, wall=plane(-7))
    np.testing.assert_allclose(depth, 8, rtol=UNFOLDED)
    assert names.tolist() == ["lamp"]


# ---------------------------------------------------------------- curved mirrors


def images_depth(mirror, wall, radius):
    """The mirror equation, 1/s + 1/s' = 2/r, r < 0 convex; ``inf`` for images at or behind."""
    image = 1 / (2 / radius - 1 / (mirror - wall))
    depth = mirror - image
    return depth if depth > 0 else np.inf


@pytest.mark.parametrize("wall", [-2.0, -50.0])
def test_a_convex_mirror_shows_small_images_behind_it(wall):
    depth, names, _ = looked_at(mirror=ball(4, 1), wall=plane(wall))
    np.testing.assert_allclose(depth, images_depth(3, wall, -1), rtol=PARAXIAL)
    assert names.tolist() == ["wall"]


@pytest.mark.parametrize(
    ("mirror", "wall", "expected"),
    [(1, -0.5, 7), (5, -2, 2.2), (1, -5, np.inf)],
    ids=["virtual", "real", "real, behind the camera"],
)
def test_a_concave_mirror_shows_images_behind_and_before_it(mirror, wall, expected):
    assert images_depth(mirror, wall, 4) == pytest.approx(expected)
    depth, names, _ = looked_at(mirror=ball(mirror - 4, 4), wall=plane(wall, size=0.1))
    np.testing.assert_allclose(depth, expected, rtol=PARAXIAL)
    assert names.tolist() == ["wall"]


def test_an_oblique_mirror_has_the_mean_of_both_its_images():
    """Coddington's equations: 2/(r cos i) in the plane of incidence, 2 cos i / r across."""
    sine = 0.6
    cosine = 0.8
    centre = [2 * sine, 0, 5 + 2 * cosine]
    shapes = {"mirror": {**ball(0, 2), "center": centre}}
    turned = -np.degrees(2 * np.arcsin(sine))
    shapes["wall"] = plane(5 + 3 * (sine**2 - cosine**2), x=-3 * 2 * sine * cosine, turn=turned)
    depth, names, _ = looked_at(**shapes)
    # From the mirror to the image; what is seen is 5 + that from the lens.
    images = [1 / (1 / 3 + 2 / (2 * cosine)), 1 / (1 / 3 + 2 * cosine / 2)]
    expected = 1 / np.mean([1 / (5 + image) for image in images])
    np.testing.assert_allclose(depth, expected, rtol=PARAXIAL)
    assert names.tolist() == ["wall"]


def test_a_cylinder_has_the_mean_of_its_plane_and_its_curved_image():
    bar = {"type": "cylinder", "p0": [0, -2, 4], "p1": [0, 2, 4], "radius": 1, "bsdf": MIRROR}
    depth, _, _ = looked_at(mirror=bar, wall=plane(-2))
    expected = 2 / (1 / images_depth(3, -2, -1) + 1 / 8)
    np.testing.assert_allclose(depth, expected, rtol=PARAXIAL)


@pytest.mark.parametrize("texcoords", [False, True])
def test_a_flat_mesh_with_smooth_normals_is_a_plane_mirror(texcoords):
    def flat(u, v):
        return np.zeros_like(u), np.stack([0 * u, 0 * u, -1 + 0 * u], axis=-1)

    mirror = mesh(3, flat, texcoords)
    depth, _, _ = looked_at(fan() * [[0.4], [0.4], [1]], mirror=mirror, wall=plane(-2))
    np.testing.assert_allclose(depth, 8, rtol=UNFOLDED)


@pytest.mark.parametrize("texcoords", [False, True])
def test_a_mesh_with_smooth_normals_is_curved_as_they_say(texcoords):
    mirror = mesh(3, bulge, texcoords)
    depth, _, _ = looked_at([0.01, 0.005, 1], mirror=mirror, wall=plane(-2))
    # Between vertices 1/128 of the radius apart, and 1/100 off the axis.
    np.testing.assert_allclose(depth, images_depth(3, -2, -4), rtol=2e-3)


def test_next_to_the_edge_of_a_curved_mirror_one_neighbour_will_do():
    bowl = {"type": "disk", "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).scale(0.5)}
    depth, _, _ = looked_at(
        np.array([0.4999 / 3, 0, 1]), mirror={**bowl, "bsdf": MIRROR}, wall=plane(-2)
    )
    np.testing.assert_allclose(depth, 8, rtol=UNFOLDED)
    depth, _, _ = looked_at([0.2581, 0, 1], mirror=ball(4, 1), wall=plane(30))
    assert np.isfinite(depth).all()


# ---------------------------------------------------------------- nothing at the end


def test_the_sky_in_a_plane_mirror_is_at_infinity():
    sky = {"type": "constant"}
    depth, names, turned = looked_at(fan(), mirror=plane(3, bsdf=MIRROR), sky=sky)
    assert np.isposinf(depth).all()
    assert turned.all()
    assert (names == "").all()


def test_the_sky_through_a_window_is_at_infinity():
    depth, names, _ = looked_at(fan(), pane=plane(3, bsdf={"type": "thindielectric"}))
    assert np.isposinf(depth).all()
    assert (names == "").all()


def test_the_sky_in_a_convex_mirror_is_at_its_focus():
    depth, names, _ = looked_at(mirror=ball(4, 1), sky={"type": "constant"})
    np.testing.assert_allclose(depth, 3 + 1 / 2, rtol=PARAXIAL)
    assert names.tolist() == [""]


def test_rays_that_hit_nothing_are_at_infinity():
    depth, names, turned = looked_at([[0, 1], [0, 0], [1, 0]], mirror=plane(3, size=1, bsdf=MIRROR))
    assert np.isposinf(depth).all()
    assert turned.tolist() == [True, False]
    assert names.tolist() == ["", ""]


# ---------------------------------------------------------------- scenes


def test_scenes_without_mirrors_are_told_apart():
    def scene(bsdf):
        return mi.load_dict({"type": "scene", "shape": ball(4, 1, bsdf)})

    for bsdf in [MIRROR, *PANES.values(), OPAQUE["rough mirror"], OPAQUE["hardly transparent"]]:
        assert has_specular(scene(bsdf))
    for bsdf in (WALL, OPAQUE["plastic"], {"type": "roughplastic"}):
        assert not has_specular(scene(bsdf))
    assert not has_specular(mi.load_dict({"type": "scene"}))


def test_without_mirrors_depth_is_that_of_the_first_hit():
    depth, names, turned = looked_at([[0, 1], [0, 0], [1, 1]], ball=ball(4, 1, WALL))
    np.testing.assert_allclose(depth, [3, np.inf])
    assert names.tolist() == ["ball", ""]
    assert not turned.any()


def test_mirrors_in_instances_are_found():
    group = {"type": "shapegroup", "shape": ball(0, 1)}
    place = mi.ScalarTransform4f().translate([0, 0, 4])
    instance = {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "group"}}
    depth, names, _ = looked_at(group=group, instance=instance, wall=plane(-2))
    np.testing.assert_allclose(depth, images_depth(3, -2, -1), rtol=PARAXIAL)
    assert names.tolist() == ["wall"]


@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "llvm_ad_mono"])
def test_other_variants_see_the_same(variant):
    mi.set_variant(variant)
    pane = plane(1, bsdf={"type": "thindielectric"})
    depth, names, _ = looked_at(pane=pane, mirror=ball(4, 1), wall=plane(-2))
    # The wall is seen through the pane.
    np.testing.assert_allclose(depth, images_depth(3, -2, -1), rtol=PARAXIAL)
    assert names.tolist() == ["wall"]


@pytest.mark.parametrize(("bounces", "error"), [(-1, ValueError), (1.5, TypeError)])
def test_bad_numbers_of_bounces_are_named(bounces, error):
    with pytest.raises(error, match=r"bounces=.*must be"):
        looked_at(bounces=bounces, ball=ball(4, 1))
