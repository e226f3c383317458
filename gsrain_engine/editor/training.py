"""Reconstruction of the open capture, and recoloring of the scene to its images."""

from pathlib import Path

from ..training.settings import TrainingSettings, load_settings
from .background_edits import recolor_to_images, reconstruct
from .capture_view import CaptureController
from .document import Recipe
from .files import Files
from .job_results import scene_results
from .jobs.job import JobRunner
from .jobs.training import recolor_job, reconstruction_job
from .viewport_state import ViewportState


class TrainingController:
    """Settings of the next reconstruction, and the start of jobs. Main thread only."""

    def __init__(self, viewport: ViewportState, captures: CaptureController, jobs: JobRunner, files: Files) -> None:
        self._viewport, self._captures, self._jobs, self._files = viewport, captures, jobs, files
        self.preset = "laptop"
        self.settings: TrainingSettings = load_settings(self.preset)

    def choose_preset(self, preset: str) -> None:
        self.preset, self.settings = preset, load_settings(preset)

    @property
    def why_no_recoloring(self) -> str | None:
        """Reason why the scene can't be recolored now, or None."""
        has_scene = self._viewport.document.scene.gaussian_count > 0
        return None if has_scene else "There is no scene to recolor yet."

    def reconstruct(self) -> None:
        """Start to fit Gaussians to the open capture; snapshots and result replace the scene, as one undo step."""
        path, allowed = self._captures.path, self._captures.allows_outside
        assert path is not None, "a capture is open"
        job = reconstruction_job(path, self.settings, allow_outside=allowed)
        recipe = Recipe(reconstruct, {"capture": path, "settings": self.settings, "allow_outside": allowed})
        self._jobs.start(job, scene_results(self._viewport, job.title, recipe, is_whole=True))

    def recolor(self, images: Path | None = None) -> None:
        """Start to solve for wet colors that reproduce the capture's images, or those of another folder."""
        path, allowed = self._captures.path, self._captures.allows_outside
        assert path is not None, "a capture is open"
        job = recolor_job(self._viewport.document.scene, self._files.known, path, images, allow_outside=allowed)
        recipe = Recipe(recolor_to_images, {"capture": path, "images": images, "allow_outside": allowed})
        self._jobs.start(job, scene_results(self._viewport, job.title, recipe))
