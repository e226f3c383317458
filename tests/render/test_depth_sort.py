"""Sorting on the GPU against NumPy: sizes around the borders of workgroups, equal keys, extreme keys."""

import numpy as np
import pytest

from gsrain_engine.render.depth_sort import KEY_BITS, KEYS_BY_GROUP, DepthSort
from gsrain_engine.render.host_sort import HostSort, nearest_first


def work_for(context, count):
    """What visible_scan.comp would say of so many keys."""
    numbers = np.array([0, 0, 0, 0, 0, count, -(-count // KEYS_BY_GROUP), 1, 1], np.uint32)
    return context.buffer(numbers.tobytes())


def sorted_by(sorter, context, keys, slots):
    sorter.reserve(max(1, len(keys)))
    if len(keys):
        for buffer, values in zip(sorter.unsorted, (keys, slots), strict=True):
            buffer.write(values)
    return np.frombuffer(sorter.sort(work_for(context, len(keys))).read(), np.uint32)[: len(keys)]


@pytest.mark.parametrize("sort", [DepthSort, HostSort])
@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, KEYS_BY_GROUP - 1, KEYS_BY_GROUP + 1, 3 * KEYS_BY_GROUP + 77])
@pytest.mark.parametrize("different", [1, 3, 1 << KEY_BITS])
def test_sorts_stably(context, sort, count, different):
    rng = np.random.default_rng(count)
    keys = rng.integers(0, different, count, dtype=np.uint32)
    slots = np.sort(rng.choice(10 * count + 1, count, replace=False)).astype(np.uint32)
    np.testing.assert_array_equal(
        sorted_by(sort(context), context, keys, slots), slots[np.argsort(keys, kind="stable")]
    )


def test_the_largest_keys_are_sorted_too(context):
    keys = np.array([0x0FFFFFFF, 0, 0x0FFFFFFE, 1 << 24, 0x0FFFFFFF], np.uint32)
    slots = np.arange(5, dtype=np.uint32)
    assert sorted_by(DepthSort(context), context, keys, slots).tolist() == [1, 3, 2, 0, 4]
    assert nearest_first(keys, slots).tolist() == [1, 3, 2, 0, 4]
