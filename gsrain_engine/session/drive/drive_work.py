"""Drives through a saved scene, as work of another process; writes one roll-out a rain."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import UInt8

from gsrain_engine.backends import open_renderer
from gsrain_engine.drive.agents.agent import Needs
from gsrain_engine.drive.agents.observation import Observation
from gsrain_engine.drive.agents.registry import open_agent
from gsrain_engine.drive.metrics.summary import measured
from gsrain_engine.drive.rollouts.json_lines import write_rollout
from gsrain_engine.drive.scenario.scenario import Scenario
from gsrain_engine.drive.simulation.drive import drive
from gsrain_engine.drive.simulation.rig_pictures import RigPictures, needed_cameras, of_width
from gsrain_engine.drive.simulation.simulation import Simulation
from gsrain_engine.rain.rain import Rain
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.scene.progress import Progress

from .drive_wishes import DriveWishes
from .opened_rollout import METRICS_SUFFIX

_PREVIEW_PX = 320
_OPENED = 0.1
"""Share of the bar when the scene is read and everybody is in place."""


def rollout_files(folder: Path, count: int) -> list[Path]:
    """Where the roll-outs of a job stand, in the order of its rains."""
    return [folder / f"rollout{number}.jsonl" for number in range(count)]


def drive_in_worker(
    scene_folder: Path, scenario: Scenario, wishes: DriveWishes, rains: Sequence[Rain]
) -> Iterator[Progress]:
    """Drive once in each rain; the roll-outs and their metrics stand beside the scene's folder.

    Raises ValueError where the scene lacks what the scenario needs, and where the agent lacks what it needs.
    """
    yield Progress(0.0, "Reading the scene")
    scene = open_to_draw(str(scene_folder))
    yield Progress(_OPENED / 3, f"Making {wishes.agent} ready")
    agent = open_agent(wishes.agent, wishes.options)
    try:
        with open_renderer() as renderer:
            for number, rain in enumerate(rains):
                yield Progress(_share(number, 0.0, len(rains)), "Looking for the road and for what stands beside it")
                needs = agent.needs
                test = msgspec.structs.replace(scenario, rain=rain)
                simulation = Simulation(test, scene, needs, renderer if needs.cameras else None, wishes.seed)
                front = _Front(simulation, renderer)
                for observation in drive(simulation, agent):
                    done = observation.time_s / test.duration_s
                    words = f"{rain.intensity_mm_h:g} mm/h, {observation.time_s:.2f} s: {_told(observation)}"
                    yield Progress(_share(number, done, len(rains)), words, front.picture(observation))
                path = rollout_files(scene_folder.parent, len(rains))[number]
                rollout = simulation.rollout(agent.name)
                write_rollout(path, rollout)
                numbers = msgspec.json.encode(measured(rollout, simulation.occupied))
                path.with_suffix(METRICS_SUFFIX).write_bytes(numbers)
    finally:
        agent.close()
    yield Progress(1.0, "Driven")


class _Front:
    """What the front camera sees; drawn only where the agent has not had it drawn."""

    def __init__(self, simulation: Simulation, renderer: Renderer) -> None:
        self._simulation = simulation
        front = needed_cameras(simulation.rig.cameras, Needs(cameras=("front",))) if simulation.rig.cameras else ()
        self._cameras = tuple(of_width(each, _PREVIEW_PX) for each in front)
        self._pictures = RigPictures(renderer, simulation.scenario.rain, self._cameras, Needs())

    def picture(self, observation: Observation) -> UInt8[np.ndarray, "h w 3"] | None:
        if not self._cameras:
            return None
        (front,) = self._cameras
        if front.name in observation.views:
            return observation.views[front.name].image
        state, simulation = observation.state, self._simulation
        velocity = state.speed_m_s * np.array([np.cos(state.yaw_rad), np.sin(state.yaw_rad), 0.0])
        time_s = simulation.scenario.start_s + observation.time_s
        views = self._pictures.views(simulation.scene_now, simulation.rig_to_world, velocity, 0.0, time_s)
        return views[front.name].image


def _share(number: int, done: float, count: int) -> float:
    return _OPENED + (1 - _OPENED) * (number + min(max(done, 0.0), 1.0)) / count


def _told(observation: Observation) -> str:
    return f"{observation.state.speed_m_s:.1f} m/s"
