"""The job "Preview": one view as a transfer makes it, from where a person looks now."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from gsrain_engine.appearance.views.placed_camera import PlacedCamera
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress

from ..jobs.copied_scene_job import CopiedSceneJob
from ..jobs.worker import Job
from .previewed_view import PreviewedView
from .transfer_work import preview_view

TITLE = "Preview"


class TransferPreview(CopiedSceneJob):
    """One view on its way. Whoever has started it takes `result` when it is finished."""

    def __init__(self, wanted: PreviewedView, width_px: int, known: KnownFiles, files: ThreadPoolExecutor) -> None:
        """Start. `wanted` says what of; its pixels are those that stand in until there are others."""
        placed = PlacedCamera(TITLE, wanted.camera, wanted.time_s).at_width(min(width_px, wanted.camera.width))
        recipe = wanted.recipe
        super().__init__(
            TITLE, wanted.scene, known, files,
            lambda copy: Job(TITLE, preview_view, copy, recipe.method, recipe.settings, placed),
        )  # fmt: skip
        self.result: PreviewedView | None = None
        self._wanted = wanted

    def _take(self, last: Progress) -> None:
        if last.preview is None:
            raise ValueError("the transfer has made no picture")
        self.result = replace(self._wanted, pixels=last.preview)
