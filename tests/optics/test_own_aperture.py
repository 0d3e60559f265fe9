"""An aperture of one's own: ten lines that focus, are described, and are parsed."""

import dataclasses
import math
from typing import ClassVar

import numpy as np
import pytest
from optics.wave_optics import bright_point

import potmesil_mi as pm
from potmesil_mi.optics.disc import disc_corner_area
from scenes import synthetic


@dataclasses.dataclass(frozen=True)
class Ring(pm.Aperture):
    """What a mirror lens has: a disc without its middle."""

    inner: float = 0.5
    name: ClassVar[str] = "ring"

    def corner_area(self, x, y):
        hole = disc_corner_area(x / self.inner, y / self.inner)
        return disc_corner_area(x, y) - self.inner**2 * hole


del pm.Aperture._registered["ring"]


@pytest.fixture(autouse=True)
def _registered():
    """Other tests of this process see the package's own apertures only."""
    pm.Aperture._registered["ring"] = Ring
    yield
    del pm.Aperture._registered["ring"]


LENS = pm.ThinLens(50, 2, 1000, aperture=Ring(0.6))


def test_it_is_described_and_parsed():
    assert pm.aperture_of("ring:inner=0.6") == Ring(0.6)
    assert pm.aperture_of(Ring(0.6).describe()) == Ring(0.6)
    assert "ring" in pm.Aperture.members()
    assert pm.ThinLens.from_dict(LENS.to_dict()) == LENS
    with pytest.raises(ValueError, match=r"^outer: not a parameter of the aperture ring.*inner$"):
        pm.aperture_of("ring:outer=1")


@pytest.mark.parametrize("method", ["layered", "lightfield", "paper"])
def test_a_point_out_of_focus_is_a_ring(variant_llvm, method):
    size, radius = 61, 15
    # In mm: a pixel is a share of the circle's radius; the field of view changes it a little.
    pixel = abs(LENS.circle_of_confusion(2000.0)) / 2 / radius
    samples = bright_point(size, pixel, 2000.0, LENS, light=100.0, background=1.0)
    options = {"inverse_square": False} if method == "paper" else {}
    picture = np.array(pm.focus(samples, method=method, **options))[..., 1] - 1
    distance = np.hypot(*(np.indices(picture.shape) - size // 2))
    on_ring = picture[(distance > 10) & (distance < 14)]
    assert picture.sum() == pytest.approx(100, rel=3e-3)
    assert picture[distance < 7].max() < 0.02 * on_ring.mean()
    # Uniform, but for what is left to see of the single lens points.
    uniform = 100 / (math.pi * radius**2 * (1 - 0.6**2))
    assert on_ring.mean() == pytest.approx(uniform, rel=0.03)
    assert on_ring.std() < 0.1 * uniform


def test_its_points_are_where_it_is_open():
    radius = np.hypot(*Ring(0.6).points(2000).T)
    assert radius.min() > 0.6 - 0.02
    assert radius.max() < 1 + 0.02
    # Evenly: as much beyond the radius that halves the area as within.
    assert (radius > math.sqrt((1 + 0.36) / 2)).mean() == pytest.approx(0.5, abs=0.02)


def test_files_keep_it_and_ask_for_it_where_it_is_not_defined(variant_llvm, tmp_path):
    path = tmp_path / "samples.exr"
    synthetic(50, lens=LENS).save(path)
    assert pm.PointSamples.load(path).lens == LENS
    del pm.Aperture._registered["ring"]
    try:
        with pytest.raises(ValueError, match=r"'ring'.*must be defined.*before the file is load"):
            pm.PointSamples.load(path)
    finally:
        pm.Aperture._registered["ring"] = Ring
