"""The way that riding along and recording take, in the world: a person's own path, or one that every scene has."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from .home_camera import default_path

Matrix = Float64[np.ndarray, "4 4"]

_VIEW_SIZE = (960, 640)  # shape of the picture that the default path's field of view is chosen for


class Ride:
    """Keeps the path of the present scene; while nothing that it depends on changes it is the very same value."""

    def __init__(self) -> None:
        self._own: tuple[CameraPath, Matrix, CameraPath] | None = None
        self._default: tuple[tuple[object, object], Matrix, CameraPath] | None = None

    def path(self, scene: Scene) -> CameraPath:
        """Path of a scene, in the world (metres, z up)."""
        to_world = scene.scene_to_world
        if scene.path is None:
            return self._default_path(scene, to_world)
        if self._own is None or self._own[0] is not scene.path or not np.array_equal(self._own[1], to_world):
            self._own = scene.path, to_world, scene.path.moved(to_world)
        return self._own[2]

    def _default_path(self, scene: Scene, to_world: Matrix) -> CameraPath:
        # Layers are left aside: what is hidden or deleted shall not move a path that a person rides along.
        drive = scene.ego, scene.rigs
        if self._default is None or any(a is not b for a, b in zip(self._default[0], drive, strict=True)):
            self._default = drive, to_world, default_path(scene, *_VIEW_SIZE)
        elif not np.array_equal(self._default[1], to_world):
            step = to_world @ np.linalg.inv(self._default[1])
            self._default = drive, to_world, self._default[2].moved(step)
        return self._default[2]
