"""Denoising of samples: what becomes better, and what stays."""

import dataclasses
import sys

import numpy as np
import pytest

from potmesil_mi.samples.columns import COLUMNS
from scenes import synthetic

SIZE = (64, 48)


def need_denoiser():
    pytest.importorskip("mitsuba_oidn", reason="needs mitsuba-oidn: pip install '.[denoise]'")


def noisy(irradiance, *, spp=8, noise=0.5, seed=0, layer=0, surface=1, z=2.0, chosen=None):
    """Samples of a wall, ``spp`` in each pixel, whose irradiance is a function of x and y.

    Its albedo is a fine texture. Noise is independent; ``chosen`` says which samples are there.
    """
    rng = np.random.default_rng(seed)
    width, height = SIZE
    row, column = np.divmod(np.repeat(np.arange(width * height), spp), width)
    count = len(row)
    x, y = column + rng.random(count), row + rng.random(count)
    light = (
        irradiance(x, y) * rng.gamma(1 / noise**2, noise**2, count) if noise else irradiance(x, y)
    )
    albedo = np.where(((3 * x).astype(int) + (3 * y).astype(int)) % 2, 0.8, 0.1)
    samples = synthetic(
        count,
        size=SIZE,
        x=x,
        y=y,
        z=np.full(count, z),
        surface=np.full(count, surface),
        weight=np.full(count, 1 / spp),
        layer=np.full(count, layer),
        albedo=np.stack([albedo, albedo / 2, albedo], axis=1),
        normal=np.tile([0.0, 0.0, -1.0], (count, 1)),
        rgb=np.stack([albedo, albedo / 2, albedo], axis=1) * light[:, None],
    )
    return samples if chosen is None else samples.chosen(chosen(x, y))


def joined(*parts):
    columns = {c.name: [getattr(part, c.name) for part in parts] for c in COLUMNS}
    whole = {name: np.concatenate(of) for name, of in columns.items() if of[0] is not None}
    return parts[0].replace(**whole)


def slope(x, y):
    return 1 + x / 64 + y / 96


def error(samples, irradiance):
    """Root mean square error of the irradiance of samples, relative to it."""
    light = irradiance(samples.x, samples.y)
    found = samples.rgb / samples.albedo
    return float(np.sqrt(np.mean((found / light[:, None] - 1) ** 2)))


def test_noise_goes_and_textures_stay(variant_llvm):
    need_denoiser()
    samples = noisy(slope)
    denoised = samples.denoised()
    assert str(denoised.provenance["denoised"]).startswith("oidn ")
    assert error(denoised, slope) < 0.15 * error(samples, slope)
    # Within most pixels all that is left is the texture.
    irradiance = (denoised.rgb / denoised.albedo).mean(axis=1).reshape(-1, 8)
    assert np.median(np.ptp(irradiance, axis=1)) < 0.01


def test_all_but_radiance_stays(variant_llvm):
    need_denoiser()
    samples = noisy(slope, spp=2)
    denoised = samples.denoised()
    for field in dataclasses.fields(samples):
        if field.name not in ("rgb", "provenance"):
            first, second = (getattr(s, field.name) for s in (samples, denoised))
            assert first is second or first == second
    assert not np.array_equal(samples.rgb, denoised.rgb)


def test_light_stays_on_its_side_of_an_edge_and_hidden_things_are_denoised(variant_llvm):
    """Also in the pixels that an edge cuts, and where one is behind the other."""
    need_denoiser()

    def dark(x, y):
        return np.full_like(x, 0.05)

    def edge(x, y):
        return x + 0.3 * y < 40.5

    front = noisy(dark, chosen=edge)
    back = noisy(slope, seed=1, surface=2, z=4.0, chosen=lambda x, y: ~edge(x, y))
    hidden = noisy(
        slope, seed=2, surface=2, z=4.0, layer=1, chosen=lambda x, y: edge(x, y) & edge(x + 4, y)
    )
    hidden = hidden.chosen(hidden.x + 0.3 * hidden.y > 34)
    denoised = joined(front, back, hidden).denoised()
    for surface, layer, light in ((1, 0, dark), (2, 0, slope), (2, 1, slope)):
        part = denoised.chosen((denoised.surface == surface) & (denoised.layer == layer))
        assert error(part, light) < 0.25, (surface, layer)


def test_lamps_and_the_sky_stay_as_they_are(variant_llvm):
    need_denoiser()
    samples = noisy(slope)
    lamp = (samples.x > 20) & (samples.x < 30)
    normal, albedo, rgb = samples.normal.copy(), samples.albedo.copy(), samples.rgb.copy()
    normal[lamp] = albedo[lamp] = 0
    rgb[lamp] *= 50
    samples = samples.replace(normal=normal, albedo=albedo, rgb=rgb)
    denoised = samples.denoised()
    np.testing.assert_array_equal(denoised.rgb[lamp], samples.rgb[lamp])
    wall = denoised.chosen(~lamp)
    assert error(wall, slope) < 0.15


def test_detail_without_noise_stays_though_no_feature_tells_it(variant_llvm):
    """Samples that agree are better left alone."""
    need_denoiser()

    def stripes(x, y):
        return np.where(x.astype(int) % 5 == 0, 1.3, 1.0)

    samples = noisy(stripes, noise=0)
    assert error(samples.denoised(), stripes) < 0.01


def test_single_samples_are_denoised(variant_llvm):
    need_denoiser()
    samples = noisy(slope, spp=1)
    assert error(samples.denoised(), slope) < 0.3 * error(samples, slope)


def test_pixels_without_samples_do_no_harm(variant_llvm):
    need_denoiser()
    samples = noisy(slope, chosen=lambda x, y: ((x + y / 7).astype(int) % 4 > 0) | (y < 10))
    assert error(samples.denoised(), slope) < 0.4 * error(samples, slope)


@pytest.mark.parametrize("absent", ["albedo", "normal"])
def test_samples_without_features_are_refused(absent):
    samples = noisy(slope, spp=1).replace(**{absent: None})
    with pytest.raises(ValueError, match=r"have none .*Sampling\(features=True\)"):
        samples.denoised()


def test_without_the_denoiser_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    with pytest.raises(ImportError, match=r"pip install 'potmesil_mi\[denoise\]'"):
        noisy(slope, spp=1).denoised()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"albedo": np.full((5, 3), 1.5)}, "albedo not 0 to 1"),
        ({"albedo": np.full((5, 3), np.nan)}, "albedo not 0 to 1"),
        ({"normal": np.full((5, 3), -2.0)}, "normal longer than 1"),
    ],
)
def test_features_that_cannot_be_are_dropped(fields, message):
    name, values = next(iter(fields.items()))
    values[1:] = 0
    with pytest.warns(RuntimeWarning, match=f"dropped 1 of 5 .* {message}"):
        samples = synthetic(5).replace(**{name: values})
    assert len(samples) == 4
