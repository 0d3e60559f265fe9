"""Apertures of the lens: tables, points, text, and the pictures that they form."""

import base64
import math
import tracemalloc
import zlib

import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from optics.wave_optics import bright_point, fourier_optics, through_pinholes

import potmesil_mi as pm
from potmesil_mi.evaluation import thinlens_sensor
from potmesil_mi.evaluation.metrics import psnr
from potmesil_mi.optics import diffraction_kernel
from potmesil_mi.optics.aperture import aperture_of
from potmesil_mi.optics.diffraction import encircled_energy, lommel_intensity, optical_coordinates
from scenes import papers_scene, still_life, synthetic

HEART = (
    np.add.outer(np.linspace(0.2, 1, 17), np.linspace(0, 0.5, 13)) * (np.arange(13) % 4 > 0) / 1.5
)
PICTURE = aperture_of(pm.ImageAperture(HEART).describe())  # of 16 bits an element
SHAPES = [pm.Disc(), pm.Polygon(6), pm.Polygon(5, 17.0, 0.4), pm.Polygon(3), PICTURE]
ALL = [*SHAPES, pm.Lommel(), pm.Lommel((550,), truncated=True), pm.Lommel("spectrum")]
LENS = pm.ThinLens(50, 2, 1000)
NEAR, FAR = 600.0, 3000.0
OFFSETS = st.tuples(st.floats(0, 1), st.floats(0, 1))


def table(aperture, radius, offset=(0.5, 0.5), depth=FAR, largest=None, lens=LENS):
    """The table of a circle with a radius of `radius` squares."""
    pixels_per_mm = 2 * radius / abs(lens.circle_of_confusion(depth))
    return aperture.table(lens, depth, pixels_per_mm, offset, largest)


