"""A clip of a scene in the rain, from a scene, a rain and a camera: as files, or frame by frame."""

from collections.abc import Iterator

from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from .frame import Frame
from .record import record
from .recorded_views import frame_numbers, sequences_of
from .recording import Recording
from .renderer import Renderer


def film(
    renderer: Renderer, recording: Recording, scene: Scene, rain: Rain, camera: Camera | CameraPath
) -> Iterator[Progress]:
    """Record a scene in its rain from a camera or along a path of the world (metres, z up); yields after each frame.

    The path's times are those of the scene and the rain. The window's Record panel and `gsrain render` write the same
    bytes. Where a caller stops, what was written can be played.

    Raises:
        ValueError: For settings that contradict themselves, and a calibration that the rain names and there is not.
        OSError: When the output can't be written.
    """
    rainfall = Rainfall.start(rain)
    sequences = sequences_of(recording, scene, rainfall, camera, in_scene_time=True)
    yield from record(renderer, recording, sequences, frame_numbers(recording, sequences))


def film_frames(
    renderer: Renderer,
    recording: Recording,
    scene: Scene,
    rain: Rain,
    camera: Camera | CameraPath,
    *,
    with_depth: bool = False,
) -> Iterator[Frame]:
    """Render the frames that `film` would record, one by one, and write nothing; of `recording` its output is unused.

    Depth is that of the scene in metres, without rain. Raises `ValueError` as `film` does, before the first frame.
    """
    rainfall = Rainfall.start(rain)
    (sequence,) = sequences_of(recording, scene, rainfall, camera, in_scene_time=True).values()
    numbers = frame_numbers(recording, {"": sequence})
    return (each.frame for each in sequence.render(renderer, numbers, sequence.sky(renderer), with_depth=with_depth))
