"""Metrics of a real drive, against the background and the road of its scene."""

import msgspec
import pytest

from gsrain_engine.simulation.agents.registry import open_agent
from gsrain_engine.simulation.metrics.summary import measure_drive
from gsrain_engine.simulation.obstacles import drivable_of
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.simulation import Simulation, drive
from small_scene import small_scene


def _driven(speed_m_s):
    simulation = Simulation(Scenario(name="to the wall", speed_m_s=speed_m_s), small_scene())
    agent = open_agent("constant-velocity")
    for _ in drive(simulation, agent):
        pass
    return simulation, simulation.rollout(agent.name)


def test_plans_that_reach_the_wall_collide_where_the_background_is_known():
    simulation, rollout = _driven(10.0)
    known = measure_drive(rollout, simulation.occupied)
    assert rollout.end == "completed" and not known.collision and known.route_completion == 1.0
    # The road ends at a wall at 40 m: from 7 m on the last planned point, 30 m ahead, puts the front bumper into it.
    assert known.planned_point_collision_rate is not None and 0 < known.planned_point_collision_rate < 0.2
    assert measure_drive(rollout).planned_point_collision_rate == 0.0
    assert known.with_background and not measure_drive(rollout).with_background


def test_slow_plans_stay_on_the_road():
    simulation, rollout = _driven(2.0)
    metrics = measure_drive(
        rollout, simulation.occupied, drivable_of(simulation.scene, simulation.ground, simulation.occupied)
    )
    assert (metrics.dac, metrics.nc, metrics.rc) == (1.0, 1.0, 1.0)
    assert metrics.comfort_executed == 1.0 and metrics.mean_speed_m_s == pytest.approx(2.0)
    assert metrics.hdscore == metrics.pdms


def test_the_same_drive_has_the_same_metrics():
    first, second = (msgspec.json.encode(measure_drive(_driven(10.0)[1])) for _ in range(2))
    assert first == second
