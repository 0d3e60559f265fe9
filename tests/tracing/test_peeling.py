"""What is sampled beyond what the pinhole sees: hidden surfaces and overscan."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.optics.blur import widest_radius_per_vergence
from potmesil_mi.samples.columns import ELSEWHERE
from potmesil_mi.tracing import peeling
from potmesil_mi.tracing.lens_rays import lens_point
from scenes import LENS, diffuse

pytestmark = pytest.mark.usefixtures("variant_llvm")

COLUMNS = ("x", "y", "rgb", "alpha", "z", "surface", "weight")
NO_OVERSCAN = pm.Sampling(overscan=0, refine=0)
CHECKS = {
    "type": "checkerboard",
    "color0": {"type": "rgb", "value": [0.2, 0.4, 0.7]},
    "color1": {"type": "rgb", "value": [0.9, 0.1, 0.3]},
}


def at(x, y, z):
    return mi.ScalarTransform4f().translate([x, y, z])


def glowing(left, right, z, radiance=CHECKS, height=6.0):
    """A thin quad from ``left`` to ``right``, whose radiance no other shape changes."""
    # No edge of the checks is on a grid of pixels.
    place = at((left + right) / 2, 0.013, z).rotate([0, 1, 0], 180)
    return {
        "type": "rectangle",
        "to_world": place.scale([(right - left) / 2, height / 2, 1]),
        "bsdf": diffuse(0, 0, 0),
        "emitter": {"type": "area", "radiance": radiance},
    }


def plain(left, right, z, height=6.0):
    """The same, lit by the sky."""
    quad = glowing(left, right, z, height=height)
    return {"type": "rectangle", "to_world": quad["to_world"], "bsdf": diffuse(0.5, 0.5, 0.5)}


def ball(**changes):
    sphere = {"type": "sphere", "center": [0, 0, 2.3], "radius": 0.3, "bsdf": diffuse(0.8, 0.3, 0)}
    return {**sphere, **changes}


def shown(*, spp=4, film=None, integrator=None, f_number=0.1, focus_distance=2.0, **shapes):
    """A scene under a sky, seen by a lens with a large aperture: 60 pixels to a slope of 1."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, **(integrator or {})},
            "sensor": {
                "type": "potmesil",
                **LENS,
                "f_number": f_number,
                "focus_distance": focus_distance,
                "film": {
                    "type": "hdrfilm",
                    "width": 48,
                    "height": 32,
                    "rfilter": {"type": "box"},
                    **(film or {}),
                },
                "sampler": {"type": "independent", "sample_count": spp},
            },
            "sky": {"type": "constant", "radiance": 0.5},
            **shapes,
        },
        optimize=False,  # it makes one surface of all quads of one material
    )


def layers(samples):
    """The samples of each layer, as dictionaries of columns."""
    last = samples.layer[samples.layer < ELSEWHERE].max()
    return [
        {f.name: getattr(samples, f.name)[samples.layer == i] for f in samples.present()}
        for i in range(last + 1)
    ]


def positions(columns):
    return columns["x"].astype(np.float64) + 1j * columns["y"]


def hidden_behind(samples, name, layer=1):
    """The samples of a layer where the pinhole sees the surface of that ``name``."""
    ids = [i for i, known in samples.surfaces.items() if known == name]
    every = layers(samples)
    visible = positions(every[0])[np.isin(every[0]["surface"], ids)]
    if layer >= len(every):
        return {column: every[0][column][:0] for column in COLUMNS}
    chosen = np.isin(positions(every[layer]), visible)
    return {column: values[chosen] for column, values in every[layer].items()}


def names(samples, columns):
    """The surfaces that more than 1 % of some samples show.

    A ray that grazes a limb may meet the far side within what single precision tells apart.
    """
    ids, counts = np.unique(columns["surface"], return_counts=True)
    return {samples.surfaces.get(int(i), "nothing") for i in ids[counts > 0.01 * counts.sum()]}


def of_surface(samples, columns, name):
    """Those of some samples that show the surface of that ``name``, or no surface for ``None``."""
    ids = [0] if name is None else [i for i, known in samples.surfaces.items() if known == name]
    chosen = np.isin(columns["surface"], ids)
    assert chosen.mean() > 0.99
    return {column: values[chosen] for column, values in columns.items()}


