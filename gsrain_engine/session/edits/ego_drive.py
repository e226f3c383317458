"""A drive for scenes that came without one: the ego vehicle goes where a camera went."""

from dataclasses import replace

import numpy as np
import scipy
from jaxtyping import Float64

from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.rotations import quaternions_from_matrices
from gsrain_engine.scene.scene import RigCamera, Scene
from gsrain_engine.scene.track import Track

RIG = "drive"
"""What the rig is called that comes with such a drive."""

_STEP_M = 0.5
"""Closer samples say more of the camera's shaking than of the way."""
_SAMPLES_PER_S, _MOST_SAMPLES = 10.0, 20_000
_AHEAD_COS = 0.5
"""A camera that looks within 60 degrees of the way shows what a driver sees."""
_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera axes (x right, y down, z forward) to ego axes (x forward, y left, z up), looking straight ahead."""


def drive_along(scene: Scene, path: CameraPath, width: int = 1600, height: int = 900) -> Scene:
    """Let the ego vehicle drive where a camera flew; `path` is in the scene's units and axes.

    The rig frame's origin is the camera's place; the vehicle stands upright and heads where it goes. A scene without
    rigs gets one of a single camera: the flown one as it was turned on average, or, where that looked backwards or
    aside, one that looks ahead. `width` and `height` are those of its pictures, px.

    Raises ValueError where the camera moves less than a step of 0.5 m.
    """
    times = _times(path)
    to_world = scene.scene_to_world
    cameras = [path.camera(float(t), width, height) for t in times]
    places = np.stack([to_world[:3, :3] @ each.position + to_world[:3, 3] for each in cameras])
    kept = _apart(places)
    if len(kept) < 2:
        raise ValueError(f"The camera moves less than {_STEP_M:g} m: no vehicle can drive along that.")
    way = np.gradient(places[kept], axis=0)
    headings = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    rotation = scipy.spatial.transform.Rotation
    upright = rotation.from_rotvec(np.outer(headings, [0.0, 0.0, 1.0]))
    track = Track(
        times[kept],
        (places[kept] - to_world[:3, 3]) @ np.linalg.inv(to_world[:3, :3]).T,
        _in_scene(upright.as_matrix(), to_world),
        np.ones(len(kept), np.bool_),
    )
    turn = to_world[:3, :3] / np.cbrt(np.linalg.det(to_world[:3, :3]))
    seen = np.stack([turn @ cameras[i].camera_to_world[:3, :3] for i in kept])
    mean = (upright.inv() * rotation.from_matrix(seen)).mean().as_matrix()
    first = cameras[0]
    mounted = RigCamera(
        "front", first.width, first.height, first.fx, first.fy, first.cx, first.cy,
        _pose(mean if mean[0, 2] > _AHEAD_COS else _LEVEL), path.exposure_s,
    )  # fmt: skip
    return replace(scene, ego=track, rigs=scene.rigs or {RIG: (mounted,)})


def drive_along_own_path(scene: Scene) -> Scene:
    """Let the ego vehicle drive along the scene's own camera path; raises ValueError where there is none."""
    if scene.path is None:
        raise ValueError("The scene has no camera path to drive along: key one on the timeline, or import one.")
    return drive_along(scene, scene.path)


def _times(path: CameraPath) -> Float64[np.ndarray, " n"]:
    """Return the moments of all keys, and more between them."""
    count = int(np.clip(path.duration_s * _SAMPLES_PER_S, 2, _MOST_SAMPLES))
    return np.union1d(np.linspace(path.start_s, path.end_s, count), path.times_s)


def _apart(places: Float64[np.ndarray, "n 3"]) -> list[int]:
    """Indices of places that are at least a step apart on the ground, the first and the last among them."""
    kept: list[int] = []
    for i, place in enumerate(places):
        if not kept or np.linalg.norm(place[:2] - places[kept[-1]][:2]) >= _STEP_M:
            kept.append(i)
    return [*kept[:-1], len(places) - 1] if len(kept) > 1 else kept


def _in_scene(
    upright: Float64[np.ndarray, "n 3 3"], to_world: Float64[np.ndarray, "4 4"]
) -> Float64[np.ndarray, "n 4"]:
    turn = to_world[:3, :3] / np.cbrt(np.linalg.det(to_world[:3, :3]))
    return np.asarray(quaternions_from_matrices(turn.T @ upright), np.float64)


def _pose(rotation: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix
