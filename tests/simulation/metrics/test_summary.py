"""All metrics of a run in one value, and that they do not depend on where in the world it was."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from gsrain_engine.simulation.metrics.summary import DriveMetrics, measure_drive, write_metrics_csv
from small_rollout import approach, ego, rollout, step, user

_PROMISED = (
    "collision", "min_ttc_s", "planned_point_collision_rate", "planned_frame_collision_rate", "comfort_executed",
    "comfort_planned", "steps", "agent", "intensity_mm_h",
)  # fmt: skip


def test_a_run_into_a_standing_car():
    metrics = measure_drive(approach(lead_x=40.0, moments=20, intensity_mm_h=8.5, seed=3))
    plain = msgspec.json.decode(msgspec.json.encode(metrics))
    assert set(_PROMISED) <= set(plain)
    assert metrics.collision and metrics.collided_with == "lead" and metrics.collision_time_s == 3.5
    assert (metrics.min_ttc_s, metrics.min_ttc_time_s, metrics.min_gap_m) == (0.0, 3.5, 0.0)
    assert (metrics.steps, metrics.frames, metrics.planned_points) == (14, 14, 6)
    assert metrics.intensity_mm_h == 8.5 and metrics.seed == 3 and metrics.duration_s == 3.5
    assert metrics.distance_m == pytest.approx(35.0) and metrics.mean_speed_m_s == pytest.approx(10.0)
    assert metrics.hardest_braking_m_s2 == 0.0 and not metrics.with_background and metrics.dac is None
    assert msgspec.convert(plain, DriveMetrics) == metrics


def test_a_moment_is_enough():
    metrics = measure_drive(rollout([step(0, ego())], end="agent"))
    assert (metrics.steps, metrics.mean_speed_m_s, metrics.comfort_executed, metrics.hdscore) == (0, 0.0, None, None)
    assert metrics.min_ttc_s == 10.0 and metrics.min_gap_m is None


def test_a_run_that_begins_later_is_the_same_run():
    """Only moments in time move along: a recorded drive starts at its own clock."""
    run = approach(lead_x=33.0, moments=20)
    later = replace(run, steps=tuple(replace(each, time_s=each.time_s + 7.5) for each in run.steps))
    moments = {"min_ttc_time_s", "collision_time_s"}
    here, there = (msgspec.structs.asdict(measure_drive(each)) for each in (run, later))
    assert here["duration_s"] == 3.0 and here["mean_speed_m_s"] == pytest.approx(10)
    for name, value in here.items():
        expected = value + 7.5 if name in moments else value
        assert there[name] == (pytest.approx(expected) if isinstance(value, float) else expected), name


def test_the_hardest_braking_is_the_largest_deceleration():
    def hardest(*accelerations):
        steps = [step(i, ego(2.5 * i, acceleration=a)) for i, a in enumerate(accelerations)]
        return measure_drive(rollout(steps)).hardest_braking_m_s2

    assert hardest(-1.0, 2.0, -3.5, 0.5) == 3.5
    assert hardest(1.0, 2.0, 0.5) == 0.0


def test_the_share_of_the_route_is_the_farthest_that_was_reached():
    steps = [step(i, ego(2.5 * i), completion=c) for i, c in enumerate((0.0, 0.3, 0.25))]
    metrics = measure_drive(rollout(steps))
    assert metrics.route_completion == 0.3
    assert metrics.mean_speed_m_s == pytest.approx(10.0)  # also of half a second


def test_the_least_gap_counts_where_somebody_is_ahead_for_a_while():
    """A car 12 m on from the start, middle to rear axle, leaves the lane at the third moment: 12 - 2.5 - 3 - 2 m."""
    steps = [step(i, ego(2.5 * i), [user(12.0, y=0.0 if i < 2 else 30.0)]) for i in range(4)]
    metrics = measure_drive(rollout(steps))
    assert metrics.min_gap_m == pytest.approx(4.5)
    assert metrics.min_ttc_s == pytest.approx(0.45) and metrics.min_ttc_time_s == 0.25


def test_a_vehicle_that_can_not_be_read_is_named():
    with pytest.raises(ValueError, match=r"scenario\.vehicle: .*length_m"):
        measure_drive(replace(approach(), scenario={"vehicle": {"length_m": "long"}}))


@settings(max_examples=15)
@given(st.floats(-math.pi, math.pi), st.floats(-500, 500), st.floats(-500, 500))
def test_metrics_do_not_depend_on_where_the_world_begins(turn, x, y):
    run = approach(lead_x=33.0, moments=9)
    here, there = measure_drive(run), measure_drive(_elsewhere(run, turn, x, y))
    for name, value in msgspec.structs.asdict(here).items():
        other = getattr(there, name)
        assert other == (pytest.approx(value, abs=1e-6) if isinstance(value, float) else value), name


def _elsewhere(run, turn, x, y):
    cosine, sine = np.cos(turn), np.sin(turn)

    def moved(record):
        return replace(
            record, x_m=float(cosine * record.x_m - sine * record.y_m + x),
            y_m=float(sine * record.x_m + cosine * record.y_m + y), yaw_rad=float(record.yaw_rad + turn),
        )  # fmt: skip

    steps = [replace(each, ego=moved(each.ego), road_users=tuple(map(moved, each.road_users))) for each in run.steps]
    return replace(run, steps=tuple(steps))


def test_metrics_as_csv(tmp_path):
    metrics = [measure_drive(approach(moments=5)), measure_drive(approach(moments=20))]
    write_metrics_csv(tmp_path / "runs.csv", metrics)
    first, *rest = (tmp_path / "runs.csv").read_text().splitlines()
    columns = first.split(",")
    assert columns == list(DriveMetrics.__struct_fields__)
    rows = [dict(zip(columns, line.split(","), strict=True)) for line in rest]
    assert [row["collision"] for row in rows] == ["false", "true"]
    assert rows[0]["collided_with"] == "" and float(rows[0]["min_ttc_s"]) == metrics[0].min_ttc_s
