"""A drive whose geometry is known, for readers of data sets: each test writes it down as its data set would."""

import io
from dataclasses import dataclass, field

import numpy as np
from PIL import Image

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture
from gsrain_engine.datasets.geometry import project_points
from gsrain_engine.scene.geometry import quaternions_from_matrices

WIDTH, HEIGHT, FOCAL = 64, 48, 40.0
YAW = np.radians(30.0)
STEP_M, STEP_S = 1.5, 0.5
BOX_LWH = (4.2, 1.8, 1.5)
BOX_ID, BOX_CLASS = "7", "Car"


def turned(yaw: float, place: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    matrix[:3, 3] = place
    return matrix


def quaternion(pose: np.ndarray) -> list[float]:
    return quaternions_from_matrices(pose[:3, :3]).tolist()


@dataclass(frozen=True)
class MiniDrive:
    """Two samples or more. The vehicle's frame lies `road_m` below its origin; a parked car stands ahead."""

    road_m: float = 0.0
    offset: tuple[float, float, float] = (1000.0, -2000.0, 30.0)
    samples: int = 3
    camera_to_vehicle: np.ndarray = field(init=False)
    """OpenCV axes; ahead at the windscreen, 1.6 m above the road, looking forward and 5 degrees to the left."""
    lidar_to_vehicle: np.ndarray = field(init=False)
    """Above the roof, turned by a quarter, as in nuScenes: x right, y forward, z up."""

    def __post_init__(self) -> None:
        axes = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
        object.__setattr__(self, "camera_to_vehicle", turned(np.radians(5.0), (1.5, 0.0, 1.6 + self.road_m)) @ axes)
        object.__setattr__(self, "lidar_to_vehicle", turned(-np.pi / 2, (1.0, 0.0, 1.8 + self.road_m)))

    def time(self, sample: int) -> float:
        return 1_532_402_927.5 + sample * STEP_S

    def vehicle_to_world(self, sample: int) -> np.ndarray:
        x, y, z = self.offset
        ahead = sample * STEP_M
        return turned(YAW, (x + ahead * np.cos(YAW), y + ahead * np.sin(YAW), z))

    def box_to_vehicle(self, sample: int) -> np.ndarray:
        """Box, with its center, to the vehicle's frame."""
        return turned(np.radians(20.0), (12.0 - sample * STEP_M, 2.0, BOX_LWH[2] / 2 + self.road_m))

    def box_to_world(self) -> np.ndarray:
        return self.vehicle_to_world(0) @ self.box_to_vehicle(0)

    def lidar_points(self, sample: int) -> np.ndarray:
        """Points of the road and of the car's faces, in the lidar's frame."""
        x, y = np.meshgrid(np.linspace(-9, 9, 25), np.linspace(-6, 6, 17))
        road = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, self.road_m)])
        local = np.random.default_rng(sample).uniform(-0.98, 0.98, (60, 3)) * np.array(BOX_LWH) / 2
        pose = self.box_to_vehicle(sample)
        car = local @ pose[:3, :3].T + pose[:3, 3]
        back = np.linalg.inv(self.lidar_to_vehicle)
        return (np.concatenate([road, car]) @ back[:3, :3].T + back[:3, 3]).astype(np.float32)

    def jpeg(self, sample: int = 0, size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
        stream = io.BytesIO()
        Image.new("RGB", size, (40 + 20 * sample, 90, 160)).save(stream, "JPEG")
        return stream.getvalue()

    def check(self, capture: Capture, *, views: int | None = None, has_boxes: bool = True) -> None:
        """Assert that a capture has this geometry, in its own world: level, meters, origin at the ego's first place."""
        assert len(capture) == (self.samples if views is None else views)
        assert capture.is_metric
        turn = turned(YAW, (0.0, 0.0, 0.0))[:3, :3]
        assert capture.ego is not None
        np.testing.assert_allclose(capture.ego.positions[0], 0.0, atol=1e-6)
        for sample in range(self.samples):
            pose = capture.ego.pose(capture.sweeps[sample].time_s)
            assert pose is not None
            np.testing.assert_allclose(pose[:3, 3], turn @ [sample * STEP_M, 0.0, 0.0], atol=2e-3)
            np.testing.assert_allclose(pose[:3, :3], turn, atol=1e-4)
        first = min(capture.views, key=lambda view: view.time_s)
        assert first.time_s == 0.0
        in_ego = np.array([1.5, 0.0, 1.6 - EGO_HEIGHT_M])
        np.testing.assert_allclose(first.camera.position, turn @ in_ego, atol=2e-3)
        # A straight line through the lens: ahead, and 5 degrees to the left of the vehicle.
        ahead = turned(YAW + np.radians(5.0), (0.0, 0.0, 0.0))[:3, :3] @ [10.0, 1.0, -0.5] + first.camera.position
        pixels, depths = project_points(ahead[None], first.camera)
        np.testing.assert_allclose(depths, 10.0, atol=1e-3)
        np.testing.assert_allclose(
            pixels[0], [first.camera.cx - FOCAL * 0.1, first.camera.cy + FOCAL * 0.05], atol=2e-3
        )
        assert len(capture.sweeps) == self.samples
        for sweep in capture.sweeps:
            road = np.median(sweep.points_m[:, 2])
            assert abs(road + EGO_HEIGHT_M) < 2e-3
            assert abs(sweep.origin_m[2] - (1.8 - EGO_HEIGHT_M)) < 2e-3
        if has_boxes:
            self.check_boxes(capture)

    def check_boxes(self, capture: Capture, box_class: str = BOX_CLASS) -> None:
        """Assert that the parked car is where it stands, and that its points are inside."""
        (box,) = capture.boxes
        assert box.class_name == box_class
        np.testing.assert_allclose(box.size_lwh, BOX_LWH, atol=1e-5)
        for sweep in capture.sweeps:
            pose = box.track.pose(sweep.time_s)
            assert pose is not None
            expected = turned(YAW, (0.0, 0.0, 0.0))[:3, :3] @ [12.0, 2.0, -EGO_HEIGHT_M]
            np.testing.assert_allclose(pose[:3, 3], expected, atol=2e-3)
            np.testing.assert_allclose(
                pose[:3, 0], [np.cos(YAW + np.radians(20)), np.sin(YAW + np.radians(20)), 0], atol=1e-4
            )
            assert points_inside(capture, sweep.points_m, 0, sweep.time_s, slack_m=-0.008) == 60  # and none of the road


def points_inside(capture: Capture, points: np.ndarray, box: int, time_s: float, slack_m: float = 0.0) -> int:
    """Number of points in a box of a capture at a time."""
    found = capture.boxes[box]
    pose = found.track.pose(time_s)
    if pose is None:
        return 0
    local = (points - pose[:3, 3]) @ pose[:3, :3] - [0.0, 0.0, found.size_lwh[2] / 2]
    return int(np.count_nonzero((np.abs(local) <= np.array(found.size_lwh) / 2 + slack_m).all(axis=1)))
