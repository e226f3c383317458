"""Obstacles: things of a car's height, however many Gaussians they are made of."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.open import load_street
from gsrain_engine.scene.scene import Layer
from gsrain_engine.scene.street.layout import StreetParameters, plan_street
from gsrain_engine.simulation.geometry import PlanarBox
from gsrain_engine.simulation.ground import road_surface_of
from gsrain_engine.simulation.obstacles import CELL_M, drivable_of, occupied_space_of
from small_scene import patch, small_scene


def standing(*things):
    """The small scene with more in it."""
    scene = small_scene()
    return replace(scene, layers=(*scene.layers, *(Layer(f"thing {i}", each) for i, each in enumerate(things))))


def occupied(scene):
    return occupied_space_of(scene, road_surface_of(scene))


def car_at(x, y, yaw=0.0):
    return PlanarBox(x, y, yaw, 4.6, 1.85)


def upright(x, y, width, low, high, steps, opacity=0.95):
    """A wall across the way."""
    wall = patch(
        (x, y - width / 2, low), np.array([0, width, 0.0]), np.array([0, 0, high - low]), steps, (0.5, 0.5, 0.5)
    )
    size = 0.7 * np.array([0.0, width, high - low]) / steps
    scales = np.tile(np.maximum(size, 0.003).astype(np.float32), (len(wall), 1))
    return replace(wall, scales=scales, opacities=np.full(len(wall), opacity, np.float32))


def post(x, y, thick):
    """A square post, 3 m high."""
    sides = []
    for dx, dy in ((1, 0), (0, 1)):
        for side in (-1, 1):
            origin = (x + (side * dx - dy) * thick / 2, y + (side * dy - dx) * thick / 2, 0.0)
            wall = patch(origin, np.array([dy * thick, dx * thick, 0.0]), np.array([0, 0, 3.0]), 12, (0.2, 0.2, 0.2))
            scales = 0.5 * np.array([dy * thick, dx * thick, 3.0]) / 12 + 0.002
            sides.append(replace(wall, scales=np.tile(scales.astype(np.float32), (len(wall), 1))))
    return Gaussians.concatenate(sides)


def test_an_empty_road_is_free_and_the_wall_at_its_end_is_not():
    space = occupied(small_scene())
    assert not space.touches(car_at(20.0, 0.0))
    assert space.touches(car_at(38.5, 0.0))
    assert not space.touches(car_at(36.0, 0.0))


@pytest.mark.parametrize("steps", [2, 5, 40])
def test_it_does_not_matter_of_how_many_gaussians_a_wall_is(steps):
    space = occupied(standing(upright(15.0, 0.0, 3.0, 0.0, 2.0, steps)))
    assert space.touches(car_at(13.0, 0.0))
    assert not space.touches(car_at(11.8, 0.0))


@pytest.mark.parametrize("thick", [0.06, 0.12, 0.4])
@pytest.mark.parametrize("shift", [0.0, 0.03, 0.07])
def test_thin_posts_are_found_wherever_they_stand_among_the_cells(thick, shift):
    space = occupied(standing(post(15.0 + shift, 0.5 + shift, thick)))
    assert space.touches(car_at(13.5, 0.0))
    assert space.touches(car_at(15.0, 0.0))
    assert not space.touches(car_at(15.0, 2.0))


def test_kerbs_and_what_hangs_overhead_are_not_in_the_way():
    kerb = upright(15.0, 0.0, 3.0, 0.0, 0.15, 20)
    branches = upright(15.0, 0.0, 3.0, 2.2, 4.0, 20)
    assert not occupied(standing(kerb, branches)).touches(car_at(15.0, 0.0))


def test_a_few_that_float_about_are_not_in_the_way():
    rng = np.random.default_rng(3)
    n = 30
    haze = patch((10, -3, 0.5), np.array([10.0, 0, 0]), np.array([0, 6.0, 0]), 40, (0.7, 0.7, 0.7))
    faint = replace(haze, opacities=np.full(len(haze), 0.3, np.float32))
    floaters = haze.take(rng.choice(len(haze), n, replace=False))
    floaters = replace(floaters, scales=np.full((n, 3), 0.06, np.float32))
    assert not occupied(standing(faint, floaters)).touches(car_at(15.0, 0.0))


@pytest.mark.parametrize("mark", ["hidden", "deleted"])
def test_what_is_hidden_or_deleted_is_gone(mark):
    scene = standing(upright(15.0, 0.0, 3.0, 0.0, 2.0, 20))
    assert occupied(scene).touches(car_at(15.0, 0.0))
    gone = scene.with_member("layers/thing 0", marks=SelectionFlags(**{mark: BitMask.all(400)}))
    assert not occupied(gone).touches(car_at(15.0, 0.0))
    assert not occupied(scene.with_member("layers/thing 0", visible=False)).touches(car_at(15.0, 0.0))


def test_a_turned_box_reaches_where_its_corners_are():
    space = occupied(standing(post(15.0, 2.0, 0.12)))
    assert not space.touches(car_at(15.0, 0.0))
    assert space.touches(car_at(15.0, 0.0, np.pi / 2))


def test_cells_lie_where_things_are():
    places = occupied(standing(post(-4.95, -2.95, 0.12))).places
    near = places[np.hypot(*(places - (-4.95, -2.95)).T) < 1.0]
    assert len(near)
    assert np.abs(near - (-4.95, -2.95)).max() < 2 * CELL_M


@pytest.fixture(scope="module")
def street():
    return load_street()


@pytest.fixture(scope="module")
def space(street):
    return occupied(street)


@pytest.fixture(scope="module")
def layout():
    return plan_street(StreetParameters())


def test_its_whole_drive_hits_nothing(street, space):
    for time_s in np.arange(0.0, 12.01, 0.05):
        pose = street.ego_to_world(float(time_s))
        assert not space.touches(car_at(pose[0, 3] + 1.3, pose[1, 3])), time_s


def test_the_other_lane_and_the_road_s_edge_are_free(layout, space):
    assert not space.touches(car_at(30.0, 1.7))
    assert not any(space.touches(PlanarBox(x, 0.0, 0.0, 4.6, 5.0)) for x in np.arange(-20.0, 140.0, 4.0))


def test_parked_cars_and_lorries_are_hit(layout, space):
    assert layout.cars and layout.trucks
    for each in (*layout.cars, *layout.trucks):
        assert space.touches(PlanarBox(each.x, each.y, 0.0, 2.0, 1.0)), each
        side = np.sign(each.y)
        assert space.touches(PlanarBox(each.x, each.y - 1.2 * side, 0.0, 4.0, 1.0)), each


def test_trees_lamps_and_houses_are_hit(layout, space):
    for each in (*layout.trees, *layout.lamps):
        x, y = (each.x, each.y) if hasattr(each, "x") else each[:2]
        assert space.touches(PlanarBox(x, y, 0.0, 0.6, 0.6)), each
    fronts = layout.parameters.front_y_m
    assert all(space.touches(PlanarBox(x, s * fronts, 0.0, 4.0, 1.0)) for x in range(0, 120, 5) for s in (-1, 1))


def test_the_pavement_is_free(layout, space):
    p = layout.parameters
    between = np.arange(0.0, 120.0, 1.0)
    free = [not space.touches(PlanarBox(float(x), p.curb_y_m + 1.9, 0.0, 1.0, 1.0)) for x in between]
    assert np.mean(free) > 0.95


def test_the_road_is_drivable_and_the_pavement_is_not(street, space, layout):
    drivable = drivable_of(street, road_surface_of(street), space)
    kerb = layout.parameters.curb_y_m
    np.testing.assert_array_equal(drivable.share_on_road(car_at(30.0, -1.7)), np.ones((2, 2)))
    np.testing.assert_array_equal(drivable.share_on_road(car_at(30.0, -kerb - 1.5)), np.zeros((2, 2)))
    half = drivable.share_on_road(car_at(30.0, -kerb))
    assert (half[:, 0] > 0.9).all() and (half[:, 1] < 0.25).all()
    turned = drivable.share_on_road(car_at(30.0, -kerb, np.pi / 2))
    assert (turned[0] > 0.9).all() and (turned[1] < 0.25).all()


def test_without_a_road_layer_flat_ground_is_road():
    scene = standing(upright(15.0, 0.0, 3.0, 0.0, 2.0, 20))
    scene = replace(scene, layers=tuple(replace(each, name=f"part {i}") for i, each in enumerate(scene.layers)))
    space = occupied(scene)
    drivable = drivable_of(scene, road_surface_of(scene), space)
    assert drivable.share_on_road(car_at(25.0, 0.0)).min() > 0.9
    assert drivable.share_on_road(car_at(25.0, 12.0)).max() == 0.0


def test_nowhere_is_road_where_there_is_nothing():
    scene = replace(small_scene(), layers=())
    space = occupied(scene)
    assert not space.touches(car_at(0.0, 0.0))
    assert drivable_of(scene, road_surface_of(scene), space).share_on_road(car_at(0.0, 0.0)).max() == 0.0
