"""Pictures of other programs in files: channels, headers, kinds of depth, what is not trusted."""

import dataclasses
import json
import math
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from picture_files import write_exr, write_image

import potmesil_mi as pm
from potmesil_mi._image import write_picture
from potmesil_mi.cli import main
from potmesil_mi.evaluation import metrics, thinlens_sensor
from potmesil_mi.optics.depth import camera_of, ndc_from_depth, ray_length_from_depth
from potmesil_mi.optics.planarity import bending, verdict
from potmesil_mi.pictures.reading import PictureFile
from potmesil_mi.samples.filtered_depth import unfiltered
from potmesil_mi.samples.standard import standard_attributes
from scenes import still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

DATA = Path(__file__).parent.parent / "data"

SIZE = (30, 20)
FOV = 50.0
FOCAL_LENGTH = 36 / (2 * math.tan(math.radians(FOV / 2)))
LENS = {"f_number": 2.0, "focus_distance": 3.0, "millimeters_per_unit": 1000.0}


def picture():
    """Colours and z: a floor that recedes, something before it, the sky above."""
    rng = np.random.default_rng(3)
    width, height = SIZE
    rgb = rng.uniform(0.4, 1, (height, width, 3)).astype(np.float32)
    row = np.arange(height)[:, None] + 0.5
    below = np.maximum(row - height / 2, 1e-3) / (width / 2) * math.tan(math.radians(FOV / 2))
    z = np.broadcast_to(1.5 / below, (height, width)).copy()
    z[:10] = np.inf
    z[6:14, 8:16] = 2.0
    return rgb, z


def ray_length(z, camera=None):
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    return ray_length_from_depth(z, x, y, camera or camera_of(FOV, SIZE))


def rgb_channels(rgb, prefix=""):
    return {f"{prefix}{name}": rgb[..., i] for i, name in enumerate("RGB")}


def same(samples, others, colours=1e-4):
    for name in ("x", "y", "z", "weight", "alpha", "rgb"):
        tolerance = colours if name == "rgb" else 1e-4
        np.testing.assert_allclose(
            getattr(samples, name), getattr(others, name), rtol=1e-4, atol=tolerance, err_msg=name
        )
    assert samples.camera.x_fov == pytest.approx(others.camera.x_fov, abs=1e-6)
    assert samples.camera.crop_size == others.camera.crop_size
    assert samples.lens.f_number == pytest.approx(others.lens.f_number, rel=1e-5)
    assert samples.lens.focus_distance == pytest.approx(others.lens.focus_distance, rel=1e-5)
    assert samples.lens.aperture_radius == pytest.approx(others.lens.aperture_radius, rel=1e-5)


def expected(**options):
    rgb, z = picture()
    lens = pm.ThinLens.of_field_of_view(FOV, **LENS)
    return pm.PointSamples.from_image(rgb, z, camera=FOV, lens=lens, depth_kind="z", **options)


def in_float32(z, background=np.inf):
    return np.where(np.isinf(z), background, z).astype(np.float32)


VIEW = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [3, 1, 2, 1]], np.float32)
"""Worlds before cameras, of rows, as OpenEXR has it."""

SLOPE = math.tan(math.radians(FOV / 2))


def projection():
    matrix = np.zeros((4, 4), np.float32)
    matrix[0, 0], matrix[1, 1] = 1 / SLOPE, 1.5 / SLOPE
    matrix[2, 2:], matrix[3, 2] = (1.01, 1), -0.1
    return matrix


TO_01 = np.array([[0.5, 0, 0, 0], [0, -0.5, 0, 0], [0, 0, 1, 0], [0.5, 0.5, 0, 1]], np.float32)
"""From NDC of -1 to 1 to those of 0 to 1 from the upper left, of rows."""


