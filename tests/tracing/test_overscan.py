"""How far beyond the crop window is sampled: by positions, and before scenes."""

import math

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples.raster import Window
from potmesil_mi.tracing.overscan import SMALL_WINDOW, covering
from scenes import diffuse

# ---------------------------------------------------------------- positions

CROP = Window(100, 80, 60, 40)


def test_the_window_covers_the_positions_and_no_more_than_it_must():
    x, y = np.array([90.5, 130.0, 163.0]), np.array([100.0, 79.9, 120.1])
    window, missing = covering(CROP, x, y, 10**6)
    assert missing == 0
    assert window.covers(CROP)
    assert (window.left, window.right) == (90, 164)
    # A tenth of a pixel is no overscan.
    assert (window.top, window.bottom) == (80, 120)


def test_a_bounded_window_leaves_out_as_few_positions_as_may_be():
    near, far = np.linspace(60.0, 99.0, 1000), np.linspace(-9e5, -1e4, 10)
    x = np.concatenate([near, far])
    window, missing = covering(CROP, x, np.full_like(x, 100.0), 20_000)
    assert window.size <= 20_000
    assert window.left <= 60
    assert missing == pytest.approx(10 / 1010)
    assert (window.top, window.bottom, window.right) == (80, 120, 160)


def test_a_bounded_window_gives_the_side_most_that_needs_it_most():
    left, right = np.linspace(-4000.0, 99.0, 2000), np.linspace(161.0, 4000.0, 20)
    x = np.concatenate([left, right])
    window, missing = covering(CROP, x, np.full_like(x, 100.0), 40_000)
    assert 39_000 < window.size <= 40_000
    assert 0 < missing < 0.9
    assert CROP.left - window.left > 10 * (window.right - CROP.right)


# ---------------------------------------------------------------- before a scene

SIZE = 48


