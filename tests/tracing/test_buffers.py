"""The memory that samples come in."""

import numpy as np
import pytest

from potmesil_mi.samples.columns import Columns
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


def columns_of(values, **more):
    values = np.asarray(values, dtype=np.float32)
    return Columns(values, values, shown(values).rgb, values, values, values, values, **more)


@pytest.mark.parametrize("capacity", [1, 100])
def test_columns_of_any_kind_follow_the_samples_that_are_there(capacity):
    buffer = SampleBuffer(capacity)
    ones = np.ones(2, dtype=np.float32)
    buffer.add(ones, ones, shown(ones), 0.5, 1)
    buffer.extend(columns_of([3, 4], visibility=np.array([5, 6], np.uint64)))
    buffer.add(ones, ones, shown(ones), 0.5, 0)
    columns = buffer.columns()
    np.testing.assert_array_equal(columns.x, [1, 1, 3, 4, 1, 1])
    np.testing.assert_array_equal(columns.layer, [1, 1, 0, 0, 0, 0])
    np.testing.assert_array_equal(columns.visibility, [0, 0, 5, 6, 0, 0])
    assert columns.through is None


def test_an_optional_column_is_taken_as_it_is_and_grows_like_the_others():
    buffer = SampleBuffer(100)
    ones = np.ones(2, dtype=np.float32)
    buffer.add(ones, ones, shown(ones), 0.5, 0)
    through = np.array([7, 8], np.float32)
    buffer.set("through", through)
    assert np.shares_memory(buffer.columns().through, through)
    buffer.add(ones, ones, shown(ones), 0.5, 0)
    np.testing.assert_array_equal(buffer.columns().through, [7, 8, 0, 0])


def test_what_is_kept_stays_in_its_order_and_in_its_memory(monkeypatch):
    monkeypatch.setattr("potmesil_mi.samples.columns.AT_ONCE", 3)
    buffer, rng = SampleBuffer(20), np.random.default_rng(1)
    values = np.arange(20, dtype=np.float32)
    buffer.extend(columns_of(values, visibility=values.astype(np.uint64)))
    before, which = buffer.columns(), rng.random(20) < 0.6
    buffer.keep(which)
    after = buffer.columns()
    assert np.shares_memory(before.x, after.x)
    for name in ("x", "y", "alpha", "z", "surface", "weight", "visibility"):
        np.testing.assert_array_equal(getattr(after, name), values[which])
    np.testing.assert_array_equal(after.rgb[:, 1], values[which])
