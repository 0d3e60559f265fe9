"""What others ask of a sensor, Mitsuba's projective cameras beside ours."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from potmesil_mi import TelecentricLens, ThinLens, potmesil_sensor, render_samples
from scenes import still_life

BUILTIN = {"type": "perspective"}
OURS = {"type": "potmesil", "f_number": 5.6}
PARALLEL = {"type": "potmesil_orthographic", "half_angle": 2.0, "focus_distance": 3.0}
CROP = {"crop_offset_x": 7, "crop_offset_y": 3, "crop_width": 31, "crop_height": 20}


def film(width=48, height=32, **parameters):
    pixels = "luminance" if "mono" in mi.variant() else "rgb"
    size = {"width": width, "height": height}
    return {"type": "hdrfilm", "pixel_format": pixels, **size, **parameters}


def load(kind, **parameters):
    """A sensor on a small film, in a general position."""
    place = mi.ScalarTransform4f().look_at(origin=[1, -2, 3.5], target=[0, 1, -1], up=[0, 1, 0])
    return mi.load_dict({**kind, "film": film(), "to_world": place, **parameters})


def update(sensor, **values):
    """The sensor's parameters after an update by these."""
    parameters = mi.traverse(sensor)
    for name, value in values.items():
        parameters[name] = value
    parameters.update()
    return parameters


def number(value):
    return float(np.array(value).item())


def fov_of(parameters):
    """The key of the field of view in the parameters of a scene."""
    return next(key for key, _ in parameters if key.endswith("x_fov"))


def rays(sensor, count=32):
    """Origins, directions and lengths of random rays, (7, count)."""
    x, y = np.random.default_rng(1981).random((2, count), dtype=np.float32)
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    return np.concatenate([np.array(ray.o), np.array(ray.d), [np.array(ray.maxt)]])


# ---------------------------------------------------------------- names


@pytest.mark.parametrize(
    ("builtin", "ours"),
    [
        (BUILTIN, OURS),
        ({"type": "thinlens", "aperture_radius": 0.1}, OURS),
        ({"type": "orthographic"}, PARALLEL),
    ],
    ids=["perspective", "thinlens", "orthographic"],
)
def test_whatever_is_asked_of_the_builtin_sensor_is_there(variants, builtin, ours):
    theirs, mine = load(builtin), load(ours)
    assert set(mi.traverse(theirs).keys()) <= set(mi.traverse(mine).keys())
    assert {name for name in dir(theirs) if not name.startswith("_")} <= set(dir(mine))
    assert str(mine.bbox()) == str(theirs.bbox())
    for name in ("near_clip", "far_clip", "shutter_open", "shutter_open_time"):
        assert getattr(mine, name)() == pytest.approx(getattr(theirs, name)(), rel=1e-7)
    assert mine.get_medium() is theirs.get_medium() is None


# ---------------------------------------------------------------- the focus that a sensor states


def test_the_focus_that_a_perspective_states_is_kept(variants):
    sensor = load(BUILTIN, fov=40.0, focus_distance=6.0)
    assert potmesil_sensor(sensor, f_number=2).focus_distance() == 6
    assert potmesil_sensor(sensor).lens().focus_distance == 6
    assert potmesil_sensor(sensor, f_number=2, focus_distance=3).focus_distance() == 3


@pytest.mark.parametrize("stated", [{}, {"focus_distance": 0.0}, {"far_clip": 50.0}], ids=str)
def test_a_perspective_that_states_no_focus_is_focused_at_infinity(variant_llvm, stated):
    assert potmesil_sensor(load(BUILTIN, **stated), f_number=2).focus_distance() == math.inf


@pytest.mark.parametrize("lens", [{}, {"aperture_radius": 1e-4}, {"f_number": math.inf}], ids=str)
def test_a_focus_nearer_than_the_focal_length_narrows_the_frame(variant_llvm, lens):
    """A scene unit is a metre by default, and the scene may be a centimetre across."""
    sensor = potmesil_sensor(load(BUILTIN, fov=40.0, focus_distance=0.015625), **lens)
    assert sensor.focus_distance() == 0.015625
    assert sensor.lens().fov == pytest.approx(40, rel=1e-6)
    assert sensor.lens().frame_width < 36
    with pytest.raises(ValueError, match=r"focus_distance=-1: "):
        potmesil_sensor(load(BUILTIN), focus_distance=-1)


