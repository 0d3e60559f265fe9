"""A real browser that looks at pages: Chromium, driven by Playwright.

What a page logs, and all that it asks for, are kept: a test asserts that there are no errors, and
that nothing is asked of anybody else.
"""

import contextlib
import os
import shutil

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")

# Software draws, so that machines without a screen have WebGL2 too; root has no sandbox.
ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")


def program():
    """Path of Chromium, or of the one that CHROMIUM names; None where there is none."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, PROGRAMS)), None)


@contextlib.contextmanager
def started():
    """Playwright's browser. asyncio.run() fails in this thread for as long as it is there."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program(), args=[*ARGUMENTS])
        try:
            yield browser
        finally:
            browser.close()


@contextlib.contextmanager
def opened(browser, width=1000, height=800, **context):
    """A page, with lists of its `errors` and its `requests`."""
    of = browser.new_context(viewport={"width": width, "height": height}, **context)
    page = of.new_page()
    page.errors, page.requests = [], []
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.on(
        "console",
        lambda said: page.errors.append(said.text) if said.type in ("error", "warning") else None,
    )
    page.on("request", lambda request: page.requests.append(request.url))
    try:
        yield page
    finally:
        of.close()
