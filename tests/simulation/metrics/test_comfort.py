"""Comfort of driven and planned motion, worked out by hand at the paper's thresholds."""

import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.simulation.metrics.comfort import (
    NUPLAN,
    PAPER,
    comfort_executed,
    comfort_planned,
    executed_motion,
    is_plan_comfortable,
    planned_motion,
)
from small_rollout import ego, rollout, step, straight


def _driven(*moments):
    return rollout([step(i, each) for i, each in enumerate(moments)])


def _accelerations(*values):
    return _driven(ego(), *(ego(acceleration=each) for each in values))


@pytest.mark.parametrize(
    ("values", "share"),
    [
        ((2.40, 2.40), 1.0),
        ((2.41, 2.40), 0.5),
        ((-4.05, -4.05), 1.0),
        ((-4.05, -4.06), 0.5),
        ((0.0, 2.09), 1.0),  # a jerk of 8.36 m/s3
        ((0.0, 2.10), 0.5),  # 8.4
        ((0.0, -2.10, -2.10, 0.0), 0.5),
    ],
)
def test_executed_acceleration_and_jerk(values, share):
    assert comfort_executed(_accelerations(*values)) == pytest.approx(share)


def test_the_first_step_has_no_jerk():
    assert comfort_executed(_accelerations(-4.0)) == 1.0
    assert np.isnan(executed_motion(_accelerations(-4.0, -3.0)).jerk_m_s3[0])
    assert executed_motion(_accelerations(-4.0, -3.0)).jerk_m_s3[1] == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("speed", "rate", "fine"),
    [(20.0, 0.24, True), (20.0, 0.25, False), (20.0, -0.25, False), (4.0, 0.48, True), (4.0, -0.48, True)],
)  # 4.8 and 5.0 m/s2 to the side; from straight on 0.48 rad/s after 0.25 s are 1.92 rad/s2
def test_executed_motion_to_the_side(speed, rate, fine):
    assert comfort_executed(_driven(ego(speed=speed), ego(speed=speed, yaw_rate=rate))) == float(fine)


def test_executed_yaw_rate_and_yaw_acceleration():
    turning = [ego(speed=1.0, yaw_rate=each) for each in (0.0, 0.48, 0.94, 0.96, 0.96)]
    assert comfort_executed(_driven(*turning)) == pytest.approx(2 / 4)  # the rate is too high in the last two
    assert comfort_executed(_driven(ego(speed=1.0), ego(speed=1.0, yaw_rate=0.49))) == 0.0  # 1.96 rad/s2


def test_nuplan_bounds_the_jerk_along_and_the_whole():
    assert comfort_executed(_accelerations(0.0, 1.1)) == 1.0  # 4.4 m/s3
    assert comfort_executed(_accelerations(0.0, 1.1), NUPLAN) == 0.5
    sideways = _driven(ego(speed=10.0), ego(speed=10.0, yaw_rate=0.22))  # 2.2 m/s2 in 0.25 s: 8.8 m/s3 across
    assert comfort_executed(sideways) == 1.0
    two = _driven(ego(speed=10.0), ego(speed=10.0), ego(speed=10.0, yaw_rate=0.22))
    assert (comfort_executed(two), comfort_executed(two, NUPLAN)) == (1.0, 0.5)


def test_nothing_driven_has_no_comfort():
    assert comfort_executed(_driven(ego())) is None
    assert comfort_planned(_driven(ego(), ego())) is None


def _plan(*points, own=None):
    return rollout([step(0, own or ego(), plan=points), step(1, ego())])


def _speeds(*speeds):
    """Points straight ahead, 0.5 s apart, with so many m/s before each."""
    return tuple((float(x), 0.0) for x in np.cumsum(speeds) * 0.5)


@pytest.mark.parametrize(
    ("speeds", "fine"),
    [
        ((10, 8, 6, 4, 2, 0), True),  # -4 m/s2
        ((10, 7.9, 5.8, 3.7, 1.6, 0), False),  # -4.2
        ((10, 11.2, 12.4, 13.6, 14.8, 16), True),  # 2.4
        ((10, 11.25, 12.5, 13.75, 15, 16), False),  # 2.5
        ((10, 10, 10, 9.0, 7.0, 5.0), True),  # jerk -2 / 0.5 = -4 m/s3
        ((10, 10, 8, 8, 8, 8), True),  # -4 m/s2 and back: 8 m/s3
        ((10, 9, 10, 9, 10, 10), True),  # 2 m/s2 to and fro: 8 m/s3
        ((10, 10, 10, 10, 10, 0), True),  # what the last point does is not seen
    ],
)
def test_planned_speeds(speeds, fine):
    assert comfort_planned(_plan(*_speeds(*speeds))) == float(fine)


