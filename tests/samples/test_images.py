"""Pictures with depth, of any program, as samples."""

import math

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.optics.depth import camera_of, ndc_from_depth, ray_length_from_depth
from scenes import still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (24, 16)
FOV = 60.0
NEAR, FAR = 0.2, 50.0
LENS = pm.ThinLens.of_field_of_view(FOV, f_number=1.4, focus_distance=3, millimeters_per_unit=1000)


def picture():
    """Colours and z of a picture: something near before a floor, and nothing at the top."""
    rng = np.random.default_rng(6)
    width, height = SIZE
    rgb = rng.uniform(0.4, 1, (height, width, 3))  # nothing ends that is bright
    z = np.broadcast_to(np.linspace(9, 3, height)[:, None], (height, width)).copy()
    z[4:10, 6:14] = 1.25
    z[:2] = np.inf
    return rgb, z


def length_of(z):
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    return ray_length_from_depth(z, x, y, camera_of(FOV, SIZE))


def planes(**options):
    return {"depth_kind": "ndc", "near": NEAR, **options}


KINDS = {
    "z": (lambda z: z, {"depth_kind": "z"}),
    "distance": (length_of, {"depth_kind": "distance"}),
    "inverse": (lambda z: 1 / z, {"depth_kind": "inverse"}),
    "opengl": (lambda z: ndc_from_depth(z, NEAR), planes()),
    "direct3d": (
        lambda z: ndc_from_depth(np.minimum(z, FAR), NEAR, FAR, clip="direct3d"),
        planes(far=FAR, clip="direct3d", background=FAR * (1 - 1e-6)),
    ),
    "reversed": (
        lambda z: ndc_from_depth(z, NEAR, clip="direct3d", reverse=True),
        planes(clip="direct3d", reverse=True),
    ),
    "blender": (
        lambda z: np.where(np.isinf(z), 1e10, z),
        {"depth_kind": "z", "background": 1e10},
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_picture_by_every_kind_of_depth(kind):
    rgb, z = picture()
    depth_of, options = KINDS[kind]
    samples = pm.PointSamples.from_image(rgb, depth_of(z), camera=FOV, lens=LENS, **options)
    assert len(samples) == z.size
    assert samples.spp == 1
    np.testing.assert_allclose(samples.z, z.ravel(), rtol=1e-5)
    np.testing.assert_array_equal(samples.surface, np.isfinite(z).ravel())
    np.testing.assert_array_equal(samples.alpha, np.isfinite(z).ravel())
    straight = pm.PointSamples.from_image(rgb, z, camera=FOV, depth_kind="z", lens=LENS)
    np.testing.assert_allclose(pm.focus(samples), pm.focus(straight), atol=1e-4)


def test_through_a_closed_aperture_it_is_the_picture():
    rgb, z = picture()
    samples = pm.PointSamples.from_image(rgb, z, camera=FOV, depth_kind="z", lens=LENS)
    image = pm.focus(samples, lens=LENS.replace(f_number=math.inf))
    np.testing.assert_allclose(image, rgb, atol=1e-6)


def test_alpha_and_ids_are_those_of_the_picture():
    rgb, z = picture()
    alpha = np.linspace(0, 1, z.size).reshape(z.shape)
    ids = (z < 2) * 7 + 1
    samples = pm.PointSamples.from_image(
        np.dstack([rgb, alpha]),
        z,
        camera=camera_of(FOV, SIZE),
        depth_kind="z",
        lens=LENS,
        surface=ids,
        surfaces={1: "floor", 8: "ball"},
    )
    np.testing.assert_allclose(samples.alpha, alpha.ravel(), atol=1e-6)
    np.testing.assert_array_equal(samples.surface, ids.ravel())
    assert samples.surfaces == {1: "floor", 8: "ball"}


@pytest.mark.parametrize("near", [0.01, 0.8])
def test_mitsubas_own_depth_is_a_distance_from_its_near_plane(near):
    scene = still_life(
        {"type": "aov", "aovs": "dd:depth,pp:position", "nested": {"type": "direct"}},
        sensor={"near_clip": near},
        spp=1,
    )
    image = np.array(mi.render(scene, spp=1))
    depth, position = image[..., -4].astype(np.float64), image[..., -3:].astype(np.float64)
    sensor = pm.render_samples(scene, spp=1).camera
    hit = depth > 0
    samples = pm.PointSamples.from_image(
        image[..., :3],
        np.where(hit, depth, np.inf),
        camera=sensor,
        depth_kind="distance",
        lens=pm.ThinLens(50.0, 2.0, 2.0, millimeters_per_unit=1000),
        antialiased=False,
        near=near,
    )
    world = np.column_stack([position.reshape(-1, 3), np.ones(hit.size)])
    z = (world @ sensor.camera_from_world().T)[:, 2]
    # The ray is that of a place within the pixel, and not of its middle.
    np.testing.assert_allclose(samples.z[hit.ravel()], z[hit.ravel()], rtol=0.01)
    assert np.mean(samples.z[hit.ravel()] / z[hit.ravel()]) == pytest.approx(1, abs=5e-4)
    assert hit.mean() > 0.5


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"depth": np.ones((3, 4))}, r"depth=.*: has shape \(3, 4\), must have \(16, 24\)"),
        ({"rgb": np.ones((16, 24))}, r"rgb=.*: has shape \(16, 24\)"),
        ({"depth": np.zeros((16, 24))}, "depth: 384 of 384 pixels are out of bounds"),
        ({"depth": np.full((16, 24), np.nan)}, "row 0, column 0: nan; must be >= 1e-30"),
        ({"depth_kind": "inverse"}, ">= 0 and finite"),
        ({"depth_kind": "planar"}, "depth_kind"),
        ({"depth_kind": "ndc"}, "near=None: must be the near plane"),
        ({"near": 0.1}, "near=0.1, .*: must not be given for depth_kind=z, but for an NDC depth"),
        ({"clip": "direct3d"}, "clip=direct3d, .*: must not be given for depth_kind=z"),
        ({"background": -1}, "background=-1: must be >= 0"),
        ({"surface": np.full((16, 24), -7)}, "surface: -7 to -7: must be 0 to"),
        ({"camera": camera_of(FOV, (30, 20))}, r"must have \(24, 16\)"),
        ({"camera": 200.0}, "camera=200.0: must be > 0 and < 180"),
        ({"surface": np.ones((2, 2))}, "surface=.*: has shape"),
        ({"clip": "vulkan"}, "clip"),
        ({"hidden": "nearer"}, "hidden"),
        ({"depth_scale": 0}, "depth_scale=0: must be >="),
        (
            {"layer": "beauty"},
            "layer='beauty', depth_channel=None: must be None, since they are names",
        ),
        ({"depth_kind": None}, "depth_kind=None: must be one of z, distance, inverse, ndc"),
        ({"camera": None}, "camera=None"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(changed, message):
    rgb, z = picture()
    given = {"rgb": rgb, "depth": z, "camera": FOV, "depth_kind": "z", "lens": LENS, **changed}
    with pytest.raises(ValueError, match=message):
        pm.PointSamples.from_image(given.pop("rgb"), given.pop("depth"), **given)


def test_what_is_of_another_type_is_refused_by_name():
    rgb, z = picture()
    for changed in ({"antialiased": "yes"}, {"background": "1e10"}, {"lens": {"f_number": 2}}):
        given = {"camera": FOV, "depth_kind": "z", "lens": LENS, **changed}
        with pytest.raises(TypeError, match=next(iter(changed))):
            pm.PointSamples.from_image(rgb, z, **given)


def test_ids_are_whole_numbers():
    rgb, z = picture()
    with pytest.raises(TypeError, match=r"surface=.*: has type float64"):
        pm.PointSamples.from_image(rgb, z, camera=FOV, depth_kind="z", lens=LENS, surface=z)
