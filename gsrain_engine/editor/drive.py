"""Driving in the editor: setup of the next drive, open roll-outs, their playback, and the camera mosaic."""

import logging
import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float64

from ..rain.simulation import RainSimulation
from ..scene.gaussians import Gaussians
from ..scene.geometry import quaternions_from_matrices
from ..scene.lod_order import lod_order
from ..scene.scene import Actor, PoseTrack, RigCamera, Scene, take_gaussians
from ..simulation.agents.base import SensorRequirements
from ..simulation.agents.registry import agent_names
from ..simulation.playback import RolloutPlayback
from ..simulation.rollout import Rollout, RolloutStep
from ..simulation.rollout_io import write_rollout
from ..simulation.scenario import Scenario, ScenarioUser
from ..simulation.scenario_io import load_scenario, save_scenario, scenario_names
from ..simulation.sensors import needed_cameras
from ..simulation.traffic.appearance import scale_gaussians, vehicle_model
from .autosave import saved_scene
from .background import Background, Task
from .files import Files
from .jobs.drive import DriveSettings, LoadedRollout, load_rollout, rollout_video_job, simulation_job
from .jobs.job import JobRunner
from .status import StatusBus, describe_error
from .viewport.camera_follow import ChaseMode, VehicleMoment
from .viewport.options import Texture
from .viewport_state import ViewportState

logger = logging.getLogger("gsrain")
_VIDEO_FPS = (1.0, 60.0)
_MAX_ROLLOUTS = 12  # number of open roll-outs from which on older ones are closed, unless they were not saved