# ---------------------------------------------------------------- what is behind


@pytest.mark.parametrize("pattern", ["sampler", "uniform", "adaptive"])
def test_behind_a_ball_is_what_a_render_without_it_shows(pattern):
    sampling = pm.Sampling(pattern, overscan=0, threshold=0.0, subdivisions=1)
    wall = glowing(-3.1, 2.95, 4)
    samples = pm.render_samples(shown(ball=ball(), wall=wall), sampling=sampling)
    bare = layers(pm.render_samples(shown(wall=wall), sampling=sampling))[0]
    behind = hidden_behind(samples, "ball")
    behind = of_surface(samples, behind, "wall")
    assert len(behind["x"]) > 300
    np.testing.assert_allclose(behind["z"], 4, rtol=1e-5)
    assert (behind["alpha"] == 1).all()
    place = {p: i for i, p in enumerate(positions(bare))}
    both = np.isin(positions(behind), positions(bare))  # adaptive subdivision goes elsewhere
    assert both.sum() > 100
    same = [place[p] for p in positions(behind)[both]]
    np.testing.assert_allclose(behind["rgb"][both], bare["rgb"][same], atol=1e-6)


def test_hidden_surfaces_are_sampled_where_the_lens_can_see_past_the_silhouette():
    samples = pm.render_samples(shown(ball=ball(), wall=glowing(-3, 3, 4)), sampling=NO_OVERSCAN)
    scale = widest_radius_per_vergence(samples.lens, samples.camera, 2.0)
    every = layers(samples)
    on_ball = every[0]["surface"] == 1
    from_middle = np.hypot(every[0]["x"] - 24, every[0]["y"] - 16)
    # How far inside the silhouette each sample lies, and how far the lens sees past it.
    inside = from_middle[on_ball].max() - from_middle[on_ball]
    parallax = scale * (1 / every[0]["z"][on_ball].max() - 1 / 4)
    sampled = np.isin(positions(every[0])[on_ball], positions(every[1]))
    # From farther inside only the rim of the lens sees anything: less than a fifth of it.
    assert sampled[inside < 0.5 * parallax].mean() > 0.99
    assert not sampled[inside > parallax + 0.1].any()
    # On the wall away from the ball nothing is hidden.
    assert not np.isin(positions(every[0])[from_middle > 11], positions(every[1])).any()


def test_inside_a_large_ball_nothing_is_sampled():
    scene = shown(ball=ball(radius=0.4), wall=glowing(-3, 3, 4), f_number=0.5)
    samples = pm.render_samples(scene, sampling=NO_OVERSCAN)
    behind = hidden_behind(samples, "ball")
    inside = np.hypot(behind["x"] - 24, behind["y"] - 16)
    assert len(inside) > 50
    assert inside.min() > 5


@pytest.mark.parametrize(
    "shape",
    [
        {"type": "sphere", "center": [0, 0, 2.3], "radius": 0.3},
        {"type": "cylinder", "p0": [0, -0.3, 2.3], "p1": [0, 0.3, 2.3], "radius": 0.2},
        {"type": "cube"},
    ],
    ids=lambda shape: shape["type"],
)
def test_the_far_side_of_closed_shapes_is_passed(shape):
    if shape["type"] == "cube":
        shape = {**shape, "to_world": at(0, 0, 2.3).rotate([0, 1, 0], 30).scale(0.2)}
    scene = shown(thing=shape, wall=glowing(-3, 3, 4))
    samples = pm.render_samples(scene, sampling=pm.Sampling(layers=4, overscan=0))
    assert names(samples, hidden_behind(samples, "thing")) == {"wall"}


def test_what_is_inside_a_closed_shape_is_never_sampled():
    stone = {"type": "sphere", "center": [0, 0, 2.3], "radius": 0.28}
    scene = shown(ball=ball(), stone=stone, wall=glowing(-3, 3, 4))
    samples = pm.render_samples(scene, sampling=pm.Sampling(layers=4, overscan=0))
    stones = [i for i, name in samples.surfaces.items() if name == "stone"]
    assert np.isin(samples.surface, stones).sum() <= 1
    assert names(samples, hidden_behind(samples, "ball")) == {"wall"}


