"""Closed-loop drives: an agent drives through a scene in the rain, and is measured."""

from gsrain_engine.backends import Backend
from gsrain_engine.drive.agents.agent import Agent as Agent
from gsrain_engine.drive.metrics.comparison import Run as Run
from gsrain_engine.drive.metrics.summary import DriveMetrics as DriveMetrics
from gsrain_engine.drive.rollouts.json_lines import read_rollout as read_rollout
from gsrain_engine.drive.rollouts.rollout import Rollout as Rollout
from gsrain_engine.drive.scenario.scenario import Scenario as Scenario
from gsrain_engine.drive.scenario.scenario_files import load_scenario as load_scenario
from gsrain_engine.drive.simulation.drive import drive_scene
from gsrain_engine.rain.rain import Rain as RainSettings
from gsrain_engine.scene.scene import Scene


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
    return drive_scene(scene, rain, agent, scenario, backend=backend)