def test_an_f_number_that_the_stated_focus_has_no_room_for_is_refused(variant_llvm):
    with pytest.raises(ValueError, match=r"focus_distance=0\.015625: .*beyond the focal length"):
        potmesil_sensor(load(BUILTIN, focus_distance=0.015625), f_number=2)


def test_the_focus_that_an_orthographic_states_is_kept(variant_llvm):
    sensor = mi.load_dict({"type": "orthographic", "focus_distance": 6.0})
    assert potmesil_sensor(sensor, half_angle=2.0).lens() == TelecentricLens(2.0, 6.0)
    assert potmesil_sensor(sensor, half_angle=2.0, focus_distance=3.0).focus_distance() == 3
    with pytest.raises(TypeError, match="half_angle must be given"):
        potmesil_sensor(sensor)


def test_samples_are_focused_where_the_perspective_says(variant_llvm):
    scene = still_life(sensor={**BUILTIN, "fov": 40.0, "focus_distance": 2.5}, spp=1)
    assert render_samples(scene).lens.focus_distance == 2.5
    sensor = potmesil_sensor(scene.sensors()[0], f_number=0.5)
    lens = render_samples(scene, sensor).lens
    assert (lens.f_number, lens.focus_distance) == (0.5, 2.5)
    assert lens.circle_of_confusion(2.5) == 0


# ---------------------------------------------------------------- projection


@pytest.mark.parametrize("crop", [{}, CROP], ids=["whole", "crop"])
@pytest.mark.parametrize("kind", [BUILTIN, OURS], ids=["builtin", "ours"])
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_projection_is_that_of_mitsubas_own_test(variant, kind, crop):
    """Mitsuba's test_perspective_matches_manual_calculation, for its sensor and for ours."""
    mi.set_variant(variant)
    sensor = load(kind, near_clip=0.1, far_clip=100.0, fov=45.0, film=film(640, 480, **crop))
    by_hand = mi.perspective_projection(
        sensor.film().size(),
        sensor.film().crop_size(),
        sensor.film().crop_offset(),
        mi.traverse(sensor)["x_fov"],
        sensor.near_clip(),
        sensor.far_clip(),
    )
    assert dr.allclose(sensor.projection_transform().matrix, by_hand.matrix)


@pytest.mark.parametrize(
    "kinds", [(BUILTIN, OURS), ({"type": "orthographic"}, PARALLEL)], ids=["pinhole", "parallel"]
)
def test_projections_are_the_same_matrix_of_the_same_type(variants, kinds):
    theirs, mine = (load(kind, film=film(**CROP)).projection_transform() for kind in kinds)
    assert type(mine) is type(theirs)
    np.testing.assert_allclose(np.array(mine.matrix), np.array(theirs.matrix), rtol=1e-6, atol=1e-6)


# ---------------------------------------------------------------- field of view


def test_x_fov_is_updated_as_in_thinlens(variant_llvm):
    """Aperture and focus stay what they are."""
    shared = {"aperture_radius": 0.125, "focus_distance": 4.0, "fov": 40.0}
    mine, theirs = load({"type": "potmesil"}, **shared), load({"type": "thinlens"}, **shared)
    for sensor in (mine, theirs):
        assert number(mi.traverse(sensor)["x_fov"]) == pytest.approx(40, rel=1e-6)
        assert number(update(sensor, x_fov=25.0)["x_fov"]) == 25
    assert mine.lens().fov == pytest.approx(25, abs=1e-12)
    assert (mine.lens().aperture_radius, mine.focus_distance()) == (0.125, 4)
    pinhole = load(BUILTIN, fov=25.0)
    np.testing.assert_allclose(rays(mine), rays(pinhole), rtol=1e-5, atol=1e-5)
    assert mine.camera().x_fov == pytest.approx(25, abs=1e-12)


@pytest.mark.parametrize("image_distance", ["focal", "focused"])
def test_x_fov_and_the_millimetres_follow_each_other(variant_llvm, image_distance):
    place = {"focus_distance": 0.5, "image_distance": image_distance}
    sensor = load(OURS, focal_length=50.0, **place)
    lens = sensor.lens()
    held = mi.traverse(sensor)  # by someone else, before the updates
    parameters = update(sensor, focal_length=85.0)
    expected = ThinLens(85.0, 5.6, 0.5, millimeters_per_unit=1000, film=image_distance)
    for each in (parameters, held):
        assert number(each["x_fov"]) == pytest.approx(expected.fov, rel=1e-6)
    update(sensor, x_fov=lens.fov)
    assert sensor.lens().focal_length == 85
    # Nearer than at infinity, a film at the focused image is farther off, and wider for its view.
    width = {"focal": 36 * 85 / 50, "focused": 36 * (85 / (500 - 85)) / (50 / (500 - 50))}
    assert number(held["frame_width"]) == pytest.approx(width[image_distance], rel=1e-6)


