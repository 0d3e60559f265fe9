"""What images tell of each other: which points of the lens see them."""

import numpy as np
import pytest

from potmesil_mi.optics.disc import lens_points
from potmesil_mi.samples.columns import VISIBILITY_POINTS
from potmesil_mi.tracing.agreement import agreed, bits, packed, points_of, told

ALL = np.uint64(2**VISIBILITY_POINTS - 1)
NUMBER = np.arange(64, dtype=np.uint32)


def left_of(edge):
    """The points of the lens left of upright edges, uint64 (N,)."""
    return packed(lens_points(VISIBILITY_POINTS)[:, 0] < np.asarray(edge)[:, None])


def test_images_in_turn_try_all_points_equally_often():
    for count in (1, 4, 16, 64):
        tries = bits(points_of(NUMBER, count)).sum(axis=0)
        np.testing.assert_array_equal(tries, count)
    mixed = bits(points_of(NUMBER, np.where(NUMBER < 32, 4, 64))).sum(axis=1)
    np.testing.assert_array_equal(mixed, np.where(NUMBER < 32, 4, 64))


def test_what_is_agreed_is_so_for_each_image():
    # The images of a cell see the lens left of edges that are a tenth of its radius apart.
    truth = left_of(np.linspace(0.15, 0.25, 64))
    tried = points_of(NUMBER, 4)
    sure, sees = agreed(truth & tried, tried, np.zeros(64, int))
    np.testing.assert_array_equal(sees, truth & sure)
    # Away from the edges nothing is left to try.
    apart = np.abs(lens_points(VISIBILITY_POINTS)[:, 0] - 0.2)
    is_sure = bits(sure).all(axis=0)
    assert is_sure[apart > 0.5].all()
    assert not is_sure[apart < 0.05].any()


def test_images_of_other_cells_do_not_matter():
    truth = np.where(NUMBER % 2 == 0, ALL, np.uint64(0))
    tried = points_of(NUMBER // 2, 4)
    sure, sees = agreed(truth & tried, tried, NUMBER % 2)
    np.testing.assert_array_equal(sure, ALL)
    np.testing.assert_array_equal(sees, truth)


def test_few_tries_are_not_enough_to_agree():
    sure, _ = agreed(points_of(NUMBER[:1], 4), points_of(NUMBER[:1], 4), np.zeros(1, int))
    assert sure[0] == 0


def test_what_is_known_stays_and_the_rest_is_as_large_a_part():
    number = np.arange(4096, dtype=np.uint32)
    truth = np.where(number * 7 % 16 < 4, ALL, np.uint64(0))
    known = points_of(number, 16)
    found = told(truth & known, known, number, 16, np.zeros(len(number), int))
    np.testing.assert_array_equal(found & known, truth & known)
    unknown = ~bits(known)
    assert bits(found)[unknown].mean() == pytest.approx(0.25, abs=0.01)


def test_an_image_that_is_alone_sees_by_points_next_to_those_that_do():
    number, known = NUMBER[:1], points_of(NUMBER[:1], 16)
    truth = left_of([0.0])
    found = told(truth & known, known, number, 16, np.zeros(1, int))
    apart = np.abs(lens_points(VISIBILITY_POINTS)[:, 0])
    np.testing.assert_array_equal(bits(found)[0, apart > 0.6], bits(truth)[0, apart > 0.6])
