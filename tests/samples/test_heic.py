"""Pictures of phones: their depth, in each form that says what it is, their lens and their size."""

import sys

import numpy as np
import pillow_heif
import pytest
from heic import representation, write_heic
from PIL import Image

import potmesil_mi as pm
from potmesil_mi.cli import main
from potmesil_mi.pictures.heic import picture_file

LENS = {"f_number": 0.2, "focus_distance": 1.0}
DISPARITY = representation(1, least=0.5, most=2.0)


def halves(width=128, height=64, scale=2, at=0.5):
    """Red, near, beside blue; the depth has 1 / scale of the pixels."""
    rgb = np.zeros((height, width, 3), np.uint8)
    split = int(width * at)
    rgb[:, :split], rgb[:, split:] = (200, 40, 30), (30, 40, 200)
    codes = np.zeros((height // scale, width // scale), np.uint8)
    codes[:, : -(-split // scale)] = 255
    return rgb, codes


def exif(**tags):
    made = Image.Exif()
    names = {"f_number": 0x829D, "focal_length": 0x920A, "full_frame": 0xA405}
    made.get_ifd(0x8769).update({names[name]: value for name, value in tags.items()})
    return made.tobytes()


def depths(path):
    file = picture_file(path)
    return file.channels(file.parts[1], ["Z"])[..., 0]


@pytest.mark.parametrize(
    "of_codes",
    [
        representation(0, near=0.5, far=2.0),
        DISPARITY,
        representation(2, near=0.5, far=2.0),
    ],
    ids=["inverse of z", "disparity", "z"],
)
def test_each_representation_of_depth_is_decoded_to_meters(tmp_path, of_codes):
    rgb, codes = halves()
    z_is_stored = of_codes == representation(2, near=0.5, far=2.0)
    path = write_heic(tmp_path / "a.heic", rgb, 255 - codes if z_is_stored else codes, of_codes)
    z = depths(path)
    assert z.shape == rgb.shape[:2]
    np.testing.assert_allclose(z[:, :64], 0.5, rtol=1e-5)
    np.testing.assert_allclose(z[:, 64:], 2.0, rtol=1e-5)


def test_a_picture_of_a_phone_is_refocused_by_one_command(tmp_path):
    rgb, codes = halves()
    said = exif(f_number=1.8, focal_length=4.25, full_frame=26)
    write_heic(tmp_path / "a.heic", rgb, codes, DISPARITY, exif=said)
    out = tmp_path / "a.png"
    arguments = ["--f-number", "0.1", "--focus-distance", "0.5", "-o", str(out)]
    assert main(["focus", str(tmp_path / "a.heic"), *arguments]) == 0
    picture = np.asarray(Image.open(out).convert("RGB"), np.float64)
    assert np.abs(picture[:, :62] - rgb[:, :62]).max() < 8
    # What is behind is blurred, and so shows through beside the edge in no way but its own.
    assert np.abs(picture[:, 66:] - rgb[:, 66:]).max() < 8


@pytest.mark.parametrize("size", [(128, 64), (64, 128)])
def test_the_field_of_view_is_that_of_the_diagonal_for_35_mm(tmp_path, size):
    rgb, codes = halves(*size)
    said = exif(f_number=1.8, focal_length=4.25, full_frame=26)
    path = write_heic(tmp_path / "a.heic", rgb, codes, DISPARITY, exif=said)
    samples = pm.PointSamples.from_image(path, lens={"focus_distance": 1})
    width = np.hypot(36, 24) * size[0] / np.hypot(*size)
    assert samples.camera.x_fov == pytest.approx(2 * np.degrees(np.arctan(width / 26 / 2)), abs=0.1)
    assert samples.lens.f_number == pytest.approx(1.8)
    assert samples.lens.millimeters_per_unit == 1000


def test_depth_without_a_representation_is_refused_and_taken_as_told(tmp_path):
    rgb, codes = halves()
    path = write_heic(tmp_path / "a.heic", rgb, codes, b"")
    with pytest.raises(ValueError, match=r"a\.heic: no file says whether its depth"):
        pm.PointSamples.from_image(path, camera=60, lens=dict(LENS, millimeters_per_unit=1000))
    samples = pm.PointSamples.from_image(
        path,
        camera=60,
        lens=dict(LENS, millimeters_per_unit=1000),
        depth_kind="inverse",
        depth_scale=2 / 255,
    )
    assert samples.z.min() == pytest.approx(0.5)


def test_the_edge_of_a_coarse_depth_goes_along_that_of_the_colours(tmp_path):
    """The split is at the fifth of eight pixels that one of depth covers."""
    rgb, codes = halves(128, 64, scale=8, at=68 / 128)
    z = depths(write_heic(tmp_path / "a.heic", rgb, codes, DISPARITY))
    near = z < 1
    assert near[:, :68].all()
    assert not near[:, 68:].any()


def test_smooth_depth_stays_smooth_when_it_is_enlarged(tmp_path):
    rgb, codes = halves(128, 64, scale=4)
    codes[:] = 128 + 2 * np.arange(32)
    disparity = 1 / depths(write_heic(tmp_path / "a.heic", rgb, codes, DISPARITY))
    steps = np.diff(disparity[:, 2:-2], axis=1)
    np.testing.assert_allclose(steps, 1.5 * 2 / 255 / 4, rtol=1e-3)


def test_depth_of_other_proportions_is_refused(tmp_path):
    rgb, _ = halves()
    path = write_heic(tmp_path / "a.heic", rgb, np.zeros((32, 32), np.uint8), DISPARITY)
    with pytest.raises(ValueError, match=r"a\.heic: its depth has 32x32 pixels"):
        pm.PointSamples.from_image(path, camera=60, lens=LENS)


def test_a_picture_without_depth_says_so(tmp_path):
    path = tmp_path / "a.heic"
    pillow_heif.from_pillow(Image.fromarray(halves()[0])).save(path)
    with pytest.raises(ValueError, match=r"a\.heic: no channel is called a depth"):
        pm.PointSamples.from_image(path, camera=60, lens=LENS)


def test_a_depth_may_be_given_beside_a_picture_of_a_phone(tmp_path):
    path = tmp_path / "a.heic"
    rgb, _ = halves()
    pillow_heif.from_pillow(Image.fromarray(rgb)).save(path, quality=-1)
    z = np.full(rgb.shape[:2], 3.0)
    samples = pm.PointSamples.from_image(
        path, z, camera=60, lens=dict(LENS, millimeters_per_unit=1000), depth_kind="z"
    )
    assert samples.z.max() == 3


def test_without_pillow_heif_the_extra_is_named(tmp_path, monkeypatch):
    path = write_heic(tmp_path / "a.heic", *halves(), DISPARITY)
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(ModuleNotFoundError, match=r"potmesil_mi\[heic\]"):
        pm.PointSamples.from_image(path, camera=60, lens=LENS)
