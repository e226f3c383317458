"""Driving jobs: simulate drives through a copy of the document in another process, and record videos of roll-outs."""

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from jaxtyping import UInt8
from msgspec import Meta

from ...backends import open_renderer
from ...rain.settings import RainSettings
from ...render.renderer import Renderer
from ...safe_io.limits import read_file
from ...scene.formats.scene_folder import FileCache
from ...scene.open import load_sorted_scene
from ...scene.progress import Progress
from ...scene.scene import Scene
from ...simulation.agents.base import Observation, SensorRequirements
from ...simulation.agents.registry import AgentOptions, open_agent
from ...simulation.metrics.summary import DriveMetrics, measure_drive
from ...simulation.playback import RolloutPlayback
from ...simulation.rollout import Rollout, run_setting
from ...simulation.rollout_io import read_any_rollout, read_rollout, write_rollout
from ...simulation.scenario import Scenario
from ...simulation.sensors import RigRenderer, camera_of_width, needed_cameras
from ...simulation.simulation import Simulation, drive
from ..drive_curves import RolloutCurves, rollout_curves
from ..notifications import describe_error
from .job import CopiedSceneJob
from .process import WorkerProcess, install_sigterm_handler

# Loaded roll-outs


@dataclass(frozen=True, slots=True, eq=False)
class LoadedRollout:
    """A finished drive with its curves and metrics."""

    rollout: Rollout
    curves: RolloutCurves
    metrics: DriveMetrics
    path: Path | None
    """File of the roll-out; None for an unsaved result of a job."""
    intensity_mm_h: float

    @property
    def title(self) -> str:
        return f"{self.metrics.scenario or 'drive'}, {self.intensity_mm_h:g} mm/h, {self.rollout.agent}"

    @property
    def collision_s(self) -> float | None:
        return self.metrics.collision_time_s

    @property
    def duration_s(self) -> float:
        return self.rollout.steps[-1].time_s

    def saved_at(self, path: Path) -> "LoadedRollout":
        """Return the roll-out with the path it was saved to."""
        return LoadedRollout(self.rollout, self.curves, self.metrics, path, self.intensity_mm_h)


Reading = Future[list[LoadedRollout]]

# Drive settings

RainSource = Literal["as the scene", "one intensity", "paper's four"]


class DriveSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a drive except for the scenario, whose rain is not used: the drive uses the document's rain."""

    agent: Annotated[str, Meta(title="Agent", description="Who drives.")]
    detector: Annotated[
        Path | None,
        Meta(title="Detector", description="ONNX file of an object detector, for agents that look at pictures."),
    ] = None
    description: Annotated[
        str | None,
        Meta(title="Its description", description="How the detector is used: a shipped name such as yolox, or a YAML."),
    ] = None
    url: Annotated[
        str | None, Meta(title="Address", description="Where an agent listens that runs elsewhere, such as http.")
    ] = None
    rain: Annotated[
        RainSource,
        Meta(
            title="Rain",
            description="The scene's rain as it is now; the same with another intensity; or one drive at each of the "
            "paper's 0, 1.2, 8.5 and 12 mm/h.",
        ),
    ] = "as the scene"
    intensity_mm_h: Annotated[
        float, Meta(ge=0, le=100, title="Intensity", description="R of this drive.", extra={"unit": "mm/h"})
    ] = 8.5
    seed: Annotated[
        int, Meta(ge=0, le=2**31 - 1, title="Seed", description="Same seed: same drops and the same drive.")
    ] = 0

    @property
    def options(self) -> AgentOptions:
        return AgentOptions(detector=self.detector, description=self.description, url=self.url)

    def rains(self, present: RainSettings) -> tuple[RainSettings, ...]:
        """Return the rain of each drive; `present` is the scene's."""
        if self.rain == "as the scene":
            return (present,)
        chosen = PAPER_MM_H if self.rain == "paper's four" else (self.intensity_mm_h,)
        return tuple(msgspec.structs.replace(present, intensity_mm_h=each) for each in chosen)


class SimulationJob(CopiedSceneJob):
    """One drive, or one in each of several rains."""

    def __init__(
        self,
        scene: Scene,
        scenario: Scenario,
        settings: DriveSettings,
        rains: Sequence[RainSettings],
        files: ThreadPoolExecutor,
        known: FileCache,
        take: Callable[[Reading], None],
    ) -> None:
        """Start; `take` receives the roll-outs while they are being read."""
        title = f"Drive {scenario.name} with {settings.agent}"
        work = partial(_started, title, scenario, settings, tuple(rains))
        super().__init__(title, scene, known, files, work)
        self._count, self._hand_over = len(rains), take

    def _take(self, last: Progress) -> None:
        # The same thread removes the folder after this.
        self._hand_over(self._folder.do(lambda folder: _read(folder, self._count)))


def _started(
    title: str, scenario: Scenario, settings: DriveSettings, rains: tuple[RainSettings, ...], copy: Path
) -> WorkerProcess:
    return WorkerProcess(title, drive_in_worker, copy, scenario, settings, rains)


def _read(folder: Path, count: int) -> list[LoadedRollout]:
    return [load_rollout(path, is_own=False) for path in rollout_files(folder, count)]


# Worker: one roll-out per rain

