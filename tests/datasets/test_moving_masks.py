from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame
from gsrain_engine.datasets.depth_maps import measured_depths, static_sweeps
from gsrain_engine.datasets.masks import (
    box_outline,
    is_moving,
    moving_boxes,
    points_in_box,
    read_camera_masks,
    static_mask,
    with_camera_masks,
)
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.undistort import undistort_frame
from tests.training.drive_capture import HEIGHT, ROAD_Z, WIDTH, box, drive_capture


def test_speed_and_way_tell_what_moves() -> None:
    assert is_moving(box("fast", (10, 0), 3.0))
    assert not is_moving(box("parked", (10, 0), 0.0))
    assert not is_moving(box("jitter", (10, 0), 0.05))
    assert is_moving(box("seen once", (10, 0), 0.0, seconds=1))
    assert not is_moving(box("sign", (10, 0), 0.0, seconds=1, label="traffic_cone"))


@given(st.floats(4, 25), st.floats(-3, 3), st.floats(-20, 20), st.integers(0, 2**32 - 1))
def test_points_of_a_box_fall_into_its_mask(x: float, y: float, speed: float, seed: int) -> None:
    view = drive_capture(3).views[1]
    mover = box("car", (x, y), speed)
    pose = mover.track.pose(view.time_s)
    assert pose is not None
    local = np.random.default_rng(seed).uniform([-2, -1, 0], [2, 1, 1.5], (50, 3))
    world = local + pose[:3, 3]
    assert points_in_box(world, mover, view.time_s, 1e-6).all()
    seen = world @ view.camera.world_to_camera[:3, :3].T + view.camera.world_to_camera[:3, 3]
    seen = seen[seen[:, 2] > 0.2]
    u = seen[:, 0] / seen[:, 2] * view.camera.fx + view.camera.cx
    v = seen[:, 1] / seen[:, 2] * view.camera.fy + view.camera.cy
    inside = (u >= 0) & (u < WIDTH) & (v >= 0) & (v < HEIGHT)
    mask = static_mask(view, [mover])
    assert not mask[v[inside].astype(int), u[inside].astype(int)].any()


def test_the_rest_of_the_picture_stays() -> None:
    view = drive_capture(3).views[0]
    mask = static_mask(view, [box("car", (20, 0), 5.0)])
    assert 0.9 < mask.mean() < 1
    assert static_mask(view, [box("behind", (-20, 0), 5.0)]).all()
    assert not len(box_outline(view, box("behind", (-20, 0), 0.0)))
    own = np.ones((HEIGHT, WIDTH), bool)
    own[:10] = False
    assert not static_mask(replace(view, mask_source=own), [])[:10].any()


def test_points_on_movers_leave_the_sweeps() -> None:
    mover, parked = box("car", (10, 0), 5.0), box("parked", (10, 4), 0.0)
    points = np.array([[10, 0, -1], [10, 4, -1], [20, 0, ROAD_Z]], np.float32)
    capture = drive_capture(2, boxes=(mover, parked))
    sweeps = tuple(replace(sweep, points_m=points) for sweep in capture.sweeps)
    static = static_sweeps(replace(capture, sweeps=sweeps))
    assert [len(sweep.points_m) for sweep in static] == [2, 3]  # a second later the car is elsewhere
    assert [each.id for each in moving_boxes(capture)] == ["car"]


def test_a_persons_masks_go_to_their_cameras(tmp_path: Path) -> None:
    picture = np.zeros((20, 30), np.uint8)
    picture[:10] = 255
    Image.fromarray(picture).save(tmp_path / "FRONT.png")
    views = drive_capture(2).views
    masked = with_camera_masks(views, read_camera_masks(tmp_path))
    assert masked[0].mask is not None
    assert masked[0].mask[: HEIGHT // 2].all() and not masked[0].mask[HEIGHT // 2 :].any()
    other = replace(views[0], sensor="LEFT")
    assert with_camera_masks([other], read_camera_masks(tmp_path))[0].mask is None
    nameless = replace(views[0], sensor="")
    assert with_camera_masks([nameless], read_camera_masks(tmp_path))[0].mask is not None


def test_bad_masks_are_named(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="CAM_BACK"):
        read_camera_masks(tmp_path)
    (tmp_path / "FRONT.png").write_text("no picture")
    with pytest.raises(CaptureError, match=r"FRONT\.png"):
        read_camera_masks(tmp_path)


def test_the_following_car_of_a_real_drive_is_masked(test_data: Path) -> None:
    capture = open_capture(test_data / "driving" / "dgp")
    moving = moving_boxes(capture)
    assert {each.class_name for each in moving} == {"Car"} and len(moving) == 4  # the other nine stand
    rear = undistort_frame(capture.views[5], 240)
    mask = static_mask(rear, moving)
    row, column = 80, 117  # the car behind, see the photograph
    assert not mask[row, column] and mask.mean() > 0.98
    assert _depth_at(capture, rear, (row, column)) == 0


def _depth_at(capture: Capture, view: CaptureFrame, window: tuple[int, int]) -> float:
    """Nearest depth around a pixel of what stands: none where only a mover was hit."""
    depth = measured_depths(capture, [view])[0][window[0] - 2 : window[0] + 3, window[1] - 2 : window[1] + 3]
    return float(depth[(depth > 0) & (depth < 25)].min(initial=np.inf)) if (depth > 0).any() else 0.0