def test_the_far_side_of_closed_shapes_that_overlap_is_passed():
    other = ball(center=[0.2, 0, 2.6])
    scene = shown(ball=ball(), other=other, wall=glowing(-3, 3, 4))
    samples = pm.render_samples(scene, sampling=NO_OVERSCAN)
    depths = samples.z[(samples.layer == 1) & (samples.surface > 0)]
    others = [i for i, name in samples.surfaces.items() if name == "other"]
    from_inside = np.isin(samples.surface, others) & (samples.layer == 1) & (samples.z > 2.6)
    assert depths.size > 300
    assert not from_inside.any()


@pytest.mark.parametrize("shape", ["sphere", "cube"])
def test_the_far_side_of_a_closed_shape_with_turned_normals_is_passed(shape):
    place = at(0, 0, 2.3).scale(0.25)
    thing = {"type": shape, "to_world": place, "flip_normals": True, "bsdf": diffuse(0.5, 0.5, 0)}
    scene = shown(thing=thing, wall=glowing(-3, 3, 4))
    samples = pm.render_samples(scene, sampling=NO_OVERSCAN)
    assert names(samples, hidden_behind(samples, "thing")) == {"wall"}


def test_the_papers_method_takes_samples_with_overscan():
    samples = pm.render_samples(near_the_frame(film=CROP), sampling=pm.Sampling(overscan=12))
    for focus_distance in (1.2, 2.0, 4.0, np.inf):
        lens = samples.lens.replace(focus_distance=focus_distance)
        image = np.array(pm.focus(samples, lens, method="paper"))
        assert image.shape[:2] == (16, 24)
        assert np.isfinite(image).all()


def test_an_open_quad_behind_another_is_sampled():
    shapes = {"near": plain(-0.3, 0.3, 2), "far": plain(-0.6, 0.6, 2.5)}
    samples = pm.render_samples(shown(**shapes, wall=glowing(-3, 3, 4)), sampling=NO_OVERSCAN)
    behind = hidden_behind(samples, "near")
    assert len(behind["x"]) > 300
    assert names(samples, behind) == {"far"}
    np.testing.assert_allclose(behind["z"], 2.5, rtol=1e-5)


def test_behind_a_room_the_camera_is_in_is_nothing_of_the_room():
    room = {"type": "cube", "to_world": at(0, 0, 2).scale([4, 4, 4]), "bsdf": diffuse(0.5, 0.5, 0)}
    lit = {"type": "point", "position": [0, 1, 0], "intensity": 3.0}
    samples = pm.render_samples(shown(room=room, ball=ball(), sky=lit), sampling=NO_OVERSCAN)
    behind = hidden_behind(samples, "ball")
    behind = of_surface(samples, behind, "room")
    assert len(behind["x"]) > 300
    np.testing.assert_allclose(behind["z"], 6, rtol=1e-5)


def test_a_mask_hides_only_where_it_is_opaque():
    holes = {
        "type": "mask",
        "opacity": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.tile([[0.0, 1.0], [1.0, 0.0]], (2, 2)).astype(np.float32)),
            "filter_type": "nearest",
            "raw": True,
        },
        "bsdf": diffuse(0.6, 0.6, 0.1),
    }
    grille = {**plain(-0.6, 0.6, 2, height=1.2), "bsdf": holes}
    samples = pm.render_samples(
        shown(grille=grille, wall=glowing(-3, 3, 4)), sampling=pm.Sampling(layers=3, overscan=0)
    )
    every = layers(samples)
    assert {1, 2} == set(every[0]["surface"])
    behind = hidden_behind(samples, "grille")
    assert len(behind["x"]) > 300
    assert names(samples, behind) == {"wall"}
    np.testing.assert_allclose(behind["z"], 4, rtol=1e-5)
    # Through the holes the wall is the first surface, and behind it is none.
    assert names(samples, hidden_behind(samples, "wall")) <= {"nothing"}