def moments(values):
    """Mean (x, y) of a table, from its middle, and the variances about it."""
    rows, columns = (np.arange(n) - n // 2 for n in values.shape)
    down, across = values.sum(axis=1), values.sum(axis=0)
    x, y = across @ columns, down @ rows
    return x, y, across @ columns**2 - x**2, down @ rows**2 - y**2


# ---------------------------------------------------------------- tables


@pytest.mark.slow
@pytest.mark.parametrize("aperture", ALL, ids=str)
@pytest.mark.parametrize("radius", [0.003, 0.3, 1.0, 7.3, 100.0])
@pytest.mark.parametrize("depth", [NEAR, FAR])
def test_every_table_integrates_to_one_and_is_nowhere_negative(aperture, radius, depth):
    values = table(aperture, radius, (0.3, 0.8), depth)
    assert values.min() >= 0
    assert values.sum() == pytest.approx(1, abs=1e-6)
    assert values.shape[0] % 2 == values.shape[1] % 2 == 1


@pytest.mark.parametrize("aperture", SHAPES, ids=str)
@pytest.mark.parametrize("radius", [0.3, 1.4, 20.0])
def test_a_table_of_small_squares_added_up_is_that_of_large_squares(aperture, radius):
    coarse = table(aperture, radius)
    fine = table(aperture, 5 * radius)
    rows, columns = ((5 * n - m) // 2 for n, m in zip(coarse.shape, fine.shape, strict=True))
    fine = np.pad(fine[max(-rows, 0) :][: 5 * len(coarse)], [(max(rows, 0),) * 2, (0, 0)])
    fine = np.pad(fine, [(0, 0), (max(columns, 0),) * 2])
    added = fine.reshape(coarse.shape[0], 5, coarse.shape[1], 5).sum(axis=(1, 3))
    np.testing.assert_allclose(added, coarse, atol=1e-12)


@pytest.mark.parametrize("aperture", [pm.Lommel((550,)), pm.Lommel((550,), truncated=True)])
@pytest.mark.parametrize("radius", [0.3, 2.4])
def test_a_diffraction_table_of_small_squares_added_up_is_that_of_large_squares(aperture, radius):
    lens = LENS.replace(f_number=22)
    coarse, fine = (table(aperture, n * radius, lens=lens, largest=(8 * n, 8 * n)) for n in (1, 5))
    coarse, fine = (
        np.pad(values, wide - len(values) // 2)[:, :]
        for values, wide in ((coarse, 40), (fine, 102))
    )
    added = fine.reshape(41, 5, 41, 5).sum(axis=(1, 3))
    np.testing.assert_allclose(added, coarse[20:61, 20:61], atol=2e-3 * coarse.max())


@pytest.mark.parametrize("blades", [3, 4, 7])
@given(OFFSETS)
def test_a_polygons_table_agrees_with_counting_points_in_it(blades, offset):
    aperture, radius, fine = pm.Polygon(blades, 10), 2.6, 40
    values = table(aperture, radius, offset)
    reach = len(values) // 2
    place = (np.arange(len(values) * fine) + 0.5) / fine - reach
    x = (place[None, :] - offset[0]) / radius
    y = (place[:, None] - offset[1]) / radius
    inside = np.ones(np.broadcast(x, y).shape, dtype=bool)
    for k in range(blades):
        # Edges face away from the corner at the top, turned anticlockwise.
        angle = math.radians(10) + (2 * k + 1) * math.pi / blades
        inside &= -x * math.sin(angle) - y * math.cos(angle) < math.cos(math.pi / blades)
    counted = inside.reshape(len(values), fine, len(values), fine).sum((1, 3)) / inside.sum()
    np.testing.assert_allclose(values, counted, atol=3e-3)


def test_wholly_curved_blades_make_a_disc():
    for blades in (3, 6):
        np.testing.assert_allclose(
            table(pm.Polygon(blades, 20, 1.0), 9.4), table(pm.Disc(), 9.4), atol=1e-5
        )


@pytest.mark.parametrize("aperture", [pm.Polygon(3), pm.ImageAperture(HEART)], ids=str)
def test_nearer_than_the_focus_highlights_are_upside_down(aperture):
    far, near = (table(aperture, 8.3, (0.5, 0.5), depth) for depth in (FAR, NEAR))
    np.testing.assert_allclose(near, far[::-1, ::-1], atol=1e-12)
    assert abs(far - near).max() > 0.1 * far.max()


def test_highlights_beyond_the_focus_show_the_aperture_upright():
    """A triangle with a corner at the top goes up twice as far as down."""
    values = table(pm.Polygon(3), 20.0)
    reach = len(values) // 2
    assert values[: reach - 11].sum() > 0.05
    assert values[reach + 12 :].sum() == 0
    corner = np.zeros((8, 8))
    corner[1:3, 4:7] = 1  # above and to the right
    x, y, *_ = moments(table(pm.ImageAperture(corner), 20.0))
    assert x > 3
    assert y < -3


@pytest.mark.parametrize("aperture", [pm.Disc(), pm.Polygon(4)], ids=str)
def test_squeeze_makes_highlights_taller_than_wide(aperture):
    plain, squeezed = (
        moments(table(aperture, 30.0, lens=LENS.replace(squeeze=squeeze))) for squeeze in (1, 2)
    )
    assert squeezed[2] == pytest.approx(plain[2] / 4, rel=0.01)
    assert squeezed[3] == pytest.approx(plain[3], rel=0.01)


@pytest.mark.parametrize("aperture", SHAPES, ids=str)
def test_points_are_where_the_aperture_is_open(aperture):
    points = aperture.points(4096)
    assert points.shape == (4096, 2)
    assert np.hypot(*points.T).max() <= 1.05  # an element on the circle is open
    share = aperture.transmission(10)
    share /= share.sum()
    edges = np.linspace(-1, 1, 11)
    counted, *_ = np.histogram2d(points[:, 1], points[:, 0], bins=[edges, edges])
    np.testing.assert_allclose(counted / 4096, share, atol=2.5e-3)


# ---------------------------------------------------------------- diffraction


@pytest.mark.parametrize("f_number", [2.0, 22.0])
def test_a_diffraction_table_is_the_integral_of_the_intensity(f_number):
    lens, pixels_per_mm, wavelength = LENS.replace(f_number=f_number), 500.0, 550.0
    channel = pm.Lommel((wavelength,)).channels[0]
    depth, fine = 1010.0, 12
    values = channel.table(lens, depth, pixels_per_mm, (0.5, 0.5), (15, 15))
    reach = len(values) // 2
    place = (np.arange(len(values) * fine) + 0.5) / fine - reach - 0.5
    u, v = optical_coordinates(
        lens, depth, np.hypot(place[None, :], place[:, None]) / pixels_per_mm, wavelength
    )
    _, per_square = optical_coordinates(lens, depth, 1 / pixels_per_mm, wavelength)
    light = lommel_intensity(u, v).reshape(len(values), fine, len(values), fine).mean((1, 3))
    # All the light in the plane is 4 pi in units of v, times I at the origin.
    light *= per_square**2 / (4 * math.pi)
    np.testing.assert_allclose(
        values * (1 - diffraction_kernel.TAIL), light, atol=3e-3 * light.max()
    )


def test_truncated_patterns_end_at_the_circle_of_confusion():
    lens = LENS.replace(f_number=16)
    whole, cut = (table(pm.Lommel((550,), truncated=t), 6.4, lens=lens) for t in (False, True))
    reach = len(cut) // 2
    assert reach == 7
    assert len(whole) > len(cut)
    distance = np.hypot(*(np.indices(cut.shape) - reach))
    assert cut[distance > 7.2].max() == 0
    inner = distance < 5
    middle = whole[len(whole) // 2 - reach :, len(whole) // 2 - reach :][: len(cut), : len(cut)]
    ratio = cut[inner] / middle[inner]
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.01)


def test_longer_waves_spread_farther_and_a_spectrum_is_smoother():
    lens = LENS.replace(f_number=22)
    red, _, blue = (c.table(lens, 1000, 500, (0.5, 0.5)) for c in pm.Lommel().channels)
    assert red.max() < 0.7 * blue.max()
    single, band = (
        c.channels[1].table(lens, 1000, 500, (0.5, 0.5), (60, 60))
        for c in (pm.Lommel(), pm.Lommel("spectrum"))
    )
    reach = len(single) // 2
    row, smooth = single[reach, reach:], band[reach, reach:]
    dark = np.flatnonzero((row[1:-1] < row[:-2]) & (row[1:-1] < row[2:]))[2] + 1
    assert smooth[dark] > 1.5 * row[dark]
    assert band.argmax() == single.argmax()


def test_tables_are_kept():
    diffraction_kernel._one_kernel.cache_clear()
    for _ in range(3):
        for focus_distance in (1000.0, 1000.0 * (1 + 1e-13)):
            lens = LENS.replace(focus_distance=focus_distance)
            table(pm.Lommel((550,)), 5.0, lens=lens)
    assert diffraction_kernel._one_kernel.cache_info().misses == 1


def test_the_energy_of_a_table_grows_as_the_closed_form_says():
    lens, pixels_per_mm = LENS.replace(f_number=11), 800.0
    channel = pm.Lommel((600,)).channels[0]
    u, per_square = optical_coordinates(lens, 1100.0, 1 / pixels_per_mm, 600.0)
    values = channel.table(lens, 1100.0, pixels_per_mm, (0.5, 0.5))
    distance = np.hypot(*(np.indices(values.shape) - len(values) // 2))
    for radius in (30.0, 60.0, 100.0, 200.0):
        within = values[distance < radius].sum() * (1 - diffraction_kernel.TAIL)
        assert within == pytest.approx(encircled_energy(u, radius * per_square), abs=5e-3)


# ---------------------------------------------------------------- text and parameters


@pytest.mark.parametrize("aperture", ALL, ids=str)
def test_the_description_of_an_aperture_makes_it_again(aperture):
    assert aperture_of(aperture.describe()) == aperture
    lens = LENS.replace(aperture=aperture)
    assert pm.ThinLens(**lens.to_dict()) == lens
    assert (lens == LENS) == (aperture == pm.Disc())


@pytest.mark.parametrize(
    ("text", "aperture"),
    [
        ("disc", pm.Disc()),
        ("polygon", pm.Polygon()),
        ("polygon:blades=7,rotation=15", pm.Polygon(7, 15)),
        ("lommel:wavelengths=550", pm.Lommel((550,))),
        ("lommel:wavelengths=610/550/465,truncated=true", pm.Lommel(truncated=True)),
        ("lommel:wavelengths=spectrum", pm.Lommel("spectrum")),
    ],
)
def test_apertures_can_be_given_as_text(text, aperture):
    assert aperture_of(text) == aperture
    assert LENS.replace(aperture=text).aperture == aperture


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: pm.Polygon(2), ValueError, r"^blades=2: "),
        (lambda: pm.Polygon(6.5), TypeError, r"^blades=6.5: "),
        (lambda: pm.Polygon(6, math.nan), ValueError, r"^rotation=nan: "),
        (lambda: pm.Polygon(6, 0, 1.5), ValueError, r"^curvature=1.5: must be 0 to 1"),
        (lambda: pm.Lommel((550, 600)), ValueError, r"^wavelengths="),
        (lambda: pm.Lommel(-5), ValueError, r"^wavelengths=-5: "),
        (lambda: pm.Lommel("rainbow"), ValueError, r"^wavelengths='rainbow': "),
        (lambda: pm.Lommel(truncated=3), TypeError, r"^truncated=3: "),
        (lambda: pm.Lommel(argument="best"), ValueError, r"^argument='best': "),
        (lambda: pm.ImageAperture(np.zeros((4, 4))), ValueError, r"^transmission_map: "),
        (lambda: pm.ImageAperture(np.ones(4)), ValueError, r"^transmission_map=.*: has shape"),
        (lambda: pm.ImageAperture([[1, math.nan]]), ValueError, r"^transmission_map: "),
        (lambda: pm.ImageAperture.load("no.png"), FileNotFoundError, r"^filename='no.png'"),
        (lambda: aperture_of("heart"), ValueError, r"^aperture='heart': must be one of disc"),
        (lambda: aperture_of("polygon:sides=4"), ValueError, r"^sides: .*blades"),
        (lambda: aperture_of("polygon:blades"), ValueError, r"^aperture='polygon:blades'"),
        (lambda: aperture_of("image"), ValueError, r"^filename: "),
        (lambda: aperture_of(6), TypeError, r"^aperture=6: "),
        (lambda: LENS.replace(squeeze=0.5), ValueError, r"^squeeze=0.5: must be 1 to 4"),
        (lambda: LENS.replace(vignetting="x"), TypeError, r"^vignetting='x': "),
        (
            lambda: LENS.replace(aperture=pm.Lommel(), vignetting=0.3),
            ValueError,
            r"^squeeze=1.0, vignetting=0.3: must be 1 and 0",
        ),
    ],
)
def test_bad_parameters_are_named(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_a_picture_in_a_file_can_be_the_aperture(variant_llvm, tmp_path):
    path = tmp_path / "heart.png"
    mi.util.write_bitmap(str(path), mi.TensorXf(np.float32(HEART)[..., None]), write_async=False)
    loaded = pm.ImageAperture.load(path)
    np.testing.assert_allclose(
        loaded.transmission_map, pm.ImageAperture(HEART).transmission_map, atol=0.02
    )
    assert aperture_of(f"image:filename={path}") == loaded
    sensor = {"aperture": "image", "aperture_image": str(path)}
    assert sensor_with(**sensor).lens().aperture == loaded


def sensor_with(**parameters):
    return mi.load_dict({"type": "potmesil", "focal_length": 50.0, "f_number": 4.0, **parameters})


@pytest.mark.parametrize(
    ("parameters", "aperture"),
    [
        ({}, pm.Disc()),
        ({"aperture": "polygon"}, pm.Polygon()),
        ({"aperture": "polygon", "blades": 5, "blade_rotation": 9.0}, pm.Polygon(5, 9)),
        ({"aperture": "polygon", "blade_curvature": 0.5}, pm.Polygon(6, 0, 0.5)),
        ({"aperture": "polygon:blades=8"}, pm.Polygon(8)),
        ({"aperture": "lommel"}, pm.Lommel()),
        ({"aperture": "lommel", "wavelengths": "600, 500, 400"}, pm.Lommel((600, 500, 400))),
        ({"aperture": "lommel", "wavelengths": 500.0, "truncated": True}, pm.Lommel(500, True)),
        ({"aperture": "lommel", "wavelengths": "spectrum"}, pm.Lommel("spectrum")),
    ],
)
def test_a_sensor_has_the_aperture_that_its_parameters_say(variant_llvm, parameters, aperture):
    sensor = sensor_with(**parameters)
    assert sensor.lens().aperture == aperture
    assert pm.potmesil_sensor(sensor, f_number=8).lens().aperture == aperture


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"aperture": "heart"}, "aperture='heart'"),
        (
            {"blades": 5},
            "blades=5: must be given for the aperture polygon alone, not for aperture='disc'",
        ),
        (
            {"aperture": "polygon", "wavelengths": 500.0},
            "wavelengths=500.0: must be given for the aperture lommel alone",
        ),
        ({"aperture": "lommel", "wavelengths": "red"}, "wavelengths='red'"),
        ({"aperture": "image"}, "aperture_image"),
        ({"aperture": "image", "aperture_image": "nowhere.png"}, "nowhere.png"),
        ({"aperture": "polygon", "blades": 2}, "blades=2"),
        ({"aperture": "polygon", "blades": 5.5}, "blades=5.5"),
        ({"aperture": "polygon", "blade_rotation": "x"}, "rotation='x'"),
        ({"aperture": "polygon", "blade_curvature": 2.0}, "curvature=2"),
        ({"aperture": "lommel", "truncated": 3}, "truncated=3"),
        ({"aperture": "lommel", "argument": "best"}, "argument='best'"),
        ({"vignetting": 1.5}, "vignetting=1.5"),
        ({"squeeze": 9.0}, "squeeze=9"),
    ],
)
def test_a_sensor_names_the_parameter_of_an_aperture_that_is_wrong(
    variant_llvm, parameters, message
):
    with pytest.raises(Exception, match=message):
        sensor_with(**parameters)


