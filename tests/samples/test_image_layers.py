"""Silhouettes parted into their surfaces, and what goes on behind near edges."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.evaluation import metrics, thinlens_sensor
from potmesil_mi.optics.depth import camera_of
from potmesil_mi.samples.bright_edges import bright_edges_of
from potmesil_mi.samples.silhouettes import parts_of
from potmesil_mi.samples.uncovered import uncovered_by
from scenes import diffuse

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (48, 32)
FOV = 40.0
LENS = pm.ThinLens.of_field_of_view(
    FOV, f_number=0.4, focus_distance=1.5, millimeters_per_unit=1000.0
)
NEAR, FAR = 1.5, 6.0
EDGE = 20.3
"""Column at which what is near ends."""


def half_plane(near, far, edge=EDGE):
    """Colours and z of a near half-plane, on the left, before a far one; antialiased."""
    width, height = SIZE
    covered = np.clip(edge - np.arange(width), 0, 1)[None, :, None] * np.ones((height, 1, 1))
    rgb = covered * np.asarray(near) + (1 - covered) * np.asarray(far)
    z = np.where(np.arange(width) + 0.5 < edge, NEAR, FAR) * np.ones((height, 1))
    return rgb, z


def samples_of(rgb, z, lens=LENS, **options):
    return pm.PointSamples.from_image(rgb, z, camera=FOV, lens=lens, depth_kind="z", **options)


@pytest.mark.parametrize("edge", [20.1, 20.4, 20.5, 20.6, 20.9])
def test_a_pixel_on_a_silhouette_is_parted_by_its_colour(edge):
    rgb, z = half_plane((0.8, 0.2, 0.1), (0.1, 0.3, 5.0), edge)
    parts = parts_of(rgb, 40.0 / z)
    assert set(parts.pixel % SIZE[0]) == {20}
    of_other = min(edge - 20, 21 - edge)
    np.testing.assert_allclose(parts.share, of_other, atol=1e-6)
    own, other = ((0.8, 0.2, 0.1), (0.1, 0.3, 5.0))[:: 1 if edge > 20.5 else -1]
    np.testing.assert_allclose(parts.own, np.broadcast_to(own, parts.own.shape), atol=1e-6)
    np.testing.assert_allclose(parts.other, np.broadcast_to(other, parts.own.shape), atol=1e-6)


def test_parts_of_a_pixel_are_the_pixel_again():
    rng = np.random.default_rng(1)
    rgb, z = rng.uniform(-0.1, 3, (*SIZE[::-1], 3)), rng.choice([1.5, 2.0, 6.0], SIZE[::-1])
    samples = samples_of(rgb, z)
    assert len(samples) > rgb[..., 0].size
    total = np.zeros((rgb[..., 0].size, 4))
    first = samples.layer == 0
    values = np.column_stack([samples.rgb, np.ones(len(samples))]) * samples.weight[:, None]
    np.add.at(total, samples.pixel()[first], values[first])
    np.testing.assert_allclose(total[:, 3], 1, atol=1e-6)
    np.testing.assert_allclose(total[:, :3], rgb.reshape(-1, 3), atol=1e-5)


def test_what_moves_less_than_a_pixel_through_the_lens_stays_whole():
    rgb, z = half_plane((1, 0, 0), (0, 0, 1))
    narrow = LENS.replace(f_number=100.0)
    assert len(samples_of(rgb, z, narrow)) == z.size
    assert len(samples_of(rgb, z, LENS.replace(f_number=np.inf))) == z.size
    assert len(samples_of(rgb, z, antialiased=False, hidden="none")) == z.size


def test_only_what_is_farther_goes_on_behind_near_edges_and_as_far_as_the_lens_sees():
    rgb, z = half_plane((1, 0, 0), (0, 0, 1))
    samples = samples_of(rgb, z)
    hidden = samples.layer > 0
    assert hidden.any()
    np.testing.assert_allclose(samples.z[hidden], FAR)
    assert samples.rgb[hidden, 0].max() < 1e-5
    # Some points of the lens see so far behind the edge.
    scale = LENS.aperture_radius * camera_of(FOV, SIZE).focal_length_pixels
    reach = scale * (1 / NEAR - 1 / FAR)
    assert samples.x[hidden].min() == pytest.approx(EDGE - reach, abs=2.5)


def test_what_goes_on_is_mirrored_at_the_edge_and_keeps_its_texture():
    _, z = half_plane(0, 0)
    found = uncovered_by(z, 40.0)
    assert len(found.pixel) > 0
    column, row = found.pixel % SIZE[0], found.pixel // SIZE[0]
    inner = (row > 0) & (row < SIZE[1] - 1)
    np.testing.assert_array_equal((found.colour_of % SIZE[0])[inner], (40 - column)[inner])
    np.testing.assert_array_equal((found.depth_of % SIZE[0])[inner], 20)


@pytest.mark.parametrize("focus_distance", [NEAR, 2.5, FAR])
@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_what_is_of_one_colour_stays_so_whatever_its_depths(method, focus_distance):
    """No black holes behind near edges, no dark border around them."""
    z = np.full(SIZE[::-1], FAR)
    z[8:20, 12:30] = 2.5
    z[10:16, 20:40] = NEAR
    lens = LENS.replace(focus_distance=focus_distance)
    picture = np.array(pm.focus(samples_of(np.ones((*z.shape, 3)), z, lens), method=method))
    np.testing.assert_allclose(picture, 1, atol=0.02)


def lamp(edge, radiance=18.0):
    """A lamp in a ceiling, left of an ``edge``: of one depth, the ceiling dark; antialiased."""
    rgb, z = half_plane((radiance,) * 3, (0.1, 0.1, 0.1), edge)
    return rgb, np.full_like(z, NEAR)


@pytest.mark.parametrize("edge", [20.1, 20.5, 20.8])
def test_a_pixel_in_which_a_lamp_ends_has_its_light_where_it_is(edge):
    rgb, z = lamp(edge)
    edges = bright_edges_of(rgb, np.zeros(z.shape, bool))
    assert set(edges.pixel % SIZE[0]) == {20}
    np.testing.assert_allclose(edges.share, edge - 20, atol=1e-6)
    np.testing.assert_allclose(edges.bright, 18, rtol=1e-6)
    np.testing.assert_allclose(edges.dark, 0.1, rtol=1e-4)
    np.testing.assert_allclose(edges.toward, np.broadcast_to((-1, 0), edges.toward.shape))
    samples = samples_of(rgb, z)
    ends = samples.rgb[:, 0] > 17
    assert samples.x[ends].max() == pytest.approx((20 + edge) / 2, abs=1e-5)
    assert samples.x[~ends].min() == pytest.approx((21 + edge) / 2, abs=1e-5)


def test_the_light_of_a_lamp_that_ends_nearly_in_focus_is_spread_from_where_it_is():
    """Against the disc of the lens over a sharp edge, in closed form."""
    edge, radius = 20.3, 0.6
    rgb, z = lamp(edge)
    pixels = LENS.aperture_radius * camera_of(FOV, SIZE).focal_length_pixels
    lens = LENS.replace(focus_distance=1 / (1 / NEAR - radius / pixels))
    fine = (np.arange(SIZE[0] * 64) + 0.5) / 64
    t = np.clip((fine - edge) / radius, -1, 1)
    covered = 0.5 - (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi
    truth = (0.1 + 17.9 * covered).reshape(-1, 64).mean(axis=1)
    off = {}
    for antialiased in (False, True):
        samples = samples_of(rgb, z, lens, antialiased=antialiased)
        row = np.array(pm.focus(samples))[SIZE[1] // 2, 4:-4, 0]
        off[antialiased] = np.abs(row - truth[4:-4]).max()
    assert off[True] < 0.2, off
    assert off[True] < off[False] / 2, off


@pytest.mark.parametrize("width", [2.0, 3.0])
def test_edges_that_a_filter_has_blurred_stay_as_they_are(width):
    """What is between two sides is then no share of a pixel."""
    ramp = np.clip((20.3 + width / 2 - np.arange(SIZE[0]) - 0.5) / width, 0, 1)
    rgb = np.broadcast_to((0.1 + 17.9 * ramp)[None, :, None], (*SIZE[::-1], 3))
    assert len(bright_edges_of(rgb, np.zeros(rgb.shape[:2], bool)).pixel) == 0


@pytest.mark.parametrize("focus_distance", [NEAR, FAR])
def test_an_edge_is_blurred_as_by_the_lens_on_both_sides(focus_distance):
    """Near in focus, without a halo; far in focus, with the far seen through the near's rim."""
    edge = 24.5
    rgb, z = half_plane((0.1, 0.1, 0.1), (1, 1, 1), edge)
    lens = LENS.replace(focus_distance=focus_distance)
    picture = np.array(pm.focus(samples_of(rgb, z, lens)))[SIZE[1] // 2, :, 0]
    # What the far side of an edge gets of the disc of a circle of the near's radius.
    camera = camera_of(FOV, SIZE)
    radius = lens.aperture_radius * camera.focal_length_pixels * abs(1 / NEAR - 1 / focus_distance)
    fine = (np.arange(SIZE[0] * 64) + 0.5) / 64
    if radius > 0:
        t = np.clip((fine - edge) / radius, -1, 1)
        covered = 0.5 - (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi
    else:
        covered = (fine < edge).astype(float)
    truth = (1 - 0.9 * covered).reshape(-1, 64).mean(axis=1)
    np.testing.assert_allclose(picture[4:-4], truth[4:-4], atol=0.035)


@pytest.mark.slow
def test_a_silhouette_in_focus_before_a_bright_background_has_no_halo():
    """Within 2 dB of point samples, where it was far below."""
    film = {
        "type": "hdrfilm",
        "width": 72,
        "height": 48,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    glow = {"type": "area", "radiance": {"type": "rgb", "value": [3, 4, 6]}}
    facing = mi.ScalarTransform4f().translate([0, 0, 20]).rotate([0, 1, 0], 180).scale([20, 20, 1])
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "potmesil",
                "fov": FOV,
                "f_number": 0.2,
                "focus_distance": 2.0,
                "millimeters_per_unit": 1000.0,
                "film": film,
                "sampler": {"type": "multijitter", "sample_count": 16},
            },
            "disc": {
                "type": "disk",
                "to_world": mi.ScalarTransform4f()
                .translate([0, 0, 2])
                .rotate([0, 1, 0], 180)
                .scale(0.4),
                "bsdf": diffuse(0.02, 0.02, 0.02),
            },
            "sky": {"type": "rectangle", "to_world": facing, "emitter": glow},
        }
    )
    sensor = scene.sensors()[0]
    camera = sensor.camera()
    rendered = mi.render(scene, sensor=thinlens_sensor(sensor, spp=1024), spp=1024)
    reference = metrics.srgb(np.array(rendered)[..., :3] / 6)
    pinhole = {
        "type": "perspective",
        "fov": FOV,
        "film": film,
        "sampler": {"type": "multijitter", "sample_count": 256},
    }
    rgb = np.array(mi.render(scene, sensor=mi.load_dict(pinhole), spp=256))[..., :3]
    # The depth in the middles of pixels.
    x, y = np.meshgrid(np.arange(72) + 0.5 - 36, np.arange(48) + 0.5 - 24)
    z = np.where(np.hypot(x, y) < 0.2 * camera.focal_length_pixels, 2.0, 20.0)
    options = {"camera": camera, "lens": sensor.lens(), "depth_kind": "z"}
    whole, parted, of_samples = (
        metrics.psnr(metrics.srgb(np.array(pm.focus(samples)) / 6), reference)
        for samples in (
            pm.PointSamples.from_image(rgb, z, antialiased=False, hidden="none", **options),
            pm.PointSamples.from_image(rgb, z, **options),
            pm.render_samples(scene, sensor),
        )
    )
    assert parted > whole + 3, (whole, parted, of_samples)
    assert parted >= of_samples - 2, (whole, parted, of_samples)