def test_few_looks_at_each_of_many_targets_are_from_all_around_the_lens():
    # From a few directions alone, walls behind a pole were missed in whole pixels.
    number, step = (np.ravel(n) for n in np.meshgrid(np.arange(64), np.arange(peeling.FEW_POINTS)))
    x, y = (np.array(n) for n in lens_point(mi.UInt32(number), mi.UInt32(step)))
    assert np.hypot(x, y).max() <= 1
    for least in (0.5, 0.8):
        outer = np.hypot(x, y) > least
        angles = np.sort(np.arctan2(y, x)[outer])
        gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
        assert np.degrees(gaps.max()) < 32


def test_the_holes_of_a_mask_behind_a_strip_are_looked_through():
    def behind_a_strip(opacity):
        mask = {"type": "mask", "opacity": opacity, "bsdf": diffuse(0.6, 0.6, 0.1)}
        shapes = {"grille": {**plain(-2, 2, 2.5), "bsdf": mask}, "wall": glowing(-3, 3, 4)}
        samples = pm.render_samples(shown(strip=plain(-0.2, 0.2, 2), **shapes), spp=2)
        return names(samples, hidden_behind(samples, "strip"))

    assert behind_a_strip(0.0) == {"wall"}
    assert behind_a_strip(1.0) == {"grille"}


def test_layers_are_what_one_ray_meets_one_after_the_other():
    strips = {
        "a": plain(-0.08, 0.08, 2),
        "b": plain(-0.1, 0.1, 2.5),
        "c": plain(-0.12, 0.12, 3),
        "d": glowing(-3, 3, 4),
    }
    counts = []
    for number in (1, 2, 3, 4):
        sampling = pm.Sampling(layers=number, overscan=0, refine=0)
        samples = pm.render_samples(shown(**strips), sampling=sampling)
        counts.append(np.bincount(samples.layer, minlength=4).tolist())
        assert samples.layer.max() == number - 1
    assert counts[3][0] == 48 * 32 * 4
    for number, count in enumerate(counts, start=1):
        # Whether a surface is looked at from the whole lens depends on its neighbours.
        np.testing.assert_allclose(count[:number], counts[3][:number], rtol=0.15)
    for layer, name, depth in ((1, "b", 2.5), (2, "c", 3.0), (3, "d", 4.0)):
        behind = hidden_behind(samples, "a", layer)
        assert len(behind["x"]) > 100
        seen = of_what(samples, name, behind)
        assert len(seen["z"]) > 0.75 * len(behind["z"])
        np.testing.assert_allclose(seen["z"], depth, rtol=1e-5)


def test_many_surfaces_behind_each_other_take_no_more_kernels_than_few():
    """Rays are followed in one kernel, however deep they go."""

    def kernels(count):
        quads = {f"quad{i}": plain(-0.1, 0.1, 1.5 + 0.2 * i, height=0.2) for i in range(count)}
        scene = shown(wall=glowing(-9, 9, 4.0, height=20.0), **quads)
        pm.render_samples(scene)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            samples = pm.render_samples(scene)
            return samples.layer.max(), len(dr.kernel_history())

    (few_layers, few), (many_layers, many) = kernels(2), kernels(10)
    assert many_layers > few_layers
    assert many <= few


def test_where_there_was_too_little_room_rays_are_followed_again(monkeypatch):
    scene = shown(near=plain(-0.5, 0.5, 1.5), far=glowing(-9, 9, 4.0, height=20.0))
    expected = pm.render_samples(scene)
    follow, rooms = peeling._follow, []

    def followed(*arguments):
        rooms.append(dr.width(arguments[-1].step))
        follow(*arguments)

    monkeypatch.setattr(peeling, "_follow", followed)
    monkeypatch.setattr(peeling, "LEAST_ROOM", 1)
    monkeypatch.setattr(peeling, "USUALLY_MET", 1)
    samples = pm.render_samples(scene)
    assert len(rooms) == 2
    assert rooms[0] < rooms[1]
    assert (expected.layer > 0).any()
    for name in (*COLUMNS, "layer"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(expected, name))


class FakeLens:
    """Its first points see what is told; the others are only counted."""

    def __init__(self, sees):
        self.sees, self.again = sees, []

    def see(self, target, first, end):
        if not self.again:
            self.again.append(0)
            return mi.Bool(self.sees)
        self.again[0] = dr.width(target)
        return dr.full(mi.Bool, True, dr.width(target))


