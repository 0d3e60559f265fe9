import contextlib
import threading

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi import _progress
from potmesil_mi._progress import one_bar, reported, track
from scenes import still_life


def listen(told):
    return pm.progress(lambda text, share: told.append((text, share)))


def test_a_callback_hears_the_share_that_is_done():
    told = []
    with listen(told):
        assert list(track([1, 2, 3, 4], "Counting")) == [1, 2, 3, 4]
    assert told == [("Counting", share) for share in (0, 0.25, 0.5, 0.75, 1)]
    assert list(track([1], "Counting")) == [1]
    assert len(told) == 5, "not heard outside the block"


def test_a_number_of_steps_that_is_not_known_is_said_so_or_given():
    told = []
    with listen(told):
        list(track(iter("ab"), "Reading"))
        list(track(iter("ab"), "Reading", total=4))
    assert [share for _, share in told] == [None, None, None, 0, 0.25, 0.5]


def test_blocks_may_be_nested_and_end_with_an_error():
    outer, inner = [], []
    with listen(outer):
        with pytest.raises(KeyError), listen(inner):
            raise KeyError
        list(track([1], "outer"))
    assert (len(outer), inner) == (2, [])


def test_what_a_callback_raises_ends_the_job():
    def stop(text, share):
        if share > 0.5:
            raise KeyboardInterrupt

    done = []
    with pm.progress(stop), pytest.raises(KeyboardInterrupt):
        done.extend(track(range(4), "Counting"))
    assert done == [0, 1, 2]


def test_each_thread_has_its_own_callback():
    told = []
    with listen(told):
        thread = threading.Thread(target=lambda: list(track([1, 2], "elsewhere")))
        thread.start()
        thread.join()
    assert told == []


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_shown_on_a_terminal_and_nowhere_else(monkeypatch, terminal):
    shown = []

    class Bar:
        def __enter__(self):
            return lambda *told: shown.append(told)

        def __exit__(self, *_):
            shown.append("gone")

    monkeypatch.setattr(_progress, "_bar", Bar)
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal, raising=False)
    list(track([1], "Counting"))
    assert shown == ([("Counting", 0.0), ("Counting", 1.0), "gone"] if terminal else [])


def test_the_bar_takes_shares_and_says_when_none_is_known(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with reported() as report:
        report("looking", None)
        report("counting", 0.5)
    list(track([1, 2], "Counting"))


def test_a_bar_is_shown_below_the_cell_of_a_notebook_and_is_gone_at_the_end(monkeypatch):
    display = pytest.importorskip("IPython.display", reason="needs pip install '.[notebooks]'")
    shown = []

    class Handle:
        def update(self, page):
            shown.append(page.data)

    def displayed(page, display_id):
        shown.append(page.data)
        return Handle()

    monkeypatch.setattr(display, "display", displayed)
    monkeypatch.setattr(_progress, "_is_notebook", lambda: True)
    times = iter(range(100))
    monkeypatch.setattr(_progress.time, "monotonic", lambda: next(times))
    list(track([1, 2], "<Counting>"))
    assert "<progress></progress> &lt;Counting&gt;" in shown[0]
    assert 'value="0.500"' in shown[1]
    assert "2 s left" in shown[1]
    assert shown[-1] == ""
    shown.clear()
    monkeypatch.setattr(_progress.time, "monotonic", lambda: 0.0)
    list(track([1, 2], "quick"))
    assert shown == []


def test_jobs_may_share_a_bar(monkeypatch):
    bars = []

    @contextlib.contextmanager
    def bar():
        bars.append([])
        yield lambda text, share: bars[-1].append(text)

    monkeypatch.setattr(_progress, "_bar", bar)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with one_bar():
        list(track([1], "first"))
        list(track([1], "second"))
    assert bars == [["first", "first", "second", "second"]]


def test_both_stages_tell_how_far_they_are(variant_llvm):
    told = []
    with listen(told):
        samples = pm.render_samples(still_life(), spp=2)
        np.array(pm.focus(samples, method="paper", tables=3))
    texts = {text for text, _ in told}
    assert {"Sampling", "Focusing"} <= texts
    for text in texts:
        shares = [share for said, share in told if said == text]
        assert (min(shares), shares[-1]) == (0, 1)
