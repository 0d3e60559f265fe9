"""The memory that samples come in."""

import numpy as np
import pytest

from potmesil_mi.tracing.buffers import SampleBuffer, Shown

pytestmark = pytest.mark.usefixtures("variant_llvm")


def shown(values):
    values = np.asarray(values, dtype=np.float32)
    return Shown(np.stack([values] * 3, axis=1), values, values, values.astype(np.uint32))


@pytest.mark.parametrize("capacity", [0, 2, 5, 100])
def test_samples_are_kept_in_their_order_however_many_come(capacity):
    buffer = SampleBuffer(capacity)
    for start, layer in ((0, 0), (3, 0), (5, 1)):
        values = np.arange(start, start + 3, dtype=np.float32)
        buffer.add(values, -values, shown(values), values / 8, layer)
    columns = buffer.columns()
    expected = [0, 1, 2, 3, 4, 5, 5, 6, 7]
    np.testing.assert_array_equal(columns.x, expected)
    np.testing.assert_array_equal(columns.y, np.negative(expected))
    np.testing.assert_array_equal(columns.rgb, np.stack([expected] * 3, axis=1))
    np.testing.assert_array_equal(columns.z, expected)
    np.testing.assert_array_equal(columns.surface, expected)
    np.testing.assert_array_equal(columns.weight, np.array(expected) / 8)
    np.testing.assert_array_equal(columns.layer, [0] * 6 + [1] * 3)


def test_samples_so_far_stay_what_they_are_while_more_come():
    buffer = SampleBuffer(2)
    ones = np.ones(2, dtype=np.float32)
    buffer.add(ones, ones, shown(ones), 0.5, 0)
    first = buffer.columns()
    buffer.add(2 * ones, ones, shown(ones), 0.5, 1)
    assert len(first.x) == 2
    np.testing.assert_array_equal(first.x, 1)
    assert len(buffer.columns().x) == 4


def test_paths_are_averaged_but_for_depth_and_surface():
    paths = shown([1, 3, 10, 30]).averaged(2)
    np.testing.assert_array_equal(paths.rgb[:, 0], [2, 20])
    np.testing.assert_array_equal(paths.alpha, [2, 20])
    np.testing.assert_array_equal(paths.z, [1, 10])
    np.testing.assert_array_equal(paths.surface, [1, 10])