def test_a_jerk_beyond_the_limit():
    assert comfort_planned(_plan(*_speeds(10, 10, 11.1, 10, 10, 10))) == 0.0  # 2.2, -2.2 m/s2: 8.8 m/s3
    assert comfort_planned(_plan(*_speeds(10, 10, 11.1, 11.1, 11.1, 11.1)), NUPLAN) == 0.0  # 4.4


def test_the_last_point_counts_under_the_other_reading():
    stop = _plan(*_speeds(10, 10, 10, 10, 10, 0))
    assert (comfort_planned(stop), comfort_planned(stop, reading="all")) == (1.0, 0.0)


def test_the_way_from_the_vehicle_to_the_first_point_counts():
    # From the vehicle to the first point 5 m in 0.5 s, then 1 m a point: from 10 m/s to 2 m/s.
    assert comfort_planned(_plan((5, 0), (6, 0), (7, 0), (8, 0), (9, 0), (10, 0))) == 0.0
    assert comfort_planned(_plan(*_speeds(2, 2, 2, 2, 2, 2), own=ego(speed=30.0))) == 1.0  # the vehicle's own speed not


def test_motion_to_the_side_is_never_felt():
    assert comfort_planned(_plan(*_circle(16.0, 10.0))) == 1.0  # 6.25 m/s2 to the side, 0.625 rad/s
    # The vehicle's own heading is that of its start, the first point's that of the way to the second: 1.5 x 0.7 rad/s.
    assert comfort_planned(_plan(*_circle(10.0, 7.0))) == 0.0
    motion = planned_motion(np.column_stack([np.zeros((4, 2)), np.arange(4) * 0.1]), 0.5)
    assert (motion.lateral_m_s2 == 0).all() and motion.yaw_rate_rad_s == pytest.approx([0.2] * 4)


def _circle(radius, speed):
    angles = speed * 0.5 * np.arange(1, 7) / radius
    return tuple((float(radius * np.sin(a)), float(radius * (1 - np.cos(a)))) for a in angles)


@pytest.mark.parametrize("side", [1, -1])
def test_headings_wrap(side):
    yaws = side * np.array([3.1, -3.1, -3.05, -3.0, -2.95, -2.9])
    rates = planned_motion(np.column_stack([np.arange(6.0), np.zeros(6), yaws]), 0.5).yaw_rate_rad_s
    assert rates[0] == pytest.approx(side * (2 * np.pi - 6.2) / 0.5)


def test_few_points_are_comfortable():
    harsh = ((5.0, 0.0), (5.1, 0.0), (40.0, 0.0))
    assert comfort_planned(_plan(*harsh)) == 1.0  # two points and the vehicle's own: three
    assert comfort_planned(_plan(*harsh, (40.1, 0.0))) == 0.0
    assert is_plan_comfortable(np.zeros((3, 3)), 0.5)
    assert comfort_planned(_plan((5.0, 0.0))) is None  # nothing is left of one point


def test_a_plan_that_stands_is_comfortable_whatever_its_jitter():
    jitter = ((0.02, 0.02), (0.0, 0.03), (0.03, -0.02), (0.0, 0.0), (0.02, 0.01), (0.0, 0.0))
    assert comfort_planned(_plan(*jitter, own=ego(speed=0.0, yaw=2.0))) == 1.0


def test_at_a_quarter_second_plans_were_uncomfortable():
    # HUGSIM's old time step: the same gentle plan, read as if its points were 0.25 s apart.
    run = rollout([step(0, ego(), plan=straight(10.0, acceleration=-1.5)), step(1, ego())])
    assert comfort_planned(run) == 1.0
    assert comfort_planned(replace(run, spacing_s=0.25)) == 0.0


@pytest.mark.parametrize(
    ("printed", "frames", "fine"),
    [("0.500", 56, 28), ("0.571", 56, 32), ("0.881", 42, 37), ("0.875", 40, 35), ("0.854", 41, 35), ("0.805", 41, 33)],
)
def test_the_papers_printed_comfort_is_a_share_of_frames(printed, frames, fine):
    kept, harsh = straight(10.0), straight(10.0, acceleration=-4.5)
    moments = [step(i, ego(), plan=kept if i < fine else harsh) for i in range(frames)]
    share = comfort_planned(rollout([*moments, step(frames, ego())]))
    assert share is not None and f"{share:.3f}" == printed
    driven = [step(0, ego())] + [step(i + 1, ego(acceleration=0.0 if i < fine else 2.5)) for i in range(frames)]
    executed = comfort_executed(rollout(driven))
    assert executed is not None and f"{executed:.3f}" == printed


def test_the_papers_table_of_thresholds():
    assert PAPER[:6] == (-4.05, 2.40, 8.37, 4.89, 0.95, 1.93)
    assert (NUPLAN.jerk_m_s3, NUPLAN.whole_jerk_m_s3) == (4.13, 8.37)
