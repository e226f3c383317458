"""Range images of the miniature drive, as Waymo's lidar on the roof would record them."""

import numpy as np

from mini_drive import BOX_LWH, MiniDrive, turned

ROWS, COLUMNS = 12, 180
BEAMS = np.radians(np.linspace(-28.0, -3.0, ROWS) + np.sin(np.arange(ROWS)))
"""From the lowest up, not evenly spaced."""
LIDAR_TO_VEHICLE = turned(np.radians(-148.0), (1.43, 0.0, 2.18))


def range_image(drive: MiniDrive, sample: int, shift_m: float = 0.0) -> np.ndarray:
    """Range, intensity, elongation, zone of each pixel, while the vehicle is `shift_m` ahead of its sample's pose."""
    ratios = (np.arange(COLUMNS, 0, -1) - 0.5) / COLUMNS
    azimuth = (ratios * 2 - 1) * np.pi - np.arctan2(LIDAR_TO_VEHICLE[1, 0], LIDAR_TO_VEHICLE[0, 0])
    inclination = BEAMS[::-1, None]
    flat = np.cos(inclination)
    beams = np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.broadcast_to(np.sin(inclination), (ROWS, COLUMNS))], axis=-1
    )
    directions = beams @ LIDAR_TO_VEHICLE[:3, :3].T
    origin = LIDAR_TO_VEHICLE[:3, 3] + [shift_m, 0, 0]
    with np.errstate(divide="ignore"):
        road = np.where(directions[..., 2] < 0, (drive.road_m - origin[2]) / directions[..., 2], np.inf)
    box = np.linalg.inv(drive.box_to_vehicle(sample))
    start, along = box[:3, :3] @ origin + box[:3, 3], directions @ box[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.sort((np.array([[-1.0], [1.0]]) * np.array(BOX_LWH) / 2 - start)[:, None, None] / along, axis=0)
    near, far = faces[0].max(axis=-1), faces[1].min(axis=-1)
    distance = np.minimum(road, np.where((near < far) & (near > 0), near, np.inf))
    image = np.zeros((ROWS, COLUMNS, 4), np.float32)
    image[..., 0] = np.where(distance < 60, distance, -1.0)
    image[..., 1] = 0.5
    return image


def pixel_poses(drive: MiniDrive, sample: int, shift_m: float) -> np.ndarray:
    """Roll, pitch, yaw and place of the vehicle at every pixel."""
    pose = drive.vehicle_to_world(sample) @ turned(0.0, (shift_m, 0.0, 0.0))
    yaw = np.arctan2(pose[1, 0], pose[0, 0])
    return np.broadcast_to(np.array([0.0, 0.0, yaw, *pose[:3, 3]], np.float32), (ROWS, COLUMNS, 6)).copy()
