"""The ground that vehicles stand on: where the scene says it is, and as its low, flat Gaussians lie."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.scene.scene import Layer, PoseTrack, Scene
from gsrain_engine.simulation.ground import SENSOR_HEIGHT_M, HeightGrid, road_surface_of
from small_scene import patch, small_scene


def drive_along(places):
    """An ego track through places, a second apart."""
    n = len(places)
    return PoseTrack(np.arange(float(n)), np.array(places, float), np.tile([1.0, 0, 0, 0], (n, 1)), np.ones(n, bool))


def slope(per_m, rig_m=1.5, **more):
    """A road that rises along x, with a car's box standing on it, and the drive up it."""
    road = patch((0, -8, 0), np.array([60.0, 0, 60.0 * per_m]), np.array([0, 16.0, 0]), 120, (0.3, 0.3, 0.3))
    road = replace(road, scales=np.tile(np.array([0.35, 0.12, 0.004], np.float32), (len(road), 1)))
    block = patch((20, 2, 20 * per_m), np.array([4.0, 0, 0]), np.array([0, 0, 1.4]), 20, (0.6, 0.1, 0.1))
    drive = drive_along([(x, 0.0, per_m * x + rig_m) for x in np.arange(2.0, 58.0, 2.0)])
    return Scene("slope", (Layer("road", road), Layer("block", block)), ego=drive, **more)


def test_a_level_scene_has_the_height_it_says():
    ground = road_surface_of(small_scene())
    assert ground.height_m(3.0, 0.5) == pytest.approx(0.0, abs=0.01)
    assert ground.rig_height_m == pytest.approx(1.5)


def test_without_a_drive_the_ground_is_level():
    scene = replace(small_scene(), ego=None, ground_m=-2.0)
    assert road_surface_of(scene).height_m(100.0, -30.0) == -2.0
    assert road_surface_of(replace(scene, ground_m=None)).height_m(0.0, 0.0) == 0.0


@pytest.mark.parametrize("per_m", [0.0, 0.06, -0.12])
def test_the_ground_follows_a_slope(per_m):
    ground = road_surface_of(slope(per_m))
    for x, y in ((5.0, 0.0), (30.0, -5.0), (22.0, 2.0), (50.0, 4.0)):
        assert ground.height_m(x, y) == pytest.approx(per_m * x, abs=0.03)


@pytest.mark.parametrize("rig_m", [0.0, 0.35, 2.1])
def test_how_high_the_rig_is_is_measured(rig_m):
    """Some data sets put the vehicle's origin on the ground, others on the roof."""
    ground = road_surface_of(slope(0.05, rig_m))
    assert ground.rig_height_m == pytest.approx(rig_m, abs=0.03)
    assert ground.height_m(30.0, 0.0) == pytest.approx(1.5, abs=0.03)


def test_what_a_scene_says_counts_where_the_drive_begins():
    ground = road_surface_of(slope(0.05, ground_m=0.1))
    assert ground.rig_height_m == pytest.approx(1.5)
    assert ground.height_m(2.0, 0.0) == pytest.approx(0.1, abs=0.03)


def test_a_height_that_nobody_can_mean_is_not_believed():
    assert road_surface_of(slope(0.0, ground_m=50.0)).height_m(10.0, 0.0) == pytest.approx(0.0, abs=0.03)


def test_where_nothing_lies_it_is_below_the_drive():
    empty = replace(slope(0.05), layers=())
    ground = road_surface_of(empty)
    assert ground.rig_height_m == SENSOR_HEIGHT_M
    assert ground.height_m(30.0, 3.0) == pytest.approx(1.5, abs=0.05)


def test_another_unit_and_another_axis_up():
    """The same slope in half meters, y up."""
    meant = slope(0.05)
    axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # world to scene: z becomes y
    to_scene = np.eye(4)
    to_scene[:3, :3] = 2 * axes
    layers = tuple(replace(layer, to_scene=to_scene) for layer in meant.layers)
    assert meant.ego is not None
    turned = Scene("turned", layers, metres_per_unit=0.5, up=(0.0, 1.0, 0.0), ego=meant.ego.moved(to_scene))
    np.testing.assert_allclose(turned.scene_to_world @ to_scene, np.eye(4), atol=1e-12)
    one, other = road_surface_of(meant), road_surface_of(turned)
    np.testing.assert_allclose(
        [one.height_m(x, 1.0) for x in (4.0, 21.0, 44.0)],
        [other.height_m(x, 1.0) for x in (4.0, 21.0, 44.0)],
        atol=1e-3,
    )


def test_one_place_and_many_are_the_same():
    rng = np.random.default_rng(1)
    grid = HeightGrid((-3.0, 2.0), 0.5, rng.normal(size=(7, 9)))
    places = rng.uniform((-6, 0), (4, 8), size=(200, 2))
    np.testing.assert_allclose(
        [grid.at(float(x), float(y)) for x, y in places], grid.at_all(places), rtol=0, atol=1e-12
    )
    assert grid.at(-3.0, 2.0) == grid.heights_m[0, 0]
    assert grid.at(-100.0, 100.0) == grid.heights_m[-1, 0]


def test_the_same_scene_is_searched_once():
    scene = slope(0.02)
    assert road_surface_of(scene) is road_surface_of(scene)
    assert road_surface_of(scene) is not road_surface_of(replace(scene))
