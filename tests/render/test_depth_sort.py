"""Sorting on the GPU against NumPy: sizes around the borders of workgroups, equal keys, extreme keys."""

import numpy as np
import pytest

from gsrain_engine.render.opengl.sort import (
    KEY_BITS,
    KEYS_BY_GROUP,
    CpuSort,
    RadixSort,
    check_sort,
    sort_faults,
)


@pytest.mark.parametrize("sort", [RadixSort, CpuSort])
@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, KEYS_BY_GROUP - 1, KEYS_BY_GROUP + 1, 3 * KEYS_BY_GROUP + 77])
@pytest.mark.parametrize("different", [1, 3, 1 << KEY_BITS])
def test_sorts_stably(context, sort, count, different):
    rng, sorter = np.random.default_rng(count), sort(context)
    keys = rng.integers(0, different, count, dtype=np.uint32)
    keys[: count // 4] = different - 1  # the largest keys, too
    slots = np.sort(rng.choice(10 * count + 1, count, replace=False)).astype(np.uint32)
    sorter.reserve(max(1, count))
    for buffer, values in zip(sorter.unsorted, (keys, slots), strict=True):
        buffer.write(values)
    work = np.array([0, 0, 0, 0, 0, count], np.uint32)  # as of visible_scan.comp
    order = np.frombuffer(sorter.sort(context.buffer(work)).read(), np.uint32)[:count]
    np.testing.assert_array_equal(order, slots[np.argsort(keys, kind="stable")])


@pytest.mark.parametrize("count", [1_000_000, 3_000_000])
def test_a_gpu_orders_all_splats_and_twice_the_same(gpu_context, count):
    """An H100 lost 9,239 of 895,842 and half of 2,687,623 while a barrier was missing."""
    assert check_sort(gpu_context, count) == (count, 0, 0, 0)


@pytest.mark.parametrize(
    ("order", "second", "faults"),
    [
        ([1, 3, 0, 2], [1, 3, 0, 2], (4, 0, 0, 0)),
        ([1, 3, 0, 0], [1, 3, 0, 0], (4, 1, 0, 0)),  # slot 2 lost, 0 twice
        ([1, 3, 0, 99], [1, 3, 0, 99], (4, 1, 0, 0)),  # no slot at all
        ([3, 1, 0, 2], [3, 1, 0, 2], (4, 0, 1, 0)),  # equal keys, the higher slot first
        ([1, 3, 2, 0], [1, 3, 0, 2], (4, 0, 1, 2)),
        ([0, 0, 0, 0], [1, 3, 0, 2], (4, 3, 0, 3)),
    ],
)
def test_the_check_counts_what_is_wrong(order, second, faults):
    check = sort_faults(np.array([5, 2, 9, 2], np.uint32), np.array(order, np.uint32), np.array(second, np.uint32))
    assert check == faults
    assert check.is_right == (faults == (4, 0, 0, 0))


def test_the_check_finds_a_software_rasterizer_right_and_a_sort_that_loses_splats_wrong(context, monkeypatch):
    assert check_sort(context, 100_000) == (100_000, 0, 0, 0)
    rng, sort = np.random.default_rng(0), RadixSort.sort

    def losing(self, work):  # some slots overwrite others, elsewhere at each call
        order = sort(self, work)
        order.write(order.read(4 * 100), offset=4 * int(rng.integers(1000, 9000)))
        return order

    monkeypatch.setattr(RadixSort, "sort", losing)
    check = check_sort(context, 10_000)
    assert (check.missing, check.changed) == (100, 200)
    assert 1 <= check.inversions <= 2
    assert not check.is_right
    assert "100 are lost" in str(check)
