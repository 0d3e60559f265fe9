"""Gradients of pictures agree with central differences, at edges too; what has none says so.

``differences`` are of pictures formed with gradients, of the same samples.
"""

import dataclasses
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


@pytest.fixture(scope="module")
def card():
    """A textured card before a textured wall, a sample a quarter of a pixel, hidden ones too."""
    rng = np.random.default_rng(3)
    side, size = 2, 48
    at = (np.arange(size * side) + 0.5) / side
    x, y = (of.ravel().astype(np.float32) for of in np.meshgrid(at, at))
    on_card = (x > 15) & (x < 33.5) & (y > 12) & (y < 36)

    def texture(x, y, phase):
        waves = [np.sin(0.9 * x + 0.5 * y + phase + k) * np.sin(0.7 * y - k) for k in range(3)]
        return (0.5 + 0.4 * np.stack(waves, axis=1)).astype(np.float32)

    behind = np.full(len(x), 4.0, np.float32)
    columns = {
        "x": np.concatenate([x, x[on_card]]),
        "y": np.concatenate([y, y[on_card]]),
        "rgb": np.concatenate(
            [
                np.where(on_card[:, None], texture(x, y, 1.0), texture(x, y, 2.0)),
                texture(x, y, 2.0)[on_card],
            ]
        ),
        "z": np.concatenate([np.where(on_card, np.float32(1.6), behind), behind[on_card]]),
        "surface": np.concatenate([1 + on_card, np.ones(on_card.sum())]).astype(np.uint32),
        "layer": np.concatenate([np.zeros(len(x)), np.ones(on_card.sum())]).astype(np.uint8),
    }
    count = len(columns["x"])
    columns["weight"] = np.full(count, 1 / side**2, np.float32)
    columns["alpha"] = np.ones(count, np.float32)
    like = synthetic(100, size=(size, size))
    camera = dataclasses.replace(like.camera, crop_size=(size, size), film_size=(size, size))
    lens = pm.ThinLens(50, 0.12, 2.3, millimeters_per_unit=1000)
    del rng
    return pm.PointSamples(**columns, camera=camera, lens=lens, surfaces={1: "wall", 2: "card"})


def of_surface(samples, surface, channels=1):
    return mi.Float(np.repeat(samples.surface == surface, channels).astype(np.float32))


def picture(samples, name, value, **options):
    """The picture where a parameter is ``value`` times as large, or a surface has that colour."""
    lens = samples.lens
    if name in ("focus_distance", "f_number", "focal_length"):
        lens = lens.replace(**{name: value * float(getattr(lens, name))})
    elif name == "aperture_radius":
        lens = lens.replace(aperture_radius=value * float(lens.plain().aperture_radius))
    elif name == "rgb":
        rgb = mi.Float(samples.rgb.ravel()) * (1 + of_surface(samples, 2, 3) * (value - 1))
        samples = samples.replace(rgb=mi.TensorXf(rgb, samples.rgb.shape))
    else:
        column = mi.Float(getattr(samples, name)) * (1 + of_surface(samples, 2) * (value - 1))
        samples = samples.replace(**{name: column})
    return pm.focus(samples, lens, **options)


def of(samples, name, factor, **options):
    value = dr.opaque(mi.Float, factor)
    dr.enable_grad(value)
    return value, picture(samples, name, value, **options)


def differences(samples, name, step, **options):
    either = [
        np.array(dr.detach(of(samples, name, factor, **options)[1]), dtype=np.float64)
        for factor in (1 + step, 1 - step)
    ]
    return (either[0] - either[1]) / (2 * step)


def derivative(samples, name, **options):
    value, formed = of(samples, name, 1.0, **options)
    dr.forward(value)
    return np.array(dr.grad(formed), dtype=np.float64)


@pytest.mark.parametrize("method", ["layered:lens_points=256", "lightfield"])
@pytest.mark.parametrize(
    ("name", "step"),
    [("focus_distance", 0.002), ("f_number", 0.03), ("aperture_radius", 0.03), ("rgb", 0.1)],
)
def test_derivatives_are_those_of_central_differences(card, name, step, method):
    exact = derivative(card, name, method=method)
    found = differences(card, name, step, method=method)
    assert np.vdot(found, exact) / np.vdot(exact, exact) == pytest.approx(1, abs=0.01)
    assert np.vdot(found, exact) ** 2 > 0.99 * np.vdot(exact, exact) * np.vdot(found, found)


def test_the_derivative_in_the_depth_of_a_surface_has_what_it_hides(card):
    """What moves is an occluder: its edges move before what is behind."""
    exact = derivative(card, "z", squares=2, lens_points=512)
    found = differences(card, "z", 0.01, squares=2, lens_points=512)
    assert np.vdot(found, exact) / np.vdot(exact, exact) == pytest.approx(1, abs=0.01)


def test_the_picture_is_that_without_gradients(card):
    without = np.array(pm.focus(card), dtype=np.float64)
    formed = np.array(dr.detach(of(card, "f_number", 1.0)[1]), dtype=np.float64)
    assert formed.shape == without.shape
    assert 10 * math.log10(1 / ((formed - without) ** 2).mean()) > 45


