"""Setup of "Make it rainy": method, views, preview and job. Not part of the document."""

from concurrent.futures import ThreadPoolExecutor
from typing import get_args

import msgspec
import numpy as np

from ..appearance.base import TransferSettings
from ..appearance.cyclegan_turbo.weight_paths import find_base_model, find_transfer_weights
from ..appearance.registry import METHODS, TransferMethod, find_method
from ..appearance.scene_views import Source, ViewChoice
from .files import SceneFiles
from .jobs.job import BackgroundJob, SceneJob
from .jobs.make_rainy import (
    MAKE_RAINY_TITLE,
    MakeRainyJobKind,
    PreviewedView,
    PreviewSettings,
    TransferPreviewJob,
    TransferRequest,
)
from .jobs.training import HOW_TO_GET_DIFFUSION, has_torch
from .services import EditorServices
from .viewport.options import Texture

QUICK_VIEWS = 8
"""Number of views for a first result within seconds."""

QUICK_WIDTH_PX = 480
PREVIEW_WIDTH_PX = 640
COMPARED_MM_H = 8.5
"""Rain of a comparison if no rain is set, because scenes are dry without."""


class WetLookController:
    """The user's choices and the results so far. Main thread only."""

    def __init__(self, scene_files: SceneFiles, files: ThreadPoolExecutor) -> None:
        """Start with the method that has no requirements; `files` is the thread that writes scenes for workers."""
        self.method = METHODS[0].name
        self.settings = TransferSettings()
        self.choice = ViewChoice(count=QUICK_VIEWS, width_px=QUICK_WIDTH_PX)
        self.preview_width_px = PREVIEW_WIDTH_PX
        self.previewed: PreviewedView | None = None
        self.texture: Texture | None = None
        self.viewport_px: tuple[int, int] = (960, 640)
        """Size of the viewport at the last frame."""
        self._scene_files, self._files = scene_files, files
        self._preview: TransferPreviewJob | None = None
        self._is_wanted = False

    @property
    def row(self) -> TransferMethod:
        return find_method(self.method)

    @property
    def recipe(self) -> PreviewSettings:
        return PreviewSettings(self.method, self.settings)

    def change(self, **fields: object) -> None:
        self.settings = msgspec.structs.replace(self.settings, **fields)

    # Preconditions

    def why_not(self, session: EditorServices) -> str | None:
        """Reason why the scene can't be made rainy now, in one sentence, or None."""
        return self.why_no_transfer or why_no_views(session, self.choice.source) or self._why_wait(session)

    def why_no_preview(self, session: EditorServices) -> str | None:
        """Reason why there can't be a preview now, or None."""
        if self.method == "images":
            return "Pictures of another program are of the chosen views alone: there is none from here."
        if not session.scene.gaussian_count:
            return "There is no scene yet to be made rainy."
        return self.why_no_transfer or self._why_wait(session)

    @property
    def why_no_transfer(self) -> str | None:
        """Missing requirements of the method, or None."""
        return missing_requirements(self.row, self.settings)

    def _why_wait(self, session: EditorServices) -> str | None:
        if session.running_jobs:
            return f"Wait for {session.running_jobs[0].title}, or cancel it."
        return "Wait for the scene that is being brought into the picture." if session.staged is not None else None

    # Preview

    @property
    def is_previewing(self) -> bool:
        return self._preview is not None and self._preview.state == "running"

    def preview(self, session: EditorServices) -> None:
        """Start to transfer the viewport's view; the result appears next to the live image."""
        if self.why_no_preview(session) is not None:
            return
        shot = session.shot(*self.viewport_px)
        nothing = np.zeros((1, 1, 3), np.uint8)
        wanted = PreviewedView(nothing, shot.camera, shot.time_s, session.scene, self.recipe)
        self._preview = TransferPreviewJob(wanted, self.preview_width_px, self._scene_files.known, self._files)
        session.start(self._preview)

    def fits(self, session: EditorServices) -> bool:
        """Return whether the preview matches the viewport's view."""
        shot = session.shot(*self.viewport_px)
        return self.previewed is not None and self.previewed.is_of(shot.camera, shot.time_s, session.scene)

    def what_is_stale(self, session: EditorServices) -> str | None:
        """Describe changes since the preview was made; None if there are none, or no preview."""
        if self.previewed is None:
            return None
        if not self.previewed.is_made_by(self.recipe):
            return "The settings have changed since."
        return None if self.fits(session) else "The view has changed since."

    def look_from_preview(self, session: EditorServices) -> None:
        """Return to the view of the preview."""
        if self.previewed is not None:
            session.stop_riding()
            session.following.follow("")
            session.navigation.look_like(self.previewed.camera)
            session.clock.seek(self.previewed.time_s)

    def poll(self, session: EditorServices) -> None:
        """Process a finished preview, and start a job that waits for a scene. Once a frame."""
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
            session.jobs = [each for each in session.jobs if each is not done]  # the image replaces the entry

    # Job

    def make(self, session: EditorServices) -> None:
        """Start the job for the session's scene, if all preconditions hold."""
        if self.why_not(session) is not None:
            return
        capture = session.captures.path if uses_capture(session, self.choice.source) else None
        order = TransferRequest(self.method, self.settings, self.choice, capture, session.captures.allows_outside)
        session.start(SceneJob(MakeRainyJobKind(session.scene, self._scene_files.known, order), self._files))

    def make_soon(self) -> None:
        """Start the job as soon as a scene is open."""
        self._is_wanted = True

    def newest(self, session: EditorServices) -> tuple[int, BackgroundJob] | None:
        """Return the last job of this kind, with its index among all jobs."""
        own = [(i, job) for i, job in enumerate(session.jobs) if _is_own(job)]
        return own[-1] if own else None

    def compare(self, session: EditorServices) -> None:
        """Show the clear scene next to the rainy one; if there is no rain, add some as an undo step."""
        session.view.split = "clear | rainy"
        if session.wetness_now == 0:
            session.change_rain("Rain to compare", intensity_mm_h=COMPARED_MM_H, wetness=None)