def test_pictures_have_the_derivative_in_x_fov_that_perspective_gives(variant_llvm):
    """Of what is seen along the rays; the edges of things need another integrator."""
    derivatives = []
    for kind in (BUILTIN, OURS):
        scene = still_life({"type": "direct"}, sensor={**kind, "fov": 40.0})
        parameters = mi.traverse(scene)
        name = fov_of(parameters)
        parameters[name] = 35.0
        dr.enable_grad(parameters[name])
        parameters.update()
        picture = mi.render(scene, parameters, seed=1, spp=4)
        dr.set_grad(parameters[name], 1)
        dr.forward_to(picture)
        derivatives.append(np.array(dr.grad(picture)))
    theirs, mine = derivatives
    assert np.abs(theirs).max() > 0.04
    np.testing.assert_allclose(mine, theirs, rtol=1e-3, atol=1e-5)


# ---------------------------------------------------------------- aperture


@pytest.mark.parametrize("image_distance", ["focal", "focused"])
@pytest.mark.parametrize("given", [{"f_number": 4.0}, {"aperture_radius": 0.0625}], ids=str)
def test_f_number_and_aperture_radius_are_one_number(variant_llvm, given, image_distance):
    place = {"focus_distance": 2.0, "image_distance": image_distance}
    sensor = load({"type": "potmesil"}, **given, **place)
    parameters = mi.traverse(sensor)

    def agree():
        lens = sensor.lens()
        reference = lens.image_distance() if image_distance == "focal" else 50.0
        radius, f_number = (number(parameters[name]) for name in ("aperture_radius", "f_number"))
        assert 2 * radius * f_number * 1000 == pytest.approx(reference, rel=1e-6)
        assert (lens.aperture_radius, lens.f_number) == pytest.approx((radius, f_number), rel=1e-6)

    agree()
    for name, new in [("f_number", 8.0), ("aperture_radius", 0.25), ("f_number", 2.0)]:
        parameters[name] = new
        parameters["focus_distance"] = 2.5 * number(parameters["focus_distance"])
        parameters.update()
        assert getattr(sensor.lens(), name) == new
        agree()


def test_a_pinhole_has_the_aperture_radius_0(variants):
    assert number(mi.traverse(load({**OURS, "f_number": math.inf}))["aperture_radius"]) == 0
    closed = load({"type": "potmesil", "aperture_radius": 0.0})
    assert number(mi.traverse(closed)["f_number"]) == math.inf


PAIRS = {
    "opening": {"f_number": 2.0, "aperture_radius": 0.0625},
    "opening_bad": {"f_number": 2.0, "aperture_radius": -1.0},
    "field": {"x_fov": 30.0, "frame_width": 24.0},
}


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_two_numbers_of_one_thing_that_do_not_agree_are_refused(variant_llvm, pair):
    sensor = load(OURS)
    lens, before = sensor.lens(), mi.traverse(sensor)
    good = {name: number(before[name]) for name in pair}
    with pytest.raises(ValueError, match=r"(aperture_radius|x_fov)=.*: must be "):
        update(sensor, **pair)
    update(sensor, **good)
    assert sensor.lens() == lens