@pytest.mark.parametrize(("in_vain", "again"), [(31, 31 + 9), (32, 9)])
@pytest.mark.parametrize("cell", [0, 2**32 - 1])
def test_enough_samples_that_look_in_vain_speak_for_all_of_their_surface(cell, in_vain, again):
    """One of ten samples of a surface is seen, and none of those of another beside it.

    Votes take no memory for cells without rays, however high the numbers of the others are.
    """
    surface = np.repeat([1, 2], [10, in_vain])
    sees = np.arange(len(surface)) == 3
    zero = dr.zeros(mi.UInt32, len(surface))
    target = peeling.Target(
        point=dr.zeros(mi.Point3f, len(surface)),
        normal=mi.Normal3f(0, 0, -1),
        direction=mi.Vector3f(0, 0, 1),
        met=dr.full(mi.Bool, True, len(surface)),
        number=zero,
    )
    lens = FakeLens(sees)
    kept = np.array(peeling._sees(lens, target, zero + cell, zero, mi.UInt32(surface)))
    assert lens.again == [again]
    np.testing.assert_array_equal(kept, (surface == 1) | (in_vain < peeling.ENOUGH))


def test_one_layer_gives_no_hidden_samples():
    scene = shown(ball=ball(), wall=glowing(-3, 3, 4))
    samples = pm.render_samples(scene, sampling=pm.Sampling(layers=1, overscan=0, refine=0))
    assert len(samples) == 48 * 32 * 4
    assert not samples.layer.any()


def test_a_pinhole_gives_no_hidden_samples_and_no_overscan():
    samples = pm.render_samples(shown(ball=ball(), wall=glowing(-3, 3, 4), f_number=np.inf))
    assert not samples.layer.any()
    assert samples.window == (0, 0, 48, 32)


def test_the_sky_behind_a_ball_is_at_infinity_and_no_surface():
    samples = pm.render_samples(shown(ball=ball()), sampling=NO_OVERSCAN)
    behind = of_surface(samples, hidden_behind(samples, "ball"), None)
    assert len(behind["x"]) > 300
    assert np.isinf(behind["z"]).all()
    np.testing.assert_allclose(behind["rgb"], 0.5, atol=1e-6)


def test_beyond_the_far_clipping_plane_nothing_is_sampled():
    scene = shown(ball=ball(), wall=glowing(-3, 3, 4))
    sensor = pm.potmesil_sensor(
        mi.load_dict({**scene.sensors()[0].lens().to_thinlens(), "far_clip": 3.0}),
        focal_length=50.0,
    )
    samples = pm.render_samples(scene, sensor, spp=1, sampling=NO_OVERSCAN)
    assert names(samples, layers(samples)[1]) == {"nothing"}


def test_a_mirror_hides_what_is_behind_it_and_not_behind_its_image():
    mirror = {**plain(-0.3, 0.3, 2), "bsdf": {"type": "conductor", "material": "none"}}
    # The wall is behind the camera, its image before the sky.
    samples = pm.render_samples(
        shown(mirror=mirror, wall=glowing(-9, 9, -0.2, height=18)), sampling=NO_OVERSCAN
    )
    first, *hidden = layers(samples)
    in_mirror = np.abs(first["x"] - 24) < 8.9
    assert names(samples, {"surface": first["surface"][in_mirror]}) == {"wall"}
    np.testing.assert_allclose(first["z"][in_mirror], 4.2, rtol=1e-4)
    np.testing.assert_allclose(first["through"][in_mirror], 2, rtol=1e-4)
    assert len(hidden) == 1
    behind = np.abs(hidden[0]["x"] - 24) < 8.9
    assert np.isinf(hidden[0]["z"][behind]).all()
    assert behind.any()


def test_lamps_that_are_not_shown_are_not_behind_anything_either():
    panel = glowing(-0.6, 0.6, 3, radiance={"type": "rgb", "value": 5.0})
    shapes = {"ball": ball(), "panel": panel, "wall": plain(-3, 3, 4)}
    for hide, expected in ((False, {"panel"}), (True, {"wall"})):
        scene = shown(integrator={"hide_emitters": hide}, **shapes)
        samples = pm.render_samples(scene, sampling=NO_OVERSCAN)
        assert names(samples, hidden_behind(samples, "ball")) == expected