def test_files_keep_the_aperture(variant_llvm, tmp_path):
    lens = LENS.replace(aperture=pm.Polygon(5), squeeze=1.5, vignetting=0.2)
    path = tmp_path / "samples.exr"
    synthetic(50, lens=lens).save(path)
    assert pm.PointSamples.load(path).lens == lens


def test_a_text_has_16_bits_for_each_element_of_a_picture():
    exact = pm.ImageAperture(HEART)
    told = aperture_of(exact.describe())
    assert told != exact
    np.testing.assert_allclose(told.transmission_map, exact.transmission_map, atol=0.5 / 65535)
    assert aperture_of(told.describe()) == told


def test_equal_pictures_have_equal_hashes_and_others_are_not_equal():
    first, same = pm.ImageAperture(HEART), pm.ImageAperture(2 * HEART)
    assert (first, hash(first)) == (same, hash(same))
    other = HEART.copy()
    other[8, 6] *= 1 + 1e-6  # less than 16 bits tell
    assert pm.ImageAperture(other) != first
    row, column = np.ones((1, 4)), np.ones((4, 1))
    assert pm.ImageAperture(row) != pm.ImageAperture(column)
    zero, minus = pm.ImageAperture([[1, 0.0], [1, 1]]), pm.ImageAperture([[1, -0.0], [1, 1]])
    assert (zero, hash(zero)) == (minus, hash(minus))


