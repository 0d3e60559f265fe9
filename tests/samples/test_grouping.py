"""Groups are those of ``np.unique``, be their keys close together or far apart."""

import numpy as np
import pytest

from potmesil_mi.samples.grouping import grouped


@pytest.mark.parametrize("dtype", [np.int64, np.uint32, np.uint64])
@pytest.mark.parametrize(
    "keys",
    [
        [],
        [7],
        [3, 1, 3, 2, 1],
        [5, 5, 5],
        range(50, 0, -1),
        [0, 2**31, 0, 9],
        [2**32 - 2, 2**32 - 1],
    ],
    ids=str,
)
def test_groups_are_numbered_in_the_order_of_their_keys(keys, dtype):
    keys = np.array(keys, dtype)
    number, first = grouped(keys)
    _, expected_first, expected = np.unique(keys, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(number, expected)
    np.testing.assert_array_equal(first, expected_first)
    assert number.dtype == first.dtype == np.int64


def test_keys_below_zero_and_of_all_64_bits_are_grouped():
    np.testing.assert_array_equal(grouped(np.array([-1, 4, -1, -3]))[0], [1, 2, 1, 0])
    far = np.array([2**64 - 1, 0, 2**63, 2**64 - 1], np.uint64)
    np.testing.assert_array_equal(grouped(far)[0], [2, 0, 1, 2])
    near = np.array([2**64 - 1, 2**64 - 2, 2**64 - 1], np.uint64)
    np.testing.assert_array_equal(grouped(near)[0], [1, 0, 1])