class RolloutPlayer:
    """The drives of one window: start, read, write and play roll-outs. Main thread only; call `poll` once a frame."""

    def __init__(
        self, viewport: ViewportState, jobs: JobRunner, files: Files, status: StatusBus, background: Background
    ) -> None:
        self._viewport, self._document, self._playback = viewport, viewport.document, viewport.playback
        self._jobs, self._files, self._status = jobs, files, status
        self.setup = DriveSetup()
        self.opened: list[LoadedRollout] = []
        self.playing: LoadedRollout | None = None
        """Roll-out that the viewport displays."""
        self.why_hidden: str | None = None
        """Reason why the viewport can't display it."""
        self.mosaic = CameraMosaic()
        self.show_ego_car, self.show_boxes, self.show_plan = True, True, True
        self.rain_as_driven = True
        """True for the rain of the drive in the viewport, False for that of the scene."""
        self._placed: RolloutInScene | None = None
        self._rainfall: RainSimulation | None = None
        self._scene_span: tuple[float, float] | None = None
        """The user's start and end of playback, while a roll-out plays."""
        self._background = background
        self._placing: Task[RolloutInScene] | None = None

    # Driving

    @property
    def why_not(self) -> str | None:
        """Reason why no drive can start now, or None."""
        if not self._document.scene.members:
            return "No scene is open."
        if self._document.scene.ego is None:
            return (
                "This scene has no recorded drive, and so no route to take: let the ego drive along a camera path "
                "(Drive menu), or open one that has, such as the street."
            )
        return self.setup.why_not

    def start(self) -> None:
        why_not = self.why_not
        if why_not is not None:
            self._status.report(why_not)
            return
        scenario, settings = self.setup.scenario, self.setup.settings
        rains = settings.rains(self._document.rain_now)
        job = simulation_job(saved_scene(self._viewport), scenario, settings, rains, self._files.known)
        origin = self._document.state.origin

        def take(found: list[LoadedRollout], _: bool) -> str | None:
            is_same = self._document.state.origin == origin
            self._open(found, plays=is_same)
            if not is_same:
                return "Driven in the scene of before, which is not open any more"
            one, *more = (each.outcome for each in found)
            return one if not more else "; ".join(f"{each.intensity_mm_h:g} mm/h: {each.outcome}" for each in found)

        self._jobs.start(job, take)

    # Files

    def open(self, path: Path) -> None:
        """Read a roll-out in the background and play it."""
        fail = partial(self._status.report, what=f"{path.name} can't be opened")
        self._background.start(lambda: [load_rollout(path)], self._open, fail, lane="drives")

    def _open(self, found: list[LoadedRollout], *, plays: bool = True) -> None:
        opened = [*self.opened, *found]
        too_old = [each for each in opened[:-_MAX_ROLLOUTS] if each.path is not None]
        self.opened = [each for each in opened if each not in too_old]
        if plays:
            self.play(found[-1])
        for each in found:
            logger.info("Opened a roll-out: %s: %s", each.title, each.outcome)

    def save_as(self, path: Path) -> None:
        """Write the playing roll-out in the background; replacing an existing file needs confirmation."""
        if self.playing is None:
            return
        path, playing = path if path.suffix else path.with_suffix(".jsonl"), self.playing

        def take(_: None) -> None:
            logger.info("Saved the roll-out %s", path)
            saved = replace(playing, path=path)
            self.opened = [saved if each is playing else each for each in self.opened]
            if self.playing is playing:
                self.playing = saved

        def write() -> None:
            fail = partial(self._status.report, what=f"{path} can't be written")
            self._background.start(lambda: write_rollout(path, playing.rollout), take, fail, lane="drives")

        self._status.ask_before_replacing([path], write)

    @property
    def why_no_video(self) -> str | None:
        """Reason why no video of the playing roll-out can be made now, or None."""
        if self.playing is None or self.placed_in(self._document.scene) is None:
            return "No roll-out plays: drive, or open one, in the Drive panel."
        if not self._document.scene.rigs:
            return "This scene has no rig whose front camera could record the drive."
        return None

    def video_to(self, path: Path) -> None:
        """Record a video of the playing roll-out in the background; replacing an existing file needs confirmation."""
        if self.playing is None:
            return
        path, rollout = path if path.suffix else path.with_suffix(".mp4"), self.playing.rollout
        if self._jobs.writes(path) is not None:
            self._status.report(f"{path} is being recorded already: choose another name")
            return

        def begin() -> None:
            fps = min(max(self._playback.timeline.fps, _VIDEO_FPS[0]), _VIDEO_FPS[1])
            job = rollout_video_job(saved_scene(self._viewport), rollout, path, fps, self._files.known)
            self._jobs.start(job, lambda video, _: logger.info("Filmed the drive %s", video))

        self._status.ask_before_replacing([path], begin)

    @property
    def unsaved_titles(self) -> list[str]:
        """Titles of the roll-outs that are lost with this document."""
        return [each.title for each in self.opened if each.path is None]

    @property
    def is_working(self) -> bool:
        """True while a roll-out is being read, written or placed."""
        return self._background.is_working("drives")

    def poll(self) -> None:
        """Move the chase camera."""
        shown = self.placed_in(self._document.scene)
        if shown is not None:
            self._viewport.chase.ride(shown.vehicle(self._playback.clock.time_s), self._viewport.navigation)

    # Playback

    @property
    def is_placing(self) -> bool:
        """True while the road of a roll-out that is to play is found in the scene."""
        return self._placing is not None

    def play(self, opened: LoadedRollout) -> None:
        """Play a roll-out from its start in place of the scene's own traffic; the document stays unchanged.

        It appears in a later frame, because finding the ground of a scene takes a moment.
        """
        if self._placing is not None:
            self._placing.cancel()
        scene = self._document.scene
        self._placing = self._background.start(
            lambda: RolloutInScene(opened.rollout, scene),
            lambda shown: self._begin(opened, shown),
            lambda error: self._begin(opened, error),
            lane="drives",
        )

    def _begin(self, opened: LoadedRollout, shown: "RolloutInScene | Exception") -> None:
        """Play a roll-out that was placed in the scene, or report why that is impossible."""
        self._placing = None
        if not any(each is opened for each in self.opened):
            return  # closed meanwhile
        was_playing = self.playing is not None
        self.playing, self.why_hidden, self._rainfall = opened, None, None
        self._set_placed(None)
        if not was_playing:
            self._scene_span = self._playback.clock.span_s
        self._playback.clock.span_s = None
        self._playback.timeline.is_fitted = False
        if isinstance(shown, Exception):
            self.why_hidden = f"The view can't show the roll-out: {shown}"
            self._status.report(self.why_hidden)
            return
        self._set_placed(shown)
        self._viewport.options.follow_path = False
        self.mosaic.rig = shown.scenario.rig or self.mosaic.rig
        self._playback.clock.seek(shown.start_s)
        if not was_playing:
            self._viewport.chase.begin("behind")

    def follow(self, mode: ChaseMode) -> None:
        """Let the camera follow the vehicle in a chase mode."""
        self._viewport.options.follow_path = False
        self._viewport.following.follow("")
        self._viewport.chase.begin(mode)

    def look_from(self, camera: RigCamera) -> None:
        """Look from the present place of a camera of the rig."""
        pose = self.rig_scene(self._document.scene).ego_to_world(self._playback.clock.time_s)
        if pose is not None:
            self._viewport.chase.begin("free")
            self._viewport.look_from(camera.camera(pose).pinhole)

    def seek(self, time_s: float) -> None:
        """Seek to a time of the playing roll-out, in seconds since its scenario began."""
        shown = self.placed_in(self._document.scene)
        self._playback.clock.seek(time_s + (shown.start_s if shown is not None else 0.0))

    def jump(self, time_s: float) -> None:
        """Pause at a time of the playing roll-out."""
        self._playback.clock.playing = False
        self.seek(time_s)

    def close(self, *closed: LoadedRollout) -> None:
        """Close roll-outs, after asking about unsaved ones; another one plays then, or else the scene returns."""

        def act() -> None:
            self.opened = [each for each in self.opened if each not in closed]
            if not self.opened:
                self.drop_all()
            elif self.playing not in self.opened:
                self.play(self.opened[-1])

        unsaved = [each.title for each in closed if each.path is None]
        self._files.confirm_losing(unsaved, "close it" if len(unsaved) == 1 else "close them", act)

    def close_all(self) -> None:
        """Close all roll-outs, after asking about unsaved ones."""
        self.close(*self.opened)

    def drop_all(self) -> None:
        """Close all roll-outs without asking, because their scene goes."""
        self.opened = []
        if self.playing is not None:
            self._stop()

    def _stop(self) -> None:
        if self._placing is not None:
            self._placing.cancel()
        self.playing = self.why_hidden = self._rainfall = self._placing = None
        self._set_placed(None)
        self._viewport.chase.begin("free")
        self._playback.clock.span_s, self._scene_span = self._scene_span, None
        self._playback.timeline.is_fitted = False

    # Viewport

    def placed_in(self, scene: Scene) -> "RolloutInScene | None":
        """The playing roll-out in a scene; None if none plays or it does not belong to the scene.

        It is placed anew after the user changed the scene's actors or units.
        """
        if self.playing is not None and self._placed is not None and not self._placed.fits(scene):
            try:
                self._set_placed(RolloutInScene(self.playing.rollout, scene))
            except ValueError as error:
                self._set_placed(None)
                self.why_hidden = f"The view can't show the roll-out: {error}"
        return self._placed

    def _set_placed(self, placed: "RolloutInScene | None") -> None:
        self._placed, self._playback.rollout_span_s = placed, None if placed is None else placed.span_s

    @property
    def displayed_scene(self) -> Scene:
        """Scene of the viewport: the document's, or a drag preview, with the road users of the playing roll-out."""
        scene = self._viewport.drawn_preview or self._document.scene
        shown = self.placed_in(scene)
        if shown is None:
            return scene
        return shown.scene(scene, with_ego=self.show_ego_car and self._viewport.chase.mode != "front camera")

    def rig_scene(self, scene: Scene) -> Scene:
        """Scene for the rig's cameras: without the body of the ego vehicle."""
        shown = self.placed_in(scene)
        return scene if shown is None else shown.scene(scene, with_ego=False)

    @property
    def shows_rain(self) -> bool:
        """True while the viewport has the rain of the playing roll-out instead of the document's."""
        return self._placed is not None and self.rain_as_driven

    def rainfall(self, *, roofs: bool) -> RainSimulation | None:
        """Rain of the playing roll-out, under roofs if they are known; None to use the document's rain."""
        if self._placed is None or not self.rain_as_driven:
            return None
        rain = self._placed.scenario.rain
        if not roofs and rain.roofs:
            rain = msgspec.structs.replace(rain, roofs=False)
        if self._rainfall is None or self._rainfall.rain != rain:
            self._rainfall = RainSimulation.start(rain)
        return self._rainfall

    @property
    def step_now(self) -> RolloutStep | None:
        """Step of the playing roll-out at the present time."""
        shown = self.placed_in(self._document.scene)
        return None if shown is None else shown.played.step(shown.own_time_s(self._playback.clock.time_s))


