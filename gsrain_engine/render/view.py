"""Views for which pictures are drawn, and the frame of the rain around them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from ..rain.frame import RainCamera
from ..rain.shelter_map import shelter_map_of
from ..rain.simulation import RainSimulation
from ..scene.camera import Camera
from ..scene.scene import Scene, is_single_object


@dataclass(frozen=True, slots=True, eq=False)
class RenderView:
    """Camera, time and motion for which a scene is drawn. World frame, meters."""

    camera: Camera
    time_s: float = 0.0
    velocity_m_s: Float64[np.ndarray, "3"] | None = None
    """Velocity of the camera; None is that of its rolling shutter, or at rest."""
    focal_px: float | None = None
    """Focal length of the output image if a smaller one is drawn; None uses the camera's."""
    exposure_share: float = 1.0
    """Fraction of the shutter time, for one of several sub-frames that share it."""


_STEP_S = 0.005  # half the time step of the velocity estimate


def ego_view(scene: Scene, camera: Camera, time_s: float) -> RenderView:
    """View of a camera that is fixed to the scene's ego vehicle, if the vehicle is present; else it is at rest."""
    now, before, after = (scene.ego_to_world(time_s + step) for step in (0.0, -_STEP_S, _STEP_S))
    velocity_m_s = np.zeros(3)
    if now is not None and before is not None and after is not None:
        mounted = np.linalg.inv(now) @ np.append(camera.position, 1.0)
        velocity_m_s = ((after - before) @ mounted)[:3] / (2 * _STEP_S)
    return RenderView(camera, time_s, velocity_m_s)


def rain_camera(scene: Scene, rainfall: RainSimulation, shot: RenderView) -> RainCamera:
    """Camera and surroundings of the rain for a view."""
    mounted, camera, velocity = _ego_anchor(scene, rainfall, shot), shot.camera, shot.velocity_m_s
    if velocity is None:
        velocity = np.zeros(3)
        if camera.rolling is not None:
            velocity = camera.world_to_camera[:3, :3].T @ camera.rolling.velocity_m_s
    return RainCamera(
        shot.camera,
        _leveled_at(shot.camera) if mounted is None else mounted,
        velocity,
        shot.focal_px,
        shelter_map_of(scene) if rainfall.rain.roofs else None,
        shot.exposure_share,
        scene.ground_m if mounted is None else None,
        _floor_m(scene, shot.camera),
    )


def _floor_m(scene: Scene, camera: Camera) -> float | None:
    """Height of the ground below a camera, if it is known; none below a single object, since it ends soon."""
    if is_single_object(scene):
        return None
    if scene.water is None or scene.water.heights_m is None:
        return scene.ground_m
    return float(scene.water.height_at(camera.position[None, :2])[0])


def rain_anchor(scene: Scene, rainfall: RainSimulation, shot: RenderView) -> Float64[np.ndarray, "4 4"]:
    """Frame of the rain regions.

    For a camera on the ego vehicle it is the vehicle's frame, leveled, so that all cameras of a rig show the same
    drops. Any other camera carries the regions along: they are at its position and turn with its heading.
    """
    mounted = _ego_anchor(scene, rainfall, shot)
    return _leveled_at(shot.camera) if mounted is None else mounted


def _leveled_at(camera: Camera) -> Float64[np.ndarray, "4 4"]:
    return leveled_frame(camera.world_to_camera[2, :3], camera.position)


def _ego_anchor(scene: Scene, rainfall: RainSimulation, shot: RenderView) -> Float64[np.ndarray, "4 4"] | None:
    """Leveled frame of the ego vehicle if the camera is mounted on it; else None."""
    ego = scene.ego_to_world(shot.time_s)
    if ego is None:
        return None
    level = leveled_frame(ego[:3, 0], ego[:3, 3])
    local = level[:3, :3].T @ (shot.camera.position - level[:3, 3])
    region = rainfall.rain.streak_region
    return level if np.all(local >= region.minimum_m) and np.all(local <= region.maximum_m) else None


def leveled_frame(forward: Float64[np.ndarray, "3"], origin: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Frame of the rain's regions: x along a heading, z up, without tilt."""
    length = float(np.hypot(forward[0], forward[1]))
    x, y = (forward[0] / length, forward[1] / length) if length > 1e-6 else (1.0, 0.0)
    frame = np.eye(4)
    frame[:2, :2] = [[x, -y], [y, x]]
    frame[:3, 3] = origin
    return frame