@pytest.mark.parametrize("image_distance", ["focal", "focused"])
def test_all_parameters_can_be_put_back_at_once(variant_llvm, image_distance):
    sensor = load(OURS, focus_distance=2.0, image_distance=image_distance)
    lens, before = sensor.lens(), rays(sensor)
    kept = {name: number(mi.traverse(sensor)[name]) for name in sensor.m_lens_parameters}
    kept["x_fov"] = number(mi.traverse(sensor)["x_fov"])
    update(sensor, focal_length=85.0, f_number=2.0, frame_width=24.0, focus_distance=3.0)
    update(sensor, **kept)
    assert sensor.lens().f_number == pytest.approx(lens.f_number, rel=1e-6)
    assert sensor.lens().fov == pytest.approx(lens.fov, rel=1e-6)
    np.testing.assert_allclose(rays(sensor), before, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("bad", [0.0, 180.0, -20.0, math.nan])
def test_an_x_fov_out_of_range_is_refused(variant_llvm, bad):
    sensor = load(OURS)
    with pytest.raises(ValueError, match=rf"x_fov={bad}: must be > 0 and < 180 degrees"):
        update(sensor, x_fov=bad)
    update(sensor, x_fov=40.0)
    assert sensor.lens().fov == pytest.approx(40, abs=1e-12)


# ---------------------------------------------------------------- placement


def test_rays_of_both_orthographic_sensors_have_the_same_derivative_in_to_world(variant_llvm):
    derivatives = []
    for kind in ({"type": "orthographic"}, PARALLEL):
        shift = mi.Float(0)
        dr.enable_grad(shift)
        sensor = load(kind)
        assert kind is not PARALLEL or not (
            mi.traverse(sensor).flags("to_world") & mi.ParamFlags.NonDifferentiable
        )
        update(sensor, to_world=mi.AffineTransform4f().translate(mi.Vector3f(shift, 2 * shift, 0)))
        ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(0.3, 0.6), mi.Point2f(0.5))
        dr.forward(shift)
        derivatives.append(np.array(dr.grad(ray.o)).ravel())
    np.testing.assert_allclose(derivatives, [[1, 2, 0]] * 2, atol=1e-6)


@pytest.mark.parametrize("kind", [OURS, PARALLEL], ids=["pinhole", "parallel"])
def test_a_to_world_whose_matrix_alone_was_set_has_an_inverse(variant_llvm, kind):
    sensor = load(kind)
    parameters = mi.traverse(sensor)
    parameters["to_world"].matrix = mi.AffineTransform4f().translate([1, 2, 3]).matrix
    parameters.set_dirty("to_world")
    parameters.update()
    back = sensor.world_transform().inverse() @ mi.Point3f(1, 2, 3)
    np.testing.assert_allclose(np.array(back).ravel(), 0, atol=1e-6)


# ---------------------------------------------------------------- seen from the scene


def directions(sensor, points, active=True):
    """uv, p, d, n, dist, pdf and the weight, of points in camera space, (parts, count)."""
    found = []
    for point in points:
        it = dr.zeros(mi.Interaction3f)
        it.p = sensor.world_transform() @ mi.Point3f(*map(float, point))
        ds, weight = sensor.sample_direction(it, mi.Point2f(0.5), active)
        parts = (ds.uv, ds.p, ds.d, ds.n, ds.dist, ds.pdf, weight)
        found.append(np.concatenate([np.array(part).ravel() for part in parts]))
    return np.array(found).T


IN_VIEW = [(0.1, 0.2, 3.0), (-0.05, 0.02, 0.7), (0.5, -0.4, 5.0), (0.0, 0.0, 1.0)]
OUT_OF_VIEW = [(5.0, 0.0, 3.0), (0.0, 4.0, 3.0), (0.1, 0.2, -3.0), (0.0, 0.0, 0.05), (0, 0, 200)]


@pytest.mark.parametrize("crop", [{}, CROP], ids=["whole", "crop"])
def test_directions_to_the_sensor_are_those_of_perspective(variants, crop):
    shared = {"fov": 40.0, "near_clip": 0.1, "far_clip": 100.0, "film": film(**crop)}
    theirs, mine = load(BUILTIN, **shared), load(OURS, **shared)
    expected = directions(theirs, IN_VIEW)
    assert (expected[-1] > 0).all()
    np.testing.assert_allclose(directions(mine, IN_VIEW), expected, rtol=2e-5, atol=2e-5)
    assert not directions(mine, OUT_OF_VIEW)[12:].any()
    assert not directions(theirs, OUT_OF_VIEW)[12].any()  # their weight is not 0 beyond the planes
    assert not directions(mine, [(0, 0, 0)])[12:].any()


def test_directions_to_a_shifted_principal_point_are_those_to_a_crop_of_a_wider_film(variants):
    wide = math.degrees(2 * math.atan(2 * math.tan(math.radians(20))))
    crop = {"crop_offset_x": 36, "crop_width": 48, "crop_height": 32}
    wider = load(BUILTIN, fov=wide, film=film(96, 32, **crop))
    shifted = load(OURS, fov=40.0, principal_point_offset_x=0.25)
    points = [(-0.9, 0.1, 2.0), (-0.2, -0.3, 2.0), (0.1, 0.0, 1.0)]
    expected = directions(wider, points)
    assert (expected[-1] > 0).all()
    np.testing.assert_allclose(directions(shifted, points), expected, rtol=2e-5, atol=2e-5)


