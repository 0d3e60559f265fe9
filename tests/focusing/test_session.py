"""Sessions: what is kept, what a refused call leaves behind, several threads at once."""

import dataclasses
import gc
import threading
import weakref

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi import _backend
from potmesil_mi.focusing.gathering import gather
from potmesil_mi.focusing.memo import Memo
from scenes import overscanned, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

FEW_TABLES = pm.Equation20(tables=5)

METHODS = pytest.mark.parametrize(
    "method", ["layered", "lightfield", FEW_TABLES], ids=["layered", "lightfield", "paper"]
)

APERTURES = [0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0]

ROUNDING = 4e-6
"""Threads add light up in a changing order: what that changes, of sums of some dozens up to 1."""


def lens_of(samples, f_number=1.0, focus_distance=2.0):
    return samples.lens.replace(f_number=f_number, focus_distance=focus_distance)


def pictures(session, f_numbers=APERTURES):
    return [np.array(session.focus(lens_of(session.samples, n))) for n in f_numbers]


@METHODS
def test_a_session_forms_the_pictures_of_focus(method):
    samples = overscanned()
    session = pm.FocusSession(samples, method)
    lens = lens_of(samples)
    np.testing.assert_allclose(
        np.array(session.focus(lens, alpha=True)),
        np.array(pm.focus(samples, lens, method=method, alpha=True)),
        atol=ROUNDING,
    )


def test_a_session_keeps_what_it_has_found_out_until_it_is_cleared():
    session = pm.FocusSession(overscanned())
    assert session.nbytes == 0
    first = np.array(session.focus(lens_of(session.samples)))
    kept = session.nbytes
    assert kept > 0
    session.focus(lens_of(session.samples, focus_distance=3.0))
    assert session.nbytes < 2 * kept, "the same aperture is not looked at again"
    session.clear()
    assert session.nbytes == 0
    again = np.array(session.focus(lens_of(session.samples)))
    np.testing.assert_allclose(again, first, atol=ROUNDING)


@pytest.mark.parametrize("method", ["layered", "lightfield"])
def test_what_is_kept_stays_within_its_bytes_and_pictures_stay_right(method):
    samples = overscanned()
    free = pm.FocusSession(samples, method)
    expected = pictures(free)
    one = pm.FocusSession(samples, method)
    one.focus(lens_of(samples, APERTURES[0]))
    bound = 3 * one.nbytes
    assert free.nbytes > bound
    tight = pm.FocusSession(samples, method, max_bytes=bound)
    for image, right in zip(pictures(tight), expected, strict=True):
        assert tight.nbytes <= bound
        np.testing.assert_allclose(image, right, atol=ROUNDING)


def test_without_any_bytes_the_last_focus_is_kept_and_no_more():
    samples = overscanned()
    session = pm.FocusSession(samples, max_bytes=0)
    expected = pictures(pm.FocusSession(samples))
    for image, right in zip(pictures(session), expected, strict=True):
        np.testing.assert_allclose(image, right, atol=ROUNDING)


class Bytes:
    def __init__(self, nbytes):
        self.nbytes = nbytes


def test_what_was_not_used_for_longest_goes_first():
    memo = Memo(max_bytes=25)
    for key in "aba":
        memo.get(key, lambda: Bytes(10))
    memo.get("c", lambda: Bytes(10))
    made = []
    for key in "ac":
        memo.get(key, lambda: made.append(1))
    assert not made
    assert memo.nbytes == 20


REFUSED = [
    {"alpha": "yes"},
    {"alpha": np.array([1.0, 0.0])},
    {"filters": ["start"]},
    {"psf": 3},
    {"rfilter": "gaussian"},
    {"lens": "wide"},
]


@METHODS
def test_refused_calls_change_nothing(method):
    samples = overscanned()
    session = pm.FocusSession(samples, method)
    expected = pictures(session, APERTURES[:2])
    kept = session.nbytes
    for refused in REFUSED:
        for _ in range(6):
            with pytest.raises((TypeError, ValueError)):
                session.focus(**refused)
            with pytest.raises((TypeError, ValueError)):
                pm.focus(samples, method=method, **refused)
        assert session.nbytes == kept, refused
        image, right = np.array(session.focus(lens_of(samples, APERTURES[1]))), expected[1]
        np.testing.assert_allclose(image, right, atol=ROUNDING, err_msg=str(refused))
    for image, right in zip(pictures(session, APERTURES[:2]), expected, strict=True):
        np.testing.assert_allclose(image, right, atol=ROUNDING)


