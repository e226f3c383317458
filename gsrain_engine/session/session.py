"""The editor without a window: panels read it and call its methods, the live view draws what it says."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import platformdirs

from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import OVERCAST, Rainfall
from gsrain_engine.rain.saved_rain import rain_of, weather_of
from gsrain_engine.rain.weather import WITHOUT_CHANGE, Weather
from gsrain_engine.render.frame import Color
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.render.sky_color import Sky
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from .capture.capture_view import CaptureView
from .drive.drives import Drives
from .edited_document import EditedDocument
from .files.kept_preferences import KeptPreferences
from .files.kept_view import look_again
from .files.opened import Opened
from .files.preferences import Preferences
from .files.scene_files import SceneFiles
from .history import Document, History
from .jobs.background_job import BackgroundJob, JobPreview
from .jobs.recorder import Recorder
from .jobs.recording_job import RecordingJob
from .jobs.scene_job import SceneJob, SceneTask
from .jobs.transfer_training import TransferTraining
from .log import LogLines, told
from .picture.interaction_budget import EXACT, Detail, InteractionBudget
from .picture.roof_search import RoofSearch
from .picture.screenshot_name import new_screenshot
from .picture.side import Side
from .picture.sky_pick import SkyPick
from .question import Answer, Question, nothing
from .rain_lab import RainLab
from .rainy.rainy_look import RainyLook
from .rainy.transfer_studio import TransferStudio
from .selection.options import SelectionOptions
from .staged_scene import StagedScene
from .timeline.clock import Clock
from .timeline.rows import content_span
from .timeline.shower_view import ShowerView
from .timeline.timeline import Timeline
from .view.following import Following
from .view.home_camera import home_navigation, scene_bounds
from .view.navigation import Navigation
from .view.ride import Ride
from .view.view_options import ViewOptions

logger = logging.getLogger("gsrain")

_VIEW_SIZE = (960, 640)  # shape of the picture that home cameras are chosen for

WindowBackend = Literal["auto", "opengl", "cpu"]


class Session(EditedDocument):
    """One open scene and everything around it. Only the main thread touches it."""

    def __init__(self, scene: Scene | None = None, rain: Rain | None = None) -> None:
        """Begin with a scene, or with an empty one."""
        scene = scene or Scene("no scene")
        super().__init__(Document(scene, rain or load_preset("clear")), Clock())
        self.navigation = Navigation()
        self.view = ViewOptions()
        self.budget = InteractionBudget()
        self.log = LogLines()
        logger.setLevel(logging.INFO)
        logger.addHandler(self.log)
        self.jobs: list[BackgroundJob] = []
        """Those that run and those that have ended, in the order of their start, until a person clears them."""
        self.previews: dict[BackgroundJob, JobPreview] = {}
        """What running jobs show of their work."""
        self.staged: StagedScene | None = None
        self.sky_seen = Sky(OVERCAST, found=False)
        """What the live view saw when it looked at the sky last."""
        self.sky_is_stale = True
        """Whether the live view should look at the sky again: it is another scene's."""
        self.is_compiling = False
        """Whether the viewport can't be drawn before kernels are compiled or loaded."""
        self.backend = ""
        """What draws the viewport."""
        self.statistics: dict[str, float] = {}
        """Figures of the last frame, by name: the Statistics panel shows them in this order."""
        self.detail: Detail = EXACT
        """How much of the exact picture the viewport shows now."""
        self.timeline = Timeline()
        self._ride = Ride()
        self.preview: Scene | None = None
        """What a tool wants drawn in place of the scene while something is dragged; to be said again each frame."""
        self._shown_preview: Scene | None = None
        self.following = Following()
        self.screenshot: Path | None = None
        """Where the live view saves its next picture."""
        self.sky_pick: SkyPick | None = None
        """The part of the next picture whose colour drops are to take."""
        self.shower = ShowerView()
        self.lab = RainLab()
        self.captures = CaptureView()
        self.selecting = SelectionOptions()
        self._files = ThreadPoolExecutor(max_workers=1, thread_name_prefix="files")
        self.drives = Drives(self._files)
        self.rainy, self.studio = RainyLook(self._files), TransferStudio(self._files)
        self.questions: list[Question] = []
        """What a person is asked, one after the other."""
        self._is_closed = False
        self.is_leaving = False
        """Whether the program shall end now: a person wants it, and has said what becomes of unsaved changes."""
        self._roofs = RoofSearch(self._files)
        self.rainfall = Rainfall.start(self.rain)
        self._other_rainfall = self.rainfall
        self._scene_of_sky = scene
        self.files = SceneFiles(self, self._files)
        self.recorder = Recorder(self, self._files)
        self._preferences = KeptPreferences(self._files)
        if self._preferences.trouble is not None:
            self.ask(Question("Preferences", self._preferences.trouble, (Answer("OK", nothing),)))
        self.enter_scene()

    # Files

    def open(self, path: str) -> None:
        """Read a scene in the background and go to it; of several, the one that was asked for last.

        With unsaved changes, a person is asked first. What goes wrong is logged and kept in `problem`, and the present
        scene stays.
        """
        self.files.open(path)

    def save(self, path: Path) -> None:
        """Write the document to a scene folder or a file, in the background."""
        self.files.save_to(path)

    @property
    def has_changes(self) -> bool:
        """Whether there is anything that was not saved."""
        return self.files.has_changes

    def enter(self, opened: Opened) -> None:
        """Go to another document."""
        self._cancel_jobs(of_the_scene=True)
        self.drives.close_all(self)
        scene = opened.scene
        rain, weather = rain_of(scene) or self.rain, weather_of(scene) or WITHOUT_CHANGE
        self.history = History.beginning_with(Document(scene, rain, weather))
        self.files.enter(opened, self.history.present)
        self._follow_document()
        self.enter_scene()
        if scene.view is not None:
            look_again(self, scene.view)

    def leave(self) -> None:
        """End the program; with unsaved changes, a person is asked first."""
        self.files.when_safe("quit", self._leave)

    def _leave(self) -> None:
        self.files.give_up()
        self.is_leaving = True

    @property
    def busy(self) -> str | None:
        """What is being read or written, None when nothing is."""
        if self.files.busy is not None:
            return self.files.busy
        if self.staged is not None and self.staged.is_opened:
            return f"Uploading {self.staged.label}"
        if self.rain.roofs and not self._roofs.knows(self.scene):
            return "Finding roofs"
        return "Preparing the picture; once after an update this takes up to a minute" if self.is_compiling else None

    @property
    def pending_files(self) -> list[Future[Any]]:
        """Reading, writing and finding roofs, to wait for where there are no frames to wait with."""
        return [*self.files.pending, *self._roofs.pending]

    @property
    def is_working(self) -> bool:
        """Whether anything goes on in the background that a frame should look after."""
        return bool(self.running_jobs) or self.is_bringing_in

    @property
    def is_bringing_in(self) -> bool:
        """Whether something is on its way into the picture, which each frame goes on with."""
        waits = self.lab.busy is not None or self.captures.is_working or self.drives.is_working
        return self.busy is not None or self.staged is not None or waits

    # Questions and preferences

    @property
    def question(self) -> Question | None:
        """What a person is asked now."""
        return self.questions[0] if self.questions else None

    def ask(self, question: Question) -> None:
        """Ask a person, after what was asked before; the same is not asked twice at once."""
        if all((each.title, each.text) != (question.title, question.text) for each in self.questions):
            self.questions.append(question)

    def answer(self, answer: Answer) -> None:
        """Act on the answer to the present question."""
        self.questions = self.questions[1:]
        answer.run()

    @property
    def preferences(self) -> Preferences:
        """Settings of the program, whatever the scene."""
        return self._preferences.value

    def prefer(self, **fields: object) -> None:
        """Change preferences and keep them; what is out of bounds is told in `problem`."""
        try:
            self._preferences.change(**fields)
        except msgspec.ValidationError as error:
            self.problem = told("That can't be preferred", error)

    # Jobs

    @property
    def running_jobs(self) -> list[BackgroundJob]:
        """Jobs that have not ended."""
        return [job for job in self.jobs if job.state == "running"]

    def start(self, job: BackgroundJob) -> None:
        """Look after a job from now on."""
        self.jobs.append(job)

    def start_task(self, task: SceneTask) -> None:
        """Start a job whose result is a scene; its files are read and written in the session's thread."""
        self.start(SceneJob(task, self._files))

    def clear_jobs(self) -> None:
        """Forget the jobs that have ended."""
        self.jobs = self.running_jobs

    def stage(self, staged: StagedScene) -> None:
        """Show a scene as soon as its Gaussians are where the next frame needs them."""
        self.staged = staged

    @property
    def is_opening(self) -> bool:
        """Whether another scene is about to take the place of this one."""
        return self.files.is_opening or (self.staged is not None and self.staged.is_opened)

    def swap_in(self) -> None:
        """Show the staged scene: its Gaussians are where the next frame needs them."""
        staged, self.staged = self.staged, None
        if staged is not None:
            staged.arrive(self)

    # Time and view

    def update(self, real_s: float) -> None:
        """Let time go by and take in what background work has finished. Once a frame."""
        self.clock.advance(real_s, self.span_s)
        self._shown_preview, self.preview = self.preview, None
        self.following.ride(self.shown_scene, self.clock.time_s, self.navigation)
        self.files.poll()
        self._preferences.poll()
        if self.rain.roofs:
            self._roofs.look_at(self.scene)
        self.lab.poll()
        self.captures.poll(self)
        self.drives.poll(self)
        for job in self.running_jobs:
            job.poll(self)
            if job.error is not None:
                self.problem = f"{job.title} failed: {job.error}"
                logger.error("%s", self.problem)
        self.rainy.poll(self)

    @property
    def wetness_now(self) -> float:
        """Share of the soaked colours at the present time, 0..1."""
        return self.shown_rainfall.wetness_at(self.clock.time_s)

    @property
    def shown_scene(self) -> Scene:
        """What the viewport shows: what a tool drags, with the road users of a roll-out that plays."""
        return self.drives.scene_in_place_of(self.scene if self._shown_preview is None else self._shown_preview)

    @property
    def shown_rainfall(self) -> Rainfall:
        """The rain that the viewport shows: the document's, or that of a roll-out that plays."""
        return self.drives.rainfall(roofs=self._roofs.knows(self.scene)) or self._drawn_rainfall

    @property
    def sky(self) -> Color:
        """Colour of the scene's sky at the present time, which drops take."""
        return self.sky_seen.at(self.wetness_now)

    @property
    def sides(self) -> list[Side]:
        """What the viewport shows: one side, or two from left to right."""
        shown, rainfall = self.shown_scene, self.shown_rainfall
        here = Side("", shown, rainfall)
        if self.view.split == "clear | rainy":
            clear = rainfall.rain.without_rain
            return [Side("clear", shown, self._rainfall_of(clear, WITHOUT_CHANGE)), here._replace(label="rainy")]
        if self.view.split == "before | after":
            before = self.history.previous
            rainfall = self._rainfall_of(before.rain, before.weather)
            left = Side(f"before: {self.history.undo_label or 'nothing'}", before.scene, rainfall)
            return [left, here._replace(label="after")]
        return [here]

    @property
    def path(self) -> CameraPath:
        """The way that riding along and recording take, in the world: the person's own, else a default one."""
        return self._ride.path(self.scene)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last moment that play: as a person has set them, else those of the flight or the traffic."""
        return self.clock.span_s or self.drives.span_s() or content_span(self.scene, self.weather)

    def ride(self, on: bool) -> None:
        """Ride along the camera path, or leave it at the place where the camera is now."""
        if on:
            self.view.follow_path = True
        else:
            self.stop_riding()

    def stop_riding(self) -> None:
        """Leave the camera path, at the place where the camera is now."""
        self.drives.chase.let_go()
        if self.view.follow_path:
            self.navigation.look_like(self.shot(*_VIEW_SIZE).camera)
            self.view.follow_path = False

    def shot(self, width: int, height: int, focal_scale: float = 1.0) -> Shot:
        """What the viewport shows now; `focal_scale` is output size over drawn size."""
        t = self.clock.time_s
        if self.view.follow_path:
            camera = self.path.camera(t, width, height)
            return Shot(camera, t, self.path.velocity(t), camera.fx * focal_scale)
        camera = self.navigation.camera(width, height)
        ride = self.following.velocity_m_s if self.drives.chase.velocity_m_s is None else self.drives.chase.velocity_m_s
        velocity = self.navigation.velocity_m_s if ride is None else self.navigation.velocity_m_s + ride
        return Shot(camera, t, velocity, camera.fx * focal_scale)

    def take_screenshot(self, folder: Path | None = None) -> None:
        """Save the next picture under the present date and time, by default in the person's pictures folder."""
        self.screenshot = new_screenshot(folder or Path(platformdirs.user_pictures_dir()))

    def frame_scene(self) -> None:
        """Back off until the whole scene can be seen."""
        self.navigation.frame(*scene_bounds(self.scene))

    def go_home(self) -> None:
        """Go to where the scene is first looked at from."""
        self.navigation = home_navigation(self.scene, *_VIEW_SIZE, self.navigation.speed_m_s)

    def close(self) -> None:
        """Stop everything that runs. To be called once more does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        self._cancel_jobs()
        self.files.close()
        self._preferences.close()
        self._files.shutdown()
        self.lab.close()
        self.captures.close()
        logger.removeHandler(self.log)

    @property
    def _drawn_rainfall(self) -> Rainfall:
        """The rain without roofs until they are found: a frame that looked for them would take seconds."""
        if not self.rain.roofs or (self._roofs.knows(self.scene) and self._shown_preview is None):
            return self.rainfall
        return replace(self.rainfall, rain=msgspec.structs.replace(self.rain, roofs=False))

    def _rainfall_of(self, rain: Rain, weather: Weather) -> Rainfall:
        if rain == self.rain and weather is self.weather:
            return self.rainfall
        if rain != self._other_rainfall.rain or weather is not self._other_rainfall.weather:
            self._other_rainfall = Rainfall.start(rain, weather=weather)
        return self._other_rainfall

    def _follow_document(self) -> None:
        self.preview = self._shown_preview = None
        if self.scene is not self._scene_of_sky:
            before, self._scene_of_sky = self._scene_of_sky, self.scene
            self._stay_in_place(before)
            self.sky_is_stale = self.sky_is_stale or before.matter != self.scene.matter
        if self.rainfall.rain != self.rain or self.rainfall.weather is not self.weather:
            self.rainfall = self.rainfall.changed(self.rain, self.clock.time_s, self.weather)

    def _stay_in_place(self, before: Scene) -> None:
        """Let the camera see the same where the scene has got other metres or another up."""
        old, new = before.scene_to_world, self.scene.scene_to_world
        if not np.array_equal(old, new):
            step = new @ np.linalg.inv(old)
            self.navigation.carry(step)

    def enter_scene(self) -> None:
        """Begin anew with the view and the timeline: this is another place."""
        self._ride, self.timeline, self.clock.span_s = Ride(), Timeline(), None
        self.rainy.previewed = None
        self.go_home()
        self.sky_is_stale = True

    def _cancel_jobs(self, *, of_the_scene: bool = False) -> None:
        """Stop what runs; a recording has a copy of the document that it began with, a training knows no scene."""
        for job in self.running_jobs:
            if not (of_the_scene and isinstance(job, RecordingJob | TransferTraining)):
                job.cancel()
