"""Points and boxes are drawn where they are seen."""

from pathlib import Path

import numpy as np

from gsrain_engine.datasets.capture import Capture, CaptureFrame, LidarSweep, TrackedBox
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.summary import chosen_views, contact_sheet, overlay
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import PoseTrack

AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera(200, 100, 100.0, 100.0, 100.0, 50.0, AHEAD)


def view(name: str, sensor: str = "", time_s: float = 0.0) -> CaptureFrame:
    return CaptureFrame(name, CAMERA, np.zeros((100, 200, 3), np.uint8), time_s, sensor)


def test_near_points_are_red_and_far_ones_blue() -> None:
    points = np.array([[5.0, 2.0, 0.0], [50.0, -20.0, 0.0]], np.float32)
    capture = Capture("c", (view("v"),), sweeps=(LidarSweep(0.0, points, np.zeros(3)),))
    picture = overlay(capture, capture[0], 200)
    near, far = picture[50, 100 - 40].astype(int), picture[50, 100 + 40].astype(int)
    assert near[0] > near[2] + 80
    assert far[2] > far[0] + 40
    assert picture.any(axis=2).sum() < 30


def test_points_of_colmap_are_drawn_where_no_lidar_is() -> None:
    capture = Capture("c", (view("v"),), points_m=np.array([[0.5, 0.0, 0.1]]), is_metric=False)
    rows, columns = np.nonzero(overlay(capture, capture[0], 200).any(axis=2))
    assert abs(rows.mean() - 30) < 1
    assert abs(columns.mean() - 100) < 1


def test_boxes_are_drawn_in_their_time_with_a_red_front() -> None:
    track = PoseTrack(
        np.array([0.0, 1.0]), np.array([[10.0, 0, -1], [10.0, 0, -1]]), np.eye(4)[[0, 0]], np.array([True, False])
    )
    box = TrackedBox("1", "car", (4.0, 2.0, 2.0), track)
    capture = Capture("c", (view("there"), view("gone", time_s=1.5)), boxes=(box,))
    drawn = overlay(capture, capture[0], 200)
    assert not overlay(capture, capture[1], 200).any()
    # The back face is 8 m away, 2 m wide and high: 25 px around the center; the front, 12 m away, is 16.7 px.
    rows, columns = np.nonzero(drawn.any(axis=2))
    np.testing.assert_allclose(
        [columns.min(), columns.max(), rows.min(), rows.max()], [87.5, 112.5, 37.5, 62.5], atol=2
    )
    red = (drawn[..., 0] > 150) & (drawn[..., 2] < 120)
    assert abs(np.nonzero(red)[1].min() - 91.7) < 2


def test_a_box_around_the_camera_is_cut_at_it() -> None:
    track = PoseTrack(np.array([0.0]), np.zeros((1, 3)) - [0, 0, 1], np.eye(4)[:1], np.array([True]))
    capture = Capture("c", (view("v"),), boxes=(TrackedBox("1", "ego", (4.0, 2.0, 2.0), track),))
    assert overlay(capture, capture[0], 200).any()


def test_views_are_chosen_from_all_cameras() -> None:
    views = tuple(view(f"{s}{k}", s, float(k)) for k in range(9) for s in ("left", "right"))
    capture = Capture("c", views)
    assert [each.name for each in chosen_views(capture, 2)] == ["left4", "right4"]
    assert [each.name for each in chosen_views(capture, 6)] == ["left0", "left4", "left8", "right0", "right4", "right8"]
    sheet = contact_sheet(capture, 4, 100)
    assert sheet.shape == (2 * (50 + 22), 2 * 100 + 4, 3)


def test_real_lidar_is_drawn_below_the_sky(test_data: Path) -> None:
    capture = open_capture(test_data / "driving" / "nuscenes_sample")
    front = next(view for view in capture if view.sensor == "CAM_FRONT")
    picture = overlay(capture, front, 640)
    changed = np.abs(picture.astype(int) - overlay(Capture("c", (front,)), front, 640)).max(axis=2) > 40
    assert 0.03 < changed.mean() < 0.3
    assert changed[:60].mean() < 0.01  # nothing is measured in the sky
