"""Up is found from level pictures, whatever world they stand in."""

import numpy as np
import pytest

from gsrain_engine.datasets.geometry import estimate_up_direction
from gsrain_engine.scene.camera import Camera, look_at

TURN = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
TURN *= np.linalg.det(TURN)


def camera(eye: tuple[float, float, float], ahead: tuple[float, float, float]) -> Camera:
    """Level camera of a z-up world, which is then turned away."""
    place, up = TURN @ np.array(eye), TURN @ np.array([0.0, 0.0, 1.0])
    return Camera(64, 48, 50.0, 50.0, 32.0, 24.0, look_at(place, place + TURN @ np.array(ahead), up))


def off_deg(cameras: list[Camera]) -> float:
    return float(np.degrees(np.arccos(np.clip(np.array(estimate_up_direction(cameras)) @ TURN[:, 2], -1, 1))))


def test_a_car_with_a_camera_that_looks_down() -> None:
    drive = [camera((float(x), 0.02 * x, 0.0), (1.0, 0.0, -0.2)) for x in range(20)]
    assert off_deg(drive) < 0.3  # the pictures' own up is 11 degrees off
    assert off_deg(drive[:1]) == pytest.approx(np.degrees(np.arctan(0.2)), abs=0.1)  # one picture knows no better


def test_a_rig_that_looks_around() -> None:
    angles = np.radians(np.arange(0, 360, 60))
    assert off_deg([camera((0.0, 0.0, 0.0), (np.cos(a), np.sin(a), -0.3)) for a in angles]) < 0.5


def test_a_walk_around_a_thing() -> None:
    angles = np.radians(np.arange(0, 360, 20))
    round_it = [camera((4 * np.cos(a), 4 * np.sin(a), 2.0), (-np.cos(a), -np.sin(a), -0.4)) for a in angles]
    assert off_deg(round_it) < 0.5


def test_a_drone_that_climbs() -> None:
    assert off_deg([camera((0.0, 0.0, float(z)), (1.0, 0.1, 0.0)) for z in range(10)]) < 0.5
