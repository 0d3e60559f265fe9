"""Living pictures in a real browser: what one sees is what ``pm.focus`` forms there."""

import base64
import io

import numpy as np
import pytest
from browser import opened
from PIL import Image

import potmesil_mi as pm
from potmesil_mi._image import in_srgb
from scenes import behind_a_bar

F_NUMBERS = [0.7, 1.4, 2.8]
BAR, CARD, LAMPS = (28, 20), (58, 52), (84, 10)
"""Pixels of things at 0.8, 2 and 8 m."""

READ = """canvas => new Promise(done => requestAnimationFrame(
    () => done(canvas.toDataURL().split(",")[1])))"""


@pytest.fixture(scope="module")
def samples():
    return behind_a_bar()


@pytest.fixture(scope="module")
def path(samples, tmp_path_factory):
    path = tmp_path_factory.mktemp("living") / "bar.html"
    pm.living_picture(samples, path, f_numbers=F_NUMBERS, psnr=38.0, title="A <bar>")
    return path


@pytest.fixture
def living(page, path):
    """The page, when its picture can be refocused."""
    return shown_on(page, path)


def shown_on(page, path):
    page.goto(path.as_uri())
    page.wait_for_selector("canvas[data-place]")
    return page


def canvas_of(page):
    return page.locator("canvas").first


def settled(page, place, level=0):
    """Wait until the picture of that focus and aperture is shown."""
    page.wait_for_function(
        "([place, level]) => { const { dataset } = document.querySelector('canvas');"
        "return Math.abs(dataset.place - place) < 2e-3 && dataset.level == level; }",
        arg=[place, level],
    )
    page.wait_for_timeout(200)  # A fade may go on.


def place_of(distance):
    return (1 / 0.8 - 1 / distance) / (1 / 0.8 - 1 / 8)


def picture_on(page):
    data = base64.b64decode(canvas_of(page).evaluate(READ))
    return np.array(Image.open(io.BytesIO(data)).convert("RGB")).astype(float)


def decibels(page, samples, f_number, distance):
    lens = samples.lens.replace(f_number=f_number, focus_distance=distance)
    expected = in_srgb(np.array(pm.focus(samples, lens)), "8").astype(float)
    return -10 * np.log10(np.mean(((picture_on(page) - expected) / 255) ** 2))


def click(page, pixel):
    canvas_of(page).click(position={"x": pixel[0] + 0.5, "y": pixel[1] + 0.5})


def assert_asks_nobody(page, path):
    assert page.errors == []
    asked = [request for request in page.requests if not request.startswith(("data:", "blob:"))]
    assert asked == [path.as_uri()]


def test_a_click_on_a_thing_brings_the_focus_to_its_depth(living, path, samples):
    for pixel, distance in ((BAR, 0.8), (LAMPS, 8.0), (CARD, 2.0)):
        click(living, pixel)
        settled(living, place_of(distance))
        assert decibels(living, samples, F_NUMBERS[0], distance) >= 37
    assert_asks_nobody(living, path)


def test_what_is_drawn_over_focuses_while_the_pointer_is_down(living, samples):
    box = canvas_of(living).bounding_box()
    living.mouse.move(box["x"] + LAMPS[0], box["y"] + LAMPS[1])
    living.mouse.down()
    settled(living, place_of(8.0))
    living.mouse.move(box["x"] + BAR[0], box["y"] + BAR[1], steps=4)
    settled(living, place_of(0.8))
    living.mouse.up()
    living.mouse.move(box["x"] + LAMPS[0], box["y"] + LAMPS[1])
    living.wait_for_timeout(300)
    settled(living, place_of(0.8))
    assert decibels(living, samples, F_NUMBERS[0], 0.8) >= 37


def test_keys_focus_and_change_the_aperture_and_a_reader_is_told(living, path, samples):
    canvas_of(living).focus()
    living.keyboard.press("End")
    living.keyboard.press("ArrowDown")
    settled(living, 1, level=1)
    assert decibels(living, samples, F_NUMBERS[1], 8.0) >= 37
    for _ in range(3):
        living.keyboard.press("ArrowLeft")
    settled(living, 0.97, level=1)
    living.wait_for_function(
        "() => document.querySelector('[aria-live=polite]').textContent"
        " === 'focused at 6.3 m, f/1.4'"
    )
    said = canvas_of(living).get_attribute("aria-label")
    assert said.startswith("A <bar>, focused at 6.3 m, f/1.4. Left and right arrow keys")
    living.keyboard.press("ArrowUp")
    living.keyboard.press("Home")
    settled(living, 0)
    assert_asks_nobody(living, path)


def test_sliders_have_names_and_values_and_the_wheel_turns_the_aperture(living, samples):
    focus, aperture = (living.get_by_role("slider", name=name) for name in ("Focus", "Aperture"))
    focus.fill("500")
    settled(living, 0.5)
    assert focus.get_attribute("aria-valuetext") == "1.45 m"
    assert decibels(living, samples, F_NUMBERS[0], 1 / (0.5 / 0.8 + 0.5 / 8)) >= 37
    aperture.hover()
    living.mouse.wheel(0, 100)
    settled(living, 0.5, level=1)
    aperture.focus()
    living.keyboard.press("End")
    settled(living, 0.5, level=2)
    assert aperture.get_attribute("aria-valuetext") == "f/2.8"
    assert decibels(living, samples, F_NUMBERS[2], 1 / (0.5 / 0.8 + 0.5 / 8)) >= 37


def test_without_webgl2_the_picture_is_drawn_anyway_and_a_note_says_so(page, path, samples):
    page.add_init_script("OffscreenCanvas.prototype.getContext = () => null;")
    shown_on(page, path)
    assert page.get_by_text("no WebGL2").is_visible()
    click(page, LAMPS)
    settled(page, 1)
    assert decibels(page, samples, F_NUMBERS[0], 8.0) >= 37
    assert_asks_nobody(page, path)


def test_without_scripts_there_is_a_picture_and_a_note(browser, path):
    with opened(browser, java_script_enabled=False) as page:
        page.goto(path.as_uri())
        assert "JavaScript is switched off" in page.locator("noscript").text_content()
        assert page.locator("img").bounding_box()["width"] == 96
        assert page.locator("img").get_attribute("alt") == "A <bar>"


def test_a_tap_on_a_phone_focuses_and_the_page_fits(browser, path):
    phone = {"width": 320, "height": 480, "has_touch": True, "is_mobile": True}
    with opened(browser, device_scale_factor=2, **phone) as page:
        shown_on(page, path)
        box = canvas_of(page).bounding_box()
        page.touchscreen.tap(box["x"] + BAR[0], box["y"] + BAR[1])
        settled(page, 0)
        assert page.evaluate("document.documentElement.scrollWidth") <= 320
        assert page.errors == []


def test_pictures_of_one_page_are_refocused_by_themselves(page, path, tmp_path, samples):
    both = tmp_path / "both.html"
    pm.living_page([path, path], both, title="Two")
    shown_on(page, both)
    first, second = page.locator("canvas").all()
    second.click(position={"x": BAR[0], "y": BAR[1]})
    page.wait_for_function("() => document.querySelectorAll('canvas')[1].dataset.place == 0")
    assert float(first.get_attribute("data-place")) == pytest.approx(place_of(2.0), abs=1e-3)
    assert decibels(page, samples, F_NUMBERS[0], 2.0) >= 37
    assert_asks_nobody(page, both)
