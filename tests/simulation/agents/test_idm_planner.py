"""Commands of the planner, and their effect on a vehicle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.simulation.agents.base import LanePath
from gsrain_engine.simulation.agents.idm import IDMPlanner, cruise_speed
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.traffic.base import VehicleAhead
from gsrain_engine.simulation.vehicle import VehicleState

STRAIGHT = Route(np.array([[0.0, 0.0], [200.0, 0.0]]))


def _least_gap(planner: IDMPlanner, gap_m: float, seen_within_m: float, strongest_m_s2: float = 3.0) -> float:
    """Drive at 10 m/s to a car that stands and is seen from so near on; the vehicle does what it can of each plan."""
    speed, dt = 10.0, 0.25
    for _ in range(80):
        lead = VehicleAhead(gap_m, 0.0) if gap_m <= seen_within_m else None
        mean = planner.distances(speed, lead)[0] / 0.5
        acceleration = float(np.clip((mean - speed) / 0.25, -strongest_m_s2, strongest_m_s2))
        after = max(0.0, speed + acceleration * dt)
        gap_m -= 0.5 * (speed + after) * dt
        speed = after
        if gap_m <= 0:
            return gap_m
    assert speed == 0
    return gap_m


@pytest.mark.parametrize("seen_within_m", [40.0, 30.0, 24.0, 18.0])
def test_a_lead_seen_from_18_m_on_is_not_hit_with_three_m_s2(seen_within_m):
    assert _least_gap(IDMPlanner(10.0), 40.0, seen_within_m) > 0


@pytest.mark.parametrize("seen_within_m", [15.0, 10.0])
def test_one_seen_later_is(seen_within_m):
    assert _least_gap(IDMPlanner(10.0), 40.0, seen_within_m) <= 0


def test_with_full_brakes_ten_metres_are_enough():
    assert _least_gap(IDMPlanner(10.0), 40.0, 10.0, strongest_m_s2=8.0) > 0


def test_it_stops_two_metres_short_and_brakes_as_comfort_allows():
    planner = IDMPlanner(10.0)
    assert _least_gap(planner, 40.0, 40.0) == pytest.approx(2.0, abs=0.4)
    assert planner.acceleration(10.0, VehicleAhead(40.0, 0.0)) == pytest.approx(-1.97, abs=0.01)  # -1.5 (45.87 / 40)^2


def test_a_free_road_is_taken_at_the_cruising_speed():
    assert IDMPlanner(10.0).distances(10.0, None) == pytest.approx(np.arange(1, 7) * 5.0)
    assert IDMPlanner(10.0).distances(5.0, None)[-1] > 15.0
    assert IDMPlanner(10.0).distances(14.0, None)[-1] < 42.0


def test_behind_a_lead_of_the_same_speed_the_gap_is_the_models():
    gap = (2.0 + 8.0 * 1.5) / np.sqrt(1 - 0.8**4)  # where the model's acceleration is nought
    assert IDMPlanner(10.0).acceleration(8.0, VehicleAhead(float(gap), 8.0)) == pytest.approx(0.0, abs=1e-9)


def test_an_emergency_brakes_harder_than_comfort_and_as_hard_as_it_can_when_time_is_up():
    planner = IDMPlanner(10.0, hard_m_s2=7.0)
    assert planner.acceleration(10.0, VehicleAhead(12.0, 0.0)) == pytest.approx(-1.25 * 100 / 22)
    assert planner.acceleration(10.0, VehicleAhead(7.9, 0.0)) == -7.0
    assert planner.acceleration(10.0, VehicleAhead(40.0, 0.0)) > -3.0


def test_who_stands_stays_until_there_is_room():
    planner = IDMPlanner(10.0)
    assert (planner.distances(0.0, VehicleAhead(3.4, 0.0)) == 0).all()
    assert (planner.distances(0.0, VehicleAhead(0.5, 0.0)) == 0).all()
    assert planner.distances(0.0, VehicleAhead(3.4, 3.0))[-1] > 1.0
    assert planner.distances(0.0, VehicleAhead(8.0, 0.0))[-1] > 1.0


@given(
    st.floats(0, 40), st.floats(-5, 120), st.floats(-20, 40), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(1, 30)
)
def test_no_plan_goes_backwards(speed, gap, lead_speed, left, yaw, cruise):
    planner = IDMPlanner(cruise)
    distances = planner.distances(speed, VehicleAhead(gap, lead_speed))
    assert np.isfinite(distances).all()
    assert (np.diff(distances, prepend=0.0) >= 0).all()
    path = LanePath.of(VehicleState(50.0, left, yaw, speed), STRAIGHT)
    points = path.points(planner.distances(speed, VehicleAhead(gap, lead_speed)))
    assert points.shape == (6, 2)
    assert (points[:, 0] >= -1e-9).all()


def test_a_stop_is_planned_where_the_vehicle_is_also_beside_a_bend():
    bend = Route(np.array([[0.0, 0.0], [10.0, 0.0], [17.0, 7.0]]))
    path = LanePath.of(VehicleState(10.2, -1.0, 0.3, 0.0), bend)
    assert np.abs(path.points(np.zeros(6))).max() < 1e-12


def test_beside_its_route_it_comes_back_gently():
    path = LanePath.of(VehicleState(20.0, 1.0, 0.0, 10.0), STRAIGHT)
    left = path.points(np.array([5.0, 15.0, 60.0]))[:, 1]
    assert left == pytest.approx([np.exp(-5 / 15) - 1, np.exp(-1) - 1, np.exp(-4) - 1])


def test_places_are_told_from_the_path_back_to_the_route():
    path = LanePath.of(VehicleState(20.0, 1.0, 0.0, 10.0), STRAIGHT)
    assert path.place(20.0, 1.0) == pytest.approx((0.0, 0.0))
    assert path.place(80.0, 0.0) == pytest.approx((60.0, -np.exp(-4)))


def test_a_drive_that_begins_at_standstill_wants_ten_metres_a_second():
    assert cruise_speed(0.0) == 10.0
    assert cruise_speed(13.9) == 13.9
