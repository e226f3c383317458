"""Comfort of driven and planned motion, worked out by hand at the paper's thresholds."""

import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.simulation.metrics.comfort import NUPLAN, comfort_executed, comfort_planned
from small_rollout import ego, rollout, step, straight


def driven(*moments):
    return rollout([step(i, each) for i, each in enumerate(moments)])


def accelerated(*values):
    return driven(ego(), *(ego(acceleration=each) for each in values))


def turned(speed, *rates):
    return driven(*(ego(speed=speed, yaw_rate=each) for each in rates))


@pytest.mark.parametrize(
    ("run", "paper", "nuplan"),
    [
        (accelerated(2.40, 2.40), 1.0, 1.0),
        (accelerated(2.41, 2.40), 0.5, 0.5),
        (accelerated(-4.05, -4.05), 1.0, 1.0),  # the first step has no jerk
        (accelerated(-4.05, -4.06), 0.5, 0.5),
        (accelerated(0.0, 2.09), 1.0, 0.5),  # a jerk of 8.36 m/s3
        (accelerated(0.0, -2.10, -2.10, 0.0), 0.5, 0.5),  # 8.4
        (accelerated(0.0, 1.1), 1.0, 0.5),  # 4.4 m/s3
        (turned(10.0, 0.0, 0.0, 0.22), 1.0, 0.5),  # 2.2 m/s2 in 0.25 s: 8.8 m/s3 across
        # 4.8 and 5.0 m/s2 to the side; from straight on 0.48 rad/s after 0.25 s are 1.92 rad/s2
        (turned(20.0, 0.0, 0.24), 1.0, 1.0),
        (turned(20.0, 0.0, -0.25), 0.0, 0.0),
        (turned(4.0, 0.0, -0.48), 1.0, 1.0),
        (turned(1.0, 0.49, 0.0), 0.0, 0.0),  # 1.96 rad/s2
        *((turned(1.0, 0.0, *np.multiply(side, (0.48, 0.94, 0.96, 0.96))), 2 / 4, 2 / 4) for side in (1, -1)),
        (driven(ego()), None, None),
    ],
)
def test_executed_motion_at_the_limits(run, paper, nuplan):
    assert (comfort_executed(run), comfort_executed(run, NUPLAN)) == (paper, nuplan)


def plan(*points, own=None):
    return rollout([step(0, own or ego(), plan=points), step(1, ego())])


def speeds(*values):
    """A plan straight ahead, points 0.5 s apart, with so many m/s before each."""
    return plan(*((float(x), 0.0) for x in np.cumsum(values) * 0.5))


def circle(radius, speed, side=1, yaw=0.0):
    angles = speed * 0.5 * np.arange(1, 7) / radius
    points = ((float(radius * np.sin(a)), float(side * radius * (1 - np.cos(a)))) for a in angles)
    return plan(*points, own=ego(yaw=yaw))


JITTER = ((0.02, 0.02), (0.0, 0.03), (0.03, -0.02), (0.0, 0.0), (0.02, 0.01), (0.0, 0.0))


@pytest.mark.parametrize(
    ("run", "share"),
    [
        (speeds(10, 8, 6, 4, 2, 0), 1.0),  # -4 m/s2
        (speeds(10, 7.9, 5.8, 3.7, 1.6, 0), 0.0),  # -4.2
        (speeds(10, 11.2, 12.4, 13.6, 14.8, 16), 1.0),  # 2.4
        (speeds(10, 11.25, 12.5, 13.75, 15, 16), 0.0),  # 2.5
        (speeds(10, 10, 8, 8, 8, 8), 1.0),  # -4 m/s2 and back: 8 m/s3
        (speeds(10, 10, 11.1, 10, 10, 10), 0.0),  # 2.2, -2.2 m/s2: 8.8 m/s3
        (speeds(10, 10, 10, 10, 10, 0), 1.0),  # the last point is not counted
        (plan((5, 0), (6, 0), (7, 0), (8, 0), (9, 0), (10, 0)), 0.0),  # to the first point 10 m/s, then 2
        (plan(*straight(2.0), own=ego(speed=30.0)), 1.0),  # the vehicle's own speed does not count
        *((circle(16.0, 10.0, side, np.pi * side), 1.0) for side in (1, -1)),  # 6.25 m/s2 to the side, 0.625 rad/s
        # The vehicle's own heading is that of its start, the first point's that to the second: 1.5 x 0.7 rad/s.
        (circle(10.0, 7.0), 0.0),
        (plan((5.0, 0.0), (5.1, 0.0), (40.0, 0.0)), 1.0),  # two points and the vehicle's own: three
        (plan((5.0, 0.0), (5.1, 0.0), (40.0, 0.0), (40.1, 0.0)), 0.0),
        (plan((5.0, 0.0)), None),  # nothing is left of one point
        (plan(*JITTER, own=ego(speed=0.0, yaw=2.0)), 1.0),  # a plan that stands
        (driven(ego(), ego()), None),
        # HUGSIM's old time step: the same gentle plan, read as if its points were 0.25 s apart.
        (plan(*straight(10.0, acceleration=-1.5)), 1.0),
        (replace(plan(*straight(10.0, acceleration=-1.5)), spacing_s=0.25), 0.0),
    ],
)
def test_planned_motion_at_the_limits(run, share):
    assert comfort_planned(run) == share


def test_nuplans_limits_of_plans():
    assert comfort_planned(speeds(10, 10, 11.1, 11.1, 11.1, 11.1), NUPLAN) == 0.0  # 4.4 m/s3