HEADERS = {
    "V-Ray": (
        {
            "cameraAperture": 36.0,
            "cameraFocalLength": FOCAL_LENGTH,
            "cameraFov": FOV,
            "cameraFNumber": 2.0,
            "cameraTargetDistance": 3.0,
        },
        {"lens": {"millimeters_per_unit": 1000.0}},
    ),
    "OpenEXR, window": (
        {"screenWindowWidth": 2 * SLOPE, "aperture": 2.0, "focus": 3.0},
        {"lens": {"millimeters_per_unit": 1000.0}, "depth_kind": "z"},
    ),
    "OpenEXR, sensor": (
        {
            "pinholeFocalLength": FOCAL_LENGTH,
            "sensorOverallDimensions": np.array([36, 24], np.float32),
            "aperture": 2.0,
            "focus": 3.0,
        },
        {"lens": {"millimeters_per_unit": 1000.0}, "depth_kind": "z"},
    ),
    "RenderMan": (
        {"worldToCamera": VIEW, "worldToNDC": VIEW @ projection()},
        {"lens": LENS, "depth_kind": "z"},
    ),
    "the standard's NDC": (
        {"worldToCamera": VIEW, "worldToNDC": VIEW @ projection() @ TO_01},
        {"lens": LENS, "depth_kind": "z"},
    ),
    "Redshift": (
        {"rs/camera/fov": FOV, "rs/camera/FStop": 2.0, "rs/camera/DOFFocusDistance": 3.0},
        {"lens": {"millimeters_per_unit": 1000.0}, "depth_kind": "z"},
    ),
}


@pytest.mark.parametrize("program", HEADERS)
def test_headers_of_all_programs_tell_the_same_camera_and_lens(tmp_path, program):
    rgb, z = picture()
    attributes, options = HEADERS[program]
    path = write_exr(tmp_path / "a.exr", {**rgb_channels(rgb), "Z": in_float32(z)}, **attributes)
    found = pm.PointSamples.from_image(path, **options)
    assert found.camera.x_fov == pytest.approx(FOV, abs=1e-4)
    camera = camera_of(found.camera.x_fov, SIZE)
    lens = pm.ThinLens.of_field_of_view(found.camera.x_fov, **LENS)
    same(found, pm.PointSamples.from_image(rgb, z, camera=camera, lens=lens, depth_kind="z"))


def test_blenders_picture_needs_but_aperture_focus_and_sensor(tmp_path):
    rgb, z = picture()
    path = write_exr(
        tmp_path / "a.exr",
        rgb_channels(rgb, "ViewLayer.Combined."),
        {"ViewLayer.Depth.Z": in_float32(z, 1e10)},
        {f"ViewLayer.Position.{axis}": in_float32(z, 0) for axis in "XYZ"},
        Lens=f"{FOCAL_LENGTH:.9f}",
    )
    lens = {"f_number": 2.0, "focus_distance": 3.0, "frame_width": 36.0}
    same(pm.PointSamples.from_image(path, lens=lens), expected())


def test_what_a_file_does_not_say_is_asked_for_all_at_once(tmp_path):
    rgb, z = picture()
    path = write_exr(tmp_path / "a.exr", {**rgb_channels(rgb), "Z": in_float32(z)})
    with pytest.raises(ValueError, match=r"a\.exr.*fov.*f_number.*focus_distance.*millimeters"):
        pm.PointSamples.from_image(path)


def test_which_kind_a_depth_is_is_not_guessed_but_told_what_planes_say(tmp_path):
    rgb, _ = picture()
    room = 1 / np.broadcast_to(np.linspace(0.1, 0.5, SIZE[1])[:, None], SIZE[::-1])
    for depth, word in ((room, "stay planes if it is z"), (ray_length(room), "it is distance")):
        path = write_exr(tmp_path / "a.exr", {**rgb_channels(rgb), "Z": depth.astype(np.float32)})
        with pytest.raises(ValueError, match=rf"a\.exr.*no file says.*{word}.*depth_kind"):
            pm.PointSamples.from_image(path, camera=FOV, lens=LENS)


@pytest.mark.parametrize("kind", ["z", "distance", "inverse or ndc"])
def test_planes_tell_the_kind_of_a_depth(kind):
    camera, size = camera_of(70.0, (96, 72)), (96, 72)
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(72) + 0.5)
    vergence = np.where(y > 36, 0.05 + (y - 36) / 100, 0.05 + 0.002 * np.abs(x - 40))
    z = 1 / vergence
    depth = {
        "z": z,
        "distance": ray_length_from_depth(z, x, y, camera),
        "inverse or ndc": ndc_from_depth(z, 0.1) + 1,
    }[kind]
    bent = bending(depth, camera)
    assert min(bent, key=bent.get) == kind
    assert f"if it is {kind}" in verdict(bent)
    rough = np.random.default_rng(0).uniform(1, 2, size[::-1])
    assert "no plane" in verdict(bending(rough, camera))


