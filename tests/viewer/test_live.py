"""`potmesil live` in a real browser, and who is let in."""

import base64
import contextlib
import http.client
import socket
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import OpenImageIO as oiio
import pytest

import potmesil_mi as pm
from potmesil_mi._image import linear_from_srgb
from potmesil_mi.evaluation import metrics
from potmesil_mi.viewer import view as module
from potmesil_mi.viewer.server import Live
from potmesil_mi.viewer.view import Viewer
from scenes import papers_scene

pytest.importorskip("aiohttp")
pytestmark = pytest.mark.usefixtures("variant_llvm")

SIDE = 96
FULL = "canvas[data-small=false]"


@pytest.fixture(scope="module")
def samples():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    return pm.render_samples(papers_scene(SIDE), spp=4)


@contextlib.contextmanager
def served(view):
    """The address of a page of the view; another thread answers."""
    live = Live(view)
    with live.listening():
        thread = threading.Thread(target=live.run)
        thread.start()
        try:
            yield live.address
        finally:
            live.end()
            thread.join()


@pytest.fixture(scope="module")
def view(samples):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SMALL_PIXELS", SIDE**2 // 4)
        yield Viewer(samples)


@pytest.fixture(scope="module")
def address(view):
    with served(view) as found:
        yield found


def opened(page, address):
    page.goto(address)
    page.wait_for_selector(FULL)
    settled(page)


def settled(page):
    """Wait until what is shown is the answer to the last question."""
    page.wait_for_selector("section[aria-busy=false]")
    page.wait_for_selector(FULL)


def shown(page, tmp_path):
    """What is on the canvas, linear (H, W, 3)."""
    url = page.evaluate("document.querySelector('canvas').toDataURL('image/png')")
    path = tmp_path / "shown.png"
    path.write_bytes(base64.b64decode(url.partition(",")[2]))
    return linear_from_srgb(oiio.ImageBuf(str(path)).get_pixels("float")[..., :3])


def click_at(page, x, y):
    box = page.locator("canvas").first.bounding_box()
    before = page.get_attribute("canvas", "data-shown")
    page.mouse.click(box["x"] + x / SIDE * box["width"], box["y"] + y / SIDE * box["height"])
    page.wait_for_selector(f"canvas:not([data-shown='{before}'])")
    settled(page)


# ---------------------------------------------------------------- the page


def test_a_click_focuses_on_the_sphere_and_the_picture_is_that_of_a_focus(
    page, address, samples, tmp_path
):
    opened(page, address)
    before = shown(page, tmp_path)
    x, y = 0.33 * SIDE, 0.7 * SIDE
    depth = pm.focus_distance_at(samples, x, y)
    assert depth == pytest.approx(pm.focus_distance_of(samples, "sphere"), rel=0.1)
    click_at(page, x, y)
    after = shown(page, tmp_path)
    assert (
        page.get_by_label("Focus", exact=True).get_attribute("aria-valuetext") == f"{depth:.4g} mm"
    )
    assert f"focused at {depth:.4g} mm" in page.get_by_role("status").first.inner_text()
    expected = pm.focus(samples, samples.lens.replace(focus_distance=depth))
    assert metrics.psnr(after, expected) > 35
    assert metrics.psnr(before, expected) < 35
    assert page.errors == []
    assert all(request.startswith(address) for request in page.requests)


def test_the_keyboard_focuses_too(page, address, samples):
    opened(page, address)
    page.locator("canvas").first.focus()
    before = page.get_attribute("canvas", "data-shown")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_selector(f"canvas:not([data-shown='{before}'])")
    settled(page)
    depth = pm.focus_distance_at(samples, SIDE / 2, SIDE / 2 + SIDE / 40)
    assert (
        page.get_by_label("Focus", exact=True).get_attribute("aria-valuetext") == f"{depth:.4g} mm"
    )


def test_every_control_has_a_label_and_the_loupe_shows_squares(page, address):
    opened(page, address)
    for label in ("Focus", "Aperture", "Shape", "Method", "Exposure", "Show", "Loupe, 400 %"):
        assert page.get_by_label(label, exact=True).is_visible(), label
    page.get_by_label("Loupe, 400 %").check()
    page.locator("canvas").first.hover()
    loupe = "document.querySelector('.pm-loupe')"
    row = page.evaluate(f"[...{loupe}.getContext('2d').getImageData(0, 100, 200, 1).data]")
    assert page.locator(".pm-loupe").is_visible()
    pixels = np.array(row).reshape(50, 4, 4)
    assert (pixels == pixels[:, :1]).all()
    assert np.ptp(pixels[..., :3]) > 0


