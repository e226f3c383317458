import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.flags import BitMask, mask_union

flags = st.lists(st.booleans(), max_size=100).map(lambda each: np.array(each, np.bool_))


@given(flags)
def test_flags_come_back(given_flags):
    mask = BitMask.of(given_flags)
    assert np.array_equal(mask.flags, given_flags)
    assert mask.size == given_flags.sum()
    assert bool(mask) == given_flags.any()
    assert np.array_equal(mask.indices, np.flatnonzero(given_flags))


@given(st.integers(0, 100).flatmap(lambda n: st.tuples(*[st.lists(st.booleans(), min_size=n, max_size=n)] * 2)))
def test_masks_combine_as_sets(pair):
    a, b = (np.array(each, np.bool_) for each in pair)
    x, y = BitMask.of(a), BitMask.of(b)
    assert np.array_equal((x & y).flags, a & b)
    assert np.array_equal((x | y).flags, a | b)
    assert np.array_equal((x - y).flags, a & ~b)
    assert np.array_equal((~x).flags, ~a)
    assert (~x).size == len(a) - x.size
    assert x.same_as(y) == np.array_equal(a, b)


def test_a_million_take_125_kb_and_unions_are_the_same_value():
    mask = BitMask.all(1_000_000)
    assert mask.words.nbytes == 125_000
    none = BitMask.none(1_000_000)
    assert mask_union(mask, none) is mask_union(mask, none)
    assert BitMask.of(np.arange(40) % 3 == 0).take(np.array([3, 1, 39])).flags.tolist() == [True, False, True]


def test_a_mask_of_another_length_is_refused():
    with pytest.raises(ValueError, match="2 words, not 1"):
        BitMask(33, np.zeros(1, np.uint32))
