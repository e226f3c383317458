"""Drives an agent through a scenario, from its start to its end."""

from collections.abc import Iterator
from contextlib import ExitStack

import msgspec

from gsrain_engine.backends import Backend, open_renderer
from gsrain_engine.rain.rain import Rain
from gsrain_engine.scene.scene import Scene

from ..agents.agent import Agent
from ..agents.observation import Observation
from ..agents.registry import AgentOptions, open_agent
from ..metrics.comparison import Run
from ..road.drivable import drivable_of
from ..rollouts.rollout import Rollout
from ..scenario.scenario import Scenario
from ..scenario.scenario_files import load_scenario
from .simulation import Simulation


def drive(simulation: Simulation, agent: Agent) -> Iterator[Observation]:
    """Let an agent drive; yields each observation that it has answered. `simulation.rollout` has what happened.

    Stop taking observations to stop the drive. What an agent raises comes through; the drive then ends as it stands.
    """
    observation = simulation.reset()
    agent.reset(simulation.seed, simulation.rig)
    while simulation.end is None:
        plan = agent.plan(observation)
        yield observation
        simulation.step(plan)
        if simulation.end is None:
            observation = simulation.observation()


def drive_through(simulation: Simulation, agent: Agent) -> Rollout:
    """Let an agent drive to the end, and return what happened. What it raises comes through."""
    for _ in drive(simulation, agent):
        pass
    return simulation.rollout(agent.name)


def drive_scene(
    scene: Scene,
    rain: Rain | None = None,
    agent: Agent | str = "oracle-idm",
    scenario: Scenario | str = "stationary-lead",
    *,
    options: AgentOptions | None = None,
    backend: Backend = "auto",
) -> Run:
    """Let an agent drive through a scene in the rain, and measure the drive.

    `rain` of None is the scenario's. An agent given by its name is opened and closed here, and so is a renderer where
    the agent needs cameras. Raises ValueError for an unknown agent or scenario, and where the scene lacks what the
    scenario needs: a recorded drive of its ego vehicle, a rig, a model.
    """
    test = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if rain is not None:
        test = msgspec.structs.replace(test, rain=rain)
    with ExitStack() as stack:
        driver = open_agent(agent, options) if isinstance(agent, str) else agent
        if driver is not agent:
            stack.callback(driver.close)
        renderer = stack.enter_context(open_renderer(backend)) if driver.needs.cameras else None
        simulation = Simulation(test, scene, driver.needs, renderer)
        rollout = drive_through(simulation, driver)
        drivable = drivable_of(scene, simulation.ground, simulation.occupied)
        return Run.of(rollout, simulation.occupied, drivable)
