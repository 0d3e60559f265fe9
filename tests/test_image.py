"""Pictures in files: of how many bits, what is clipped, and what is read again."""

import math

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

import potmesil_mi as pm
from potmesil_mi._image import (
    BIT_DEPTHS,
    attributes_described,
    encoded_picture,
    linear_from_srgb,
    read_srgb,
    require_format,
    write_picture,
)
from potmesil_mi.pictures.reading import PictureFile
from potmesil_mi.samples.formed import attributes_of_formed
from scenes import synthetic

SIZE = (20, 14)
"""Width and height of the pictures of ``synthetic`` samples."""


def random_picture(channels=3, seed=0):
    return np.random.default_rng(seed).random((*SIZE[::-1], channels)).astype(np.float32)


def stored(path):
    """The numbers of a file as they are, and its spec."""
    how = oiio.ImageSpec()
    how.attribute("oiio:UnassociatedAlpha", 1)
    opened = oiio.ImageInput.open(str(path), how)
    return opened.read_image(0, 0, 0, opened.spec().nchannels, opened.spec().format), opened.spec()


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.tiff"])
def test_every_code_of_16_bits_is_written_as_it_was(tmp_path, name):
    codes = np.arange(1 << 16, dtype=np.uint16).reshape(256, 256)
    linear = linear_from_srgb(codes / 65535)
    write_picture(np.repeat(linear[..., None], 3, axis=2), tmp_path / name, bit_depth="16")
    values, spec = stored(tmp_path / name)
    assert str(spec.format) == "uint16"
    np.testing.assert_array_equal(values, np.repeat(codes[..., None], 3, axis=2))


def test_16_bits_are_rounded_to_the_nearest_and_clipped(tmp_path):
    row = np.array([-1, 0, 0.4 / 65535 / 12.92, 0.6 / 65535 / 12.92, 1, 2, np.nan, np.inf])
    write_picture(np.repeat(row[None, :, None], 3, axis=2), tmp_path / "a.png", bit_depth="16")
    values, _ = stored(tmp_path / "a.png")
    assert values[0, :, 0].tolist()[:6] == [0, 0, 0, 1, 65535, 65535]
    assert values[0, 7, 0] == 65535


@pytest.mark.parametrize(("name", "bit_depth"), [("a.exr", "float"), ("a.tif", "float")])
@pytest.mark.parametrize("channels", [3, 4])
def test_floats_are_kept_bit_for_bit(tmp_path, name, bit_depth, channels):
    picture = 100 * random_picture(channels) - 1
    write_picture(picture, tmp_path / name, bit_depth=bit_depth)
    values, spec = stored(tmp_path / name)
    assert str(spec.format) == "float"
    np.testing.assert_array_equal(values, picture)


def test_a_picture_that_is_not_aligned_in_memory_is_written_like_others(tmp_path):
    memory = bytearray(1 + 4 * 5 * 3 * 4)
    image = np.frombuffer(memory, np.float32, offset=1).reshape(4, 5, 3)
    image[:] = np.linspace(0, 1, image.size).reshape(image.shape)
    assert not image.flags.aligned
    write_picture(image, tmp_path / "picture.exr")
    np.testing.assert_array_equal(stored(tmp_path / "picture.exr")[0], image)


def test_what_a_half_cannot_be_is_clipped_and_maps_stay_whole(tmp_path):
    picture = random_picture()
    picture[0, :5, 0] = 65504, 65536, 1e30, np.inf, -1e9
    maps = {"Z": np.full(SIZE[::-1], np.inf), "id": np.full(SIZE[::-1], (1 << 24) - 1)}
    write_picture(picture, tmp_path / "a.exr", None, maps, bit_depth="half")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert {name: of.dtype.name for name, of in channels.items()} == {
        **dict.fromkeys("RGB", "float16"),
        "Z": "float32",
        "id": "float32",
    }
    assert channels["R"][0, :5].tolist() == [65504, 65504, 65504, 65504, -65504]
    np.testing.assert_array_equal(channels["G"], picture[..., 1].astype(np.float16))
    assert np.isinf(channels["Z"]).all()
    assert (channels["id"] == (1 << 24) - 1).all()


@pytest.mark.parametrize(
    ("name", "bit_depth"),
    [(f"a{ending}", depth) for ending, depths in BIT_DEPTHS.items() for depth in depths],
)
def test_any_picture_is_read_in_8_bits_of_srgb(tmp_path, name, bit_depth):
    """Frames of all formats make a movie."""
    picture = np.broadcast_to(linear_from_srgb(np.float32(99.2 / 255)), (16, 16, 3))
    write_picture(picture, tmp_path / name, bit_depth=bit_depth)
    found = read_srgb(tmp_path / name)
    assert found.shape == (16, 16, 3)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, 99)


def test_the_quality_of_a_jpeg_is_what_was_asked_for(tmp_path):
    picture = random_picture()
    sizes = []
    for quality in (1, 50, 90, 100):
        write_picture(picture, tmp_path / "a.jpg", quality=quality)
        sizes.append((tmp_path / "a.jpg").stat().st_size)
    assert sizes == sorted(set(sizes))
    write_picture(picture, tmp_path / "b.jpg")
    assert (tmp_path / "b.jpg").stat().st_size == sizes[2]