# Playback: each road user gets a track, so that no copies are needed

EGO_CAR = "ego car"
"""Id of the actor that is the ego vehicle's body; no road user has this id."""


class RolloutInScene:
    """One roll-out in one scene; scenes that differ only away from the roll-out's actors share it."""

    def __init__(self, rollout: Rollout, scene: Scene) -> None:
        """Give each road user its track.

        Raises ValueError if the scene lacks an actor of the roll-out, because it was driven in another scene.
        """
        try:
            self.played = RolloutPlayback(rollout, scene)
            self._times = np.array([each.time_s for each in rollout.steps])
            self._to_scene = np.linalg.inv(scene.scene_to_world)
            self._scale = 1 / scene.metres_per_unit
            self._users = tuple(self._user(id, scene) for id in rollout.users)
        except KeyError as missing:
            raise ValueError(f"this scene has no actor {missing}: the roll-out is of {rollout.scene!r}") from None
        rig = np.array([self.played.rig_to_world(t) for t in self._times])
        self._rig = self._track(rig, np.ones(len(rig), bool))
        self._body = self._ego_car(scene)
        self._of = scene
        self._shown: dict[bool, tuple[Scene, Scene]] = {}

    def fits(self, scene: Scene) -> bool:
        """Return whether the roll-out is still valid in a scene: same units, axes, and actors that it uses."""
        are_same = all(map(operator.is_, self._actors_of(self._of), self._actors_of(scene)))
        return are_same and np.array_equal(scene.scene_to_world, self._of.scene_to_world)

    def _actors_of(self, scene: Scene) -> list[Actor | None]:
        """The scene's own actors that the roll-out uses."""
        actors = {each.id: each for each in scene.actors}
        models = {user.model.removeprefix("actor:") for user in self.scenario.road_users}
        return [actors.get(id) for id in sorted({*self.played.rollout.users, *models})]

    @property
    def scenario(self) -> Scenario:
        return self.played.scenario

    @property
    def start_s(self) -> float:
        """Scene time at the start of the scenario."""
        return self.played.scene_time_s(0.0)

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end in the scene's time."""
        return self.start_s, self.played.scene_time_s(self.played.end_s)

    def own_time_s(self, clock_s: float) -> float:
        """Seconds since the scenario began, clipped to the drive."""
        return float(np.clip(clock_s - self.start_s, 0.0, self.played.end_s))

    def scene(self, scene: Scene, *, with_ego: bool) -> Scene:
        """Return a scene with all road users; `with_ego` includes a body for the ego vehicle."""
        if with_ego not in self._shown or self._shown[with_ego][0] is not scene:
            actors = (*self._users, self._body) if with_ego else self._users
            self._shown[with_ego] = scene, replace(scene, actors=actors, ego=self._rig)
        return self._shown[with_ego][1]

    def vehicle(self, clock_s: float) -> VehicleMoment:
        """Ego vehicle at a scene time, for a chase camera."""
        time_s = self.own_time_s(clock_s)
        pose, state = self.played.rig_to_world(time_s), self.played.state(time_s)
        return VehicleMoment(pose, state.speed_m_s, self.played.rig.height_m, self.front_camera)

    @property
    def front_camera(self) -> RigCamera | None:
        """The rig's camera that looks most straight ahead."""
        cameras = self.played.rig.cameras
        return needed_cameras(cameras, SensorRequirements(cameras=("front",)))[0] if cameras else None

    def _user(self, id: str, scene: Scene) -> Actor:
        """A road user with its Gaussians and its track through the whole drive."""
        played, poses, there = self.played, [np.eye(4)] * len(self._times), np.zeros(len(self._times), bool)
        for k, time_s in enumerate(self._times):
            for user in played.users(float(time_s)):
                if user.id == id:
                    poses[k], there[k] = user.pose, True
        first = float(self._times[int(there.argmax())])
        actor = next(each for each in played.scene(first).actors if each.id == id)
        if not any(actor.gaussians is each.gaussians for each in scene.actors):
            actor = _in_lod_order(actor)
        return replace(actor, track=self._track(np.array(poses), there))

    def _ego_car(self, scene: Scene) -> Actor:
        vehicle = self.scenario.vehicle
        look = vehicle_model("saloon", scene)
        gaussians: Gaussians = scale_gaussians(look.gaussians, self._scale * vehicle.length_m / look.size_lwh_m[0])
        middle = np.eye(4)
        middle[:3, 3] = vehicle.middle_m, 0.0, -self.played.rig.height_m
        poses = np.array([self.played.rig_to_world(t) @ middle for t in self._times])
        length, width, height = (self._scale * each for each in (vehicle.length_m, vehicle.width_m, vehicle.height_m))
        track = self._track(poses, np.ones(len(poses), bool))
        return _in_lod_order(Actor(EGO_CAR, "car", (length, width, height), gaussians, track, wet_sh=look.wet_sh))

    def _track(self, poses: Float64[np.ndarray, "t 4 4"], there: np.ndarray) -> PoseTrack:
        """Scene track from poses in the world (meters) at the roll-out's times."""
        own = self._to_scene @ poses
        turns = own[:, :3, :3] / np.cbrt(np.linalg.det(own[:, :3, :3]))[:, None, None]
        quaternions = np.asarray(quaternions_from_matrices(turns), np.float64)
        return PoseTrack(self._times + self.start_s, own[:, :3, 3].copy(), quaternions, there)