def test_a_depth_may_come_from_a_file_of_any_kind(tmp_path):
    rgb, z = picture()
    rgb, z = np.round(rgb * 65535) / 65535, np.where(np.isinf(z), np.inf, np.round(z * 1000) / 1000)
    z[~np.isinf(z) & (z > 60)] = 60.0
    lens = pm.ThinLens.of_field_of_view(FOV, **LENS)
    wanted = pm.PointSamples.from_image(rgb, z, camera=FOV, lens=lens, depth_kind="z")
    colours = write_exr(tmp_path / "rgb.exr", rgb_channels(rgb.astype(np.float32)))
    millimetres = np.where(np.isinf(z), 0, z * 1000).round().astype(np.uint16)
    np.save(tmp_path / "z.npy", z)
    files = {
        "z.png": (write_image(tmp_path / "z.png", millimetres), {"depth_scale": 0.001}),
        "codes.tif": (write_image(tmp_path / "c.tif", millimetres), {"depth_scale": 0.001}),
        "z.tif": (write_image(tmp_path / "z.tif", in_float32(z, 1e5)), {"background": 1e5}),
        "z.npy": (tmp_path / "z.npy", {}),
        "z.exr": (write_exr(tmp_path / "z.exr", {"Z": in_float32(z)}), {}),
        "grey.exr": (write_exr(tmp_path / "y.exr", {"Y": in_float32(z)}), {}),
    }
    for path, options in files.values():
        found = pm.PointSamples.from_image(
            colours, path, camera=FOV, lens=LENS, depth_kind="z", **options
        )
        same(found, wanted)
    with pytest.raises(ValueError, match=r"depth_scale=None.*1/256"):
        pm.PointSamples.from_image(
            colours, tmp_path / "z.png", camera=FOV, lens=LENS, depth_kind="z"
        )


def test_colours_of_8_bits_are_srgb_and_multiplied_by_alpha(tmp_path):
    rgb, z = picture()
    codes = np.round(255 * rgb).astype(np.uint8)
    alpha = np.full((*SIZE[::-1], 1), 51, np.uint8)
    np.save(tmp_path / "z.npy", z)
    png = write_image(
        tmp_path / "a.png", np.concatenate([codes, alpha], 2), **{"oiio:UnassociatedAlpha": 1}
    )
    found = pm.PointSamples.from_image(
        png, tmp_path / "z.npy", camera=FOV, lens=LENS, depth_kind="z", antialiased=False
    )
    first = found.layer == 0
    linear = np.where(
        codes / 255 <= 0.04045, codes / 255 / 12.92, ((codes / 255 + 0.055) / 1.055) ** 2.4
    )
    np.testing.assert_allclose(found.rgb[first], 0.2 * linear.reshape(-1, 3), atol=1e-6)
    np.testing.assert_allclose(found.alpha[first], 0.2, atol=1e-6)


def test_layers_halves_and_cryptomatte_are_understood(tmp_path):
    rgb, z = picture()
    ids = np.where(np.isinf(z), 0, np.where(z == 2, 0x12345678, 0x3F000001)).astype(np.uint32)
    manifest = {"box": "12345678", "floor": "3f000001", "elsewhere": "00000007"}
    path = write_exr(
        tmp_path / "a.exr",
        {
            **rgb_channels(rgb.astype(np.float16), "beauty."),
            **rgb_channels(np.zeros_like(rgb), "diffuse."),
            "depth.Z": in_float32(z),
            "normal.Z": in_float32(z, 0),
            "CryptoObject00.R": ids.view(np.float32),
            "CryptoObject00.G": np.ones_like(in_float32(z)),
        },
        **{"cryptomatte/abc/manifest": json.dumps(manifest)},
    )
    found = pm.PointSamples.from_image(path, camera=FOV, lens=LENS, depth_kind="z")
    same(found, expected(), colours=1e-3)
    assert found.surfaces == {0x12345678: "box", 0x3F000001: "floor"}
    assert set(found.surface) == {0, 0x12345678, 0x3F000001}
    with pytest.raises(ValueError, match=r"layer='specular'.*'beauty', 'diffuse'"):
        pm.PointSamples.from_image(path, camera=FOV, lens=LENS, depth_kind="z", layer="specular")


def test_of_several_depths_one_must_be_named(tmp_path):
    rgb, z = picture()
    channels = {"a.depth": in_float32(z), "b.depth": in_float32(z) + 1}
    path = write_exr(tmp_path / "a.exr", {**rgb_channels(rgb), **channels})
    options = {"camera": FOV, "lens": LENS, "depth_kind": "z"}
    with pytest.raises(ValueError, match=r"depth_channel.*a\.depth, b\.depth"):
        pm.PointSamples.from_image(path, **options)
    same(pm.PointSamples.from_image(path, depth_channel="a.depth", **options), expected())


