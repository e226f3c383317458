"""The job "Recolour": wet colours are solved for so that the scene looks like given pictures."""

from collections.abc import Iterator
from pathlib import Path

from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.other_pictures import with_images
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.reconstruct.recoloring.recolored_file import read_recolored, write_recolored
from gsrain_engine.reconstruct.recoloring.recolored_scene import with_colors
from gsrain_engine.reconstruct.recoloring.run import RecolorOptions, recolor_to_capture
from gsrain_engine.scene.formats import read_scene
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..document.staged_scene import StagedScene
from .report_files import new_report
from .scene_copy import write_copy
from .scene_job import Assignment

_COLORS = "colors.npz"


class Recoloring:
    """One scene to be recoloured to pictures, a `SceneTask`."""

    preparing = "Saving the scene for the worker"

    def __init__(
        self,
        scene: Scene,
        known: KnownFiles,
        capture: Path,
        images: Path | None = None,
        options: RecolorOptions | None = None,
        *,
        allow_outside: bool = False,
    ) -> None:
        """Cameras come from a capture; so do the pictures, unless a folder has them anew, under the same names."""
        pictures = images or capture
        self.title = f"Recolour to {pictures.name}"
        self.report: Path | None = new_report(f"{scene.name} to {pictures.name}")
        self._scene, self._known = scene, known
        self._capture, self._images, self._options = capture, images, options or RecolorOptions()
        self._allow_outside = allow_outside

    def prepare(self, folder: Path) -> Assignment:
        copy = write_copy(self._scene, folder, self._known)
        arguments = copy, self._capture, self._images, self._options, folder / _COLORS, self.report, self._allow_outside
        return Assignment(recolor_copy, arguments)

    def snapshot(self, folder: Path) -> Scene | None:
        return None

    def load(self, folder: Path) -> Scene:
        return with_colors(self._scene, read_recolored(folder / _COLORS))

    def staged(self, scene: Scene) -> StagedScene:
        """Bring the wet colours, and nothing else."""
        return StagedScene(self.title, scene, only_wet_colors=True)


def recolor_copy(
    copy: Path,
    capture: Path,
    images: Path | None,
    options: RecolorOptions,
    output: Path,
    report: Path | None,
    allow_outside: bool = False,
) -> Iterator[Progress]:
    """Work of the job, for another process: solve for a saved scene's wet colours and write them."""
    yield Progress(0.0, "Reading the scene")
    scene, pictures = read_scene(copy), open_capture(capture, allow_outside=allow_outside)
    if images is not None:
        pictures = with_images(pictures, images)
    run = yield from recolor_to_capture(scene, pictures, options)
    if report is not None:
        write_report(report, run.report)
    write_recolored(output, {each.key: each.wet_sh for each in run.scene.members if each.wet_sh is not None})
