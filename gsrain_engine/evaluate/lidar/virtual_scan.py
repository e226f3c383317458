"""A lidar in a scene: what its beams hit, from four pictures of its surfaces around it."""

import math

import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.datasets.capture import EGO_HEIGHT_M
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene

from .beams import Beams
from .sensor import LidarSensor
from .surface_planes import Surfaces
from .sweep_beams import MATT

_FACE_DEG = 90.0
_MARGIN_PX = 4
_LARGEST_PX = 2048
_ROAD_UP = 0.95
_ROAD_M = 0.3


def scan_scene(
    scene: Scene, time_s: float, sensor_to_world: Float64[np.ndarray, "4 4"], sensor: LidarSensor, matt: float = MATT
) -> Beams:
    """Send the sensor's beams into a scene. `sensor_to_world` is a pose: x forward, y left, z up, metres.

    Everything has the same near-infrared reflectance `matt`, times the cosine of incidence: colours say nothing of it.
    All beams are sent at one moment. Sky is nothing.
    """
    own = _own_directions(sensor)
    directions = own @ sensor_to_world[:3, :3].T
    origin = sensor_to_world[:3, 3].copy()
    ranges, normals = np.full(len(own), np.inf), np.zeros((len(own), 3))
    azimuths = np.degrees(np.arctan2(own[:, 1], own[:, 0]))
    surfaces = Surfaces.of(scene, time_s)
    faces = np.round(azimuths / _FACE_DEG).astype(int) % 4
    for face in np.unique(faces).tolist():
        mine = np.flatnonzero(faces == face)
        camera = _face_camera(sensor, sensor_to_world, face)
        ranges[mine], normals[mine] = surfaces.met_by(directions[mine], camera)
    cosines = np.abs(np.sum(normals * directions, axis=1))
    found = np.isfinite(ranges)
    points = np.where(found[:, None], origin + directions * np.where(found, ranges, 0)[:, None], origin)
    return Beams(
        time_s=time_s,
        origin_m=origin,
        directions=directions,
        ranges_m=ranges,
        points_m=points.astype(np.float32),
        reflectances=matt * cosines,
        road_cosines=np.where(found & _is_road(scene, time_s, points, normals), cosines, 0.0),
        untouched=np.zeros(len(own), bool),
    ).heard_by(sensor)


def _own_directions(sensor: LidarSensor) -> Float64[np.ndarray, "n 3"]:
    """Unit directions in the sensor's own frame, ring by ring, each from its right to its left."""
    limit, step = sensor.azimuth_limit_deg, sensor.azimuth_step_deg
    azimuths = np.radians(-limit + step * (np.arange(round(2 * limit / step)) + 0.5))
    up, around = np.meshgrid(np.radians(sensor.elevations_deg), azimuths, indexing="ij")
    return np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(-1, 3)


def _face_camera(sensor: LidarSensor, sensor_to_world: Float64[np.ndarray, "4 4"], face: int) -> Camera:
    """A camera that sees a quarter of the beams, with pixels as wide as the azimuth's step."""
    focal = min(1 / math.radians(sensor.azimuth_step_deg), _LARGEST_PX / 2)
    half = math.ceil(focal) + _MARGIN_PX
    steepest = math.sqrt(2) * focal  # at a picture's sides, where rows of equal elevation rise
    top, bottom = (
        math.ceil(steepest * math.tan(math.radians(max(highest, 0.0)))) + _MARGIN_PX
        for highest in (max(sensor.elevations_deg), -min(sensor.elevations_deg))
    )
    turn = math.radians(_FACE_DEG * face)
    forward = np.array([math.cos(turn), math.sin(turn), 0.0])
    right = np.array([math.sin(turn), -math.cos(turn), 0.0])
    to_camera = np.eye(4)
    to_camera[:3, :3] = np.stack([right, (0.0, 0.0, -1.0), forward]) @ sensor_to_world[:3, :3].T
    to_camera[:3, 3] = -to_camera[:3, :3] @ sensor_to_world[:3, 3]
    return Camera(2 * half, top + bottom, focal, focal, float(half), float(top), to_camera)


def _is_road(
    scene: Scene, time_s: float, points_m: Float64[np.ndarray, "n 3"], normals: Float64[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """What lies flat at the height of the road, where that is known."""
    ego = scene.ego_to_world(time_s)
    height = scene.ground_m if ego is None else float(ego[2, 3]) - EGO_HEIGHT_M
    flat = normals[:, 2] > _ROAD_UP
    return flat if height is None else flat & (np.abs(points_m[:, 2] - height) < _ROAD_M)
