"""Gaps estimated from boxes of known cars."""

import pytest

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.simulation.agents.base import LanePath
from gsrain_engine.simulation.agents.lead_tracking import road_user_class, sightings

from .seen_road import GROUND_M, ROUTE, VEHICLE, camera, seen_car, state


def _seen(detection, of=None, pitch_rad=0.0):
    of = of or state()
    return sightings([detection], camera(of, pitch_rad), GROUND_M, LanePath.of(of, ROUTE), VEHICLE)


@pytest.mark.parametrize("gap_m", [60.0, 40.0, 20.0, 10.0, 6.0])
def test_the_ground_tells_the_gap(gap_m):
    (sighting,) = _seen(seen_car(state(), gap_m))
    assert sighting.gap_m == pytest.approx(gap_m, abs=1e-6)


def test_a_camera_that_looks_down_measures_the_same():
    (sighting,) = _seen(seen_car(state(), 20.0, pitch_rad=0.05), pitch_rad=0.05)
    assert sighting.gap_m == pytest.approx(20.0, abs=0.05)


@pytest.mark.parametrize("gap_m", [3.0, 1.0, 0.3])
def test_a_box_that_the_picture_cuts_below_is_measured_by_its_width_to_be_on_the_safe_side(gap_m):
    (sighting,) = _seen(seen_car(state(), gap_m))
    error = 0.1 * (gap_m + 3.6 - 1.5)
    assert sighting.gap_m == pytest.approx(gap_m - error, abs=1e-6)
    assert sighting.error_m == pytest.approx((error**2 + 0.09) ** 0.5)


def test_the_error_grows_with_the_square_of_the_distance():
    errors = [_seen(seen_car(state(), gap))[0].error_m for gap in (20.0, 42.9)]
    assert errors[1] ** 2 - 0.09 == pytest.approx(16 * (errors[0] ** 2 - 0.09), rel=0.01)  # twice the depth
    assert errors[1] == pytest.approx((0.09 + (1.6 * (42.9 + 0.8 + 2.1) ** 2 / (858 * 2)) ** 2) ** 0.5, rel=1e-3)


@pytest.mark.parametrize(("left_m", "counts"), [(0.0, True), (1.0, True), (-1.9, True), (2.3, False), (-2.8, False)])
def test_who_stands_beside_the_lane_does_not_count(left_m, counts):
    assert bool(_seen(seen_car(state(), 15.0, left_m=left_m))) is counts


def test_beside_its_own_way_back_to_the_route_nobody_counts_who_counts_on_the_route():
    beside = state(left_m=3.0)
    assert _seen(seen_car(beside, 5.0, left_m=3.0), beside)
    assert not _seen(seen_car(beside, 5.0, left_m=0.0), beside)


def test_a_parked_car_that_the_picture_cuts_at_its_side_does_not_count():
    near = Detection("car", 0.9, (524.0, 250.0, 800.0, 534.0))
    assert not _seen(near)
    assert _seen(Detection("car", 0.9, (100.0, 250.0, 700.0, 534.0)))


def test_who_is_above_the_horizon_or_too_far_is_not_measured():
    assert not _seen(Detection("car", 0.9, (390.0, 240.0, 410.0, 266.0)))
    assert not _seen(seen_car(state(), 85.0))


@pytest.mark.parametrize(
    ("name", "known"),
    [("car", "car"), ("Van", "car"), ("pedestrian", "person"), ("rider", "person"), ("bench", None), ("dog", None)],
)
def test_only_road_users_count(name, known):
    assert road_user_class(Detection(name, 0.9, (0.0, 0.0, 1.0, 1.0))) == known


def test_a_person_stands_where_the_box_ends():
    person = seen_car(state(), 20.0, class_name="person", width_m=0.5, overhang_m=0.0)
    assert _seen(person)[0].gap_m == pytest.approx(20.0, abs=1e-6)