# Camera mosaic


@dataclass(slots=True)
class CameraMosaic:
    """Requests of the mosaic panel, and its images."""

    rig: str = ""
    """Name of the rig; an unknown name selects the first."""
    width_px: int = 240
    """Width of each image."""
    is_requested: bool = False
    """True if the panel is visible; set again in each frame."""
    is_behind: bool = False
    """True if images are outdated."""
    pictures: dict[str, Texture] = field(default_factory=dict[str, Texture])
    """By camera."""

    def want(self, width_px: float) -> None:
        """Request the images at about this width, a multiple of 16 pixels."""
        self.is_requested = True
        self.width_px = max(64, 16 * round(width_px / 16))

    def cameras(self, scene: Scene) -> tuple[RigCamera, ...]:
        if not scene.rigs:
            return ()
        return scene.rigs.get(self.rig) or next(iter(scene.rigs.values()))


def mosaic_rows(cameras: Sequence[RigCamera]) -> list[list[RigCamera]]:
    """Arrange cameras: those that look ahead in the upper row, the others below, each from left to right."""
    from_left = sorted(cameras, key=lambda each: float(np.round(each.camera_to_ego[1, 2], 6)), reverse=True)
    ahead = [each for each in from_left if each.camera_to_ego[0, 2] > 0]
    behind = [each for each in from_left if each.camera_to_ego[0, 2] <= 0]
    return [row for row in (ahead, behind) if row]


