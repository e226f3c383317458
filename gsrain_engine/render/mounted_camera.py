"""A camera of the ego vehicle's rig as it drives. World frame, metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import RigCamera, Scene

_STEP_S = 0.005
"""Half the time over which the speed is taken: tracks are linear between their samples, 100 ms apart."""


@dataclass(frozen=True, slots=True, eq=False)
class MountedCamera:
    """One camera of a rig, wherever its vehicle is."""

    scene: Scene
    rig: str
    name: str

    def at(self, time_s: float) -> Camera:
        """Camera at a time, in its own size; raises `ValueError` while there is no vehicle."""
        return rig_camera(self.scene, self.rig, self.name, time_s)

    def velocity(self, time_s: float) -> Float64[np.ndarray, "3"]:
        """Velocity at a time; zero before and after the drive, and where the vehicle comes or goes."""
        times = self._times_s
        before, after = np.clip([time_s - _STEP_S, time_s + _STEP_S], times[0], times[-1])
        if not before < after or not times[0] <= time_s <= times[-1]:
            return np.zeros(3)
        try:
            return (self.at(float(after)).position - self.at(float(before)).position) / (after - before)
        except ValueError:
            return np.zeros(3)

    @property
    def end_s(self) -> float:
        return float(self._times_s[-1])

    @property
    def front_at_start(self) -> Camera:
        """The rig's camera that looks most straight ahead, where the drive begins."""
        assert self.scene.ego is not None
        ahead = max(self.scene.rigs[self.rig], key=lambda each: each.camera_to_ego[0, 2])
        first = int(np.argmax(self.scene.ego.valid))
        return rig_camera(self.scene, self.rig, ahead.name, float(self._times_s[first]))

    @property
    def _times_s(self) -> Float64[np.ndarray, " t"]:
        assert self.scene.ego is not None
        return self.scene.ego.times


def mounted_cameras(scene: Scene, names: tuple[str, ...]) -> list[MountedCamera]:
    """Find rig cameras by RIG (all of a rig), RIG/NAME, NAME, or "all"; each once, in the order of the rigs.

    Raises `ValueError` for a name that fits none, and where the scene has no ego vehicle.
    """
    every = [(rig, camera) for rig, cameras in scene.rigs.items() for camera in cameras]
    if not every or scene.ego is None or not len(scene.ego.times):
        raise ValueError(f"scene {scene.name!r} has no vehicle with cameras")
    for name in names:
        if not any(_fits(name, rig, camera) for rig, camera in every):
            known = ", ".join(f"{rig}/{camera.name}" for rig, camera in every)
            raise ValueError(f"scene {scene.name!r} has no camera {name!r}, only {known}")
    chosen = [(rig, camera) for rig, camera in every if any(_fits(name, rig, camera) for name in names)]
    return [MountedCamera(scene, rig, camera.name) for rig, camera in chosen]


def _fits(name: str, rig: str, camera: RigCamera) -> bool:
    return name in ("all", rig, camera.name, f"{rig}/{camera.name}")
