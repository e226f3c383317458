"""The shipped scenarios with other road users: a hazard to who does not brake, none to who does."""

import pytest

from gsrain_engine.scene.open import load_street
from gsrain_engine.simulation.agents.registry import open_agent
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation, drive


@pytest.fixture(scope="module")
def street():
    return load_street()


def driven(name, agent, street):
    simulation, driver = Simulation(load_scenario(name), street), open_agent(agent)
    for _ in drive(simulation, driver):
        pass
    return simulation.rollout(driver.name)


@pytest.mark.parametrize(("name", "hit"), [("lead-braking", "lead"), ("idm-traffic", "van"), ("cut-in", "lead")])
def test_who_keeps_speed_drives_into_it(street, name, hit):
    rollout = driven(name, "constant-velocity", street)
    assert (rollout.end, rollout.steps[-1].collision) == ("collision", hit)


@pytest.mark.parametrize("name", ["lead-braking", "idm-traffic", "cut-in"])
def test_who_sees_and_brakes_does_not(street, name):
    rollout = driven(name, "oracle-idm", street)
    assert rollout.end in ("time", "completed")
    assert all(step.collision is None for step in rollout.steps)
    assert min(step.ego.acceleration_m_s2 for step in rollout.steps) < -0.5
