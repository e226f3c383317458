"""The ground, and what stands on it, in a real place: laser points, and vehicles that people have labelled."""

import numpy as np
import pytest

from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.simulation.geometry import PlanarBox
from gsrain_engine.simulation.ground import road_surface_of
from gsrain_engine.simulation.obstacles import occupied_space_of

MIDDLE_S = 1.08


@pytest.fixture(scope="module")
def capture(test_data):
    return open_capture(test_data / "driving" / "dgp" / "scene_02")


@pytest.fixture(scope="module")
def scene(capture):
    """Every point a ball as large as the gap to its neighbors."""
    points = np.concatenate([sweep.points_m for sweep in capture.sweeps])
    n, f = len(points), np.float32
    size = np.clip(0.004 * np.linalg.norm(points, axis=1), 0.03, 0.3)
    balls = Gaussians(points, np.repeat(size[:, None], 3, axis=1).astype(f), np.tile(np.array([1, 0, 0, 0], f), (n, 1)),
                      np.full(n, 0.9, f), np.zeros((n, 1, 3), f))  # fmt: skip
    return Scene("points", (Layer("points", balls),), ego=capture.ego)


def labelled(capture):
    """The labelled vehicles near the car: poses and sizes."""
    poses = [(box.track.pose(MIDDLE_S), box.size_lwh) for box in capture.boxes]
    return [(pose, size) for pose, size in poses if pose is not None and np.hypot(*pose[:2, 3]) < 30]


def test_the_rig_is_where_the_points_of_the_road_are_below_it(scene):
    assert road_surface_of(scene).rig_height_m == pytest.approx(1.5, abs=0.05)


def test_labelled_vehicles_stand_on_the_ground_that_is_found(capture, scene):
    near = labelled(capture)
    assert len(near) == 2
    for pose, _ in near:
        assert pose[2, 3] == pytest.approx(road_surface_of(scene).height_m(pose[0, 3], pose[1, 3]), abs=0.3)


def test_they_are_in_the_way_and_the_lane_is_free(capture, scene):
    space = occupied_space_of(scene, road_surface_of(scene))
    for pose, (length, width, _) in labelled(capture):
        yaw = float(np.arctan2(pose[1, 0], pose[0, 0]))
        assert space.touches(PlanarBox(pose[0, 3], pose[1, 3], yaw, length, width))
    for along in np.arange(-14.0, 5.0, 0.5):
        assert not space.touches(PlanarBox(0.016 * along, float(along) - 1.3, -np.pi / 2, 4.6, 1.85)), along
