"""Drives an agent through a scenario, from its start to its end."""

from collections.abc import Iterator

from ..agents.agent import Agent
from ..agents.observation import Observation
from ..rollouts.rollout import Rollout
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
