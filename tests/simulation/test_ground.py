"""Ground, obstacles and road of made-up scenes and of the built-in street."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.simulation.geometry import PlanarBox
from gsrain_engine.simulation.ground import SENSOR_HEIGHT_M, road_surface_of
from gsrain_engine.simulation.obstacles import drivable_of, occupied_space_of
from simulation.small_drive import in_other_units, track
from small_scene import patch, small_scene


def slope(per_m, rig_m=1.5, **more):
    """A road that rises along x, with a car's box standing on it, and the drive up it."""
    road = patch((0, -8, 0), np.array([60.0, 0, 60.0 * per_m]), np.array([0, 16.0, 0]), 120, (0.3, 0.3, 0.3))
    road = replace(road, scales=np.tile(np.array([0.35, 0.12, 0.004], np.float32), (len(road), 1)))
    block = patch((20, 2, 20 * per_m), np.array([4.0, 0, 0]), np.array([0, 0, 1.4]), 20, (0.6, 0.1, 0.1))
    drive = track(np.arange(28.0), [(x, 0.0, per_m * x + rig_m) for x in np.arange(2.0, 58.0, 2.0)])
    return Scene("slope", (Layer("road", road), Layer("block", block)), ego=drive, **more)


@pytest.mark.parametrize("other_units", [False, True])
@pytest.mark.parametrize(("per_m", "rig_m"), [(0.0, 0.0), (0.06, 0.35), (-0.12, 2.1), (0.05, 1.5)])
def test_the_ground_follows_a_slope_and_the_height_of_the_rig_is_measured(per_m, rig_m, other_units):
    """Some data sets put the vehicle's origin on the ground, others on the roof; some have y up."""
    scene = slope(per_m, rig_m)
    ground = road_surface_of(in_other_units(scene) if other_units else scene)
    assert ground.rig_height_m == pytest.approx(rig_m, abs=0.03)
    for x, y in ((5.0, 0.0), (30.0, -5.0), (22.0, 2.0), (50.0, 4.0)):
        assert ground.height_m(x, y) == pytest.approx(per_m * x, abs=0.03)
    space = occupied(scene)
    drivable = drivable_of(scene, road_surface_of(scene), space)
    for x in (5.0, 50.0):
        assert not space.touches(car_at(x, 0.0)) and drivable.share_on_road(car_at(x, 0.0)).min() > 0.9
    assert space.touches(car_at(22.0, 1.5)) and drivable.share_on_road(car_at(30.0, 12.0)).max() == 0.0


def test_a_stated_height_counts_where_the_drive_begins_if_it_is_plausible():
    ground = road_surface_of(slope(0.05, ground_m=0.1))
    assert ground.rig_height_m == pytest.approx(1.5) and ground.height_m(2.0, 0.0) == pytest.approx(0.1, abs=0.03)
    assert road_surface_of(slope(0.0, ground_m=50.0)).height_m(10.0, 0.0) == pytest.approx(0.0, abs=0.03)
    empty = road_surface_of(replace(slope(0.05), layers=()))  # without Gaussians it is below the drive
    assert empty.rig_height_m == SENSOR_HEIGHT_M and empty.height_m(30.0, 3.0) == pytest.approx(1.5, abs=0.05)
    for stated, height in ((-2.0, -2.0), (None, 0.0)):  # without a drive it is level
        assert road_surface_of(replace(small_scene(), ego=None, ground_m=stated)).height_m(100.0, -30.0) == height


# Obstacles


def standing(*things):
    """The small scene with more in it."""
    scene = small_scene()
    return replace(scene, layers=(*scene.layers, *(Layer(f"thing {i}", each) for i, each in enumerate(things))))


def occupied(scene):
    return occupied_space_of(scene, road_surface_of(scene))


def car_at(x, y, yaw=0.0):
    return PlanarBox(x, y, yaw, 4.6, 1.85)


def flat(origin, u, v, steps):
    """A thin wall of Gaussians along two axes."""
    wall = patch(origin, np.array(u, float), np.array(v, float), steps, (0.5, 0.5, 0.5))
    size = 0.6 * (np.abs(u) + np.abs(v)) / steps + 0.002
    return replace(wall, scales=np.tile(size.astype(np.float32), (len(wall), 1)))


def across(x, low, high, steps=20):
    """A wall 3 m wide across the road."""
    return flat((x, -1.5, low), (0, 3, 0), (0, 0, high - low), steps)


HAZE = patch((10, -3, 0.5), np.array([10.0, 0, 0]), np.array([0, 6.0, 0]), 40, (0.7, 0.7, 0.7))
FEW = HAZE.take(np.random.default_rng(3).choice(len(HAZE), 30, replace=False))


@pytest.mark.parametrize(
    ("thing", "change", "is_hit"),
    [
        *((across(15.0, 0.0, 2.0, steps), {}, True) for steps in (2, 5, 40)),  # however many Gaussians it has
        (across(15.0, 0.0, 2.0), {"marks": SelectionFlags(hidden=BitMask.all(400))}, False),
        (across(15.0, 0.0, 2.0), {"marks": SelectionFlags(deleted=BitMask.all(400))}, False),
        (across(15.0, 0.0, 2.0), {"visible": False}, False),
        (across(15.0, 0.0, 0.15), {}, False),  # a curb
        (across(15.0, 2.2, 4.0), {}, False),  # a branch
        (replace(HAZE, opacities=np.full(len(HAZE), 0.3, np.float32)), {}, False),
        (replace(FEW, scales=np.full((30, 3), 0.06, np.float32)), {}, False),  # single floaters
    ],
)
def test_walls_are_hit_and_curbs_branches_haze_and_hidden_things_are_not(thing, change, is_hit):
    space = occupied(standing(thing).with_member("layers/thing 0", **change))
    assert space.touches(car_at(13.0, 0.0)) == is_hit and not space.touches(car_at(11.8, 0.0))
    assert space.touches(car_at(38.5, 0.0)) and not space.touches(car_at(36.0, 0.0))  # the scene's own at 40 m


def test_without_a_road_layer_flat_ground_is_road_and_nothing_is_without_a_scene():
    scene = standing(across(15.0, 0.0, 2.0))
    scene = replace(scene, layers=tuple(replace(each, name=f"part {i}") for i, each in enumerate(scene.layers)))
    for scene_now, low in ((scene, 0.9), (replace(scene, layers=()), None)):
        drivable = drivable_of(scene_now, road_surface_of(scene_now), occupied(scene_now))
        assert drivable.share_on_road(car_at(25.0, 12.0)).max() == 0.0
        share = drivable.share_on_road(car_at(25.0, 0.0))
        assert share.max() == 0.0 if low is None else share.min() > low