def described_picture(levels, **changes):
    """The text of an aperture that is a picture, of bytes as they are given."""
    data = base64.urlsafe_b64encode(zlib.compress(bytes(levels))).decode().rstrip("=")
    parameters = {"width": 4, "height": 3, "data": data, **changes}
    return "image:" + ",".join(f"{name}={value}" for name, value in parameters.items())


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (described_picture(24 * b"a", width=5), ValueError, "^data=.*5 x 3 elements"),
        (described_picture(25 * b"a"), ValueError, "^data=.*4 x 3 elements of 16 bits, 24 bytes"),
        (described_picture(24 * b"a", width=0), ValueError, "^width=0: must be 1 to 4096"),
        (described_picture(24 * b"a", height=4097), ValueError, "^height=4097: must be 1 to 4096"),
        (described_picture(24 * b"a", width=2.5), TypeError, "^width=2.5: must be a whole number"),
        (described_picture(24 * b"a", data="eJx!"), ValueError, "^data='eJx!'.*damaged"),
        (described_picture(24 * b"a", data="eJx"), ValueError, "^data='eJx'.*: "),
        (described_picture(24 * b"a", data="abcd"), ValueError, "^data='abcd'.*damaged"),
        (described_picture(24 * b"\0"), ValueError, "^transmission_map: "),
    ],
)
def test_a_damaged_picture_in_a_text_is_named(text, error, message):
    with pytest.raises(error, match=message):
        aperture_of(text)
    assert aperture_of(described_picture(24 * b"a")).transmission_map.shape == (3, 4)


