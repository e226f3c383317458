"""Masks in COCO's run lengths."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsrain_engine.render.label_export import encode_rle, run_lengths
from oracles.run_lengths import unpacked

masks = hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24))


def test_runs_go_down_the_columns_and_begin_with_what_is_not_there():
    assert run_lengths(np.array([[False, True], [True, True]])) == [1, 3]
    assert run_lengths(np.array([[True, False], [False, False]])) == [0, 1, 3]
    assert run_lengths(np.zeros((2, 3), bool)) == [6]


@given(masks)
def test_what_is_packed_comes_back(mask):
    np.testing.assert_array_equal(unpacked(encode_rle(mask)), mask)


@given(masks, st.integers(1, 40))
def test_strings_are_those_of_pycocotools(mask, times):
    coco = pytest.importorskip("pycocotools.mask")
    large = np.kron(mask, np.ones((times, 1), bool))
    theirs = coco.encode(np.asfortranarray(large.astype(np.uint8)))
    assert encode_rle(large)["counts"] == theirs["counts"].decode()


def test_runs_that_do_not_fill_the_picture_are_refused():
    value = encode_rle(np.eye(5, dtype=bool))
    with pytest.raises(ValueError, match="cover 25 of 30"):
        unpacked({"size": [5, 6], "counts": value["counts"]})
