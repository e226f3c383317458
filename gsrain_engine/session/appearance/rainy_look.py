"""How the scene is to be made rainy: method, views, the preview of one view, and the job. Not part of the document."""

from concurrent.futures import ThreadPoolExecutor

import msgspec
import numpy as np

from gsrain_engine.appearance.methods import METHODS, Method, method_of
from gsrain_engine.appearance.transfer_settings import TransferSettings
from gsrain_engine.appearance.views.choice import ViewChoice

from ..desk import Desk
from ..files.scene_files import SceneFiles
from ..jobs.background_job import BackgroundJob
from ..jobs.scene_job import SceneJob
from ..view.texture import Texture
from .lacking import lacking
from .previewed_view import PreviewedView, Recipe
from .rainy_scene_job import TITLE, RainyScene
from .transfer_preview import TransferPreview
from .transfer_work import TransferOrder
from .view_sources import uses_capture, why_no_views

QUICK_VIEWS = 8
"""Enough for a first look, and made in seconds."""
QUICK_WIDTH_PX = 480
PREVIEW_WIDTH_PX = 640
COMPARED_MM_H = 8.5
"""Rain that a comparison is shown in where there is none: scenes are dry without."""


class RainyLook:
    """What a person has chosen, and what came of it so far. Call everything on the main thread."""

    def __init__(self, scene_files: SceneFiles, files: ThreadPoolExecutor) -> None:
        """Begin with the method that needs nothing; `files` is the thread where scenes are written for workers."""
        self.method = METHODS[0].name
        self.settings = TransferSettings()
        self.choice = ViewChoice(count=QUICK_VIEWS, width_px=QUICK_WIDTH_PX)
        self.preview_width_px = PREVIEW_WIDTH_PX
        self.previewed: PreviewedView | None = None
        self.texture: Texture | None = None
        """The preview on the GPU."""
        self.viewport_px: tuple[int, int] = (960, 640)
        """Size of the viewport at the last frame."""
        self._scene_files, self._files = scene_files, files
        self._preview: TransferPreview | None = None
        self._is_wanted = False

    @property
    def row(self) -> Method:
        return method_of(self.method)

    @property
    def recipe(self) -> Recipe:
        """The method and its settings, as they are now."""
        return Recipe(self.method, self.settings)

    def change(self, **fields: object) -> None:
        self.settings = msgspec.structs.replace(self.settings, **fields)

    # Whether

    def why_not(self, session: Desk) -> str | None:
        """Why the scene can't be made rainy now, in one sentence; None where it can."""
        return self.why_no_transfer or why_no_views(session, self.choice.source) or self._why_wait(session)

    def why_no_preview(self, session: Desk) -> str | None:
        """Why there can't be a preview now; None where there can."""
        if self.method == "images":
            return "Pictures of another program are of the chosen views alone: there is none from here."
        if not session.scene.gaussian_count:
            return "There is no scene yet to be made rainy."
        return self.why_no_transfer or self._why_wait(session)

    @property
    def why_no_transfer(self) -> str | None:
        """What the method lacks; None where it has all it needs."""
        return lacking(self.row, self.settings)

    def _why_wait(self, session: Desk) -> str | None:
        if session.running_jobs:
            return f"Wait for {session.running_jobs[0].title}, or cancel it."
        return "Wait for the scene that is being brought into the picture." if session.staged is not None else None

    # Preview

    @property
    def is_previewing(self) -> bool:
        return self._preview is not None and self._preview.state == "running"

    def preview(self, session: Desk) -> None:
        """Begin to transfer what the viewport shows; the picture comes later, and is laid beside the live one."""
        if self.why_no_preview(session) is not None:
            return
        shot = session.shot(*self.viewport_px)
        nothing = np.zeros((1, 1, 3), np.uint8)
        wanted = PreviewedView(nothing, shot.camera, shot.time_s, session.scene, self.recipe)
        self._preview = TransferPreview(wanted, self.preview_width_px, self._scene_files.known, self._files)
        session.start(self._preview)

    def fits(self, session: Desk) -> bool:
        """Whether the preview is of what the viewport shows now."""
        shot = session.shot(*self.viewport_px)
        return self.previewed is not None and self.previewed.is_of(shot.camera, shot.time_s, session.scene)

    def what_is_stale(self, session: Desk) -> str | None:
        """Say what is different from when the preview was made; None where nothing is, or there is none."""
        if self.previewed is None:
            return None
        if not self.previewed.is_made_by(self.recipe):
            return "The settings have changed since."
        return None if self.fits(session) else "The view has changed since."

    def look_from_preview(self, session: Desk) -> None:
        """Go back to where the preview was made."""
        if self.previewed is not None:
            session.stop_riding()
            session.following.follow("")
            session.navigation.look_like(self.previewed.camera)
            session.clock.seek(self.previewed.time_s)

    def poll(self, session: Desk) -> None:
        """Take in a preview that has come, and start a job that was waiting for the scene. Once a frame."""
        if self._is_wanted and session.scene.gaussian_count and self._why_wait(session) is None:
            self._is_wanted = False
            session.problem = self.why_not(session) or session.problem
            self.make(session)
        if self._preview is None or self._preview.state == "running":
            return
        done, self._preview = self._preview, None
        if done.result is not None:
            self.previewed = done.result
            session.view.split = "now | preview"
            session.jobs = [each for each in session.jobs if each is not done]  # the picture says it all

    # The job

    def make(self, session: Desk) -> None:
        """Start the job for the session's scene, if nothing is in its way."""
        if self.why_not(session) is not None:
            return
        capture = session.captures.path if uses_capture(session, self.choice.source) else None
        order = TransferOrder(self.method, self.settings, self.choice, capture, session.captures.allows_outside)
        session.start(SceneJob(RainyScene(session.scene, self._scene_files.known, order), self._files))

    def make_soon(self) -> None:
        """Start the job as soon as a scene is there."""
        self._is_wanted = True

    def newest(self, session: Desk) -> tuple[int, BackgroundJob] | None:
        """Return the last job of this kind, with its place among all jobs."""
        own = [(i, job) for i, job in enumerate(session.jobs) if _is_own(job)]
        return own[-1] if own else None

    def compare(self, session: Desk) -> None:
        """Lay the clear scene beside the rainy one; where no rain falls, let it rain, as a step."""
        session.view.split = "clear | rainy"
        if session.wetness_now == 0:
            session.change_rain("Rain to compare", intensity_mm_h=COMPARED_MM_H, wetness=None)


def _is_own(job: BackgroundJob) -> bool:
    return isinstance(job, TransferPreview) or (isinstance(job, SceneJob) and job.title == TITLE)
