"""Tiles: a picture formed part by part is the one that is formed as a whole, without a seam."""

import dataclasses
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing.tiles import stages
from scenes import SCENES, behind_a_bar, evenly_spread, overscanned, papers_scene, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

ROUNDING = 1e-5
"""Largest difference, as a part of the brightest colour or of 1: sums are added in another order,
and transforms are of other sizes."""


@pytest.fixture(autouse=True)
def one_thread():
    """Sums are added in one order: several threads change a few pixels from run to run."""
    before = dr.thread_count()
    dr.set_thread_count(1)
    yield
    dr.set_thread_count(before)


@pytest.fixture
def looked_at(monkeypatch):
    """The windows of the tiles that are looked at."""
    windows, part_of = [], stages.part_of

    def spied(samples, crop, sampled):
        windows.append(sampled)
        return part_of(samples, crop, sampled)

    monkeypatch.setattr(stages, "part_of", spied)
    return windows


def require_same(samples, tiles=(2, 2), **how):
    whole = np.array(pm.focus(samples, **how))
    tiled = np.array(pm.focus(samples, tiles=tiles, **how))
    assert tiled.shape == whole.shape
    assert np.ptp(whole) > 0.05
    np.testing.assert_allclose(tiled, whole, rtol=0, atol=ROUNDING * max(1, whole.max()))


@pytest.fixture(scope="module")
def figure11():
    mi.set_variant("llvm_ad_rgb")
    return pm.render_samples(papers_scene(112), spp=2)


@pytest.fixture(scope="module")
def thicket():
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_file(str(SCENES / "thicket.xml"), optimize=False, res=48)
    return pm.render_samples(scene, spp=4)


def wide():
    """Lamps behind a bar, with circles that are spread on coarser pixels."""
    lens = pm.ThinLens(50.0, 0.35, 2.0, millimeters_per_unit=1000.0)
    return behind_a_bar(lens)


@pytest.mark.parametrize("method", ["layered", "lightfield", "paper:tables=9"])
def test_figure_11_has_no_seam(figure11, looked_at, method):
    require_same(figure11, (3, 2), method=method)
    assert max(window.size for window in looked_at) < figure11.window.size


@pytest.mark.parametrize("method", ["layered", "lightfield:lens_points=64"])
def test_a_crowded_scene_has_no_seam(thicket, looked_at, method):
    assert thicket.is_crowded
    require_same(thicket, (2, 3), method=method)
    assert min(window.size for window in looked_at) < thicket.window.size


@pytest.mark.parametrize("method", ["layered", "lightfield:lens_points=64"])
def test_highlights_and_coarse_pixels_have_no_seam(looked_at, method):
    require_same(behind_a_bar(), (3, 1), method=method)
    assert min(window.size for window in looked_at) < 96 * 64
    require_same(wide(), (3, 2), method=method)


@pytest.mark.parametrize(
    "lens",
    [
        {"aperture": "polygon:blades=5,rotation=10", "squeeze": 1.4},
        {"vignetting": 0.4},
        {"aperture": "lommel:wavelengths=610/550/465", "f_number": 16},
        {"aperture_radius": 0},
    ],
)
def test_lenses_of_all_kinds_have_no_seam(figure11, lens):
    require_same(figure11, lens=figure11.lens.replace(**lens))


def test_filters_of_the_film_and_special_effects_meet_the_edges_of_no_tile(figure11):
    rfilter = mi.load_dict({"type": "gaussian"})
    require_same(figure11, rfilter=rfilter, alpha=True, filters=["star:threshold=0.5"], squares=2)


@pytest.mark.parametrize("spread", [evenly_spread, overscanned])
@pytest.mark.parametrize("squares", [1, 3])
def test_samples_that_chance_spreads_have_no_seam(spread, squares):
    """Subpixels without any borrow those of others, also across an edge."""
    samples = spread(8000) if spread is overscanned else spread((64, 40), 2)
    lens = samples.lens.replace(f_number=4.0)
    require_same(samples, (4, 3), lens=lens, squares=squares, alpha=True)