def before_the_lens(unit=1.0, *, radius=0.05, film=None, near_clip=1e-3, **shapes):
    """A wall of radiance 1 in focus at 4 m, 40 degrees wide; ``unit`` scene units are a metre."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "thinlens",
                "fov": 40,
                "aperture_radius": radius * unit,
                "focus_distance": 4 * unit,
                "near_clip": near_clip * unit,
                "far_clip": 100 * unit,
                "film": {
                    "type": "hdrfilm",
                    "width": SIZE,
                    "height": SIZE,
                    "rfilter": {"type": "box"},
                    **(film or {}),
                },
                "sampler": {"type": "multijitter", "sample_count": 16},
            },
            "wall": {
                "type": "rectangle",
                "to_world": placed([0, 0, 4 * unit], 4 * unit),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
            **shapes,
        }
    )


def placed(center, scale):
    return mi.ScalarTransform4f().translate(center).rotate([0, 1, 0], 180).scale(scale)


def plate(unit=1.0, radiance=0.0, center=(0.06, 0.0, 0.05), radius=0.03):
    """A round plate across the axis, by default beside the frame and close before the lens."""
    place = placed([unit * at for at in center], radius * unit)
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    shown = {"emitter": lamp} if radiance > 0 else {}
    return {"type": "disk", "to_world": place, "bsdf": diffuse(0, 0, 0), **shown}


def share_of_lens(column, count=400):
    """Which part of the lens a pixel in the middle row sees past the plate: closed by geometry.

    The plate at depth z is seen from the lens as a circle of radius r Zf / (Zf - z) there.
    """
    focal = SIZE / (2 * math.tan(math.radians(20)))
    grid = (np.arange(count) + 0.5) / count * 2 - 1
    u, v = (axis.ravel() * 0.05 for axis in np.meshgrid(grid, grid))
    inside = u**2 + v**2 <= 0.05**2
    u, v = u[inside], v[inside]
    # Mitsuba's x points to the left of the picture.
    slope = (SIZE / 2 - column - 0.5) / focal
    x, y = (at * (1 - 0.05 / 4) for at in (u, v))
    return float(np.mean((x + slope * 0.05 - 0.06) ** 2 + y**2 > 0.03**2))


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("radiance", [0.0, 3.0])
@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_what_stands_beside_the_frame_close_before_the_lens_covers_its_part(radiance, method):
    scene = before_the_lens(plate=plate(radiance=radiance))
    samples = pm.render_samples(scene)
    image = np.array(pm.focus(samples, method=method))[SIZE // 2 - 2 : SIZE // 2 + 2, :, 1]
    for column in (1, 10, 24, 45):
        seen = share_of_lens(column)
        expected = seen + (1 - seen) * radiance
        assert image[:, column].mean() == pytest.approx(expected, abs=0.012 * max(1, radiance))
    assert share_of_lens(1) < 0.8


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e6])
def test_the_window_is_the_same_whatever_the_unit(unit):
    samples = pm.render_samples(before_the_lens(unit, plate=plate(unit)), spp=1)
    window = samples.window
    # The plate reaches 0.09 to the side. The lens sees 0.068 of it, past the frame's border.
    sees = 0.05 * (1 - 0.05 / 4) + 0.05 * math.tan(math.radians(20))
    focal = SIZE / (2 * math.tan(math.radians(20)))
    expected = SIZE / 2 - focal * sees / 0.05
    assert expected - 2 < window.left <= expected
    assert window.right == SIZE
    assert window.top == pytest.approx(SIZE - window.bottom, abs=1)


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize(
    "where",
    [
        pytest.param({"center": (30.0, 0.0, 20.0), "radius": 5.0}, id="far"),
        pytest.param({"center": (0.3, 0.0, 0.05)}, id="out of the lens's sight"),
        pytest.param({"center": (0.02, 0.0, 5e-4), "radius": 0.01}, id="before the near plane"),
    ],
)
def test_what_the_lens_does_not_see_in_the_frame_does_not_enlarge_the_window(where):
    scene = before_the_lens(plate=plate(**where))
    samples = pm.render_samples(scene, spp=1)
    assert samples.window == samples.crop_window


@pytest.mark.usefixtures("variant_llvm")
def test_far_beyond_the_crop_window_samples_are_few_and_cover_the_window():
    scene = before_the_lens(plate=plate(radius=0.04))
    samples = pm.render_samples(scene, sampling=pm.Sampling(layers=1))
    assert samples.window.size > 4 * SIZE**2
    assert len(samples) < 16 * 0.8 * samples.window.size
    assert samples.weight.sum() == pytest.approx(samples.window.size, rel=1e-5)
    inside = samples.crop_window.contains(samples.x, samples.y)
    assert (samples.weight[inside] == 1 / 16).all()
    assert inside[: 16 * SIZE**2].all()
    assert not inside[16 * SIZE**2 :].any()


@pytest.mark.usefixtures("variant_llvm")
def test_where_the_bound_is_reached_a_warning_says_what_is_missing():
    # A floor just below the middle of the lens: it is seen from close by, and half of the lens is
    # below it.
    floor = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f()
        .translate([0, -0.01, 0])
        .rotate([1, 0, 0], -90)
        .scale(50.0),
        "bsdf": diffuse(0.5, 0.5, 0.5),
    }
    scene = before_the_lens(floor=floor)
    with pytest.warns(UserWarning, match=r"overscan: .* of what the lens sees") as caught:
        samples = pm.render_samples(scene, spp=1)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert samples.window.size <= max(16 * SIZE**2, SMALL_WINDOW)
    remedy = int(str(caught[0].message).split("overscan=")[1].split()[0])
    assert remedy > 200


@pytest.mark.usefixtures("variant_llvm")
def test_an_orthographic_camera_samples_what_its_lens_sees_beside_the_frame():
    sensor = {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f().scale([1, 1, 1]),
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 4},
    }
    wall = {"type": "rectangle", "to_world": placed([0, 0, 4], 9.0)}
    lens = pm.TelecentricLens(half_angle=20.0, focus_distance=4.0)

    def window_with(center):
        shape = {"type": "disk", "to_world": placed(center, 0.3), "bsdf": diffuse(0, 0, 0)}
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path"},
                "sensor": sensor,
                "wall": wall,
                "shape": shape,
            }
        )
        return pm.render_samples(scene, lens=lens, sampling=pm.Sampling(layers=1)).window

    # The frame is 2 wide. At depth 0.5 the lens sees 3.5 tan(20 degrees) = 1.27 beyond it.
    edge = -math.floor((1.7 - 1) / 2 * SIZE)
    assert edge - 2 <= window_with([1.4, 0, 0.5]).left <= edge + 1
    assert window_with([2.7, 0, 0.5]) == (0, 0, SIZE, SIZE)
