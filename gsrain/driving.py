"""Closed-loop drives: an agent drives through a scene in the rain, and is measured."""

from gsrain_engine.backends import Backend
from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.agents.base import Agent as Agent
from gsrain_engine.simulation.metrics.summary import DriveMetrics as DriveMetrics
from gsrain_engine.simulation.metrics.summary import ScoredRun as Run
from gsrain_engine.simulation.rollout import Rollout as Rollout
from gsrain_engine.simulation.rollout_io import read_rollout as read_rollout
from gsrain_engine.simulation.scenario import Scenario as Scenario
from gsrain_engine.simulation.scenario_io import load_scenario as load_scenario
from gsrain_engine.simulation.simulation import drive_scene

from .rain import checked_rain


def drive(
    scene: Scene,
    rain: RainSettings | None = None,
    *,
    agent: Agent | str = "oracle-idm",
    scenario: Scenario | str = "stationary-lead",
    backend: Backend = "auto",
) -> Run:
    """Let an agent drive through a scene; `run.metrics.collided` says whether it hit something.

    Args:
        scene: A scene whose ego vehicle has a recorded drive, such as the built-in street: its route.
        rain: The rain; None is the scenario's.
        agent: A name, such as "constant-velocity", "oracle-idm" or "camera-idm"; a file with a class of yours
            ("my_driver.py"); or an object with the methods of `Agent`.
        scenario: A shipped name, a file (ours, HUGSIM's, OpenSCENARIO XML), or a value.
        backend: Renderer of what the agent's cameras see, if it needs any.

    Returns:
        The metrics and the roll-out; `run.save("run.jsonl")` writes what the window plays.

    Raises:
        ValueError: For an unknown agent or scenario, and where the scene lacks what the scenario needs.
    """
    return drive_scene(scene, None if rain is None else checked_rain(rain), agent, scenario, backend=backend)