def test_a_picture_in_a_text_is_unpacked_no_further_than_its_size():
    bomb = described_picture(bytes(1 << 28))  # 260 kB of text
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"^data=.*4 x 3 elements"):
            aperture_of(bomb)
        assert tracemalloc.get_traced_memory()[1] < 10 * len(bomb)
    finally:
        tracemalloc.stop()


def test_a_text_from_a_file_names_no_file(tmp_path):
    secret = tmp_path / "secret.png"
    values = {**LENS.to_dict(), "aperture": f"image:filename={secret}"}
    with pytest.raises(ValueError, match=r"^filename='.*secret.png': a file must not name another"):
        pm.ThinLens.from_dict(values)
    with pytest.raises(FileNotFoundError):  # A person may.
        pm.ThinLens(**values)
    assert pm.ThinLens.from_dict({**values, "aperture": PICTURE.describe()}).aperture == PICTURE


def test_optical_coordinates_do_not_go_through_the_text_of_the_aperture(monkeypatch):
    lens = LENS.replace(aperture=PICTURE)
    expected = optical_coordinates(LENS, 900.0, 0.01, 550.0)
    monkeypatch.setattr(pm.ImageAperture, "describe", lambda _: pytest.fail("described"))
    assert optical_coordinates(lens, 900.0, 0.01, 550.0) == expected


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize("pixel", [1e-3, 4e-3])
@pytest.mark.parametrize("depth", [1000.0, 1200.0, 700.0])
@pytest.mark.parametrize(
    ("method", "offset"), [("layered", 0.0), ("layered", 0.4), ("lightfield", 0.2)]
)
def test_a_bright_point_looks_as_wave_optics_has_it(variant_llvm, pixel, depth, method, offset):
    size = 97
    lens = pm.ThinLens(50, 22, 1000, aperture=pm.Lommel((550,)), film="focused")
    samples = bright_point(size, pixel, depth, lens, offset)
    picture = np.array(pm.focus(samples, method=method), dtype=np.float64)[..., 1]
    expected = fourier_optics(size, pixel, depth, samples.lens, 550.0, offset)
    np.testing.assert_allclose(picture / picture.max(), expected / expected.max(), atol=0.01)


