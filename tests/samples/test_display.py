"""Cards that notebooks show: what they say, that they are small, and that they never fail."""

import base64
import dataclasses
import html
import re

import numpy as np
import OpenImageIO as oiio
import pytest

import potmesil_mi as pm
from potmesil_mi import _html
from potmesil_mi.samples.display import ENOUGH, THUMBNAIL, thumbnail
from scenes import evenly_spread, synthetic


def facts(card):
    """The facts on a card, by their names."""
    found = re.findall(r"<th style[^>]*>(.*?)</th><td[^>]*>(.*?)</td>", card)
    return {html.unescape(name): html.unescape(fact) for name, fact in found}


def pixels(card, folder):
    """The picture on a card, as a file reader sees it."""
    kind, data = re.search(r'src="data:image/(\w+);base64,([^"]+)"', card).groups()
    path = folder / f"picture.{kind}"
    path.write_bytes(base64.b64decode(data))
    return oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)


def test_samples_show_their_size_depths_lens_and_surfaces(tmp_path):
    samples = synthetic(500, size=(20, 14), z=np.linspace(1.5, 4, 500))
    card = samples._repr_html_()
    told = facts(card)
    assert told["picture"].startswith("20×14 pixels, 40°")
    assert told["samples"].startswith("500,")
    assert told["depth"] == "1.5 m to 4 m"
    assert told["surfaces"] == "one, two, three"
    assert told["lens"] == "50 mm, f/2"
    assert told["focused at"] == "2 m"
    near, far = samples.lens.depth_of_field()
    assert told["depth of field"] == f"{near:.4g} m to {far:.4g} m"
    assert pixels(card, tmp_path).shape == (14, 20, 3)


def test_the_thumbnail_is_the_picture_of_the_pinhole():
    samples = evenly_spread((24, 16))
    left = samples.replace(rgb=(samples.x < 12)[:, None] * np.array([1.0, 0.5, 0.0]))
    picture = thumbnail(left)
    assert picture.shape == (16, 24, 3)
    np.testing.assert_allclose(picture[:, :12] - [1, 0.5, 0], 0, atol=1e-6)
    assert not picture[:, 12:].any()


def test_the_thumbnail_leaves_out_what_the_pinhole_does_not_see():
    samples = evenly_spread((8, 8))
    hidden = np.arange(len(samples)) % 2 == 1
    rgb = np.where(hidden[:, None], 9.0, 0.25) * np.ones(3)
    picture = thumbnail(samples.replace(layer=hidden.astype(np.uint8), rgb=rgb))
    np.testing.assert_allclose(picture, 0.25)


def test_the_thumbnail_of_many_samples_is_small_and_has_no_holes():
    samples = evenly_spread((600, 150), rgb=np.ones((1440000, 3)))
    assert len(samples) > 2 * ENOUGH
    picture = thumbnail(samples)
    assert picture.shape == (THUMBNAIL // 4, THUMBNAIL, 3)
    np.testing.assert_allclose(picture, 1, atol=1e-6)


def test_a_picture_without_anything_visible_is_black():
    samples = evenly_spread((8, 8))
    assert not thumbnail(samples.replace(layer=np.ones(len(samples), np.uint8))).any()


def test_the_thumbnail_of_a_crop_window_is_of_it_alone():
    samples = evenly_spread((20, 14))
    camera = dataclasses.replace(samples.camera, crop_offset=(10, 0), crop_size=(10, 14))
    rgb = (samples.x >= 10)[:, None] * np.ones(3)
    picture = thumbnail(samples.replace(camera=camera, window=pm.Window(0, 0, 20, 14), rgb=rgb))
    assert picture.shape == (14, 10, 3)
    assert (picture == 1).all()


def test_names_on_a_card_are_escaped():
    card = synthetic(9, surfaces={1: "<script>alert(1)</script>", 2: 'a"&b'})._repr_html_()
    assert "<script" not in card
    assert '<script>alert(1)</script>, a"&b' in facts(card)["surfaces"]


def test_many_surfaces_are_counted():
    card = synthetic(99, surfaces={i: f"s{i}" for i in range(100)})._repr_html_()
    assert facts(card)["surfaces"].endswith("s7 and 92 more")
    assert len(card) < 8000


def test_what_hit_nothing_has_no_depth_to_tell():
    told = facts(synthetic(9, z=np.full(9, np.inf))._repr_html_())
    assert told["depth"] == "- to -, and the sky"


def test_samples_of_an_orthographic_camera_show_a_telecentric_lens():
    camera = dataclasses.replace(
        synthetic(1).camera, projection="orthographic", x_fov=0, film_width=2.0
    )
    samples = synthetic(99, camera=camera, lens=pm.TelecentricLens(1.5, 3.0))
    told = facts(samples._repr_html_())
    assert told["picture"].endswith("2 across, in parallel")
    assert (told["lens"], told["focused at"]) == ("1.5°", "3")


def test_a_lens_shows_its_focus_depth_of_field_and_aperture(tmp_path):
    lens = pm.ThinLens(55, 5.6, 550, aperture="polygon:blades=6", squeeze=1.5)
    card = lens._repr_html_()
    assert "ThinLens: 55 mm, f/5.6" in card
    near, far = lens.depth_of_field()
    told = facts(card)
    assert told["focused at"] == "550 mm"
    assert told["depth of field"] == f"{near:.4g} mm to {far:.4g} mm"
    assert told["squeeze"] == "1.5"
    assert told["aperture"].startswith("polygon")
    picture = pixels(card, tmp_path)
    assert picture[32, 32].min() > 250
    assert picture[0, 0].max() < 5


def test_a_pinhole_has_no_depth_of_field():
    card = pm.ThinLens(55, np.inf)._repr_html_()
    assert "ThinLens: a pinhole" in card
    assert "depth of field" not in facts(card)


@pytest.mark.parametrize("aperture", ["disc", "lommel", "polygon:curvature=0.5"])
def test_every_aperture_has_a_card(aperture):
    assert "<img" in pm.ThinLens(55, 5.6, 550, aperture=aperture)._repr_html_()


def test_a_camera_shows_where_it_stands_and_looks():
    camera = pm.Camera.looking_at((0, 1, 2), (0, 1, 0), film_size=(40, 30), x_fov=45.0)
    told = facts(camera._repr_html_())
    assert (told["stands at"], told["looks along"]) == ("0, 1, 2", "0, 0, -1")
    assert "crop window" not in told
    cropped = dataclasses.replace(camera, crop_offset=(4, 5), crop_size=(10, 10))
    assert facts(cropped._repr_html_())["crop window"] == "4 to 14 across, 5 to 15 down"


def test_a_stack_shows_its_foci_and_lenses():
    stack = pm.focal_stack(synthetic(99), [2.0, 3.0, 4.0], f_numbers=[2, 4])
    told = facts(stack._repr_html_())
    assert told["pictures"] == "6"
    assert told["focused at"] == "2 m to 4 m"
    assert told["lens"] == "50 mm, f/2, 50 mm, f/4"
    assert told["method"].startswith("layered")


def test_what_cannot_be_drawn_is_left_to_the_text(monkeypatch):
    lens = pm.ThinLens(55, np.array([2.0, 4.0]), 550)
    assert lens._repr_html_() is None
    monkeypatch.setattr(_html, "encoded_picture", lambda *_: 1 / 0)
    assert synthetic(9)._repr_html_() is None


def test_a_card_fits_light_and_dark_pages():
    card = synthetic(9)._repr_html_()
    assert not re.search(r"(?<![-\w])(color|background): *(#|black|white|rgb\()", card)
