"""A drive through a world that is known exactly: a chequered road, a striped wall ahead of it, a blue sky."""

import numpy as np

from gsrain_engine.datasets.capture import Capture, CaptureFrame, LidarSweep, TrackedBox
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import PoseTrack

WALL_X, WALL_HEIGHT, ROAD_Z = 30.0, 4.0, -1.5
SKY = np.array([0.45, 0.62, 0.9])
WIDTH, HEIGHT = 96, 64


def drive_capture(frames: int = 6, step_m: float = 1.0, bonnet: int = 0, **changes: object) -> Capture:
    """Views of a camera that drives along x, a lidar on top; the lowest `bonnet` rows show the ego's own body."""
    views, sweeps = [], []
    for k in range(frames):
        eye = np.array([k * step_m, 0.0, 0.0])
        pose = look_at(eye, eye + [1.0, 0, 0], np.array([0.0, 0, 1]))
        camera = Camera(WIDTH, HEIGHT, 70.0, 70.0, WIDTH / 2, HEIGHT / 2, pose)
        image = (np.clip(world_colors(camera), 0, 1) * 255 + 0.5).astype(np.uint8)
        if bonnet:
            image[-bonnet:] = body(bonnet)
        views.append(CaptureFrame(f"{k}", camera, image, float(k), "FRONT"))
        sweeps.append(LidarSweep(float(k), scan(eye), eye))
    values = {"views": tuple(views), "sweeps": tuple(sweeps), **changes}
    return Capture("drive", **values)  # type: ignore[arg-type]


def body(rows: int) -> np.ndarray:
    columns = np.linspace(0, 1, WIDTH)
    stripes = 90 + 60 * np.sin(columns * 9)
    return np.repeat(np.repeat(stripes[None, :, None], rows, 0), 3, 2).astype(np.uint8)


def rays(camera: Camera) -> np.ndarray:
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    local = np.stack([*np.meshgrid(u, v), np.ones((camera.height, camera.width))], axis=-1)
    return local @ camera.world_to_camera[:3, :3]


def world_depth(camera: Camera) -> np.ndarray:
    """Depth along the view axis; inf in the sky."""
    eye, directions = camera.position, rays(camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        road = np.where(directions[..., 2] < 0, (ROAD_Z - eye[2]) / directions[..., 2], np.inf)
        wall = np.where(directions[..., 0] > 0, (WALL_X - eye[0]) / directions[..., 0], np.inf)
        is_wall = eye[2] + wall * directions[..., 2] <= WALL_HEIGHT
    return np.minimum(road, np.where(is_wall, wall, np.inf))


def world_colors(camera: Camera) -> np.ndarray:
    depth = world_depth(camera)
    finite = np.isfinite(depth)
    places = camera.position + np.where(finite, depth, 0)[..., None] * rays(camera)
    road = 0.35 + 0.2 * np.sin(places[..., 0] * 2.1) * np.sin(places[..., 1] * 1.7)
    wall = 0.3 + 0.2 * np.sin(places[..., 1] * 0.8 + places[..., 2])
    is_wall = places[..., 0] > WALL_X - 1e-3
    gray = np.where(is_wall, wall, road)[..., None] * np.array([1.0, 0.8, 0.6])
    return np.where(finite[..., None], gray, SKY)


def scan(eye: np.ndarray) -> np.ndarray:
    """Points of a lidar with rings, on road and wall."""
    azimuth = np.radians(np.arange(-50, 50, 0.5))
    elevation = np.radians(np.arange(-25, 5, 0.8))
    a, e = (each.ravel() for each in np.meshgrid(azimuth, elevation))
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    with np.errstate(divide="ignore"):
        road = np.where(directions[:, 2] < 0, (ROAD_Z - eye[2]) / directions[:, 2], np.inf)
    wall = (WALL_X - eye[0]) / directions[:, 0]
    distance = np.minimum(road, wall)
    points = eye + distance[:, None] * directions
    return points[points[:, 2] <= WALL_HEIGHT].astype(np.float32)


def box(name: str, start: tuple[float, float], speed_m_s: float, seconds: int = 6, label: str = "Car") -> TrackedBox:
    """A box of 4 x 2 x 1.5 m on the road that drives along x."""
    times = np.arange(seconds, dtype=np.float64)
    places = np.stack([start[0] + speed_m_s * times, np.full(seconds, start[1]), np.full(seconds, ROAD_Z)], axis=1)
    track = PoseTrack(times, places, np.tile([1.0, 0, 0, 0], (seconds, 1)), np.ones(seconds, np.bool_))
    return TrackedBox(name, label, (4.0, 2.0, 1.5), track)