def test_a_data_window_is_a_crop_of_the_display_window(tmp_path):
    rgb, z = picture()
    window = {
        "dataWindow": (np.array([5, 3], np.int32), np.array([34, 22], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([39, 29], np.int32)),
    }
    path = write_exr(tmp_path / "a.exr", {**rgb_channels(rgb), "Z": in_float32(z)}, **window)
    camera = pm.PointSamples.from_image(path, camera=FOV, lens=LENS, depth_kind="z").camera
    assert (camera.film_size, camera.crop_offset, camera.crop_size) == ((40, 30), (5, 3), SIZE)


# ---------------------------------------------------------------- Mitsuba's own


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_mitsubas_own_depth_gives_pictures_as_good_as_first_hits(tmp_path, rfilter):
    """Its `aov` integrator: depth along the ray, filtered, 0 where nothing is."""
    film = {"width": 72, "height": 48, "rfilter": {"type": rfilter}}
    scene = still_life(
        film=film,
        sensor={
            "type": "potmesil",
            "fov": 40.0,
            "f_number": 0.2,
            "focus_distance": 2.0,
            "millimeters_per_unit": 1000.0,
        },
        spp=64,
        sampler="multijitter",
    )
    sensor = scene.sensors()[0]
    pinhole = mi.load_dict(
        {
            "type": "perspective",
            "fov": 40.0,
            "film": {
                "type": "hdrfilm",
                "component_format": "float32",
                **film,
                "pixel_format": "rgba",
            },
            "sampler": {"type": "multijitter", "sample_count": 64},
        }
    )
    integrator = mi.load_dict(
        {"type": "aov", "aovs": "dd.y:depth", "nested": {"type": "path", "max_depth": 3}}
    )
    mi.render(scene, sensor=pinhole, integrator=integrator, spp=64)
    path = tmp_path / "aov.exr"
    pinhole.film().bitmap().write(str(path))
    reference = np.array(
        mi.render(scene, sensor=thinlens_sensor(sensor, spp=4096), integrator=scene.integrator())
    )[..., :3]
    first_hits = pm.render_samples(scene, spp=64, sampling=pm.Sampling(layers=1, overscan=0))
    with pytest.warns(UserWarning, match="counted from the near plane"):
        of_picture = pm.PointSamples.from_image(path, camera=40.0, lens=sensor.lens())
    of_samples, of_file = (
        metrics.psnr(metrics.srgb(np.array(picture)[..., :3]), metrics.srgb(reference))
        for picture in (pm.focus(first_hits, rfilter=sensor.film().rfilter()), pm.focus(of_picture))
    )
    assert of_file >= of_samples - 0.5, (of_file, of_samples)
    farther = pm.PointSamples.from_image(path, camera=40.0, lens=sensor.lens(), near=1.01)
    np.testing.assert_allclose(farther.z.min(), of_picture.z.min() + 1, rtol=1e-5)


# ---------------------------------------------------------------- what is easily mistaken


def test_mitsubas_depth_without_alpha_has_a_sky():
    _, z = picture()
    found = unfiltered(np.where(np.isinf(z), 0, z), None)
    assert np.isinf(found[:4]).all()
    assert set(found[14:].ravel()) <= set(z.ravel())


def test_normals_are_no_depth(tmp_path):
    rgb, z = picture()
    normals = {f"{axis}": np.full(z.shape, 0.5, np.float32) for axis in "XYZ"}
    for more in ({f"normals.{name}": of for name, of in normals.items()}, normals):
        channels = {**rgb_channels(rgb), "depth": in_float32(z)}
        path = write_exr(tmp_path / "a.exr", channels, more)
        found = pm.PointSamples.from_image(path, camera=FOV, lens=LENS, depth_kind="z")
        same(found, expected())


def test_signed_whole_numbers_ask_for_their_scale_too(tmp_path):
    rgb, z = picture()
    colours = write_exr(tmp_path / "a.exr", rgb_channels(rgb))
    codes = np.where(np.isinf(z), 0, np.minimum(z, 30) * 1000).astype(np.int16)
    depth = write_image(tmp_path / "d.tif", codes)
    options = {"camera": FOV, "lens": LENS, "depth_kind": "z"}
    with pytest.raises(ValueError, match="depth_scale=None"):
        pm.PointSamples.from_image(colours, depth, **options)
    found = pm.PointSamples.from_image(colours, depth, depth_scale=0.001, **options)
    assert found.z.min() == pytest.approx(2.0)


def test_files_and_arrays_go_together(tmp_path):
    rgb, z = picture()
    colours, options = write_exr(tmp_path / "a.exr", rgb_channels(rgb)), {"depth_kind": "z"}
    np.save(tmp_path / "z.npy", z)
    lens = pm.ThinLens.of_field_of_view(FOV, **LENS)
    same(pm.PointSamples.from_image(colours, z, camera=FOV, lens=LENS, **options), expected())
    path = str(tmp_path / "z.npy")
    same(pm.PointSamples.from_image(rgb, path, camera=FOV, lens=lens, **options), expected())


def test_what_is_known_of_a_program_holds_where_its_kind_is_said(tmp_path):
    rgb, z = picture()
    path = write_exr(
        tmp_path / "a.exr",
        rgb_channels(rgb, "V.Combined."),
        {"V.Depth.Z": in_float32(z, 1e10)},
    )
    lens = {"f_number": 2.0, "focus_distance": 3.0}
    found = pm.PointSamples.from_image(path, camera=FOV, lens=lens, depth_kind="z")
    assert np.isinf(found.z).sum() == np.isinf(expected().z).sum()


def test_where_nothing_is_known_may_be_said_to_be_nothing():
    rgb, z = picture()
    holes = np.where(np.isinf(z), 0, z)
    holes[0, 0] = np.nan
    lens = pm.ThinLens.of_field_of_view(FOV, **LENS)
    options = {"camera": FOV, "lens": lens, "depth_kind": "z"}
    with pytest.raises(ValueError, match="background=0"):
        pm.PointSamples.from_image(rgb, holes, **options)
    same(pm.PointSamples.from_image(rgb, holes, background=0, **options), expected())
    nothing = pm.PointSamples.from_image(rgb, np.full_like(z, np.inf), **options)
    assert np.isfinite(np.array(pm.focus(nothing))).all()


def test_an_overscan_is_left_out(tmp_path):
    rgb, z = picture()
    window = {
        "dataWindow": (np.array([-3, -2], np.int32), np.array([26, 17], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([23, 15], np.int32)),
    }
    path = write_exr(tmp_path / "a.exr", {**rgb_channels(rgb), "Z": in_float32(z)}, **window)
    found = pm.PointSamples.from_image(path, camera=FOV, lens=LENS, depth_kind="z")
    assert found.camera.crop_size == found.camera.film_size == (24, 16)
    first = found.crop_window.pixel_of(found.x, found.y)[: 24 * 16]
    np.testing.assert_array_equal(first, np.arange(24 * 16))
    np.testing.assert_allclose(found.z[: 24 * 16], z[2:18, 3:27].ravel(), rtol=1e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"focus_distance": math.inf},
        {"aperture": "polygon:blades=6", "squeeze": 1.5, "film": "focused"},
        {"f_number": math.inf},
    ],
)
def test_a_crop_that_this_package_wrote_is_read_as_it_was(tmp_path, changes):
    rgb, z = picture()
    lens = pm.ThinLens.of_field_of_view(FOV, **LENS).replace(**changes)
    camera = dataclasses.replace(
        camera_of(FOV, (60, 40), (0.1, -0.05)), crop_offset=(20, 10), crop_size=SIZE
    )
    said, maps = standard_attributes(camera, lens), {"Z": in_float32(z)}
    write_picture(rgb, tmp_path / "a.exr", said, maps)
    found = pm.PointSamples.from_image(tmp_path / "a.exr")
    assert found.camera.film_size == (60, 40)
    assert (found.camera.crop_offset, found.camera.crop_size) == ((20, 10), SIZE)
    assert found.camera.x_fov == pytest.approx(FOV, abs=1e-4)
    np.testing.assert_allclose(found.camera.principal_point_offset, (0.1, -0.05), atol=1e-6)
    assert found.lens.to_dict() == lens.to_dict()


