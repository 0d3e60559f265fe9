"""The browser that tests look at pages with tells what it is asked to keep."""

NOBODY = "http://127.0.0.1:9/x.png"


def test_errors_and_requests_of_a_page_are_kept(page):
    page.set_content(f"<script>console.error('wrong')</script><img src='{NOBODY}'>")
    page.wait_for_load_state("load")
    assert page.errors[0] == "wrong"
    assert len(page.errors) == 2
    assert page.requests == [NOBODY]


def test_the_browser_draws_by_webgl2(page):
    page.set_content("<canvas id='c'></canvas>")
    assert page.evaluate("document.getElementById('c').getContext('webgl2') !== null")
    assert page.errors == []
