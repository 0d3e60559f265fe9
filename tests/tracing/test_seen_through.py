"""What is seen through mirrors and glass: which points of the lens see it, and what it becomes."""

import mitsuba as mi
import numpy as np
import pytest
from specular import GLASS, before_lens, cube, lamp, plane

import potmesil_mi as pm
from potmesil_mi.optics.disc import Disc
from potmesil_mi.samples.columns import ELSEWHERE

pytestmark = pytest.mark.usefixtures("variant_llvm")

PLAIN = {"type": "conductor", "material": "none"}
RADIUS = 0.06
FOCUS = 6.0
SIZE = 48
TINTED = {**GLASS, "specular_transmittance": 0.5}


def scene_of(spp=64, radius=RADIUS, **shapes):
    """``shapes`` before a lens, in SIZE pixels."""
    return before_lens(size=SIZE, spp=spp, radius=radius, focus=FOCUS, **shapes)


def images(samples, layer=0):
    """Where the samples of a layer that are seen through something have their images, (n, 3)."""
    chosen = samples.chosen((samples.layer == layer) & (samples.through > 0))
    camera = samples.camera
    left, up = (
        (middle - at) / camera.focal_length_pixels * chosen.z
        for middle, at in zip(camera.principal_point, (chosen.x, chosen.y), strict=True)
    )
    return chosen, np.stack([left, up, chosen.z], axis=1)


def bits(samples):
    """Which points see the samples, bool (N, 64)."""
    return (samples.visibility[:, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)) > 0


def crossing(samples, images, z):
    """Where rays from the points of the lens to the images cross the plane at ``z``, (n, 64, 2)."""
    points = samples.visibility_points
    share = z / images[:, 2, None, None]
    return points + share * (images[:, None, :2] - points)


def test_points_of_the_lens_see_an_image_where_their_rays_meet_the_mirror():
    # A mirror of 0.4 units, a bar before it, and a wall behind the camera.
    scene = scene_of(
        spp=4,
        mirror=plane(1, size=0.2, bsdf=PLAIN),
        bar={**lamp(0.5, 0.0), "to_world": bar_at(0.5)},
        wall=lamp(-5, facing=1),
        back=lamp(9),
    )
    samples = pm.render_samples(scene)
    for layer in (0, ELSEWHERE):
        some, image = images(samples, layer)
        assert len(some) > 100
        np.testing.assert_allclose(some.through, 1, rtol=1e-4)
        # Beside the image of the wall there is that of the bar.
        of_wall = some.z > 2
        some, image = some.chosen(of_wall), image[of_wall]
        np.testing.assert_allclose(some.z, 7, rtol=1e-4)
        at_mirror = np.abs(crossing(some, image, 1.0)).max(axis=2)
        # The bar is in the way, and again on the way back from the mirror.
        at_bar = np.minimum(*(np.abs(crossing(some, image, z))[..., 0] for z in (0.5, 1.5)))
        expected = (at_mirror < 0.2) & (at_bar > 0.01)
        clear = (np.abs(at_mirror - 0.2) > 1e-4) & (np.abs(at_bar - 0.01) > 1e-4)
        assert (bits(some) == expected)[clear].mean() > 0.9995
        assert clear.mean() > 0.9


@pytest.mark.parametrize("layer", [0, ELSEWHERE])
def test_points_that_are_not_tried_are_told_by_others_of_the_pixel(layer):
    # At 64 samples each tries 4 points.
    scene = scene_of(mirror=plane(1, size=0.2, bsdf=PLAIN), wall=lamp(-5, facing=1), back=lamp(9))
    some, image = images(pm.render_samples(scene), layer)
    expected = np.abs(crossing(some, image, 1.0)).max(axis=2) < 0.2
    found = bits(some)
    partly = ~expected.all(axis=1)
    assert partly.sum() > 1000
    assert (found == expected)[partly].mean() > 0.93
    assert abs(found[partly].mean() - expected[partly].mean()) < 0.01
    # No point sees more than it should, wherever in the lens it is.
    by_point = found[partly].mean(axis=0) - expected[partly].mean(axis=0)
    assert np.abs(by_point).max() < 0.03


