"""Intervals: by hand, by SciPy and by the literature."""

import math

import msgspec
import numpy as np
import pytest
from scipy import stats

from gsrain_engine.report.interval import Interval, quantiles, resampled


def ends(interval):
    return interval.value, interval.low, interval.high


def test_students_interval_by_hand():
    found = Interval.student([1.0, 2.0, 3.0], "rain seeds")
    half = 4.302653 / 3**0.5  # two degrees of freedom
    assert ends(found) == pytest.approx((2.0, 2 - half, 2 + half)) and found.half_width == pytest.approx(half)
    assert (found.kind, found.over, found.n) == ("Student, 95 %", "rain seeds", 3)
    assert ends(Interval.student([2.0, 2.0], "rain seeds")) == (2.0, 2.0, 2.0)
    alone = Interval.student([1.5], "rain seeds")
    assert alone.value == 1.5 and np.isnan([alone.low, alone.high]).all()
    assert alone.plain == {
        "mean": 1.5, "low": None, "high": None, "kind": "Student, 95 %", "over": "rain seeds", "n": 1
    }  # fmt: skip


@pytest.mark.parametrize(
    ("hits", "of", "expected"),
    [
        (81, 263, (0.2553, 0.3662)), (15, 148, (0.0624, 0.1605)), (0, 20, (0.0, 0.1611)), (1, 29, (0.0061, 0.1718)),
        (20, 20, (1 - 0.1611, 1.0)),
    ],
)  # fmt: skip
def test_wilson_intervals_of_the_literature(hits, of, expected):
    """Newcombe 1998, table 1; the interval of all hits mirrors that of none."""
    found = Interval.wilson(hits, of, "drives")
    assert ends(found) == pytest.approx((hits / of, *expected), abs=5e-5) and found.n == of


def test_of_no_trial_nothing_is_known():
    found = Interval.wilson(0, 0, "drives")
    assert math.isnan(found.value) and (found.low, found.high, found.n) == (0.0, 1.0, 0)


def test_the_bootstrap_of_a_mean_has_the_standard_error():
    """Of 400 normal values: the ends are 1.96 s / sqrt(n) from the mean, within what 2000 resamples allow."""
    values = np.random.default_rng(4).normal(30, 2, 400)
    found = Interval.bootstrap(values, "frames")
    error = 1.96 * values.std() / math.sqrt(400)
    assert found.value == pytest.approx(values.mean())
    assert (found.value - found.low, found.high - found.value) == pytest.approx((error, error), rel=0.1)
    of_scipy = stats.bootstrap(
        (values,), np.mean, n_resamples=2000, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval  # fmt: skip
    assert ends(found)[1:] == pytest.approx(of_scipy, abs=0.005)
    assert Interval.bootstrap(values, "frames") == found != Interval.bootstrap(values, "frames", seed=1)
    assert ends(Interval.bootstrap([7.5], "frames")) == (7.5, 7.5, 7.5)
    assert ends(Interval.bootstrap([30.0] * 99 + [math.inf], "frames")) == (math.inf, 30, math.inf)
    with pytest.raises(ValueError, match="at least one value"):
        Interval.bootstrap([], "frames")


def test_a_spread_has_the_lowest_and_the_highest():
    assert ends(Interval.spread([3.0, 1.0, 2.0], "rain seeds")) == (2.0, 1.0, 3.0)
    assert ends(Interval.spread([3.0, 1.0, 2.0], "rain seeds").scaled(10)) == (20.0, 10.0, 30.0)


def test_files_keep_the_name_of_the_mean():
    written = msgspec.json.decode(msgspec.json.encode(Interval.spread([1.0, 2.0], "rain seeds")))
    assert written == Interval.spread([1.0, 2.0], "rain seeds").plain


def test_quantiles_are_those_of_numpy_without_nan():
    values = np.array([np.nan, *np.arange(101.0)])
    assert quantiles(values, 0.9) == pytest.approx((5, 95))
    drawn = resampled((np.arange(5),), lambda frames: float(frames.max()), resamples=50, vectorized=False)
    assert drawn.shape == (50,) and set(drawn) <= {2, 3, 4}


# Over objects, with the seeds of the rain


def of(changes, scenes=None):
    changes = np.asarray(changes, float)
    return Interval.over_objects(changes, np.ones_like(changes), scenes or ["one"] * len(changes))


def test_objects_that_differ_make_it_wider_than_the_seeds():
    random = np.random.default_rng(1)
    own, weather = random.normal(-0.1, 0.1, (40, 1)), random.normal(0, 0.005, (1, 5))
    found, seeds = of(own + weather), (own + weather).mean(axis=0)
    student = Interval.student(seeds, "rain seeds")
    assert found.value == pytest.approx(student.value)
    assert found.low < min(student.low, seeds.min()) and found.high > max(student.high, seeds.max())
    by_hand = 1.96 * math.hypot(own.std() / math.sqrt(40), weather.std())
    assert found.half_width == pytest.approx(by_hand, rel=0.15)
    assert of(own + weather) == found and (found.over, found.n) == ("objects", 40)


def test_of_equal_objects_it_is_the_spread_by_seeds():
    assert ends(of([[-0.1, -0.2, -0.4]] * 20)) == pytest.approx((-0.7 / 3, -0.4, -0.1))
    assert ends(of([[-0.1, -0.3]])) == pytest.approx((-0.2, -0.3, -0.1))
    alone = of([[-0.1]])
    assert alone.value == -0.1 and np.isnan(alone.half_width)


def test_an_object_counts_by_its_images():
    found = Interval.over_objects(np.array([[0.0], [3.0]]), np.array([[1.0], [3.0]]), ["one", "one"])
    assert ends(found) == (0.75, 0.0, 1.0)


def test_scenes_are_drawn_as_a_whole():
    """Ten objects of each of two scenes agree: as single objects they would say more than two scenes can."""
    changes, scenes = [[0.0]] * 10 + [[1.0]] * 10, ["a"] * 10 + ["b"] * 10
    found, apart = of(changes, scenes), of(changes)
    assert ends(found) == (0.5, 0.0, 1.0) and (found.over, found.n) == ("objects of 2 scenes", 20)
    assert apart.half_width < 0.3 and "clustered by scene" in found.kind
