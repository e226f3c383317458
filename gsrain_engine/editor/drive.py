"""Driving in the editor: setup of the next drive, open roll-outs, and playback."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from ..rain.simulation import RainSimulation
from ..scene.scene import Scene
from ..simulation.agents.registry import agent_names
from ..simulation.rollout import RolloutStep
from ..simulation.rollout_io import write_rollout
from ..simulation.scenario import Scenario, ScenarioUser
from ..simulation.scenario_io import load_scenario, save_scenario, scenario_names
from .autosave import saved_scene
from .drive_playback import RolloutInScene
from .files import SceneFiles
from .jobs.drive import DriveSettings, LoadedRollout, Reading, RolloutVideoJob, SimulationJob, load_rollout
from .notifications import describe_error
from .overlays_drive import CameraMosaic
from .services import EditorServices
from .viewport.camera_follow import ChaseCamera, ChaseMode

logger = logging.getLogger("gsrain")
_VIDEO_FPS = (1.0, 60.0)
_MAX_ROLLOUTS = 12  # maximum number of open roll-outs; the oldest is closed first


class RolloutPlayer:
    """The drives of one session: start, read, write and play roll-outs. Main thread only; call `poll` once a frame."""

    def __init__(self, scene_files: SceneFiles, chase: ChaseCamera, files: ThreadPoolExecutor) -> None:
        """Use `files` as the thread for reading and writing; `chase` is the camera that may follow the vehicle."""
        self._scene_files, self._files = scene_files, files
        self.settings = DriveSetup()
        self.opened: list[LoadedRollout] = []
        self.playing: LoadedRollout | None = None
        """Roll-out that the viewport shows."""
        self.trouble: str | None = None
        """Reason why the viewport can't show it."""
        self.chase, self.mosaic = chase, CameraMosaic()
        self.show_ego_car, self.show_boxes, self.show_plan = True, True, True
        self.rain_as_driven = True
        """True for the rain of the drive in the viewport, False for that of the scene."""
        self._shown: RolloutInScene | None = None
        self._rainfall: RainSimulation | None = None
        self._kept_span: tuple[float, float] | None = None
        self._reading: list[tuple[str, Reading]] = []
        self._writing: list[tuple[LoadedRollout, Path, Future[None]]] = []
        self._placing: tuple[LoadedRollout, Future[RolloutInScene]] | None = None
        """Roll-out that plays as soon as all actors are placed."""

    # Driving

    def newest_job(self, session: EditorServices) -> tuple[int, SimulationJob] | None:
        """Job of the last drive that was started, with its index among the jobs."""
        jobs = [(number, job) for number, job in enumerate(session.jobs) if isinstance(job, SimulationJob)]
        return jobs[-1] if jobs else None

    def why_not(self, session: EditorServices) -> str | None:
        """Reason why no drive can start now, or None."""
        if any(isinstance(job, SimulationJob) for job in session.running_jobs):
            return "A drive goes on."
        if session.scene.ego is None:
            return (
                "This scene has no recorded drive, and so no route to take: let the ego drive along a camera path "
                "(Drive menu), or open one that has, such as the street."
            )
        return self.settings.why_not

    def start(self, session: EditorServices) -> None:
        why_not = self.why_not(session)
        if why_not is not None:
            session.problem = why_not
            return
        wanted = self.settings
        rains = wanted.settings.rains(session.rain_now)
        job = SimulationJob(
            saved_scene(session), wanted.scenario, wanted.settings, rains, self._files, self._scene_files.known,
            lambda reading: self._reading.append((wanted.scenario.name, reading)),
        )  # fmt: skip
        session.start(job)

    # Files

    def open(self, path: Path) -> None:
        """Read a roll-out in the background and play it."""
        self._reading.append((path.name, self._files.submit(lambda: [load_rollout(path)])))

    def save_as(self, session: EditorServices, path: Path) -> None:
        """Write the playing roll-out in the background; replacing an existing file needs confirmation."""
        if self.playing is None:
            return
        path, playing = path if path.suffix else path.with_suffix(".jsonl"), self.playing

        def write() -> None:
            self._writing.append((playing, path, self._files.submit(write_rollout, path, playing.rollout)))

        session.questions.before_replacing([path], write)

    def why_no_video(self, session: EditorServices) -> str | None:
        """Reason why no video of the playing roll-out can be made now, or None."""
        if self.playing is None or self._placed_in(session.scene) is None:
            return "No roll-out plays: drive, or open one, in the Drive panel."
        if not session.scene.rigs:
            return "This scene has no rig whose front camera could record the drive."
        if any(isinstance(job, RolloutVideoJob) for job in session.running_jobs):
            return "A video is being rendered."
        return None

    def video_to(self, session: EditorServices, path: Path) -> None:
        """Record a video of the playing roll-out in the background; replacing an existing file needs confirmation."""
        if self.playing is None:
            return
        path, rollout = path if path.suffix else path.with_suffix(".mp4"), self.playing.rollout

        def begin() -> None:
            fps = min(max(session.timeline.fps, _VIDEO_FPS[0]), _VIDEO_FPS[1])
            scene, known = saved_scene(session), self._scene_files.known
            session.start(RolloutVideoJob(scene, rollout, path, fps, self._files, known))

        session.questions.before_replacing([path], begin)

    @property
    def is_working(self) -> bool:
        """True while a roll-out is being read, written or placed."""
        return bool(self._reading or self._writing or self._placing)

    @property
    def pending(self) -> list[Future[Any]]:
        """Reads and writes in progress, to wait for where there are no frames."""
        placing = [] if self._placing is None else [self._placing[1]]
        return [*[each[1] for each in self._reading], *[each[2] for each in self._writing], *placing]

    def poll(self, session: EditorServices) -> None:
        """Process finished reads and writes, and move the chase camera; never blocks."""
        for name, reading in [each for each in self._reading if each[1].done()]:
            self._reading.remove((name, reading))
            self._take(session, name, reading)
        for opened, path, writing in [each for each in self._writing if each[2].done()]:
            self._writing.remove((opened, path, writing))
            self._written(session, opened, path, writing)
        if self._placing is not None and self._placing[1].done():
            (opened, placing), self._placing = self._placing, None
            self._begin(session, opened, placing)
        shown = self._placed_in(session.scene)
        if shown is not None:
            self.chase.ride(shown.vehicle(session.clock.time_s), session.navigation)

    # Playback

    def play(self, session: EditorServices, opened: LoadedRollout) -> None:
        """Play a roll-out from its beginning in place of the scene's own traffic; the document stays unchanged.

        It appears in a later frame, because finding the ground of a scene takes a moment.
        """
        self._placing = opened, self._files.submit(RolloutInScene, opened.rollout, session.scene)

    def follow(self, session: EditorServices, mode: ChaseMode) -> None:
        """Let the camera follow the vehicle in a chase mode."""
        session.view.follow_path = False
        session.following.follow("")
        self.chase.begin(mode)

    def seek(self, session: EditorServices, time_s: float) -> None:
        """Seek to a time of the playing roll-out, in seconds since its scenario began."""
        shown = self._placed_in(session.scene)
        session.clock.seek(time_s + (shown.start_s if shown is not None else 0.0))

    def jump(self, session: EditorServices, time_s: float) -> None:
        """Pause at a time of the playing roll-out."""
        session.clock.playing = False
        self.seek(session, time_s)

    def close(self, session: EditorServices, opened: LoadedRollout) -> None:
        """Close a roll-out; the scene returns after the last playing one."""
        self.opened = [each for each in self.opened if each is not opened]
        if opened is self.playing:
            self._stop(session)
            if self.opened:
                self.play(session, self.opened[-1])

    def close_all(self, session: EditorServices) -> None:
        self.opened, self._placing = [], None
        if self.playing is not None:
            self._stop(session)

    # Viewport

    def placed_in(self, session: EditorServices) -> RolloutInScene | None:
        """The playing roll-out in the present scene; None if none plays or it does not belong to the scene."""
        return self._placed_in(session.scene)

    def scene_in_place_of(self, scene: Scene) -> Scene:
        """The scene with the road users of the playing roll-out; unchanged if none plays."""
        shown = self._placed_in(scene)
        if shown is None:
            return scene
        return shown.scene(scene, with_ego=self.show_ego_car and self.chase.mode != "front camera")

    def rig_scene(self, session: EditorServices) -> Scene:
        """Scene for the rig's cameras: without the body of the ego vehicle."""
        shown = self._placed_in(session.scene)
        return session.scene if shown is None else shown.scene(session.scene, with_ego=False)

    def rainfall(self, *, roofs: bool) -> RainSimulation | None:
        """Rain of the playing roll-out, under roofs if they are known; None to use the document's rain."""
        if self._shown is None or not self.rain_as_driven:
            return None
        rain = self._shown.scenario.rain
        if not roofs and rain.roofs:
            rain = msgspec.structs.replace(rain, roofs=False)
        if self._rainfall is None or self._rainfall.rain != rain:
            self._rainfall = RainSimulation.start(rain)
        return self._rainfall

    def span_s(self) -> tuple[float, float] | None:
        """Start and end of the playing roll-out, in the scene's time."""
        return None if self._shown is None else self._shown.span_s

    def step_now(self, session: EditorServices) -> RolloutStep | None:
        """Step of the playing roll-out at the present time."""
        shown = self._placed_in(session.scene)
        return None if shown is None else shown.played.step(shown.own_time_s(session.clock.time_s))

    def _placed_in(self, scene: Scene) -> RolloutInScene | None:
        """The playing roll-out; placed again after the user changed the scene's actors or units."""
        if self.playing is not None and self._shown is not None and not self._shown.fits(scene):
            try:
                self._shown = self._shown.placed_in(scene)
            except ValueError as error:
                self._shown, self.trouble = None, _not_here(error)
        return self._shown

    def _begin(self, session: EditorServices, opened: LoadedRollout, placing: "Future[RolloutInScene]") -> None:
        if not any(each is opened for each in self.opened):
            return  # closed meanwhile
        was_playing = self.playing is not None
        self.playing, self.trouble, self._shown, self._rainfall = opened, None, None, None
        if not was_playing:
            self._kept_span = session.clock.span_s
        session.clock.span_s = None
        session.timeline.is_fitted = False
        try:
            self._shown = placing.result()
        except ValueError as error:
            session.problem = self.trouble = _not_here(error)
            return
        session.view.follow_path = False
        self.mosaic.rig = self._shown.scenario.rig or self.mosaic.rig
        session.clock.seek(self._shown.start_s)
        if not was_playing:
            self.chase.begin("behind")

    def _stop(self, session: EditorServices) -> None:
        self.playing = self.trouble = self._shown = self._rainfall = self._placing = None
        self.chase.begin("free")
        session.clock.span_s, self._kept_span = self._kept_span, None
        session.timeline.is_fitted = False

    def _take(self, session: EditorServices, name: str, reading: Reading) -> None:
        try:
            found = reading.result()
        except Exception as error:  # any disk or file error
            session.problem = describe_error(f"{name} can't be opened", error)
            return
        self.opened = [*self.opened, *found][-_MAX_ROLLOUTS:]
        self.play(session, found[-1])
        for each in found:
            logger.info("Opened a roll-out: %s: %s after %.2f s", each.title, each.rollout.end, each.duration_s)

    def _written(self, session: EditorServices, opened: LoadedRollout, path: Path, writing: "Future[None]") -> None:
        try:
            writing.result()
        except Exception as error:  # any disk error
            session.problem = describe_error(f"{path} can't be written", error)
            return
        logger.info("Saved the roll-out %s", path)
        saved = opened.saved_at(path)
        self.opened = [saved if each is opened else each for each in self.opened]
        if self.playing is opened:
            self.playing = saved