def _is_own(job: BackgroundJob) -> bool:
    return isinstance(job, TransferPreviewJob) or (isinstance(job, SceneJob) and job.title == MAKE_RAINY_TITLE)


# View sources

SOURCES: tuple[Source, ...] = get_args(Source)

TITLES: dict[Source, str] = {
    "auto": "the best there are",
    "recorded": "of the open capture",
    "rig": "of the rig, along the drive",
    "path": "along the camera path",
    "around": "around the middle",
}
"""Display names."""


def why_no_views(session: EditorServices, source: Source) -> str | None:
    """Reason why views of a source are not available, in one sentence, or None."""
    scene, captures = session.scene, session.captures
    if not scene.gaussian_count:
        return "There is no scene yet to be made rainy."
    if source == "recorded":
        if captures.capture is None:
            return "No capture is open: open the scene's recording in Capture, or choose other views."
        if not captures.capture.has_poses:
            return "Nothing tells where the capture's cameras stood: choose other views."
        if not captures.lies_in(scene):
            return "The open capture has axes of its own: its cameras are not in the scene."
    if source == "rig" and not (scene.ego is not None and scene.ego.valid.any() and any(scene.rigs.values())):
        return "The scene has no drive with a camera rig: choose other views."
    if source == "path" and scene.path is None:
        return "There is no camera path yet: insert keyframes in Timeline, or choose other views."
    return None


def uses_capture(session: EditorServices, source: Source) -> bool:
    """Return whether a source uses the open capture; `auto` does only if the user confirmed that it fits."""
    is_sure = session.captures.in_scene_axes is True and why_no_views(session, "recorded") is None
    return source == "recorded" or (source == "auto" and is_sure)


# Requirements of transfers, checked before a worker starts


def missing_requirements(method: TransferMethod, settings: TransferSettings) -> str | None:
    """Describe in one sentence a missing requirement and its remedy; None if all are met."""
    if method.needs_torch and not has_torch():
        return f"{method.title} needs torch, which is not installed: {HOW_TO_GET_DIFFUSION}"
    if method.needs == "images" and settings.images is None:
        return f"{method.title}: choose a folder of pictures first."
    for place in (getattr(settings, name) for name in ("weights", "images", "base") if name in method.uses):
        if place is not None and not place.exists():
            return f"{place}: is not there; choose another place."
    try:
        if "weights" in method.uses and settings.weights is None:
            find_transfer_weights()
        if "base" in method.uses:
            find_base_model(settings.base)
    except FileNotFoundError as missing:
        return f"{method.title}: {missing}"
    return None
