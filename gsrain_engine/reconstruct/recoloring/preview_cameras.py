"""Where a preview looks at a scene from. World frame (metres, z up)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import RigCamera, Scene

PREVIEW_PIXELS = 480 * 320
"""Size of a preview image, whatever its shape."""

EYE_HEIGHT_M = 1.6
_FIELD_OF_VIEW_DEG = 60.0


class PreviewCamera(NamedTuple):
    """A camera, and when: actors stand where they are at that time."""

    camera: Camera
    time_s: float


def preview_cameras(scene: Scene, count: int = 8) -> list[PreviewCamera]:
    """Choose cameras: along the ego vehicle's way where the scene has one with a rig, else around its middle."""
    rig = next((cameras for cameras in scene.rigs.values() if cameras), ())
    if scene.ego is not None and len(scene.ego.times) and rig:
        along = _along_the_ego_track(scene, rig, count)
        if along:
            return along
    return _around_the_middle(scene, count)


def _along_the_ego_track(scene: Scene, rig: Sequence[RigCamera], count: int) -> list[PreviewCamera]:
    """Spread views over the way driven, the front camera at every other one, the others in turn between."""
    assert scene.ego is not None
    ordered = sorted(rig, key=lambda each: -each.camera_to_ego[0, 2])  # forward is +x of the ego frame
    front, others = ordered[0], ordered[1:] or ordered
    times = _evenly_driven(scene.ego.times, scene.ego.positions, count)
    chosen = [front if i % 2 == 0 else others[i // 2 % len(others)] for i in range(count)]
    views: list[PreviewCamera] = []
    for time_s, mounted in zip(times, chosen, strict=True):
        ego_to_world = scene.ego_to_world(time_s)
        if ego_to_world is not None:
            views.append(PreviewCamera(_preview_size(mounted, ego_to_world @ mounted.camera_to_ego), time_s))
    return views


def _evenly_driven(times: Float64[np.ndarray, " t"], positions: Float64[np.ndarray, "t 3"], count: int) -> list[float]:
    """Times at which equal shares of the way are driven; of time, where the vehicle stands still."""
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    if driven[-1] <= 0:
        driven = times - times[0]
    shares = (np.arange(count) + 0.5) / count
    return [float(t) for t in np.interp(shares * driven[-1], driven, times)]


def _preview_size(mounted: RigCamera, camera_to_world: Float64[np.ndarray, "4 4"]) -> Camera:
    camera = Camera(
        mounted.width, mounted.height, mounted.fx, mounted.fy, mounted.cx, mounted.cy,
        np.linalg.inv(camera_to_world), mounted.exposure_s,
    )  # fmt: skip
    shrink = np.sqrt(PREVIEW_PIXELS / (camera.width * camera.height))
    return camera.resized(max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))


def _around_the_middle(scene: Scene, count: int) -> list[PreviewCamera]:
    """Look outwards from the middle and inwards from a ring, in turn: one of the two suits a street, one an object."""
    middle, reach = _robust_extent(scene)
    width, height = 480, 320
    views: list[PreviewCamera] = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        ring = middle + 2.2 * reach * outward + np.array([0, 0, 0.3 * reach])
        eye, target = (middle, middle + outward) if i % 2 else (ring, middle)
        pose = look_at(eye, target, np.array([0.0, 0.0, 1.0]))
        views.append(PreviewCamera(Camera.from_fov(width, height, _FIELD_OF_VIEW_DEG, pose), 0.0))
    return views


def _robust_extent(scene: Scene) -> tuple[Float[np.ndarray, "3"], float]:
    """Middle of the box that holds the visible Gaussians but the outer twentieths, and half its diagonal.

    In metres; sky is left out; the middle is at eye height where the ground is known.
    """
    layers = [layer for layer in scene.layers if layer.visible and layer.kind != "sky"]
    parts = [part for layer in layers if (part := scene.part(layer)) is not None]
    places = [part.remaining.means @ part.to_world[:3, :3].T + part.to_world[:3, 3] for part in parts]
    points = np.concatenate([np.zeros((0, 3)), *places])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return np.array([0.0, 0.0, EYE_HEIGHT_M]), 1.0
    low, high = np.quantile(points, [0.05, 0.95], axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
    if scene.ground_m is not None:
        middle[2] = scene.ground_m + EYE_HEIGHT_M
    return middle, max(reach, 1e-3)
