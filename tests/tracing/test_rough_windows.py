"""What rough mirrors and rough glass show: an image, as long as its light is not spread too far."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from specular import GLASS, MIRROR, WALL, N, ball, cube, fan, loaded, looked_at, plane, visible_in

from potmesil_mi.tracing.onward import DULL, has_specular
from potmesil_mi.tracing.windows import Chain, meets_end

pytestmark = pytest.mark.usefixtures("variant_llvm")

IMAGE = 5e-4


def rough_mirror(alpha):
    return {"type": "roughconductor", "alpha": alpha, "distribution": "ggx"}


def rough_glass(alpha):
    return {**GLASS, "type": "roughdielectric", "alpha": alpha, "distribution": "ggx"}


def left_of_image(lobe):
    """Its weight, for a lobe in radians."""
    return max(1 - (lobe / DULL) ** 2, 0) ** 2


def mean_depth(weight, image, surface):
    return 1 / (weight / image + (1 - weight) / surface)


@pytest.mark.parametrize(
    ("smooth", "rough"), [(MIRROR, rough_mirror(1e-4)), (GLASS, rough_glass(1e-4))]
)
def test_what_is_hardly_rough_is_smooth(smooth, rough):
    shapes = {"behind": plane(7), "before": plane(-2)}
    expected, _, turned = looked_at(fan(), shown=ball(4, 1, smooth), **shapes)
    depth, names, also = looked_at(fan(), shown=ball(4, 1, rough), **shapes)
    assert turned.tolist() == also.tolist() == (names == "shown").tolist()
    np.testing.assert_allclose(depth, expected, rtol=IMAGE)


def test_a_mirror_goes_from_its_image_to_itself_as_it_gets_rough():
    for alpha in (0.02, 0.1, 0.19, 0.2, 0.5):
        depth, _, turned = looked_at(mirror=plane(3, bsdf=rough_mirror(alpha)), wall=plane(-2))
        expected = mean_depth(left_of_image(2 * alpha), 8, 3)
        np.testing.assert_allclose(depth, expected, rtol=IMAGE)
        assert turned.all() == (alpha < 0.2)


def test_both_faces_of_rough_glass_take_from_the_image():
    alpha = 0.3
    depth, _, _ = looked_at(slab=cube(3, 1, rough_glass(alpha)), wall=plane(7))
    near, far = (left_of_image(alpha * lobe) for lobe in (1 - 1 / N, N - 1))
    behind = mean_depth(far, 5 + 2 / N, 2 + 2 / N)
    np.testing.assert_allclose(depth, mean_depth(near, behind, 2), rtol=IMAGE)


def test_total_reflection_in_rough_glass():
    shapes = {
        "front": plane(3, size=1, bsdf=rough_glass(1e-3)),
        "across": plane(4, turn=45, facing=1, size=1.4, bsdf=rough_glass(1e-3)),
        "wall": plane(4, turn=90, x=-3),
    }
    depth, _, _ = looked_at(**shapes)
    np.testing.assert_allclose(depth, 3 + 4 / N, rtol=IMAGE)


def test_a_rough_mirror_in_a_mirror_has_the_depth_of_its_image():
    shapes = {"mirror": plane(3, bsdf=MIRROR), "wall": plane(9)}
    depth, _, _ = looked_at(rough=plane(-2, facing=1, bsdf=rough_mirror(0.5)), **shapes)
    np.testing.assert_allclose(depth, 8, rtol=IMAGE)
    shapes["wall"] = plane(2.5, size=0.01, x=0.5)
    depth, _, _ = looked_at(rough=plane(-2, facing=1, bsdf=rough_mirror(0.1)), bounces=2, **shapes)
    weight = left_of_image(0.2)
    np.testing.assert_allclose(depth, mean_depth(weight, 8 + 5, 8), rtol=IMAGE)


def test_the_chain_ends_at_what_is_rough():
    scene = loaded(mirror=plane(3, bsdf=rough_mirror(0.1)), wall=plane(-2))
    ray, visible = visible_in(scene)
    np.testing.assert_allclose(visible.hit.p.z, 3, rtol=1e-5)
    assert np.array(visible.turns).tolist() == [0]
    assert np.array(visible.is_rough).tolist() == [True]
    assert np.array(visible.throughput).ravel().tolist() == [1, 1, 1]
    assert np.array(visible.last.o).tolist() == np.array(ray.o).tolist()


def test_rays_of_the_lens_see_a_rough_mirror_where_they_meet_it():
    mirror = plane(3, x=1, size=1.005, bsdf=rough_mirror(0.1))
    scene = loaded(mirror=mirror, slab=cube(1, 0.2), wall=plane(-2), behind=plane(9))
    _, visible = visible_in(scene, (0.005, 0, 1))
    chain, image = Chain.of(visible), visible.depth * mi.Vector3f(0.005, 0, 1)
    lens = mi.Point3f([-0.06, 0, 0.06], 0, 0)
    ray = mi.Ray3f(lens, dr.normalize(image - lens))
    # The rim is at x = -0.005: the ray from x = -0.06 passes beside it.
    assert np.array(meets_end(scene, ray, chain, 1e-3)).tolist() == [False, True, True]


def test_roughness_is_found_wherever_it_is():
    def image_depth(bsdf):
        return looked_at(mirror=plane(3, bsdf=bsdf), wall=plane(-2))[0]

    texture = mi.Bitmap(np.tile(np.array([0.05, 0.15], "f")[None, :, None], (2, 1, 1)))
    texture = {"type": "bitmap", "raw": True, "bitmap": texture}
    expected = image_depth(rough_mirror(0.1))
    for bsdf in (
        {"type": "twosided", "bsdf": rough_mirror(0.1)},
        {"type": "roughconductor", "alpha_u": 0.05, "alpha_v": 0.15},
        rough_mirror(texture),
    ):
        np.testing.assert_allclose(image_depth(bsdf), expected, rtol=1e-5)


def test_roughness_is_found_in_instances():
    group = {"type": "shapegroup", "shape": ball(0, 1, rough_mirror(1e-3))}
    place = mi.ScalarTransform4f().translate([0, 0, 4])
    instance = {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "group"}}
    depth, _, _ = looked_at(group=group, instance=instance, sky={"type": "constant"})
    np.testing.assert_allclose(depth, 3 + 1 / 2, rtol=IMAGE)


@pytest.mark.parametrize("bsdf", [WALL, {"type": "roughplastic"}, {"type": "principled"}])
def test_what_is_dull_below_shows_no_image(bsdf):
    assert not has_specular(loaded(shown=plane(3, bsdf=bsdf)))