def test_grey_with_alpha_and_what_contradicts_itself(tmp_path):
    _, z = picture()
    grey = np.full((*SIZE[::-1], 2), (188, 51), np.uint8)
    np.save(tmp_path / "z.npy", z)
    png = write_image(tmp_path / "a.png", grey, **{"oiio:UnassociatedAlpha": 1})
    options = {"lens": LENS, "depth_kind": "z", "antialiased": False}
    found = pm.PointSamples.from_image(png, tmp_path / "z.npy", camera=FOV, **options)
    np.testing.assert_allclose(found.alpha, 0.2, atol=1e-6)
    np.testing.assert_allclose(found.rgb, 0.2 * 0.5029, atol=1e-4)
    for lens, camera, problem in (
        ({**LENS, "focal_length": 50, "frame_width": 100}, FOV, "give one of them"),
        (LENS, 0, "camera=0"),
        ({**LENS, "half_angle": 3}, FOV, "half_angle"),
        ({**LENS, "focus_distance": 0}, FOV, "focus_distance"),
    ):
        with pytest.raises(ValueError, match=problem):
            pm.PointSamples.from_image(
                png, tmp_path / "z.npy", camera=camera, lens=lens, depth_kind="z"
            )
    with pytest.raises(TypeError, match=r"rgb=.*: has type uint8"):
        pm.PointSamples.from_image(grey, z, camera=FOV, lens=LENS, depth_kind="z")


