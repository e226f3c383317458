"""The editor without a window: panels read it and call its methods, the live view draws what it says."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
import platformdirs

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import OVERCAST, Rainfall
from gsrain_engine.rain.roofs import Roofs, roofs_of
from gsrain_engine.render.frame import Color
from gsrain_engine.render.gpu_arrays import Harmonics
from gsrain_engine.render.look import Look
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.scene import Scene

from .background_job import BackgroundJob
from .clock import Clock
from .history import Document, History
from .home_camera import default_path, home_camera, scene_bounds
from .interaction_budget import EXACT, Detail, InteractionBudget
from .log import LogLines
from .navigation import Navigation
from .open_scene import open_to_draw
from .rain_lab import RainLab
from .rainy_look import with_gaussians_of
from .rainy_look_job import RainyLookJob
from .staged_scene import StagedScene

logger = logging.getLogger("gsrain")

_VIEW_SIZE = (960, 640)  # shape of the picture that home cameras are chosen for

WindowBackend = Literal["auto", "opengl", "cpu"]

Split = Literal["off", "clear | rainy", "before | after"]
"""before: the document before the last step of its history."""


@dataclass(slots=True)
class ViewOptions:
    """How the viewport shows things; not part of the document."""

    show_streak_region: bool = False
    show_haze_region: bool = False
    background: Color = (0.0, 0.0, 0.0)
    gain_ev: float = 0.0
    """Brightens or darkens the display only."""
    shrink: int = 1
    """Draw every so many-th pixel in each direction; the rain keeps the drops of the full picture."""
    beyond_calibration: bool = False
    """Let the intensity slider go on to 100 mm/h."""
    follow_path: bool = False
    """Ride along the camera path instead of flying by hand."""
    look: Look = "splats"
    split: Split = "off"
    """Which two pictures stand side by side."""
    divider: float = 0.5
    """Where the left one ends, as a share of the width."""
    harmonics: Harmonics = "half"
    """How colours lie on the GPU."""
    show_selection: bool = True
    """Tint what is selected."""
    dialog: str = ""
    """Which of the window's own pages is open: commands, keys or about."""
    tool: str = ""
    """Name of the viewport's tool; none is plain navigation."""


class Side(NamedTuple):
    """What one side of the viewport shows."""

    label: str
    scene: Scene
    rainfall: Rainfall


