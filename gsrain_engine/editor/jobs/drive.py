"""Driving jobs: simulate drives through a copy of the document, and record videos of roll-outs; loaded roll-outs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from jaxtyping import Float64, UInt8
from msgspec import Meta

from ...backends import open_renderer
from ...rain.settings import HEAVIEST_MM_H, RainSettings
from ...render.level_of_detail import lod_cut
from ...render.renderer import Renderer
from ...safe_io.limits import read_file
from ...scene.formats.scene_folder import FileCache
from ...scene.open import load_sorted_scene
from ...scene.progress import Progress
from ...scene.scene import Scene
from ...settings import Settings
from ...simulation.agents.base import Observation, SensorRequirements
from ...simulation.agents.registry import AgentOptions, open_agent
from ...simulation.metrics.collisions import gaps_m, times_to_collision_s
from ...simulation.metrics.summary import DriveMetrics, measure_drive
from ...simulation.playback import RolloutPlayback
from ...simulation.rollout import Rollout
from ...simulation.rollout_io import read_any_rollout, read_rollout, write_rollout
from ...simulation.scenario import Scenario
from ...simulation.sensors import RigRenderer, camera_of_width, needed_cameras
from ...simulation.simulation import Simulation, drive
from .folder import write_copy
from .job import Job
from .process import install_sigterm_handler

_PAPER_MM_H = (0.0, 1.2, 8.5, 12.0)  # intensities of the paper's closed-loop tables
_METRICS_SUFFIX = ".metrics.json"
"""Suffix of the metrics next to a job's roll-out: they include the occupancy of its scene's background."""

# Loaded roll-outs


@dataclass(frozen=True, slots=True, eq=False)
class RolloutCurves:
    """Values per step of a roll-out, for plots. Times are seconds since the scenario began."""

    times_s: Float64[np.ndarray, " n"]
    speed_m_s: Float64[np.ndarray, " n"]
    acceleration_m_s2: Float64[np.ndarray, " n"]
    """Mean over the previous step."""
    ttc_s: Float64[np.ndarray, " n"]
    """Time to collision, 0..10 (paper's TTC, bumper to bumper)."""
    gap_m: Float64[np.ndarray, " n"]
    """Gap to the nearest vehicle ahead in the lane; NaN if there is none."""

    @classmethod
    def of(cls, rollout: Rollout) -> "RolloutCurves":
        """Compute the curves of a roll-out; raises ValueError if its vehicle can't be read."""
        gaps = gaps_m(rollout)
        return cls(
            np.array([each.time_s for each in rollout.steps]),
            np.array([each.ego.speed_m_s for each in rollout.steps]),
            np.array([each.ego.acceleration_m_s2 for each in rollout.steps]),
            times_to_collision_s(rollout),
            np.where(np.isfinite(gaps), gaps, np.nan),
        )

    @property
    def min_ttc_time_s(self) -> float:
        """Time at which the time to collision was smallest."""
        return float(self.times_s[int(self.ttc_s.argmin())])

    def ttc_at(self, time_s: float) -> float:
        """Time to collision at a time, interpolated between steps."""
        return float(np.interp(time_s, self.times_s, self.ttc_s))


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

    @property
    def outcome(self) -> str:
        """Its end in words, with the time in seconds."""
        hit = self.metrics.collided_with
        if hit is None:
            return f"no collision in {self.duration_s:.2f} s ({self.rollout.end})"
        return f"collision with {hit} after {self.duration_s:.2f} s"


def load_rollout(path: Path, *, is_own: bool = True) -> LoadedRollout:
    """Read a roll-out; `is_own` is false for a temporary file of a job.

    Raises ValueError, with the file and the line, or OSError.
    """
    rollout, file = read_any_rollout(path), path.with_suffix(_METRICS_SUFFIX)
    try:
        metrics = measure_drive(rollout) if is_own else msgspec.json.decode(read_file(file), type=DriveMetrics)
        curves = RolloutCurves.of(rollout)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return LoadedRollout(rollout, curves, metrics, path if is_own else None, rollout.intensity_mm_h)


# Drive settings

RainSource = Literal["as the scene", "one intensity", "paper's four"]


class DriveSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a drive except for the scenario, whose rain is not used: the drive uses the document's rain."""

    agent: Annotated[str, Meta(title="Agent", description="The driving agent.")]
    detector: Annotated[
        Path | None,
        Meta(title="Detector", description="ONNX file of an object detector, for agents that look at pictures."),
    ] = None
    description: Annotated[
        str | None,
        Meta(title="Its description", description="A shipped detector description such as yolox, or a YAML file."),
    ] = None
    url: Annotated[str | None, Meta(title="Address", description="URL of a driving agent that runs elsewhere.")] = None
    rain: Annotated[
        RainSource,
        Meta(
            title="Rain",
            description="The scene's rain as it is now; the same with another intensity; or one drive at each of the "
            "paper's 0, 1.2, 8.5 and 12 mm/h.",
        ),
    ] = "as the scene"
    intensity_mm_h: Annotated[
        float, Meta(ge=0, le=HEAVIEST_MM_H, title="Intensity", description="R of this drive.", extra={"unit": "mm/h"})
    ] = 8.5
    seed: Annotated[
        int, Meta(ge=0, le=2**31 - 1, title="Seed", description="Same seed: same drops and the same drive.")
    ] = 0

    def rains(self, present: RainSettings) -> tuple[RainSettings, ...]:
        """Return the rain of each drive; `present` is the scene's."""
        if self.rain == "as the scene":
            return (present,)
        chosen = _PAPER_MM_H if self.rain == "paper's four" else (self.intensity_mm_h,)
        return tuple(msgspec.structs.replace(present, intensity_mm_h=each) for each in chosen)


def simulation_job(
    scene: Scene, scenario: Scenario, settings: DriveSettings, rains: Sequence[RainSettings], known: FileCache
) -> Job[list[LoadedRollout]]:
    """Create a job of one drive, or one in each of several rains; `known` are the scene's files."""

    def inputs(folder: Path) -> tuple[object, ...]:
        return write_copy(scene, folder, known), scenario, settings, rains

    def read(folder: Path) -> list[LoadedRollout]:
        return [load_rollout(path, is_own=False) for path in _rollout_files(folder, len(rains))]

    title = f"Drive {scenario.name} with {settings.agent}"
    return Job("drive", title, drive_in_worker, read, inputs)


# Worker: one roll-out per rain

_PREVIEW_PX = 320
_OPENED = 0.1  # progress at which the scene is read and all actors are placed


def _rollout_files(folder: Path, count: int) -> list[Path]:
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
    options = AgentOptions(detector=settings.detector, description=settings.description, url=settings.url)
    agent = open_agent(settings.agent, options)
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
                    speed = f"{observation.state.speed_m_s:.1f} m/s"
                    message = f"{rain.intensity_mm_h:g} mm/h, {observation.time_s:.2f} s: {speed}"
                    yield Progress(_share(number, done, len(rains)), message, front.picture(observation))
                path = _rollout_files(scene_folder.parent, len(rains))[number]
                rollout = simulation.rollout(agent.name)
                write_rollout(path, rollout)
                metrics = msgspec.json.encode(measure_drive(rollout, simulation.occupied))
                path.with_suffix(_METRICS_SUFFIX).write_bytes(metrics)
    finally:
        agent.close()
    yield Progress(1.0, "Driven")


class _FrontCamera:
    """Image of the front camera; rendered only if the agent does not request it."""

    def __init__(self, simulation: Simulation, renderer: Renderer) -> None:
        self._simulation, cameras = simulation, simulation.rig.cameras
        front = needed_cameras(cameras, SensorRequirements(cameras=("front",))) if cameras else ()
        self._cameras = tuple(camera_of_width(each, _PREVIEW_PX) for each in front)
        rain, needs = simulation.scenario.rain, SensorRequirements()
        self._pictures = RigRenderer(renderer, rain, self._cameras, needs, lod_cut(simulation.scene, None))

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


# Roll-out videos


def rollout_video_job(scene: Scene, rollout: Rollout, video: Path, fps: float, known: FileCache) -> Job[Path]:
    """Create a job that records a video, as `gsrain drive` does; `known` are the scene's files."""

    def inputs(folder: Path) -> tuple[object, ...]:
        file = folder / "rollout.jsonl"
        write_rollout(file, rollout)
        return write_copy(scene, folder, known), file, video, fps

    return Job("drive video", f"Film {video.name}", render_video_in_worker, lambda _: video, inputs, output=video)


def render_video_in_worker(scene_folder: Path, rollout: Path, film: Path, fps: float) -> Iterator[Progress]:
    """Worker: render a video; on SIGTERM, closes the file first.

    Raises ValueError if the scene has no rig, or not the actors of the roll-out.
    """
    # Matplotlib loads slowly: not before the first video.
    from ...simulation.video import RolloutVideo, render_rollout_video

    install_sigterm_handler()
    yield Progress(0.0, "Reading the scene")
    played = RolloutPlayback(read_rollout(rollout), load_sorted_scene(str(scene_folder)))
    with open_renderer() as renderer:
        yield from render_rollout_video(film, RolloutVideo(played, renderer), fps)
