"""Fixtures that set a Mitsuba variant, and the settings of hypothesis."""

import potmesil_mi  # before mitsuba: it offers Dr.Jit a usable LLVM  # noqa: F401

# isort: split
import os
import signal
import threading
from pathlib import Path

import browser as browsers
import hypothesis
import mitsuba as mi
import pytest

TESTS = Path(__file__).parent

if threading.current_thread() is threading.main_thread():
    # Shells let what runs in their background ignore Ctrl-C, and so would what tests interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)

QUICK = (
    "optics",
    "samples",
    "filters",
    "test_architecture.py",
    "test_docs.py",
    "test_spec.py",
    "test_validation.py",
    "optics/test_disocclusion.py",
    "tracing/test_sampling.py",
)
"""Where `pytest -m quick` looks: it runs what sets no variant and is not marked slow."""


def may_be_quick(path):
    return any(path.is_relative_to(TESTS / place) for place in QUICK)


def pytest_ignore_collect(collection_path, config):
    """With `-m quick` other files are not even imported."""
    if config.option.markexpr == "quick" and collection_path.is_file():
        return None if may_be_quick(collection_path) else True
    return None


@pytest.hookimpl(wrapper=True, tryfirst=True)  # Before pytest looks at the marks, and after it.
def pytest_collection_modifyitems(items):
    mark_quick(items)
    yield
    items[:] = longest_first(items, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))


def mark_quick(items):
    """Mark what takes milliseconds. What sets a variant compiles kernels and forms pictures."""
    for item in items:
        sets_variant = any(
            name.startswith(("variant", "every_variant")) for name in item.fixturenames
        )
        is_slow = sets_variant or item.get_closest_marker("slow") is not None
        if may_be_quick(item.path) and not is_slow:
            item.add_marker("quick")


def longest_first(items, workers):
    """What takes longest is begun at once, so that no worker waits for it in the end.

    Each worker begins with a share of the items, in their order, and so with a share of the long.
    """
    longest = [item for item in items if item.get_closest_marker("longest")]
    others = [item for item in items if not item.get_closest_marker("longest")]
    ordered = []
    for worker in range(workers):
        share = len(items) * (worker + 1) // workers - len(ordered)
        first = longest[worker::workers]
        rest = max(share - len(first), 0)
        ordered += first + others[:rest]
        del others[:rest]
    return ordered + others


hypothesis.settings.register_profile(
    "potmesil_mi", derandomize=True, deadline=None, database=None, max_examples=60
)
hypothesis.settings.load_profile("potmesil_mi")


@pytest.fixture
def variant_llvm():
    """`llvm_ad_rgb`, the variant that most tests need."""
    mi.set_variant("llvm_ad_rgb")


@pytest.fixture
def variant_spectral():
    """`llvm_ad_spectral`, for what depends on wavelengths."""
    mi.set_variant("llvm_ad_spectral")


@pytest.fixture(
    scope="session", params=["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral", "scalar_rgb"]
)
def every_variant(request):
    """Of session scope, so that pytest orders tests by variant: a switch takes 0.2 s."""
    return request.param


@pytest.fixture
def variants(every_variant):
    """The test once in every kind of variant; gives the variant's name."""
    mi.set_variant(every_variant)
    return every_variant


@pytest.fixture(scope="module")  # While it is there, asyncio.run() fails in the thread of tests.
def browser():
    """Chromium; a test without one is skipped."""
    pytest.importorskip("playwright")
    if browsers.program() is None:
        pytest.skip("no Chromium here (setup.sh installs Debian's); CHROMIUM=/path/to/it names one")
    with browsers.started() as started:
        yield started


@pytest.fixture
def page(browser):
    """An empty page of the browser, which keeps `errors` and `requests`."""
    with browsers.opened(browser) as opened:
        yield opened