def test_a_dr_jit_array_for_alpha_is_refused_and_later_pictures_are_right():
    samples = overscanned()
    with pytest.raises(TypeError, match="alpha="):
        pm.focus(samples, alpha=mi.Float(1))
    for n in APERTURES:
        assert np.isfinite(np.array(pm.focus(samples, lens_of(samples, n)))).all()


@dataclasses.dataclass
class NotFrozen(pm.Aperture):
    """An aperture by which nothing can be kept."""

    size: float = 1.0

    def corner_area(self, x, y):
        return pm.Disc().corner_area(x / self.size, y / self.size)


def test_an_aperture_that_cannot_be_a_key_is_refused_with_the_remedy():
    samples = overscanned()
    with pytest.raises(TypeError, match="psf=NotFrozen: must be hashable, as a frozen dataclass"):
        pm.focus(samples, lens_of(samples).replace(aperture=NotFrozen()))


def test_a_session_keeps_the_samples_and_the_method_that_it_was_made_with():
    session = pm.FocusSession(overscanned())
    with pytest.raises(AttributeError):
        session.samples = overscanned()
    with pytest.raises(AttributeError):
        session.method = "paper"
    assert session.max_bytes == 2 << 30
    with pytest.raises(AttributeError):
        session.max_bytes = 0


class Broken(pm.Disc):
    """An aperture that fails when it is looked through."""

    def points(self, count):
        raise RuntimeError("broken")


def test_a_focus_that_fails_on_its_way_leaves_nothing_behind():
    samples = overscanned()
    session = pm.FocusSession(samples)
    right = np.array(session.focus(lens_of(samples)))
    kept = session.nbytes
    for _ in range(6):
        with pytest.raises(RuntimeError, match="broken"):
            session.focus(lens_of(samples).replace(aperture=Broken()))
    assert session.nbytes == kept
    np.testing.assert_allclose(np.array(session.focus(lens_of(samples))), right, atol=ROUNDING)


def test_apertures_that_differ_in_the_points_for_highlights_alone_have_their_own_pictures():
    def disc(radius):
        y, x = np.mgrid[-1:1:64j, -1:1:64j]
        return pm.ImageAperture((np.hypot(x, y) <= radius).astype(float))

    samples = synthetic(20 * 14 * 4)
    rgb = samples.rgb.copy()
    rgb[samples.pixel() == 150] = 300.0
    samples = samples.replace(rgb=rgb)
    lens = lens_of(samples, 0.5, 1.2)

    def picture(of, aperture):
        return np.array(pm.focus(of, lens.replace(aperture=aperture), lens_points=1))

    wide, narrow = (picture(samples, disc(radius)) for radius in (1.0, 0.3))
    expected = picture(samples.replace(), disc(0.3))
    np.testing.assert_allclose(narrow, expected, rtol=1e-5, atol=1e-5)
    assert np.abs(wide - narrow).max() > 0.01 * wide.max()


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"samples": 3}, TypeError, "samples=3"),
        ({"method": "lightfeld"}, ValueError, "method='lightfeld'.*lightfield"),
        ({"method": 3}, TypeError, "method=3"),
        ({"max_bytes": -1}, ValueError, "max_bytes=-1"),
        ({"max_bytes": 1.5}, TypeError, r"max_bytes=1\.5"),
    ],
)
def test_a_bad_argument_is_named(arguments, error, text):
    with pytest.raises(error, match=text):
        pm.FocusSession(**{"samples": synthetic(), **arguments})


def test_a_session_that_nobody_holds_frees_its_samples():
    samples = overscanned()
    session = pm.FocusSession(samples)
    session.focus()
    reference = weakref.ref(samples)
    del samples, session
    gc.collect()
    assert reference() is None


# ---------------------------------------------------------------- threads


@METHODS
@pytest.mark.parametrize("shared", [True, False], ids=["same_samples", "own_samples"])
def test_four_threads_form_the_pictures_that_one_forms(method, shared):
    samples = overscanned(30_000)
    apertures = APERTURES[:5]
    expected = pictures(pm.FocusSession(samples, method), apertures)
    session = pm.FocusSession(samples, method)
    differences, errors = [], []

    def work(start):
        own = session if shared else pm.FocusSession(samples.replace(), method)
        try:
            for i in range(5):
                k = (start + i) % 5
                image = np.array(own.focus(lens_of(samples, apertures[k])))
                differences.append(np.abs(image - expected[k]).max())
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(start,)) for start in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert len(differences) == 20
    assert max(differences) < 1e-5