class Session:
    """One open scene and everything around it. Only the main thread touches it."""

    def __init__(self, scene: Scene | None = None, rain: Rain | None = None) -> None:
        """Begin with a scene, or with an empty one."""
        scene = scene or Scene("no scene")
        self.clock = Clock()
        self.navigation = Navigation()
        self.view = ViewOptions()
        self.budget = InteractionBudget()
        self.log = LogLines()
        logger.setLevel(logging.INFO)
        logger.addHandler(self.log)
        self.jobs: list[BackgroundJob] = []
        """Those that run and those that have ended, in the order of their start, until a person clears them."""
        self.staged: StagedScene | None = None
        self.sky: Color = OVERCAST
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
        self.problem: str | None = None
        """What went wrong last, in one sentence: the viewport shows it until it is closed or a scene is opened."""
        self.path: CameraPath | None = None
        self.screenshot: Path | None = None
        """Where the live view saves its next picture."""
        self.lab = RainLab()
        self._files = ThreadPoolExecutor(max_workers=1, thread_name_prefix="files")
        self._opening: tuple[str, Future[Scene]] | None = None
        self._saving: tuple[Path, Future[None]] | None = None
        self._roofs: tuple[Scene, Future[Roofs | None]] | None = None
        self.history = History.beginning_with(Document(scene, rain or load_preset("clear")))
        self.rainfall = Rainfall.start(self.rain)
        self._other_rainfalls: dict[Rain, Rainfall] = {}
        self._scene_of_sky = scene
        self._enter_scene()

    # The document

    @property
    def scene(self) -> Scene:
        """The scene as it is now."""
        return self.history.present.scene

    @property
    def rain(self) -> Rain:
        """The rain as it is now."""
        return self.history.present.rain

    def change_rain(self, label: str, gesture: str | None = None, **fields: object) -> None:
        """Change fields of the rain. Changes of one gesture (a drag) make one step; call `end_gesture` when it ends."""
        self.set_rain(label, msgspec.structs.replace(self.rain, **fields), gesture)

    def set_rain(self, label: str, rain: Rain, gesture: str | None = None) -> None:
        """Go to another rain; drops in the air go on from where they are."""
        if rain != self.rain:
            self.history.record(label, self.history.present.with_rain(rain), gesture)
            self._follow_document()

    def use_calibration(self, name: str) -> None:
        """Let the rain follow another calibration, by name or file; what is wrong with it is kept in `problem`."""
        try:
            load_calibration(name)
        except (ValueError, OSError) as error:
            self.problem = str(error)
            logger.error("%s", error)
        else:
            self.lab.add_file(name)
            self.change_rain("Calibration", calibration=name)

    def compare_calibration(self, name: str) -> None:
        """Show another calibration beside the rain's own; what is wrong with it is kept in `problem`."""
        try:
            self.lab.compare_with(name)
        except (ValueError, OSError) as error:
            self.problem = str(error)
            logger.error("%s", error)

    def use_fitted_calibration(self) -> None:
        """Keep the lab's last fit in a file, and let the rain follow it."""
        try:
            path = self.lab.keep_fitted()
        except OSError as error:
            self.problem = _told("The calibration can't be saved", error)
        else:
            self.use_calibration(path)

    def set_scene(self, label: str, scene: Scene, gesture: str | None = None) -> None:
        """Go to a changed version of the scene."""
        self.history.record(label, self.history.present.with_scene(scene), gesture)
        self._follow_document()

    def show_member(self, key: str, visible: bool) -> None:
        """Show or hide a layer or an actor."""
        verb = "Show" if visible else "Hide"
        self.set_scene(f"{verb} {self.scene.member(key).name}", self.scene.with_member(key, visible=visible))

    def end_gesture(self) -> None:
        """Say that a drag is over."""
        self.history.end_gesture()

    def undo(self) -> None:
        """Step back."""
        self.history.undo()
        self._follow_document()

    def redo(self) -> None:
        """Step forward."""
        self.history.redo()
        self._follow_document()

    def go_to_step(self, step: int) -> None:
        """Go to a step of the history, backward or forward."""
        self.history.go_to(step)
        self._follow_document()

    # Files

    def open(self, path: str) -> None:
        """Read a scene in the background and go to it; of several, the one that was asked for last.

        What goes wrong is logged and kept in `problem`, and the present scene stays.
        """
        if self._opening is not None:
            self._opening[1].cancel()
        logger.info("Opening %s", path)
        self.problem = None
        self._opening = path, self._files.submit(open_to_draw, path)

    def save(self, path: Path) -> None:
        """Write the scene, with its rain, in the background."""
        if self._saving is None:
            rain = msgspec.to_builtins(self.rain)
            self._saving = path, self._files.submit(write_scene, replace(self.scene, rain=rain), path)

    @property
    def busy(self) -> str | None:
        """What is being read or written, None when nothing is."""
        if self._opening is not None:
            return f"Opening {self._opening[0]}"
        if self.staged is not None and self.staged.is_opened:
            return f"Uploading {self.staged.label}"
        if self._saving is not None:
            return f"Saving {self._saving[0]}"
        if self.rain.roofs and not self._roofs_are_found:
            return "Finding roofs"
        return "Preparing the picture; once after an update this takes up to a minute" if self.is_compiling else None

    @property
    def pending_files(self) -> list[Future[Any]]:
        """Reading, writing and finding roofs, to wait for where there are no frames to wait with."""
        return [each[1] for each in (self._opening, self._saving, self._roofs) if each is not None]

    @property
    def is_working(self) -> bool:
        """Whether anything goes on in the background that a frame should look after."""
        return bool(self.running_jobs) or self.busy is not None or self.staged is not None or self.lab.busy is not None

    # Jobs

    @property
    def running_jobs(self) -> list[BackgroundJob]:
        """Jobs that have not ended."""
        return [job for job in self.jobs if job.state == "running"]

    def start(self, job: BackgroundJob) -> None:
        """Look after a job from now on."""
        self.jobs.append(job)

    def make_rainy(self) -> None:
        """Start the job "Make it rainy (preview)"; one at a time."""
        if not any(isinstance(job, RainyLookJob) for job in self.running_jobs):
            self.start(RainyLookJob(self.scene, self._files))

    def clear_jobs(self) -> None:
        """Forget the jobs that have ended."""
        self.jobs = self.running_jobs

    def stage(self, staged: StagedScene) -> None:
        """Show a scene as soon as its Gaussians are where the next frame needs them."""
        self.staged = staged

    @property
    def is_opening(self) -> bool:
        """Whether another scene is about to take the place of this one."""
        return self._opening is not None or (self.staged is not None and self.staged.is_opened)

    def swap_in(self) -> None:
        """Show the staged scene: its Gaussians are where the next frame needs them."""
        if self.staged is None:
            return
        staged, self.staged = self.staged, None
        if staged.is_opened:
            self._go_to(staged.scene)
            logger.info("Opened %s: %s Gaussians", staged.label, f"{staged.scene.gaussian_count:,}")
        else:
            self.set_scene(staged.label, with_gaussians_of(self.scene, staged.scene))
            logger.info("%s: done", staged.label)

    # Time and view

    def update(self, real_s: float) -> None:
        """Let time go by and take in what background work has finished. Once a frame."""
        self.clock.advance(real_s)
        self._poll_files()
        if self.rain.roofs and (self._roofs is None or self._roofs[0] is not self.scene):
            self._roofs = self.scene, self._files.submit(roofs_of, self.scene)
        self.lab.poll()
        for job in self.running_jobs:
            job.poll(self)
            if job.error is not None:
                logger.error("%s failed: %s", job.title, job.error)

    @property
    def sides(self) -> list[Side]:
        """What the viewport shows: one side, or two from left to right."""
        here = Side("", self.scene, self._drawn_rainfall)
        if self.view.split == "clear | rainy":
            clear = msgspec.structs.replace(self.rain, intensity_mm_h=0.0)
            return [Side("clear", self.scene, self._rainfall_of(clear)), here._replace(label="rainy")]
        if self.view.split == "before | after":
            before = self.history.previous
            left = Side(f"before: {self.history.undo_label or 'nothing'}", before.scene, self._rainfall_of(before.rain))
            return [left, here._replace(label="after")]
        return [here]

    def shot(self, width: int, height: int, focal_scale: float = 1.0) -> Shot:
        """What the viewport shows now; `focal_scale` is output size over drawn size."""
        t = self.clock.time_s
        if self.view.follow_path and self.path is not None:
            along = t % self.path.duration_s if self.path.duration_s > 0 else 0.0
            camera = self.path.camera(along, width, height)
            return Shot(camera, along, self.path.velocity(along), camera.fx * focal_scale)
        camera = self.navigation.camera(width, height)
        return Shot(camera, t, self.navigation.velocity_m_s, camera.fx * focal_scale)

    def take_screenshot(self, folder: Path | None = None) -> None:
        """Save the next picture under the present date and time, by default in the person's pictures folder."""
        folder = folder or Path(platformdirs.user_pictures_dir())
        name = f"gsrain_{datetime.now():%Y-%m-%d_%H-%M-%S}"
        taken = {each.name for each in folder.glob(f"{name}*.png")}
        chosen, number = f"{name}.png", 1
        while chosen in taken:
            number += 1
            chosen = f"{name}_{number}.png"
        self.screenshot = folder / chosen

    def frame_scene(self) -> None:
        """Back off until the whole scene can be seen."""
        self.navigation.frame(*scene_bounds(self.scene))

    def go_home(self) -> None:
        """Go to where the scene is first looked at from."""
        camera = home_camera(self.scene, *_VIEW_SIZE)
        self.navigation = Navigation(speed_m_s=self.navigation.speed_m_s)
        self.navigation.look_like(camera)
        low, high = scene_bounds(self.scene)
        in_front = float(camera.world_to_camera[2, :3] @ ((low + high) / 2) + camera.world_to_camera[2, 3])
        self.navigation.distance_m = float(np.clip(in_front, 1.0, 20.0))

    def close(self) -> None:
        """Stop everything that runs."""
        self._cancel_jobs()
        if self._opening is not None:
            self._opening[1].cancel()
        self._files.shutdown()
        self.lab.close()
        logger.removeHandler(self.log)

    @property
    def _roofs_are_found(self) -> bool:
        return self._roofs is not None and self._roofs[0] is self.scene and self._roofs[1].done()

    @property
    def _drawn_rainfall(self) -> Rainfall:
        """The rain without roofs until they are found: a frame that looked for them would take seconds."""
        if not self.rain.roofs or self._roofs_are_found:
            return self.rainfall
        return replace(self.rainfall, rain=msgspec.structs.replace(self.rain, roofs=False))

    def _rainfall_of(self, rain: Rain) -> Rainfall:
        if rain == self.rain:
            return self.rainfall
        if rain not in self._other_rainfalls:
            self._other_rainfalls = {rain: Rainfall.start(rain)}
        return self._other_rainfalls[rain]

    def _follow_document(self) -> None:
        if self.scene is not self._scene_of_sky:
            self._scene_of_sky, self.sky_is_stale = self.scene, True
        if self.rainfall.rain != self.rain:
            self.rainfall = self.rainfall.changed(self.rain, self.clock.time_s)

    def _enter_scene(self) -> None:
        self.path = default_path(self.scene, *_VIEW_SIZE)
        self.go_home()
        self.sky_is_stale = True

    def _poll_files(self) -> None:
        if self._opening is not None and self._opening[1].done():
            (path, opening), self._opening = self._opening, None
            try:
                self.staged = StagedScene(path, opening.result(), is_opened=True)
            except Exception as error:  # whatever a file can do to its reader: the window lives on
                self.problem = _told(f"{path} can't be opened", error)
        if self._saving is not None and self._saving[1].done():
            (target, saving), self._saving = self._saving, None
            try:
                saving.result()
            except Exception as error:
                self.problem = _told(f"{target} can't be saved", error)
            else:
                logger.info("Saved %s", target)

    def _cancel_jobs(self) -> None:
        for job in self.running_jobs:
            job.cancel()

    def _go_to(self, scene: Scene) -> None:
        self._cancel_jobs()
        rain = self.rain
        try:
            rain = msgspec.convert(scene.rain, Rain) if scene.rain is not None else rain
        except msgspec.ValidationError as error:
            logger.error("%s: the scene's rain can't be used: %s", scene.name, error)
        self.history = History.beginning_with(Document(scene, rain))
        self._follow_document()
        self._enter_scene()


def _told(what: str, error: Exception) -> str:
    """Log what went wrong, with a traceback where it is our own fault; returns it in one sentence."""
    foreseen = isinstance(error, SceneFormatError | OSError | MemoryError)
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    sentence = reason if isinstance(error, SceneFormatError) else f"{what}: {reason}"
    logger.error("%s", sentence, exc_info=not foreseen)
    return sentence