@pytest.mark.parametrize(
    ("paths", "form", "problem"),
    [
        (["a.png"], {"bit_depth": "half"}, "bit_depth='half': must be one of 8, 16 for .*png"),
        (["a.exr", "a.jpg"], {"bit_depth": "16"}, "must be one of float, half for .*exr"),
        (["a.jpg"], {"bit_depth": "16"}, "must be one of 8 for .*jpg"),
        (["a.TIF"], {"bit_depth": "half"}, "must be one of 16, 8, float for .*tif"),
        (["a.exr"], {"bit_depth": "32"}, "must be one of 8, 16, half, float"),
        (["a.exr"], {"bit_depth": 16}, "bit_depth=16: must be one of"),
        (["a.png"], {"quality": 50}, "quality=50: must be left out"),
        (["a.jpg"], {"quality": 0}, "quality=0: must be 1 to 100"),
        (["a.jpg"], {"quality": 101}, "quality=101: must be 1 to 100"),
        (["a.gif"], {}, "gif"),
    ],
)
def test_what_a_format_cannot_have_is_refused_by_name(paths, form, problem):
    with pytest.raises((ValueError, TypeError), match=problem):
        require_format(paths, **form)


def test_a_picture_that_cannot_be_so_is_not_begun(tmp_path):
    with pytest.raises(ValueError, match="bit_depth"):
        write_picture(random_picture(), tmp_path / "a.png", bit_depth="float")
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- read again


@pytest.mark.parametrize(
    ("name", "bit_depth", "tolerance"),
    [
        ("a.exr", "half", 5e-4),
        ("a.tif", "float", 0),
        ("a.tif", "16", 3e-5),
        ("a.tif", "8", 8e-3),
        ("a.png", "16", 3e-5),
    ],
)
@pytest.mark.parametrize("channels", [3, 4])
def test_a_picture_is_read_again_as_it_was(tmp_path, name, bit_depth, tolerance, channels):
    samples = synthetic(50)
    lens = samples.lens.replace(f_number=math.inf)
    rgb = random_picture(channels)
    if channels == 4:
        rgb[..., 3] = 0.25 + 0.75 * rgb[..., 3]
        rgb[..., :3] *= rgb[..., 3:]
    said = attributes_of_formed(samples, "layered", lens)
    write_picture(rgb, tmp_path / name, said, bit_depth=bit_depth)
    found = pm.PointSamples.from_image(
        tmp_path / name,
        np.full(SIZE[::-1], 2.0),
        depth_kind="z",
        camera=samples.camera,
        antialiased=False,
        hidden="none",
    )
    np.testing.assert_allclose(found.rgb, rgb[..., :3].reshape(-1, 3), atol=tolerance)
    if channels == 4:
        np.testing.assert_allclose(found.alpha, rgb[..., 3].ravel(), atol=max(tolerance, 1e-7))
    assert found.lens.to_dict() == lens.to_dict()


def test_a_tiff_says_all_that_is_said(tmp_path):
    samples = synthetic(50).replace(provenance={"seed": 7})
    said = attributes_of_formed(samples, "layered", samples.lens.replace(focus_distance=math.inf))
    write_picture(random_picture(), tmp_path / "a.tif", said)
    attributes = PictureFile(tmp_path / "a.tif").parts[0].attributes
    assert attributes["Software"] == said["Software"]
    assert attributes["potmesil:seed"] == 7
    assert attributes["potmesil:method"] == "layered"
    assert float(attributes["potmesil:focus_distance"]) == math.inf
    np.testing.assert_allclose(attributes["worldToCamera"], said["worldToCamera"].ravel())


@pytest.mark.parametrize(
    "text",
    [
        None,
        7,
        "a view of the sea",
        "{",
        "[" * 100_000,
        '{"a": ' * 100_000,
        '{"shape": [3, 4]}',
        '{"potmesil:lens": ' + "9" * 10_000 + "}",
    ],
)
def test_the_description_of_another_program_says_nothing_of_ours(text):
    assert set(attributes_described(text)) <= {"potmesil:lens"}


def test_what_is_no_number_or_text_in_a_description_is_left_out():
    text = '{"potmesil:lens": "x", "focus": [1, [2]], "a": {}, "b": null, "c": [1, 2], "d": true}'
    assert attributes_described(text) == {"potmesil:lens": "x", "c": [1.0, 2.0]}


def test_a_jpeg_of_high_quality_has_a_colour_for_each_pixel(tmp_path):
    stripes = np.zeros((16, 16, 3), np.float32)
    stripes[:, ::2] = 1, 0, 0
    stripes[:, 1::2] = 0, 0, 1
    errors = {}
    for quality in (94, 95):
        write_picture(stripes, tmp_path / "stripes.jpg", quality=quality)
        read = read_srgb(tmp_path / "stripes.jpg").astype(float)
        errors[quality] = np.abs(read - 255 * stripes).mean()
    assert errors[95] < 10 < errors[94]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_an_encoded_picture_is_what_a_file_of_it_has(suffix, tmp_path):
    picture = np.random.default_rng(0).random((5, 7, 3), np.float32)
    write_picture(picture, tmp_path / f"picture{suffix}", bit_depth="8", quality=80)
    written = (tmp_path / f"picture{suffix}").read_bytes()
    assert encoded_picture(picture, suffix, 80) == written
