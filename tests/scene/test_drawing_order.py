"""Drawing order: a permutation in levels of falling contribution, neighbors side by side."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.lod_order import in_lod_order, lod_growth, lod_level_ends, lod_order, sort_into_lod_order

NUMBERS = st.one_of(st.sampled_from([0.0, 1e-30, 1e30, 1.0]), st.floats(0, 10, width=32))


def random_gaussians(count, degree=1, seed=0):
    r = np.random.default_rng(seed)
    quaternions = r.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    numbers = (
        r.normal(size=(count, 3)),
        np.exp(r.normal(-3, 1, (count, 3))),
        quaternions,
        r.uniform(0, 1, count),
        r.normal(size=(count, (degree + 1) ** 2, 3)),
    )
    return Gaussians(*(each.astype(np.float32) for each in numbers))


@st.composite
def odd_gaussians(draw):
    """Up to 40 Gaussians, many of them equal, flat, transparent or huge."""
    n = draw(st.integers(0, 40))
    few = random_gaussians(n)
    scales = draw(arrays(np.float32, (n, 3), elements=NUMBERS.map(np.float32)))
    opacities = draw(arrays(np.float32, n, elements=st.sampled_from([0.0, 0.5, 1.0])))
    means = draw(arrays(np.float32, (n, 3), elements=st.floats(-(2.0**100), 2.0**100, width=32)))
    return Gaussians(means, scales, few.quaternions, opacities, few.sh)


def contributions(gaussians):
    a, b, c = gaussians.scales.astype(np.float64).T
    values = (gaussians.opacities * (a * b + b * c + c * a)).astype(np.float32)
    return np.where(np.isfinite(values), values, 0)


def arrays_of(gaussians):
    return {field.name: getattr(gaussians, field.name) for field in fields(gaussians)}


@given(odd_gaussians())
def test_levels_hold_everything_once_and_what_contributes_nothing_last(gaussians):
    with np.errstate(over="ignore"):
        values = contributions(gaussians)
    order = lod_order(gaussians)
    assert sorted(order) == list(range(len(gaussians)))
    np.testing.assert_array_equal(order, lod_order(gaussians))
    ends = lod_level_ends(len(gaussians))
    assert ends[-1] == len(gaussians)
    for end in ends:
        if (values[order[:end]] == 0).any():
            assert (values[order[end:]] == 0).all()


def test_large_ones_come_first_and_equal_ones_evenly():
    """Of 4000 equal Gaussians beside 100 of a hundred times their area: a binomial bound of 5 standard deviations."""
    many = random_gaussians(4100)
    scales = np.full((4100, 3), 0.1, np.float32)
    scales[:100] = 1.0
    means = np.random.default_rng(1).uniform(0, 1, (4100, 3)).astype(np.float32)
    gaussians = Gaussians(means, scales, many.quaternions, np.ones(4100, np.float32), many.sh)
    first = lod_order(gaussians)[: lod_level_ends(4100)[0]]
    assert np.sum(first < 100) == 100  # a chance of 1 in e^10 each to come later
    equal = first[first >= 100]
    left = np.mean(means[equal, 0] < 0.5)
    assert abs(left - 0.5) < 5 * 0.5 / np.sqrt(len(equal))


@given(odd_gaussians(), st.sampled_from([1 / 8, 1 / 4, 1 / 2, 1.0]))
def test_what_is_kept_grows_to_cover_what_all_did(gaussians, share):
    ordered = in_lod_order(gaussians)
    with np.errstate(over="ignore"):
        values = contributions(ordered).astype(np.float64)
    kept = values[: int(np.ceil(share * len(ordered)))].sum()
    growth = lod_growth(ordered, share)
    assert growth >= 1
    if kept > 0:
        np.testing.assert_allclose(growth**2 * kept, values.sum(), rtol=1e-6)


@given(odd_gaussians())
def test_in_place_is_the_same_order(gaussians):
    expected = in_lod_order(gaussians)
    own = Gaussians(**{name: array.copy() for name, array in arrays_of(gaussians).items()})
    sort_into_lod_order(own)
    for name, array in arrays_of(expected).items():
        np.testing.assert_array_equal(array, getattr(own, name))


@pytest.mark.parametrize("field", ["means", "scales", "opacities"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_ordered_too(field, value):
    values = arrays_of(random_gaussians(100))
    values[field][3] = value
    order = lod_order(Gaussians(**values))
    assert sorted(order) == list(range(100))
    if field != "means":
        assert 3 in order[lod_level_ends(100)[-2] :]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_few_are_ordered(count):
    gaussians = random_gaussians(count, degree=3)
    assert sorted(lod_order(gaussians)) == list(range(count))
    sort_into_lod_order(gaussians)
    assert len(gaussians) == count


def test_a_level_is_a_path_through_space():
    gaussians = in_lod_order(random_gaussians(8000))
    first = gaussians.means[: lod_level_ends(8000)[0]]
    step = np.linalg.norm(np.diff(first, axis=0), axis=1).mean()
    shuffled = np.random.default_rng(1).permutation(first)
    assert step < 0.35 * np.linalg.norm(np.diff(shuffled, axis=0), axis=1).mean()


def test_arrays_that_must_not_be_written_are_refused():
    gaussians = random_gaussians(5)
    gaussians.scales.flags.writeable = False
    with pytest.raises(ValueError, match="scales must be contiguous and writable"):
        sort_into_lod_order(gaussians)
