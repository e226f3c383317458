"""Closed-loop drives: an agent drives through a scene in the rain, and is measured."""

from pathlib import Path

from gsrain_engine.choices import Backend
from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.agents.base import Agent as Agent
from gsrain_engine.simulation.metrics.summary import DriveMetrics as DriveMetrics
from gsrain_engine.simulation.metrics.summary import ScoredRun as Run
from gsrain_engine.simulation.rollout import Rollout as Rollout
from gsrain_engine.simulation.rollout_io import read_rollout as open_rollout
from gsrain_engine.simulation.scenario import Scenario as Scenario
from gsrain_engine.simulation.scenario_io import load_scenario as open_scenario
from gsrain_engine.simulation.simulation import drive_scene

from .arguments import checked


@checked
def drive(
    scene: Scene,
    rain: RainSettings | None = None,
    *,
    agent: Agent | Path | str = "oracle-idm",
    scenario: Scenario | Path | str = "stationary-lead",
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
    driver = str(agent) if isinstance(agent, Path) else agent
    test = str(scenario) if isinstance(scenario, Path) else scenario
    return drive_scene(scene, rain, driver, test, backend=backend)


@checked
def load_scenario(name: Path | str) -> Scenario:
    """Load a shipped scenario by name, or a scenario file by path: GSRAIN's, HUGSIM's, or OpenSCENARIO XML.

    A file's own file names are resolved against its folder first, then the working folder. Raises `ValueError` with the
    file, the field and what is allowed.
    """
    return open_scenario(name)


@checked
def read_rollout(path: Path | str) -> Rollout:
    """Read a roll-out of `run.save`; raises `ValueError` with file and line where it is cut off or newer."""
    return open_rollout(path)
