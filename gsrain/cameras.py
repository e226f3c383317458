"""Cameras and camera paths of a scene's world: meters, z up. A camera looks along its own z axis, y down (OpenCV)."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from gsrain_engine.editor.viewport import camera as views
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX
from gsrain_engine.scene import camera_path
from gsrain_engine.scene.camera import Camera as Camera
from gsrain_engine.scene.camera import look_at as look_at
from gsrain_engine.scene.camera_path_io import read_camera_path, write_camera_path
from gsrain_engine.scene.scene import Scene


def home_camera(scene: Scene, size: tuple[int, int] = DEFAULT_SIZE_PX) -> Camera:
    """Return the camera that a scene is first shown from; `size` is width and height in pixels.

    It looks through the windscreen where the scene has an ego vehicle with cameras, else at the scene's middle.
    """
    return views.home_camera(scene, *size)


class CameraPath(camera_path.CameraPath):
    """Keyframes of a camera in time, with smooth curves between them: positions in meters, times in seconds."""

    @classmethod
    def through(cls, times_s: Sequence[float], cameras: Sequence[Camera]) -> "CameraPath":
        """Fly through cameras at rising times in seconds; the exposure is the first one's.

        Raises `ValueError` without a camera, and where the times are not as many or don't rise.
        """
        return cls._of(super().through(times_s, cameras))

    @classmethod
    def orbit(cls, scene: Scene, seconds: float = views.ORBIT_S, degrees: float = views.ORBIT_DEG) -> "CameraPath":
        """Swing around a scene's middle in front of its home camera; 360 degrees go all the way round.

        Raises `ValueError` where the time is not above 0.
        """
        return cls._of(views.orbit_around(scene, *DEFAULT_SIZE_PX, seconds, degrees))

    @classmethod
    def default(cls, scene: Scene) -> "CameraPath":
        """Return the path that a scene is shown along: its own, else the drive of its ego vehicle, else an orbit."""
        own = None if scene.path is None else scene.path.moved(scene.scene_to_world)
        return cls._of(own or views.default_path(scene, *DEFAULT_SIZE_PX))

    @classmethod
    def read(cls, path: Path | str, scene: Scene) -> "CameraPath":
        """Read a file in a scene's own units and axes: ours, nerfstudio's camera_path.json, or 3DGS's cameras.json.

        Raises `SceneFormatError` when it can't be read.
        """
        return cls._of(read_camera_path(Path(path)).moved(scene.scene_to_world))

    def save(self, path: Path | str, scene: Scene) -> None:
        """Write the path as JSON, in a scene's own units and axes, as `gsrain render --camera-path` reads it."""
        write_camera_path(Path(path), self.moved(np.linalg.inv(scene.scene_to_world)))

    @classmethod
    def _of(cls, path: camera_path.CameraPath) -> "CameraPath":
        return cls(**{field.name: getattr(path, field.name) for field in fields(path)})
