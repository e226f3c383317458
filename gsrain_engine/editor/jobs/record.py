"""Export job and worker: record a saved scene with its rain, weather and path, as `gsrain render PROJECT` does."""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from msgspec.structs import replace
from PIL import Image

from ...backends import open_renderer
from ...rain.keyframes import keyframes_of, rain_of
from ...rain.settings import RainSettings
from ...rain.simulation import RainSimulation
from ...render.export import export_frames, export_sequences, first_pictures, frame_numbers
from ...render.export_settings import DEFAULT_SIZE_PX, ExportSettings
from ...render.intensity_sheet import write_sheet
from ...render.renderer import Renderer
from ...render.sequence import FrameSequence
from ...report.numbers import write_provenance
from ...scene.camera_path import CameraPath
from ...scene.formats.scene_folder import FileCache
from ...scene.open import load_sorted_scene
from ...scene.progress import Progress
from ...scene.scene import Scene
from ..viewport.camera import default_path
from .folder import write_copy
from .job import Job
from .process import install_sigterm_handler

logger = logging.getLogger("gsrain")
SHEET_MM_H = 0.0, 1.2, 5.0, 8.5, 12.0
"""Intensities of a sheet: the quick choices of the Rain panel."""


def export_job(scene: Scene, recording: ExportSettings, known: FileCache) -> Job[str]:
    """Create a job with the settings of the command line, whose result is the output; `known` are the scene's files.

    It goes on when another scene is opened, because it has its own copy of the document.
    """

    def log_stopped() -> None:
        is_begun = Path(recording.output).exists()
        left = "what there is of it can be played" if is_begun else "nothing of it was written yet"
        logger.info("Stopped recording %s: %s", recording.output, left)

    return Job(
        "export", f"Record {recording.path.name}", record_in_worker, lambda _: recording.output,
        lambda folder: (write_copy(scene, folder, known), recording), on_cancel=log_stopped, ends_with_scene=False,
        output=recording.path,
    )  # fmt: skip


def frame_job(scene: Scene, still: ExportSettings, known: FileCache) -> Job[UInt8[np.ndarray, "h w c"]]:
    """Create a job whose result is one frame of a recording as it would be written: RGB, or RGBA (straight alpha)."""

    def read(folder: Path) -> UInt8[np.ndarray, "h w c"]:
        with Image.open(folder / _FRAME) as image:
            return np.asarray(image)

    return Job(
        "frame", "Preview a frame", frame_in_worker, read,
        lambda folder: (write_copy(scene, folder, known), still), ends_with_scene=True,
    )  # fmt: skip


_FRAME = "frame.png"


def frame_in_worker(folder: Path, still: ExportSettings) -> Iterator[Progress]:
    """Worker: render one frame of a scene folder next to it."""
    yield from record_in_worker(folder, replace(still, output=str(folder.parent / _FRAME)))


TIMED_FRAMES = 4


def timing_job(scene: Scene, recording: ExportSettings, known: FileCache) -> Job[None]:
    """Create a job that draws and writes the first frames of a recording, and discards them: for its metric of time."""
    end_s = recording.first_s + TIMED_FRAMES / recording.fps
    frames = replace(recording, last_s=end_s)
    return Job(
        "timing", f"Time {TIMED_FRAMES} frames", time_in_worker,
        inputs=lambda folder: (write_copy(scene, folder, known), frames), ends_with_scene=False,
    )  # fmt: skip


def time_in_worker(folder: Path, frames: ExportSettings) -> Iterator[Progress]:
    """Worker: record a few frames of a scene folder next to it."""
    yield from record_in_worker(folder, replace(frames, output=str(folder.parent / f"timed{frames.path.suffix}")))


def record_in_worker(folder: Path, recording: ExportSettings) -> Iterator[Progress]:
    """Worker: record a scene folder; on SIGTERM, closes its videos first, so that they are playable.

    Raises:
        ValueError: For inconsistent settings, such as a camera that the scene lacks.
        OSError: If it can't be written; the part written so far is playable.
    """
    install_sigterm_handler()
    yield Progress(0.0, "Reading the scene")
    with open_renderer() as renderer:
        yield from export_scene(renderer, load_sorted_scene(str(folder)), recording)


def export_scene(renderer: Renderer, scene: Scene, recording: ExportSettings) -> Iterator[Progress]:
    """Record a scene with the rain and the camera path that it is saved with; raises as `record_in_worker` does.

    NAME.provenance.json beside the recording says what its first picture holds.
    """
    sequences = saved_sequences(scene, recording)
    numbers = frame_numbers(recording, sequences)
    yield from export_frames(renderer, recording, sequences, numbers)
    write_provenance(recording.path, first_pictures(renderer, sequences, numbers[0]))


def saved_sequences(scene: Scene, recording: ExportSettings) -> dict[str, FrameSequence]:
    """Frame sequences of a scene with the rain, its keyframes and the camera path that it is saved with."""
    rainfall = RainSimulation.start(rain_of(scene) or RainSettings(), weather=keyframes_of(scene))
    path = own_path(scene, *(recording.size_px or DEFAULT_SIZE_PX))
    return export_sequences(recording, scene, rainfall, path, in_scene_time=scene.path is not None)


def sheet_job(scene: Scene, still: ExportSettings, known: FileCache) -> Job[str]:
    """Create a job that draws a sheet of intensities, as `gsrain render --sheet` does, whose result is the output."""
    return Job(
        "export", f"Draw {still.path.name}", sheet_in_worker, lambda _: still.output,
        lambda folder: (write_copy(scene, folder, known), still), ends_with_scene=False, output=still.path,
    )  # fmt: skip


def sheet_in_worker(folder: Path, still: ExportSettings) -> Iterator[Progress]:
    """Worker: draw a sheet of `SHEET_MM_H` for the present view of a scene folder."""
    yield Progress(0.0, "Reading the scene")
    sequences = saved_sequences(load_sorted_scene(str(folder)), still)
    with open_renderer() as renderer:
        yield from write_sheet(renderer, sequences, SHEET_MM_H, still.path)


def page_job(scene: Scene, page: Path, known: FileCache) -> Job[Path]:
    """Create a job that writes a web page, as `gsrain publish PROJECT` does, whose result is its path."""
    return Job(
        "export", f"Publish {page.name}", page_in_worker, lambda _: page,
        lambda folder: (write_copy(scene, folder, known), page), ends_with_scene=False, output=page,
    )  # fmt: skip


def page_in_worker(folder: Path, page: Path) -> Iterator[Progress]:
    """Worker: write a web page of a scene folder with its rain and path; raises as `publish_page` does."""
    from ...publish.page import opening_view, publish_page  # its shaders and templates are for pages alone

    yield Progress(0.0, "Reading the scene")
    scene = load_sorted_scene(str(folder))
    rain = rain_of(scene) or RainSettings()
    path = own_path(scene, *DEFAULT_SIZE_PX)
    film = ExportSettings(output="page.mp4")
    is_own = scene.path is not None
    sequence = export_sequences(film, scene, RainSimulation.start(rain), path, in_scene_time=is_own)[""]
    opening = opening_view(scene, None, has_path=False)
    with open_renderer("cpu") as renderer:
        yield from publish_page(renderer, scene, rain, sequence, "Path", page, opening=opening)


def own_path(scene: Scene, width: int, height: int) -> CameraPath:
    """The scene's camera path, else the ego's drive, else an orbit. World frame, meters."""
    return default_path(scene, width, height) if scene.path is None else scene.path.moved(scene.scene_to_world)