def test_samples_on_the_edges_of_pixels_have_no_seam():
    y, x = (axis.ravel() for axis in np.mgrid[0:65, 0:129] / 2)
    rng = np.random.default_rng(3)
    samples = synthetic(
        len(x),
        size=(64, 32),
        x=x,
        y=y,
        rgb=rng.uniform(0, 1, (len(x), 3)),
        z=np.where(x < 30, 1.5, 4.0),
        weight=np.full(len(x), 0.25),
        lattice=2,
    )
    for method in ("layered", "paper:tables=5"):
        require_same(samples, (3, 1), method=method)


def test_what_is_in_focus_in_one_tile_alone_is_filled_in_all_of_them():
    samples = evenly_spread((96, 24), 2, z=np.tile(np.where(np.arange(192) < 40, 2.0, 6.0), 48))
    require_same(samples, (4, 1), lens=samples.lens.replace(f_number=8.0))


def test_what_mirrors_show_has_no_seam():
    """Of which it is known what lens points see, in one tile alone."""
    samples = evenly_spread((72, 32), 2, z=np.tile(np.where(np.arange(144) < 60, 2.0, 4.0), 64))
    shown = samples.x > 50
    bits = np.random.default_rng(2).integers(1, 1 << 63, len(samples), dtype=np.uint64)
    samples = samples.replace(
        visibility=np.where(shown, bits, np.uint64(0)),
        visibility_radius=(0.0125, 0.0125),
        through=np.where(shown, np.float32(2.5), np.float32(0)),
    )
    require_same(samples, (3, 1))


@pytest.mark.parametrize("method", ["layered", "paper:tables=9"])
def test_orthographic_cameras_have_no_seam(method):
    perspective = evenly_spread((64, 40), 2)
    camera = dataclasses.replace(
        perspective.camera, projection="orthographic", x_fov=0.0, film_width=4.0
    )
    samples = perspective.replace(camera=camera, lens=pm.TelecentricLens(3.0, 2.0))
    require_same(samples, (3, 2), method=method)


def test_what_there_is_no_room_for_is_found_out_again(figure11, monkeypatch):
    monkeypatch.setattr(stages, "KEPT_BYTES", 0)
    require_same(figure11)


def test_a_tile_that_would_take_too_much_memory_is_refused(figure11, monkeypatch):
    monkeypatch.setenv("POTMESIL_MAX_MEMORY", "1M")
    with pytest.raises(MemoryError, match="focusing"):
        pm.focus(figure11, tiles=(2, 2))


def test_a_method_of_ones_own_is_refused_by_name():
    @dataclasses.dataclass(frozen=True)
    class Grey(pm.Method):
        """A method of one's own, for the time of the test."""

        name: ClassVar[str] = "grey-of-tiles"

        def form(self, exposure, memo):
            return np.ones((*exposure.crop.shape, 3)), np.ones(exposure.crop.shape)

    try:
        with pytest.raises(ValueError, match="method=grey-of-tiles: must be layered, lightfield"):
            pm.focus(synthetic(), tiles=(2, 2), method=Grey())
    finally:
        del pm.Method._registered[Grey.name]


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"tiles": (0, 1)}, r"tiles\[0\]=0: must be 1 to 20"),
        ({"tiles": (1, 15)}, r"tiles\[1\]=15: must be 1 to 14"),
        ({"tiles": (1, 2, 3)}, r"tiles=\(1, 2, 3\): must be columns and rows, as \(2, 2\)"),
    ],
)
def test_what_cannot_be_formed_by_tiles_is_refused_by_name(how, message):
    with pytest.raises(ValueError, match=message):
        pm.focus(synthetic(), **how)


def test_samples_of_an_exposure_are_formed_by_tiles_with_the_paper_alone():
    samples = evenly_spread((40, 24), 2)
    moving = samples.replace(motion=np.tile(np.float32([3, 1, 0]), (len(samples), 1)))
    require_same(moving, method="paper:tables=5")
    with pytest.raises(ValueError, match="tiles: must be left out for samples of an exposure"):
        pm.focus(moving, tiles=(2, 2))
