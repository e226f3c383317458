"""Edits of actors and the ego vehicle: track, orientation, timing, start pose, and the scene's origin."""

from dataclasses import replace

import numpy as np
import scipy
from jaxtyping import Float64

from ...scene.camera_path import CameraPath
from ...scene.geometry import quaternion_product, quaternions_from_matrices
from ...scene.scene import Actor, PoseTrack, RigCamera, Scene
from ...scene.transforms import transform_gaussians
from .lamps import moved_lamps
from .members import find_unlocked_member


def moved_actor(actor: Actor, similarity: Float64[np.ndarray, "4 4"]) -> Actor:
    """Transform an actor with its whole track by a similarity of the scene; its Gaussians scale along."""
    moved = replace(actor, track=actor.track.moved(similarity))
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    if abs(scale - 1) < 1e-12:
        return moved
    length, width, height = (scale * each for each in actor.size_lwh)
    gaussians = transform_gaussians(actor.gaussians, np.diag([scale, scale, scale, 1.0]))
    return replace(moved, gaussians=gaussians, size_lwh=(length, width, height))


def turn_actor(scene: Scene, key: str, left_deg: float) -> Scene:
    """Rotate an unlocked actor to the left about its own z axis, at every time; its positions stay."""
    actor = _unlocked_actor(scene, key)
    half = np.radians(left_deg) / 2
    turn = np.broadcast_to([np.cos(half), 0.0, 0.0, np.sin(half)], actor.track.quaternions_wxyz.shape)
    quaternions = quaternion_product(actor.track.quaternions_wxyz, turn)
    return scene.with_member(key, track=replace(actor.track, quaternions_wxyz=quaternions))


def retime_actor(scene: Scene, key: str, start_s: float, duration_s: float) -> Scene:
    """Change start and duration (above 0) of an unlocked actor's track; a track of one sample only shifts."""
    actor = _unlocked_actor(scene, key)
    if not (duration_s > 0 and np.isfinite([start_s, duration_s]).all()):
        raise ValueError(f"The drive of {actor.name} must last longer than 0 s, not {duration_s:g} s.")
    times, span = actor.track.times, duration_of(actor)
    stretch = duration_s / span if span > 0 else 1.0
    return scene.with_member(key, track=replace(actor.track, times=start_s + stretch * (times - times[:1])))


def start_of(actor: Actor) -> float:
    """Time of the first sample of the actor's track, in seconds."""
    return float(actor.track.times[0]) if len(actor.track.times) else 0.0


def duration_of(actor: Actor) -> float:
    """Duration of the actor's track in seconds."""
    times = actor.track.times
    return float(times[-1] - times[0]) if len(times) else 0.0


def _unlocked_actor(scene: Scene, key: str) -> Actor:
    actor = find_unlocked_member(scene, key)
    if not isinstance(actor, Actor):
        raise ValueError(f"{actor.name} is a layer: it stands still.")
    return actor


# Ego drive along a camera path