# Drive setup

_FIRST = "stationary-lead"
_DRIVERS = ("oracle-idm", "constant-velocity")  # default drivers by preference


class DriveSetup:
    """Setup of the next drive: an editable scenario, its driver, and its rain."""

    def __init__(self) -> None:
        self.error: str | None = None
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

    @cached_property
    def scenario(self) -> Scenario:
        """Scenario of the next drive; use `change` to set it."""
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
        """Load a shipped scenario by name, or one from a file; an error is reported in the panel."""
        try:
            scenario = load_scenario(source)
        except (ValueError, OSError) as error:
            self.error = describe_error(f"{source} can't be opened", error)
            return
        self.scenario, self.source, self.is_changed, self.error = scenario, str(source), False, None

    def save(self, path: Path) -> None:
        """Write the scenario; the file becomes its source."""
        path = path if path.suffix else path.with_suffix(".yaml")
        try:
            save_scenario(self.scenario, path)
        except OSError as error:
            self.error = describe_error(f"{path} can't be written", error)
            return
        self.source, self.is_changed, self.error = str(path), False, None

    def change(self, scenario: Scenario) -> None:
        """Set a changed scenario; an inconsistent one is rejected with an error."""
        if scenario == self.scenario:
            return
        try:
            self.scenario = msgspec.convert(msgspec.to_builtins(scenario), Scenario)
        except ValueError as error:
            self.error = str(error)
            return
        self.is_changed, self.error = True, None

    def change_user(self, number: int, user: ScenarioUser) -> None:
        users = (*self.scenario.road_users[:number], user, *self.scenario.road_users[number + 1 :])
        self.change(msgspec.structs.replace(self.scenario, road_users=users))


def _in_lod_order(actor: Actor) -> Actor:
    gaussians, wet_sh = take_gaussians(actor, lod_order(actor.gaussians).astype(np.int64))
    return replace(actor, gaussians=gaussians, wet_sh=wet_sh)