# ---------------------------------------------------------------- nothing is trusted


def test_a_file_that_is_no_picture_is_one_error_that_names_it(tmp_path):
    path = tmp_path / "a.exr"
    path.write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"a\.exr: is not a picture"):
        pm.PointSamples.from_image(path, camera=FOV, lens=LENS)
    with pytest.raises(FileNotFoundError, match=r"b\.exr"):
        pm.PointSamples.from_image(tmp_path / "b.exr")
    with pytest.raises(IsADirectoryError):
        pm.PointSamples.from_image(tmp_path)


def test_a_header_that_asks_for_too_much_memory_is_refused(tmp_path):
    rgb, z = picture()
    path = write_exr(tmp_path / "a.exr", {**rgb_channels(rgb), "Z": in_float32(z)})
    data = bytearray(path.read_bytes())
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    data[at + 8 : at + 16] = np.array([60000, 60000], "<i4").tobytes()
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a\.exr"):
        pm.PointSamples.from_image(path, camera=FOV, lens=LENS, depth_kind="z")


def test_a_picture_that_blender_wrote_is_refocused_by_one_command(tmp_path):
    """``benchmarks/blender.py --sample`` made it: multi-part, with stamps, of Blender 5.0.1."""
    path = DATA / "blender.exr"
    lens = ["--f-number", "0.2", "--focus-distance", "2.2", "--frame-width", "36"]
    assert main(["focus", str(path), *lens, "-o", str(tmp_path / "a.exr")]) == 0
    file = PictureFile(tmp_path / "a.exr")
    picture = file.channels(file.parts[0], ["R", "G", "B"])
    samples = pm.PointSamples.from_image(
        path, lens={"f_number": 0.2, "focus_distance": 2.2, "frame_width": 36.0}
    )
    assert samples.camera.x_fov == pytest.approx(2 * math.degrees(math.atan(36 / 70)))
    assert samples.lens.focal_length == pytest.approx(35)
    # It looks down by 6 degrees from 1 m above the floor, which the lower half shows.
    bottom = samples.z[samples.visible().y.argmax()]
    assert 1 < bottom < 4
    first = samples.layer == 0
    sharp = np.zeros((48 * 64, 3))
    light = samples.rgb[first] * samples.weight[first][:, None]
    np.add.at(sharp, samples.pixel()[first], light)
    np.testing.assert_allclose(picture.mean(), sharp.mean(), rtol=0.03)
    # The wall at 16 m is blurred.
    detail = np.abs(np.diff(picture, axis=1)).mean(axis=(1, 2))
    before = np.abs(np.diff(sharp.reshape(48, 64, 3), axis=1)).mean(axis=(1, 2))
    assert detail[:12].sum() < 0.8 * before[:12].sum()


WITHOUT_MITSUBA = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "mitsuba":
            raise ImportError(name)

sys.meta_path.insert(0, Blocked())
from potmesil_mi._image import write_picture
from potmesil_mi.cli import main

lens = ["--f-number", "0.2", "--focus-distance", "2.2", "--frame-width", "36"]
sys.exit(main(["focus", sys.argv[1], *lens, "-o", sys.argv[2], "--maps", "depth", "coc"]))
"""


def test_refocusing_a_picture_needs_nothing_of_mitsuba(tmp_path):
    command = [sys.executable, "-W", "error", "-c", WITHOUT_MITSUBA]
    subprocess.run([*command, DATA / "blender.exr", tmp_path / "a.exr"], check=True)
    names = PictureFile(tmp_path / "a.exr").parts[0].channels
    assert set(names) == {"R", "G", "B", "Z", "coc"}
