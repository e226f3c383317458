from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.scene.scene import DrawItem
from gsrain_engine.training import init
from gsrain_engine.training.init import actor_layers, points_of_box
from rasterized import rasterize

from .drive_capture import ROAD_Z, box, drive_capture

RED = np.array([200, 30, 20], np.uint8)


def rear_of(car, time_s: float) -> np.ndarray:
    """Points on the side of a car that looks to the camera behind it."""
    pose = car.track.pose(time_s)
    y, z = (each.ravel() for each in np.meshgrid(np.linspace(-0.95, 0.95, 20), np.linspace(0.2, 1.45, 14)))
    return np.stack([np.full(len(y), -1.95), y, z], axis=1) + pose[:3, 3]


def with_car(capture: Capture, car) -> Capture:
    """The car is red in the pictures and has points in the sweeps."""
    views, sweeps = [], []
    for view, sweep in zip(capture.views, capture.sweeps, strict=True):
        points = rear_of(car, view.time_s)
        seen = points @ view.camera.world_to_camera[:3, :3].T + view.camera.world_to_camera[:3, 3]
        u = seen[:, 0] / seen[:, 2] * view.camera.fx + view.camera.cx
        v = seen[:, 1] / seen[:, 2] * view.camera.fy + view.camera.cy
        image = view.image.copy()
        image[int(v.min()) : int(v.max()) + 1, int(u.min()) : int(u.max()) + 1] = RED
        views.append(replace(view, image_source=image))
        all_points = np.concatenate([sweep.points_m, points.astype(np.float32)])
        sweeps.append(replace(sweep, points_m=all_points))
    return replace(capture, views=tuple(views), sweeps=tuple(sweeps), boxes=(car,))


@pytest.fixture
def car():
    return box("car", (8, 0.5), 2.0)


def test_points_meet_in_the_things_own_frame(car) -> None:
    points = points_of_box(with_car(drive_capture(4), car), car)
    assert len(points) == 20 * 14  # every sweep tells the same ones
    np.testing.assert_allclose(points[:, 0], -1.95, atol=1e-5)


def test_a_car_becomes_an_actor_in_its_colour(car) -> None:
    capture = with_car(drive_capture(4), car)
    (actor,) = actor_layers(capture, capture.views)
    assert (actor.id, actor.class_name, actor.size_lwh) == ("car", "Car", (4.0, 2.0, 1.5))
    assert actor.track is car.track
    assert np.abs(actor.gaussians.means[:, 1]).max() < 1.0
    view = capture.views[2]
    frame = rasterize([DrawItem(actor.gaussians, actor.pose_at(view.time_s))], view.camera)
    pose = car.track.pose(view.time_s)
    middle = view.camera.world_to_camera[:3] @ (pose @ [-1.95, 0, 0.8, 1])
    row = int(middle[1] / middle[2] * view.camera.fy + view.camera.cy)
    column = int(middle[0] / middle[2] * view.camera.fx + view.camera.cx)
    shown = frame.rgba[row, column]
    assert shown[3] > 0.8
    np.testing.assert_allclose(shown[:3] / shown[3], RED / 255, atol=0.06)
    assert frame.depth is not None and frame.depth[row, column] == pytest.approx(middle[2], abs=0.3)


def test_what_stands_or_has_few_points_is_no_actor(car, monkeypatch) -> None:
    parked = box("parked", (8, 0.5), 0.0)
    capture = with_car(drive_capture(4), parked)
    assert actor_layers(capture, capture.views) == ()
    capture = with_car(drive_capture(4), car)
    assert actor_layers(drive_capture(4), capture.views) == ()
    monkeypatch.setattr(init, "MIN_POINTS", 300)
    assert actor_layers(capture, capture.views) == ()


def test_what_no_view_shows_is_no_actor(car) -> None:
    capture = with_car(drive_capture(4), car)
    away: list[CaptureFrame] = [replace(view, camera=replace(view.camera, cx=1e6)) for view in capture.views]
    assert actor_layers(capture, away) == ()
    assert ROAD_Z < 0