@pytest.mark.parametrize("method", ["layered", "lightfield"])
@pytest.mark.parametrize("pixel", [2e-3, 8e-3, 16e-3, 70e-3])
@pytest.mark.parametrize("offset", [0.0, 0.2, 0.45])
@pytest.mark.parametrize("depth", [1000.0, 900.0])
def test_patterns_narrow_or_wide_keep_the_light_of_a_point(
    variant_llvm, method, pixel, offset, depth
):
    size = 61
    lens = pm.ThinLens(50, 8, 1000, aperture=pm.Lommel((550,), truncated=depth < 1000))
    samples = bright_point(size, pixel, depth, lens, offset, light=100.0, background=1.0)
    picture = np.array(pm.focus(samples, method=method), dtype=np.float64)
    assert picture.min() > 0.999
    assert (picture[..., 1] - 1).sum() == pytest.approx(100, rel=3e-3)


@pytest.mark.parametrize("method", ["layered", "lightfield", "paper"])
@pytest.mark.parametrize("aperture", [*SHAPES, pm.Lommel((550,), truncated=True)], ids=str)
@pytest.mark.parametrize("depth", [NEAR, FAR])
def test_the_light_of_a_point_is_the_pinholes_whatever_the_aperture(
    variant_llvm, method, aperture, depth
):
    size = 121
    lens = pm.ThinLens(50, 4, 1000, aperture=aperture)
    samples = bright_point(size, 0.1, depth, lens, light=100.0, background=1.0)
    options = {"inverse_square": False, "tables": 9} if method == "paper" else {}
    picture = np.array(pm.focus(samples, method=method, **options), dtype=np.float64)
    np.testing.assert_allclose(picture.sum(axis=(0, 1)) / (size**2 + 100), 1, rtol=1e-4)