def test_a_hidden_sample_has_the_weight_and_place_of_the_one_before_it():
    scene = shown(ball=ball(), wall=glowing(-3, 3, 4))
    for pattern in ("sampler", "uniform", "adaptive"):
        sampling = pm.Sampling(pattern, overscan=0, subdivisions=1, refine=0)
        every = layers(pm.render_samples(scene, sampling=sampling))
        place = {p: i for i, p in enumerate(positions(every[0]))}
        assert len(place) == len(every[0]["x"])
        same = [place[p] for p in positions(every[1])]
        np.testing.assert_array_equal(every[1]["weight"], every[0]["weight"][same])
        assert (every[1]["z"] > every[0]["z"][same]).all()


def test_a_wider_aperture_to_come_is_allowed_for():
    scene = shown(ball=ball(), wall=glowing(-3, 3, 4), f_number=0.5)
    own, wide, narrow = (
        pm.render_samples(scene, spp=1, sampling=pm.Sampling(min_f_number=n))
        for n in (None, 0.1, 4.0)
    )
    hidden = [np.count_nonzero(s.layer) for s in (narrow, own, wide)]
    assert hidden[0] < hidden[1] < hidden[2] / 1.5
    windows = [s.window[2] * s.window[3] for s in (narrow, own, wide)]
    assert windows[0] < windows[1] < windows[2]
    assert own.lens == wide.lens == scene.sensors()[0].lens()


def tube(**place):
    """A cylinder without caps, into which the camera looks from one side."""
    ends = {"p0": [0, -0.1, 2.2], "p1": [0, 0.5, 2.9], "radius": 0.25, **place}
    return {"type": "cylinder", **ends, "bsdf": {"type": "twosided", "b": diffuse(0.5, 0.5, 0)}}


def test_the_inside_of_an_open_tube_is_sampled_where_the_lens_looks_into_it():
    """The sides that the pinhole's rays come out of are turned away from the lens, too."""
    samples = pm.render_samples(shown(tube=tube(), wall=glowing(-3, 3, 4)), sampling=NO_OVERSCAN)
    inner = of_what(samples, "tube", layers(samples)[1])
    assert len(inner["x"]) > 60


def of_what(samples, name, columns):
    ids = [i for i, known in samples.surfaces.items() if known == name]
    chosen = np.isin(columns["surface"], ids)
    return {column: values[chosen] for column, values in columns.items()}


def test_light_behind_a_shut_door_is_seen_by_no_point_of_the_lens():
    door = {"type": "cube", "to_world": at(0, 0, 3).scale([4, 4, 0.05]), "bsdf": diffuse(0.4, 0, 0)}
    lamp = glowing(-1, 1, 3.4, radiance={"type": "rgb", "value": 100.0})
    leg = plain(-0.1, 0.1, 2)
    samples = pm.render_samples(shown(leg=leg, door=door, lamp=lamp), sampling=NO_OVERSCAN)
    assert names(samples, hidden_behind(samples, "leg")) == {"door"}
    assert samples.layer.max() == 1
    assert samples.rgb.max() < 2


@pytest.mark.parametrize("size", [1e-3, 1e6])
def test_scenes_of_any_size_have_the_same_hidden_surfaces(size):
    counts = [np.bincount(scaled_scene_samples(factor).layer) for factor in (1.0, size)]
    assert counts[0][0] == 48 * 32 * 4
    assert counts[0][1] > 300
    np.testing.assert_allclose(counts[1], counts[0], rtol=0.01, atol=2)


def scaled_scene_samples(size):
    """Samples of a ball, a strip and a wall, in units of which ``size`` are a metre."""
    shapes = {
        "ball": {"type": "sphere", "to_world": at(0, 0, 2.3).scale(0.3), "bsdf": diffuse(1, 1, 0)},
        "strip": plain(-0.4, 0.1, 2.9),
        "wall": glowing(-3, 3, 4),
    }
    for shape in shapes.values():
        shape["to_world"] = mi.ScalarTransform4f().scale(size) @ shape["to_world"]
    lens = {**LENS, "f_number": 0.1, "focus_distance": 2.0 * size}
    scene = shown(**shapes)
    sensor = mi.load_dict(
        {
            "type": "potmesil",
            **lens,
            "millimeters_per_unit": 1000 / size,
            "near_clip": 0.01 * size,
            "far_clip": 1e4 * size,
            "film": scene.sensors()[0].film(),
            "sampler": scene.sensors()[0].sampler(),
        }
    )
    return pm.render_samples(scene, sensor, sampling=NO_OVERSCAN)