def test_what_is_refused_is_said_on_the_page_and_the_next_picture_comes(page, address, view):
    opened(page, address)
    start = view._own
    view._own = start.replace(vignetting=0.5)  # which the method paper has not
    try:
        page.get_by_label("Method").select_option("paper")
        page.get_by_role("alert").wait_for()
        assert "vignetting=0.5: must be 0" in page.get_by_role("alert").inner_text()
    finally:
        view._own = start
    before = page.get_attribute("canvas", "data-shown")
    page.get_by_label("Method").select_option("own")
    page.wait_for_selector(f"canvas:not([data-shown='{before}'])")
    assert page.get_by_role("alert").is_hidden()
    assert page.errors == []


def test_while_one_drags_pictures_are_small_and_stale_ones_are_not_formed(
    page, address, view, monkeypatch
):
    """Each picture takes so long that many positions of the slider pass meanwhile."""
    opened(page, address)
    asked, answer = [], view.answer

    def slowly(message):
        asked.append(message)
        time.sleep(0.05)
        return answer(message)

    monkeypatch.setattr(view, "answer", slowly)
    slider = page.get_by_label("Focus", exact=True)
    box, moves = slider.bounding_box(), 30
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.8 * box["width"], middle)
    page.mouse.down()
    for i in range(moves):
        page.mouse.move(box["x"] + (0.8 - 0.7 * i / moves) * box["width"], middle)
    page.wait_for_selector("canvas[data-small=true]")
    during = len(asked)
    page.mouse.up()
    page.wait_for_selector(FULL)
    assert all(one["small"] for one in asked[:during])
    assert 1 <= during < moves
    assert asked[-1]["small"] is False
    assert asked[-1]["focus_distance"] == view.about["foci"][int(slider.input_value())]


def test_the_page_fits_a_narrow_window(page, address):
    page.set_viewport_size({"width": 400, "height": 800})
    opened(page, address)
    assert page.evaluate("document.documentElement.scrollWidth") <= 400


# ---------------------------------------------------------------- who is let in


def status(address, path=None, method="GET", **headers):
    """The status, and the headers, of an answer to a request."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=10)
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, parts.path if path is None else path, headers=headers)
    response = connection.getresponse()
    response.read()
    connection.close()
    return response.status, response.headers


def test_the_page_may_load_nothing_from_elsewhere(address):
    code, headers = status(address)
    assert code == 200
    assert headers["Content-Security-Policy"].startswith("default-src 'self';")
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize(
    "path", ["/", "/viewer.js", "/wrong/", "/wrong/viewer.js", "/wrong/socket"]
)
def test_without_the_token_nothing_is_told(address, path):
    code, headers = status(address, path)
    assert code == 403
    assert "Content-Security-Policy" in headers


def test_what_there_is_not_is_not_found_and_no_other_file_is_read(address):
    path = urlsplit(address).path
    assert status(address, path + "view.py")[0] == 404
    assert status(address, path + "..%2fview.py")[0] == 404
    assert status(address, method="POST")[0] == 405
    assert status(address, "*", method="OPTIONS")[0] == 403
    assert status(address, "/%ff%fe/")[0] == 403


def test_another_name_and_another_page_are_refused(address):
    port = urlsplit(address).port
    assert status(address, Host=f"evil.example:{port}")[0] == 403
    assert status(address, Origin="http://evil.example")[0] == 403
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec_WebSocket_Version": "13",
        "Sec_WebSocket_Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    path = urlsplit(address).path + "socket"
    assert status(address, path, **upgrade, Origin="http://evil.example")[0] == 403
    assert status(address, path, **upgrade)[0] == 403
    assert status(address, path, **upgrade, Origin=f"http://127.0.0.1:{port}")[0] == 101


def test_only_the_loopback_address_is_listened_on(address):
    with pytest.raises(ConnectionRefusedError):  # 127.0.0.2 is one of "every address".
        socket.create_connection(("127.0.0.2", urlsplit(address).port), timeout=5)


def test_a_port_that_is_taken_is_an_error(address, samples):
    live = Live(Viewer(samples), urlsplit(address).port)
    with pytest.raises(OSError, match="address already in use"), live.listening():
        pass