RIG = "drive"  # name of the rig that `drive_along` creates
_STEP_M = 0.5  # minimum distance of samples: closer ones show the camera's shaking rather than the route
_SAMPLES_PER_S, _MAX_SAMPLES = 10.0, 20_000
_AHEAD_COS = 0.5  # minimum cosine to the direction of travel at which the rig has the camera's orientation
_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera axes (x right, y down, z forward) to ego axes (x forward, y left, z up), looking straight ahead."""


def drive_along(scene: Scene, path: CameraPath, width: int = 1600, height: int = 900) -> Scene:
    """Let the ego vehicle drive along a camera path, in the scene's units and axes.

    The rig frame's origin is the camera position; the vehicle is upright and faces its direction of travel. A scene
    without rigs gets one with a single camera: the path's camera in its mean orientation or, if that points backward or
    sideways, a camera that points ahead. `width` and `height` are its image size in px.

    Raises ValueError if the camera moves less than a step of 0.5 m.
    """
    to_world = scene.scene_to_world
    turn = to_world[:3, :3] / np.cbrt(np.linalg.det(to_world[:3, :3]))
    count = int(np.clip(path.duration_s * _SAMPLES_PER_S, 2, _MAX_SAMPLES))
    times = np.union1d(np.linspace(path.start_s, path.end_s, count), path.times_s)
    cameras = [path.camera(float(t), width, height) for t in times]
    places = np.stack([to_world[:3, :3] @ each.position + to_world[:3, 3] for each in cameras])
    rows = _apart(places)
    if len(rows) < 2:
        raise ValueError(f"The camera moves less than {_STEP_M:g} m: no vehicle can drive along that.")
    ahead = np.gradient(places[rows], axis=0)
    headings = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    rotation = scipy.spatial.transform.Rotation
    upright = rotation.from_rotvec(np.outer(headings, [0.0, 0.0, 1.0]))
    track = PoseTrack(
        times[rows],
        (places[rows] - to_world[:3, 3]) @ np.linalg.inv(to_world[:3, :3]).T,
        np.asarray(quaternions_from_matrices(turn.T @ upright.as_matrix()), np.float64),
        np.ones(len(rows), np.bool_),
    )
    cameras_to_world = np.stack([turn @ cameras[i].camera_to_world[:3, :3] for i in rows])
    mean = (upright.inv() * rotation.from_matrix(cameras_to_world)).mean().as_matrix()
    camera_to_ego, first = np.eye(4), cameras[0]
    camera_to_ego[:3, :3] = mean if mean[0, 2] > _AHEAD_COS else _LEVEL
    mounted = RigCamera(
        "front", first.width, first.height, first.fx, first.fy, first.cx, first.cy, camera_to_ego, path.exposure_s
    )
    return replace(scene, ego=track, rigs=scene.rigs or {RIG: (mounted,)})


def drive_along_own_path(scene: Scene) -> Scene:
    """Let the ego vehicle drive along the scene's own camera path; raises ValueError if there is none."""
    if scene.path is None:
        raise ValueError("The scene has no camera path to drive along: key one on the timeline, or import one.")
    return drive_along(scene, scene.path)


def _apart(places: Float64[np.ndarray, "n 3"]) -> list[int]:
    """Indices of positions at least a step apart on the ground, including the first and the last."""
    rows = [0]
    for i, place in enumerate(places):
        if np.linalg.norm(place[:2] - places[rows[-1]][:2]) >= _STEP_M:
            rows.append(i)
    return [*rows[:-1], len(places) - 1] if len(rows) > 1 else rows


# Ego start and scene origin

SENSOR_HEIGHT_M = 1.5
"""Default height of the ego frame's origin above the ground."""


def set_ego_start(scene: Scene, ground_point_m: Float64[np.ndarray, "3"], heading_rad: float) -> Scene:
    """Set the start of the ego vehicle to a point above the ground, in the world (meters, z up).

    An existing drive moves as a whole and keeps its direction and its height above its own start. Otherwise creates a
    standing ego at sensor height; the heading is counted from +x to +y.
    """
    world_to_scene = np.linalg.inv(scene.scene_to_world)
    place = ground_point_m + np.array([0.0, 0.0, SENSOR_HEIGHT_M])
    if scene.ego is not None and len(scene.ego.times):
        there = np.eye(4)
        there[:3, 3] = world_to_scene[:3, :3] @ place + world_to_scene[:3, 3] - scene.ego.positions[0]
        return replace(scene, ego=scene.ego.moved(there))
    c, s = float(np.cos(heading_rad)), float(np.sin(heading_rad))
    pose = np.array([[c, -s, 0, place[0]], [s, c, 0, place[1]], [0, 0, 1, place[2]], [0, 0, 0, 1.0]])
    standing = PoseTrack(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones(1, np.bool_))
    return replace(scene, ego=standing.moved(world_to_scene @ pose))


def set_origin(scene: Scene, point_m: Float64[np.ndarray, "3"]) -> Scene:
    """Move everything, also locked layers, so that a point of the world becomes its origin."""
    shift = np.eye(4)
    shift[:3, 3] = -np.linalg.inv(scene.scene_to_world)[:3, :3] @ point_m
    return replace(
        scene,
        layers=tuple(replace(each, to_scene=shift @ each.to_scene) for each in scene.layers),
        actors=tuple(replace(each, track=each.track.moved(shift)) for each in scene.actors),
        ego=None if scene.ego is None else scene.ego.moved(shift),
        lamps=moved_lamps(scene.lamps, shift),
        path=None if scene.path is None else scene.path.moved(shift),
        views=tuple(view.moved(shift) for view in scene.views),
        ground_m=None if scene.ground_m is None else scene.ground_m - float(point_m[2]),
        water=None if scene.water is None else scene.water.moved(*(-point_m).tolist()),
    )