@pytest.mark.parametrize("name", ["rgb", "z", "weight", "alpha"])
def test_columns_have_gradients_backwards_as_forwards(card, name):
    rng = np.random.default_rng(5)
    column = getattr(card, name)

    def attached():
        values = mi.Float(column.ravel())
        dr.enable_grad(values)
        given = mi.TensorXf(values, column.shape) if column.ndim == 2 else values
        formed = pm.focus(card.replace(**{name: given}), alpha=True)
        return values, formed

    values, formed = attached()
    along = rng.standard_normal(column.size).astype(np.float32)
    dr.set_grad(values, mi.Float(along))
    dr.enqueue(dr.ADMode.Forward, values)
    dr.traverse(dr.ADMode.Forward)
    other = rng.standard_normal(formed.shape).astype(np.float32)
    forwards = np.vdot(np.array(dr.grad(formed), dtype=np.float64), other)
    values, formed = attached()
    dr.backward(dr.sum(formed.array * mi.Float(other.ravel())))
    backwards = np.vdot(np.array(dr.grad(values), dtype=np.float64), along)
    assert abs(forwards) > 0.01
    assert backwards == pytest.approx(forwards, rel=1e-4)


def test_all_gradients_come_at_once(card):
    lens = {
        name: dr.opaque(mi.Float, float(getattr(card.lens, name)))
        for name in ("f_number", "focus_distance", "focal_length")
    }
    dr.enable_grad(*lens.values())
    rgb = mi.TensorXf(card.rgb)
    dr.enable_grad(rgb)
    formed = pm.focus(
        card.replace(rgb=rgb), card.lens.replace(**lens), rfilter=mi.load_dict({"type": "gaussian"})
    )
    dr.backward(dr.sum(dr.square(formed.array)))
    for name, value in lens.items():
        assert dr.grad(value)[0] != 0, name
    assert np.abs(np.array(dr.grad(rgb))).max() > 0


def test_a_session_forgets_nothing_between_steps(card):
    session = pm.FocusSession(card)
    pictures = []
    for focus in (2.3, 1.7, 2.3):
        value = dr.opaque(mi.Float, focus)
        dr.enable_grad(value)
        formed = session.focus(card.lens.replace(focus_distance=value))
        dr.backward(dr.sum(formed.array))
        pictures.append(np.array(dr.detach(formed)))
    np.testing.assert_allclose(pictures[0], pictures[2], atol=1e-5)
    assert np.abs(pictures[0] - pictures[1]).max() > 0.01


def attach(value):
    value = dr.opaque(mi.Float, value)
    dr.enable_grad(value)
    return value


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "paper"}, "method=paper"),
        ({"filters": ["star:points=4"]}, "filters="),
        ({"psf": pm.Lommel()}, "psf="),
    ],
)
def test_what_has_no_derivatives_is_refused_by_name(card, options, message):
    with pytest.raises(NotImplementedError, match=message):
        pm.focus(card, card.lens.replace(f_number=attach(2.0)), **options)


def test_columns_without_derivatives_are_refused(card):
    x = mi.Float(card.x)
    dr.enable_grad(x)
    with pytest.raises(TypeError, match=r"x=.*has gradients enabled"):
        card.replace(x=x)


def test_what_would_lose_gradients_is_refused(card):
    rgb = mi.TensorXf(card.rgb)
    dr.enable_grad(rgb)
    attached = card.replace(rgb=rgb)
    for lossy in (attached.merge, attached.denoised):
        with pytest.raises(NotImplementedError, match="rgb: has gradients enabled"):
            lossy()


def test_chosen_samples_keep_their_gradients(card):
    z = mi.Float(card.z)
    dr.enable_grad(z)
    some = card.replace(z=z).crop((8, 8, 16, 16), halo=4)
    assert len(some) < len(card)
    dr.backward(dr.sum(some.attached["z"]))
    assert np.array(dr.grad(z)).sum() == len(some)


def test_a_column_that_is_replaced_has_no_gradients_any_more(card):
    z = mi.Float(card.z)
    dr.enable_grad(z)
    assert card.replace(z=z).replace(z=card.z).attached == {}
    assert list(card.replace(z=z).replace(rgb=card.rgb).attached) == ["z"]


def test_gradients_that_would_take_too_much_memory_are_refused(card, monkeypatch):
    from potmesil_mi.focusing.memory import memory_of_focus

    method = pm.Layered(squares=2)
    takes = memory_of_focus(card, method, 2)
    monkeypatch.setenv("POTMESIL_MAX_MEMORY", f"{int(2 * takes / 1e6)}M")
    pm.focus(card, method=method)
    with pytest.raises(MemoryError, match="with gradients"):
        pm.focus(card, card.lens.replace(f_number=attach(2.0)), method=method)


def test_a_rim_before_what_hides_nothing_has_derivatives(card):
    """Then some of the lens see nothing of things, and there is no edge."""
    flat = card.visible().replace(z=np.full(np.count_nonzero(card.layer == 0), 3.0, np.float32))
    focus = attach(2.3)
    formed = pm.focus(flat, flat.lens.replace(focus_distance=focus, vignetting=0.5))
    dr.backward(dr.sum(dr.square(formed.array)))
    assert dr.grad(focus)[0] != 0


def test_depths_keep_their_gradients_where_something_is_too_near_to_be_spread(card):
    """What is so near is moved, and has no derivative; all the rest has its own."""
    z = card.z.copy()
    z[0] = 1e-7
    depth = mi.Float(z)
    dr.enable_grad(depth)
    dr.backward(dr.sum(dr.square(pm.focus(card.replace(z=depth)).array)))
    found = np.array(dr.grad(depth))
    assert np.isfinite(found).all()
    assert found[0] == 0
    assert np.count_nonzero(found) > len(found) / 2
