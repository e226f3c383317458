import math

import numpy as np
import pytest

from gsrain_engine.evaluation.detection.metrics import recall_by_distance, robustness


def test_performance_under_rain_is_the_mean_and_its_share_of_the_clear():
    result = robustness(0.5, [0.4, 0.3, 0.2])
    assert (result.mpc, result.rpc) == (pytest.approx(0.3), pytest.approx(0.6))
    assert math.isnan(robustness(0.0, [0.1]).rpc)
    with pytest.raises(ValueError, match="at least one intensity"):
        robustness(0.5, [])


def test_recall_is_counted_between_distances():
    distances = np.array([5, 10, 15, 19.9, 20, 45, 99])
    confidences = np.array([0.9, 0.25, 0.2, 0.8, 0.0, 0.7, 0.9])
    near, middle, far = recall_by_distance(distances, confidences, (0, 10, 20, 50))
    assert [(each.objects, each.found) for each in (near, middle, far)] == [(1, 1), (3, 2), (2, 1)]
    assert middle.recall == pytest.approx(2 / 3)
    assert recall_by_distance(distances, confidences, (20, 30), min_confidence=0)[0].found == 0  # a miss stays one
    with pytest.raises(ValueError, match="must rise, not 0, 20, 20 m"):
        recall_by_distance(distances, confidences, (0, 20, 20))


def test_intervals_are_wilsons():
    """8 of 10 and 0 of 10 as Wilson's formula is tabulated; nothing known spans everything."""
    eight, none, nobody = recall_by_distance(
        np.array([1.0] * 10 + [11.0] * 10), np.array([0.9] * 8 + [0.0] * 12), (0, 10, 20, 30)
    )
    assert eight.interval == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert none.interval == pytest.approx((0, 0.2775), abs=1e-4)
    assert nobody.interval == (0, 1)
    assert math.isnan(nobody.recall)