@pytest.mark.parametrize("method", ["layered", "lightfield", FEW_TABLES], ids=str)
def test_threads_that_evaluate_other_arrays_at_once_spoil_no_picture(method):
    samples = overscanned(60_000)
    expected = pictures(pm.FocusSession(samples, method), APERTURES[:3])
    numbers = np.linspace(0, 1, 200_000, dtype=np.float32)
    done = threading.Event()

    def evaluate():
        while not done.is_set():
            np.array(mi.Float(numbers) * 2 + 1)

    threads = [threading.Thread(target=evaluate) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        found = [
            image
            for _ in range(3)
            for image in pictures(pm.FocusSession(samples, method), APERTURES[:3])
        ]
    finally:
        done.set()
        for thread in threads:
            thread.join()
    for image, right in zip(found, 3 * expected, strict=True):
        np.testing.assert_allclose(image, right, atol=1e-5)


def test_ends_of_depths_are_found_right_beside_busy_threads():
    samples = overscanned(60_000)
    expected = gather(samples, 1, 20.0)
    numbers = np.linspace(0, 1, 200_000, dtype=np.float32)
    done = threading.Event()

    def evaluate():
        while not done.is_set():
            np.array(mi.Float(numbers) * 2 + 1)

    threads = [threading.Thread(target=evaluate) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        found = [gather(samples, 1, 20.0) for _ in range(20)]
    finally:
        done.set()
        for thread in threads:
            thread.join()
    for fragments in found:
        np.testing.assert_array_equal(fragments.bin, expected.bin)
        np.testing.assert_allclose(fragments.gap_in_front, expected.gap_in_front, atol=ROUNDING)
        np.testing.assert_allclose(fragments.values, expected.values, rtol=1e-4, atol=1e-5)


def thread_of(module):
    return type("Thread", (threading.Thread,), {"__module__": module})()


def test_idle_threads_of_notebooks_are_told_from_those_of_users():
    assert _backend._is_idle(thread_of("ipykernel.heartbeat"))
    assert _backend._is_idle(thread_of("IPython.core.history"))
    assert not _backend._is_idle(thread_of("ipykernel.subshell"))
    assert not _backend._is_idle(thread_of("concurrent.futures.thread"))
    assert not _backend._is_idle(threading.Thread(target=pictures))


def test_beside_another_thread_arrays_are_not_evaluated_alone():
    waiting = threading.Event()
    other = threading.Thread(target=waiting.wait)
    other.start()
    try:
        assert not _backend.evaluates_alone()
    finally:
        waiting.set()
        other.join()


def compiled_by(session, focus_distance):
    """How many kernels a focus compiles."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        session.focus(lens_of(session.samples, 0.2, focus_distance))
        history = dr.kernel_history([dr.KernelType.JIT])
    assert len(history) > 5
    return sum(not kernel["cache_hit"] for kernel in history)


def receding(count, size, seed):
    """Samples of a plane that recedes: each focus has slices of other sizes."""
    samples = synthetic(count, size=size, seed=seed)
    return samples.replace(z=1 + 6 * samples.x / size[0])


def test_refocusing_seldom_compiles_anything():
    """What differs from focus to focus, as how large images are, is in little of Dr.Jit's code."""
    session = pm.FocusSession(receding(150_000, (320, 240), 0))
    compiled = [compiled_by(session, float(distance)) for distance in np.linspace(1.5, 5, 60)]
    # Where images have as many sizes as there are numbers of blocks with light, it is 90.
    assert sum(compiled[30:]) <= 20


def test_first_focuses_of_other_samples_seldom_compile_anything():
    """Neither how NumPy's memory is aligned nor where the nearest sample is is in the code."""
    rng = np.random.default_rng(5)
    compiled = []
    for seed in range(12):
        session = pm.FocusSession(receding(40_000 + int(rng.integers(100)), (100, 80), seed))
        compiled.append(compiled_by(session, 2.5))
    # Where they are, it is 2 to 4 each time.
    assert sum(compiled[4:]) <= 4, compiled