# ---------------------------------------------------------------- overscan


def near_the_frame(**options):
    """A ball that is just beyond the right side of a crop window, before a wall in focus."""
    shapes = {"ball": ball(center=[-0.36, 0, 1.2], radius=0.1), "wall": glowing(-6, 6, 4)}
    return shown(focus_distance=4.0, **shapes, **options)


CROP = {"crop_offset_x": 12, "crop_offset_y": 8, "crop_width": 24, "crop_height": 16}


def test_overscan_reaches_as_far_as_the_circles_of_confusion():
    # All that is beyond the window is a wall at 4 m; the focus may be set from 1 m on.
    scene = shown(wall=glowing(-60, 60, 4, height=120), ball=ball(center=[0, 0, 1.1], radius=0.1))
    samples = pm.render_samples(scene, spp=1)
    scale = widest_radius_per_vergence(samples.lens, samples.camera, 1.0)
    reach = scale * (1 - 1 / 4)
    left, top, width, height = samples.window
    margins = np.array([-left, -top, left + width - 48, top + height - 32])
    assert (margins >= reach - 1).all()
    assert (margins <= reach + 2).all()


def test_overscan_covers_the_circles_that_reach_the_window_and_no_more():
    samples = pm.render_samples(near_the_frame(film=CROP), spp=1)
    scale = widest_radius_per_vergence(samples.lens, samples.camera, 4.0)
    reach = scale * (1 / 1.2 - 1 / 4)
    left, top, width, height = samples.window
    # On the other sides is only the wall, on which the lens is focused.
    assert (left, top, height) == (12, 8, 16)
    assert 36 + reach - 2 < left + width < 36 + reach + 2


@pytest.mark.parametrize("margin", [0, 1, 7])
def test_overscan_is_as_wide_as_is_asked_for(margin):
    samples = pm.render_samples(
        near_the_frame(film=CROP), sampling=pm.Sampling(overscan=margin, layers=1, refine=0)
    )
    assert samples.window == (12 - margin, 8 - margin, 24 + 2 * margin, 16 + 2 * margin)
    assert len(samples) == (24 + 2 * margin) * (16 + 2 * margin) * 4
    assert (np.bincount(samples.pixel()) == 4).all()
    assert samples.camera.crop_size == (24, 16)


def test_the_samples_of_the_crop_window_come_first_and_are_those_without_overscan():
    scene = near_the_frame(film=CROP)
    with_it, without = (
        pm.render_samples(scene, seed=3, sampling=pm.Sampling(overscan=n, layers=1, refine=0))
        for n in (6, 0)
    )
    count = 24 * 16 * 4
    assert len(without) == count
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(with_it, name)[:count], getattr(without, name))


@pytest.mark.parametrize("pattern", ["uniform", "adaptive"])
def test_a_grid_covers_the_overscan_too(pattern):
    sampling = pm.Sampling(pattern, overscan=3, layers=1, threshold=1.0, subdivisions=1)
    samples = pm.render_samples(near_the_frame(film=CROP), spp=1, sampling=sampling)
    assert samples.window == (9, 5, 30, 22)
    assert (samples.x.min(), samples.x.max()) == (9, 39)
    assert (samples.y.min(), samples.y.max()) == (5, 27)


@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_pictures_at_the_border_agree_with_the_middle_of_a_larger_one(method):
    whole = pm.focus(pm.render_samples(near_the_frame(spp=16)), method=method)
    middle = np.array(whole)[8:24, 12:36]
    errors = {}
    for name, sampling in (("automatic", pm.Sampling()), ("none", NO_OVERSCAN)):
        samples = pm.render_samples(near_the_frame(film=CROP, spp=16), sampling=sampling)
        image = np.array(pm.focus(samples, method=method))
        assert image.shape == middle.shape
        errors[name] = np.abs(image - middle)[:, -4:].mean()
    assert errors["automatic"] < 0.025
    assert errors["none"] > 3 * errors["automatic"]