@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_the_rim_of_a_bright_mirror_in_focus_has_no_halo(method):
    scene = scene_of(mirror=plane(1, size=0.2, bsdf=PLAIN), wall=lamp(-5, 20.0, 1), back=lamp(9))
    samples = pm.render_samples(scene)
    picture = np.array(pm.focus(samples, samples.lens.replace(focus_distance=1.0), method=method))
    profile = picture[SIZE // 2 - 6 : SIZE // 2 + 6, : SIZE // 2, 1].mean(axis=0)
    rim = SIZE / 2 - 0.2 * samples.camera.focal_length_pixels
    column = np.arange(SIZE // 2)
    np.testing.assert_allclose(profile[column + 3 < rim], 1, atol=0.1)
    np.testing.assert_allclose(profile[column - 2 > rim], 20, atol=1.0)


def bar_at(z):
    place = mi.ScalarTransform4f().translate([0, 0, z]).rotate([0, 1, 0], 180)
    return place.scale([0.01, 5, 1])


def test_what_the_pinhole_does_not_see_of_an_image_is_found_as_densely_as_what_it_sees():
    scene = scene_of(mirror=plane(1, size=0.2, bsdf=PLAIN), wall=lamp(-5, facing=1), back=lamp(9))
    samples = pm.render_samples(scene)
    some, image = images(samples, ELSEWHERE)
    # Beside the mirror, where some points see the image whose rays meet it.
    beside = (image[:, 0] > 0) & (np.abs(image[:, 1]) < 0.8)
    assert beside.any()
    column = np.floor(some.x[beside] * 4).astype(int)
    rows = SIZE * 1.6 / (7 * 2 * np.tan(np.radians(20)))
    total = np.bincount(column, some.weight[beside] * bits(some)[beside].mean(axis=1)) * 4 / rows
    # The lens of which a column of the image sees the mirror: a part of a disc.
    left = (SIZE / 2 - (np.arange(len(total)) + 0.5) / 4) / samples.camera.focal_length_pixels * 7
    edge = (0.2 - left / 7) / (6 / 7) / samples.visibility_radius[0]
    expected = Disc().corner_area(edge, np.ones_like(edge)) / np.pi
    outside = (left / 7 > 0.2 + 0.001) & (left / 7 < 0.2 + 0.04)
    assert outside.sum() >= 4
    np.testing.assert_allclose(total[outside], expected[outside], atol=0.08)


@pytest.mark.parametrize("method", ["layered", "lightfield"])
@pytest.mark.parametrize(
    ("window", "depth", "wall"),
    [
        (lambda: plane(1, size=0.2, bsdf=PLAIN), 1.0, lambda: lamp(-5, facing=1)),
        (lambda: cube(1, 0.01, bsdf=TINTED, size=0.2), 0.99, lambda: lamp(FOCUS, size=9)),
    ],
    ids=["mirror", "slab"],
)
def test_the_rim_is_blurred_by_its_own_depth(window, depth, wall, method):
    # Only the mirror shows light, or the slab takes most of it.
    scene = scene_of(spp=64, window=window(), wall=wall())
    samples = pm.render_samples(scene)
    picture = np.array(pm.focus(samples, method=method))[..., 1]
    profile = picture[SIZE // 2 - 6 : SIZE // 2 + 6].mean(axis=0)
    inside, beyond = profile[SIZE // 2 - 4 : SIZE // 2 + 4].mean(), profile[:4].mean()
    # The edge at the depth of the window, seen by each point of the lens in another place.
    middle = SIZE / 2 - 0.2 / depth * samples.camera.focal_length_pixels
    blur = RADIUS * samples.camera.focal_length_pixels * (1 / depth - 1 / FOCUS)
    across = (np.arange(SIZE // 2) + 0.5 - middle) / blur
    share = Disc().corner_area(across, np.ones_like(across)) / np.pi
    # The edge is upright: it passes several of the 64 points of the lens at once.
    np.testing.assert_allclose(
        profile[: SIZE // 2],
        beyond + share * (inside - beyond),
        atol=0.05,
    )


def test_scenes_without_windows_know_nothing_of_them():
    samples = pm.render_samples(scene_of(spp=1, wall=lamp(6), near=lamp(2, size=0.3)))
    assert samples.through is None
    assert samples.visibility is None
    assert samples.visibility_radius is None


@pytest.mark.parametrize("spp", [1, 4, 16])
def test_any_number_of_samples_finds_what_is_elsewhere(spp):
    samples = pm.render_samples(
        scene_of(spp=spp, mirror=plane(1, size=0.2, bsdf=PLAIN), wall=lamp(-5, facing=1))
    )
    elsewhere = samples.layer == ELSEWHERE
    assert elsewhere.sum() > 20
    assert samples.weight[elsewhere].max() <= 64 / spp + 1e-6