def test_the_mask_that_a_direction_is_asked_with_stays_what_it_is(variant_llvm):
    active = mi.Bool([True])
    directions(load(OURS), OUT_OF_VIEW[:1], active)
    assert active[0]
    assert not directions(load(OURS), IN_VIEW[:1], mi.Bool([False]))[12:].any()


def small_scene(kind, integrator, **sensor):
    """The still life under an area light, which gives the ball a shadow."""
    to_world = mi.ScalarTransform4f().look_at([1.5, 2, -1], [0, 0, 3], [0, 1, 0]).scale(0.5)
    light = {"type": "area", "radiance": {"type": "rgb", "value": [30, 30, 25]}}
    lamp = {"type": "rectangle", "to_world": to_world, "emitter": light}
    window = {"width": 12, "height": 12, "sample_border": True}
    sensor = {**kind, "fov": 40.0, **sensor}
    return still_life(integrator, film=window, sensor=sensor, lamp=lamp)


def test_light_is_traced_to_the_sensor_as_to_perspective(variant_llvm):
    theirs, mine = (
        np.array(mi.render(small_scene(kind, {"type": "ptracer", "max_depth": 3}), seed=1))
        for kind in (BUILTIN, OURS)
    )
    assert theirs.max() > 0.1
    np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "integrator",
    [
        {"type": "direct_projective", "guiding": "none"},
        {"type": "prb_projective", "max_depth": 3, "sppi": 0},
    ],
    ids=lambda integrator: integrator["type"],
)
def test_projective_integrators_give_the_derivatives_that_they_give_with_perspective(
    variant_llvm, integrator
):
    forward, backward = [], []
    for kind in (BUILTIN, OURS):
        scene = small_scene(kind, integrator)
        parameters = mi.traverse(scene)
        place = mi.AffineTransform4f(parameters["ball.to_world"])

        def picture(shift, scene=scene, parameters=parameters, place=place):
            dr.enable_grad(shift)
            moved = mi.AffineTransform4f().translate(mi.Vector3f(shift, 0, 0))
            parameters["ball.to_world"] = moved @ place
            parameters.update()
            return mi.render(scene, parameters, seed=3, spp=4)

        shift = mi.Float(0)
        image = picture(shift)
        dr.forward(shift)
        forward.append(np.array(dr.grad(image)))
        shift = mi.Float(0)
        image = picture(shift)
        weights = np.random.default_rng(0).random(image.shape).astype(np.float32)
        dr.backward(dr.sum(image * mi.TensorXf(weights), axis=None))
        backward.append(dr.grad(shift)[0])
    assert np.abs(forward[0]).max() > 1  # edges move over dark and bright
    np.testing.assert_allclose(forward[1], forward[0], rtol=1e-4, atol=1e-5)
    assert backward[1] == pytest.approx(backward[0], rel=1e-4)
    assert backward[1] == pytest.approx(np.sum(forward[1] * weights), rel=1e-4)


@pytest.mark.parametrize(
    "kinds",
    [({**BUILTIN, "fov": 40.0}, {**OURS, "fov": 40.0}), ({"type": "orthographic"}, PARALLEL)],
    ids=["pinhole", "parallel"],
)
def test_a_batch_of_sensors_renders_as_one_of_builtin_ones(variant_llvm, kinds):
    pictures = []
    for kind in kinds:
        there = mi.ScalarTransform4f().translate([0.2, 0, 0])
        two = {"type": "batch", "one": {**kind}, "other": {**kind, "to_world": there}}
        scene = still_life({"type": "direct"}, film={"width": 24, "height": 8}, sensor=two)
        pictures.append(np.array(mi.render(scene, seed=1, spp=2)))
    assert pictures[0].std() > 0.03
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-5, atol=1e-5)


def test_the_kernel_of_one_field_of_view_serves_another(variant_llvm):
    scene = still_life({"type": "direct"}, sensor={**OURS, "fov": 40.0}, spp=1)
    parameters = mi.traverse(scene)
    name = fov_of(parameters)
    hashes = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for fov in (41.0, 42.5):
            parameters[name] = fov
            parameters.update()
            dr.kernel_history_clear()
            dr.eval(mi.render(scene, spp=1))
            history = dr.kernel_history([dr.KernelType.JIT])
            hashes.append([kernel["hash"] for kernel in history])
    assert hashes[0]
    assert set(hashes[0]) == set(hashes[1])