@pytest.mark.parametrize("method", ["layered", "lightfield", "paper"])
@pytest.mark.parametrize(
    "lens",
    [
        LENS.replace(aperture=pm.Polygon(5)),
        LENS.replace(aperture=pm.ImageAperture(HEART)),
        LENS.replace(aperture=pm.Lommel()),
        LENS.replace(squeeze=1.7),
        LENS.replace(vignetting=0.6),
    ],
    ids=["polygon", "image", "lommel", "squeeze", "vignetting"],
)
def test_a_uniform_picture_stays_uniform_whatever_the_aperture(variant_llvm, method, lens):
    if method == "paper" and lens.vignetting > 0:
        return
    samples = synthetic(20 * 14 * 16)
    samples = samples.replace(rgb=np.full_like(samples.rgb, 0.7))
    lens = samples.lens.replace(
        f_number=1.0, aperture=lens.aperture, squeeze=lens.squeeze, vignetting=lens.vignetting
    )
    options = {"tables": 9} if method == "paper" else {}
    image = np.array(pm.focus(samples, lens, method=method, **options))
    np.testing.assert_allclose(image, 0.7, atol=1e-4)


@pytest.mark.parametrize("method", ["layered", "lightfield"])
@pytest.mark.parametrize(
    "changes",
    [
        {"aperture": pm.Polygon(3)},
        {"aperture": pm.Polygon(5, 10.0, 0.3)},
        {"aperture": pm.ImageAperture(HEART)},
        {"squeeze": 1.6},
        {"vignetting": 0.5},
    ],
    ids=["triangle", "curved", "image", "squeeze", "vignetting"],
)
def test_pictures_are_those_of_many_pinholes_on_the_aperture(
    variant_llvm, pinhole_pictures, method, changes
):
    samples, picture = pinhole_pictures(changes)
    lens = samples.lens.replace(**changes)
    quality = psnr(np.array(pm.focus(samples, lens, method=method)), picture)
    assert quality > 42
    turned = {**changes, "aperture": pm.Polygon(3, 180.0)}
    other = np.array(pm.focus(samples, samples.lens.replace(**turned), method=method))
    assert psnr(other, picture) < quality - 3, "the wrong aperture can be told from the right one"


@pytest.fixture(scope="module")
def pinhole_pictures():
    made = {}

    def make(changes):
        key = str(changes)
        if key not in made:
            mi.set_variant("llvm_ad_rgb")
            scene = papers_scene(96, f_number=1.4, focus_distance=2000)
            sensor = scene.sensors()[0]
            sampling = pm.Sampling(overscan=24)
            samples = pm.render_samples(scene, spp=16, sampling=sampling)
            lens = sensor.lens().replace(**changes)
            made[key] = samples, through_pinholes(scene, lens, 128)
        return made[key]

    return make


def test_the_papers_method_refuses_vignetting(variant_llvm):
    samples = synthetic()
    with pytest.raises(ValueError, match=r"^vignetting=0.3: must be 0 for the method paper"):
        pm.focus(samples, samples.lens.replace(vignetting=0.3), method="paper")


def test_thinlens_cannot_be_compared_with_other_apertures(variant_llvm):
    scene = still_life(sensor={"type": "potmesil", "f_number": 4.0, "aperture": "polygon"})
    with pytest.raises(ValueError, match=r"^aperture=Polygon.*thinlens knows no other"):
        thinlens_sensor(scene.sensors()[0])


@pytest.mark.parametrize("method", ["layered", "lightfield", "paper"])
def test_in_the_geometric_limit_diffraction_changes_nothing(variant_llvm, method):
    samples = pm.render_samples(papers_scene(128), spp=16)
    options = {"squares": 2, **({"tables": 9} if method == "paper" else {})}
    disc, lommel = (
        np.array(pm.focus(samples, samples.lens.replace(aperture=a), method=method, **options))
        for a in ("disc", "lommel")
    )
    assert psnr(lommel, disc) > 50
    assert lommel.mean() == pytest.approx(disc.mean(), rel=1e-4)