_PREVIEW_PX = 320
_OPENED = 0.1  # progress at which the scene is read and all actors are placed


def rollout_files(folder: Path, count: int) -> list[Path]:
    """Paths of a job's roll-outs, in the order of its rains."""
    return [folder / f"rollout{number}.jsonl" for number in range(count)]


def drive_in_worker(
    scene_folder: Path, scenario: Scenario, settings: DriveSettings, rains: Sequence[RainSettings]
) -> Iterator[Progress]:
    """Drive once in each rain; writes the roll-outs and their metrics next to the scene's folder.

    Raises ValueError if the scene lacks what the scenario needs, or the agent what it needs.
    """
    yield Progress(0.0, "Reading the scene")
    scene = load_sorted_scene(str(scene_folder))
    yield Progress(_OPENED / 3, f"Making {settings.agent} ready")
    agent = open_agent(settings.agent, settings.options)
    try:
        with open_renderer() as renderer:
            for number, rain in enumerate(rains):
                yield Progress(_share(number, 0.0, len(rains)), "Looking for the road and for what stands beside it")
                needs = agent.needs
                test = msgspec.structs.replace(scenario, rain=rain)
                simulation = Simulation(test, scene, needs, renderer if needs.cameras else None, settings.seed)
                front = _FrontCamera(simulation, renderer)
                for observation in drive(simulation, agent):
                    done = observation.time_s / test.duration_s
                    words = f"{rain.intensity_mm_h:g} mm/h, {observation.time_s:.2f} s: {_notes_of(observation)}"
                    yield Progress(_share(number, done, len(rains)), words, front.picture(observation))
                path = rollout_files(scene_folder.parent, len(rains))[number]
                rollout = simulation.rollout(agent.name)
                write_rollout(path, rollout)
                numbers = msgspec.json.encode(measure_drive(rollout, simulation.occupied))
                path.with_suffix(METRICS_SUFFIX).write_bytes(numbers)
    finally:
        agent.close()
    yield Progress(1.0, "Driven")


class _FrontCamera:
    """Image of the front camera; rendered only if the agent does not request it."""

    def __init__(self, simulation: Simulation, renderer: Renderer) -> None:
        self._simulation = simulation
        front = (
            needed_cameras(simulation.rig.cameras, SensorRequirements(cameras=("front",)))
            if simulation.rig.cameras
            else ()
        )
        self._cameras = tuple(camera_of_width(each, _PREVIEW_PX) for each in front)
        self._pictures = RigRenderer(renderer, simulation.scenario.rain, self._cameras, SensorRequirements())

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


def _notes_of(observation: Observation) -> str:
    return f"{observation.state.speed_m_s:.1f} m/s"


# Roll-out videos

logger = logging.getLogger("gsrain")


class RolloutVideoJob(CopiedSceneJob):
    """One video, as `gsrain drive` makes it."""

    def __init__(
        self, scene: Scene, rollout: Rollout, film: Path, fps: float, files: ThreadPoolExecutor, known: FileCache
    ) -> None:
        title = f"Film {film.name}"
        super().__init__(title, scene, known, files, partial(_start_video, title, rollout, film, fps))
        self._film = film

    def _describe(self, error: Exception) -> str:
        return describe_error(f"{self._film} can't be filmed", error)

    def _take(self, last: Progress) -> None:
        logger.info("Filmed the drive %s", self._film)


def _start_video(title: str, rollout: Rollout, film: Path, fps: float, copy: Path) -> WorkerProcess:
    beside = copy.parent / "rollout.jsonl"
    write_rollout(beside, rollout)
    return WorkerProcess(title, render_video_in_worker, copy, beside, film, fps)


def render_video_in_worker(scene_folder: Path, rollout: Path, film: Path, fps: float) -> Iterator[Progress]:
    """Worker: render a video; on SIGTERM, closes the file first.

    Raises:
        ValueError: If the scene has no rig, or not the actors of the roll-out.
        OSError: If the video can't be written.
    """
    # Matplotlib loads slowly: not before the first video.
    from ...simulation.video import RolloutVideo, render_rollout_video

    install_sigterm_handler()
    yield Progress(0.0, "Reading the scene")
    played = RolloutPlayback(read_rollout(rollout), load_sorted_scene(str(scene_folder)))
    with open_renderer() as renderer:
        yield from render_rollout_video(film, RolloutVideo(played, renderer), fps)


PAPER_MM_H = (0.0, 1.2, 8.5, 12.0)
"""Intensities of the paper's closed-loop tables."""

METRICS_SUFFIX = ".metrics.json"
"""Suffix of the metrics next to a job's roll-out: they include the occupancy of its scene's background."""


def load_rollout(path: Path, *, is_own: bool = True) -> LoadedRollout:
    """Read a roll-out; `is_own` is false for a temporary file of a job.

    Raises:
        ValueError: For an invalid roll-out, with the file and the line.
        OSError: If the file can't be read.
    """
    rollout = read_any_rollout(path)
    beside = path.with_suffix(METRICS_SUFFIX)
    try:
        metrics = measure_drive(rollout) if is_own else msgspec.json.decode(read_file(beside), type=DriveMetrics)
        curves = rollout_curves(rollout)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    intensity = run_setting(rollout).intensity_mm_h
    return LoadedRollout(rollout, curves, metrics, path if is_own else None, intensity)