def _not_here(error: ValueError) -> str:
    return f"The view can't show the roll-out: {error}"


# Drive setup

_FIRST = "stationary-lead"
_DRIVERS = ("oracle-idm", "constant-velocity")  # default drivers by preference


class DriveSetup:
    """Setup of the next drive: an editable scenario, its driver, and its rain."""

    def __init__(self) -> None:
        self.problem: str | None = None
        """Last error of a scenario file."""
        self.source = _FIRST
        """Name of the shipped scenario, or path of the file, that it was read from."""
        self.is_changed = False
        """True if the scenario differs from its source."""

    @cached_property
    def scenario_names(self) -> list[str]:
        return scenario_names()

    @cached_property
    def agent_names(self) -> list[str]:
        """All available agents; cached, because looking for installed ones is too slow for each frame."""
        return agent_names()

    @property
    def scenario(self) -> Scenario:
        return self._scenario

    @cached_property
    def _scenario(self) -> Scenario:
        return load_scenario(_FIRST)

    @cached_property
    def settings(self) -> DriveSettings:
        """Settings of the next drive; may be assigned."""
        there = self.agent_names
        return DriveSettings(agent=next((name for name in _DRIVERS if name in there), there[0]))

    @property
    def why_not(self) -> str | None:
        """Reason why the setup can't be driven, or None."""
        if self.settings.agent not in self.agent_names:
            return f"There is no agent {self.settings.agent}."
        if self.settings.detector is not None and not self.settings.detector.is_file():
            return f"{self.settings.detector}: there is no such detector."
        return None

    def load(self, source: str | Path) -> None:
        """Load a shipped scenario by name, or one from a file; an error is set as `problem`."""
        try:
            scenario = load_scenario(source)
        except (ValueError, OSError) as error:
            self.problem = describe_error(f"{source} can't be opened", error)
            return
        self._scenario, self.source, self.is_changed, self.problem = scenario, str(source), False, None

    def save(self, path: Path) -> None:
        """Write the scenario; the file becomes its source."""
        path = path if path.suffix else path.with_suffix(".yaml")
        try:
            save_scenario(self.scenario, path)
        except OSError as error:
            self.problem = describe_error(f"{path} can't be written", error)
            return
        self.source, self.is_changed, self.problem = str(path), False, None

    def change(self, scenario: Scenario) -> None:
        """Set a changed scenario; an inconsistent one is rejected and the error set as `problem`."""
        if scenario == self.scenario:
            return
        try:
            self._scenario = msgspec.convert(msgspec.to_builtins(scenario), Scenario)
        except ValueError as error:
            self.problem = str(error)
            return
        self.is_changed, self.problem = True, None

    def change_user(self, number: int, user: ScenarioUser) -> None:
        users = (*self.scenario.road_users[:number], user, *self.scenario.road_users[number + 1 :])
        self.change(msgspec.structs.replace(self.scenario, road_users=users))
