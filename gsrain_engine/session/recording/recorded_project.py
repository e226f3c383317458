"""Records a saved scene with its own rain, weather and path, as `gsrain render PROJECT` does."""

from collections.abc import Iterator
from pathlib import Path

from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.rain.saved_rain import rain_of, weather_of
from gsrain_engine.render.record import record
from gsrain_engine.render.recorded_views import frame_numbers, sequences_of
from gsrain_engine.render.recording import DEFAULT_SIZE_PX, Recording
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..jobs.orderly_end import end_files_when_told
from ..view.home_camera import default_path


def own_path(scene: Scene, width: int, height: int) -> CameraPath:
    """The path that a person made for a scene, else the ego's drive, else a swing around it. World frame, metres."""
    return default_path(scene, width, height) if scene.path is None else scene.path.moved(scene.scene_to_world)


def record_project(folder: Path, recording: Recording) -> Iterator[Progress]:
    """Record a scene folder.

    Raises:
        ValueError: For what contradicts itself, such as a camera that the scene does not have.
        OSError: When it can't be written; what had been written can be played.
    """
    yield Progress(0.0, "Reading the scene")
    scene = open_to_draw(str(folder))
    rainfall = Rainfall.start(rain_of(scene) or Rain(), weather=weather_of(scene))
    path = own_path(scene, *(recording.size_px or DEFAULT_SIZE_PX))
    sequences = sequences_of(recording, scene, rainfall, path, in_scene_time=scene.path is not None)
    with open_renderer() as renderer:
        yield from record(renderer, recording, sequences, frame_numbers(recording, sequences))


def record_in_worker(folder: Path, recording: Recording) -> Iterator[Progress]:
    """Record as work of another process: told to end, it ends its videos first."""
    end_files_when_told()
    yield from record_project(folder, recording)
