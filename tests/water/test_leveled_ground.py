"""Water on the ground of captures: its map is found from Gaussians, and its mirror follows the ground's slopes."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.water_map import find_water, with_water_map
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.ground_water import GroundWater, ground_membership
from gsrain_engine.scene.lamps import LitLamps
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from gsrain_engine.water.leveled_ground import LeveledView, leveled_lamps, leveled_view

ALONG, ACROSS = 0.06, -0.03
ASPHALT, GRASS = (0.3, 0.3, 0.31), (0.25, 0.4, 0.1)


def height(x, y):
    return 7.0 + ALONG * x + ACROSS * y


def gaussians(means, scales, colors):
    n = len(means)
    sh = ((np.asarray(colors) - 0.5) / SH_C0)[:, None]
    numbers = means, scales, np.tile([1.0, 0, 0, 0], (n, 1)), np.full(n, 0.99), sh
    return Gaussians(*(np.ascontiguousarray(each, np.float32) for each in numbers))


def captured_slope(scatter_m=0.02, dip_m=0.0):
    """A road on a slope between grass and a wall, as a reconstruction has them: bumpy, without labels."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform((-5, -9), (40, 9), (16000, 2)).T
    z = height(x, y) + rng.normal(0, scatter_m, len(x)) - dip_m * np.exp(-0.5 * (np.hypot(x - 12, y) / 0.8) ** 2)
    ground = np.stack([x, y, z], axis=1)
    colors = np.where(y[:, None] < -4, GRASS, ASPHALT)
    wall = rng.uniform((-5, 8, 0), (40, 8.3, 6), (4000, 3))
    wall[:, 2] += height(wall[:, 0], wall[:, 1])
    road = gaussians(ground, np.tile([0.2, 0.2, 0.02], (len(x), 1)), colors)
    front = gaussians(wall, np.tile([0.2, 0.03, 0.2], (len(wall), 1)), np.tile([0.5, 0.4, 0.3], (len(wall), 1)))
    layers = Layer("road", road, wet_sh=road.sh), Layer("front", front, wet_sh=front.sh)
    return Scene("slope", layers)


def test_films_are_found_on_the_road_of_a_slope_and_puddles_in_its_hollows():
    water = find_water(captured_slope(dip_m=0.06))
    assert water is not None and water.heights_m is not None and water.scatter_m == pytest.approx(0.02, abs=0.01)
    points = np.stack(np.meshgrid([0.0, 8, 17, 25, 33], [-7.0, -2.0, 2.0, 6.0]), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(water.height_at(points), height(*points.T), atol=0.02)

    def covered(x, y):
        return water.at(np.stack(np.meshgrid(np.linspace(*x, 60), np.linspace(*y, 30)), axis=-1).reshape(-1, 2))

    assert covered((-2, 38), (-3, 7)).sum(axis=1).mean() > 0.4
    assert covered((-2, 38), (-8, -5)).sum(axis=1).mean() < 0.02  # grass
    assert covered((11.5, 12.5), (-0.5, 0.5))[:, 1].mean() > 2 * covered((-2, 38), (-3, 7))[:, 1].mean()
    assert find_water(replace(captured_slope(), layers=captured_slope().layers[1:])) is None  # a wall alone


def test_a_map_with_heights_is_saved_exactly_moved_and_scaled(tmp_path):
    scene = with_water_map(captured_slope())
    dry = replace(scene, layers=tuple(replace(each, wet_sh=None) for each in scene.layers), water=None)
    assert with_water_map(dry).water is None
    write_scene(scene, tmp_path / "slope")
    read = read_scene(tmp_path / "slope").water
    assert scene.water is not None and scene.water.heights_m is not None and read is not None
    np.testing.assert_array_equal(read.heights_m, scene.water.heights_m)
    assert read.scatter_m == scene.water.scatter_m
    place = np.array([[6.0, 1.5]])
    changed = read.moved(1.0, -2.0, 0.5).scaled(2.0)
    np.testing.assert_allclose(changed.height_at(2 * (place + (1, -2))), 2 * (read.height_at(place) + 0.5), atol=1e-5)


def slope_map():
    """A map of the slope itself, all under standing water."""
    y, x = np.mgrid[-9:9:36j, -5:40:90j]
    cover = np.full((36, 90, 2), (0, 255), np.uint8)
    return GroundWater((-5.25, -9.26), 0.5056, cover, height(x, y).astype(np.float32), 0.02)


@pytest.mark.parametrize("moves", [False, True])
def test_reflections_of_objects_on_a_slope_touch_them(moves):
    """The image of a ball is where the ground's own plane puts it, for fixed ones and for actors."""
    scene = captured_slope()
    at = np.array([14.0, 1.0, height(14.0, 1.0) + 1.2])
    ball = gaussians([np.zeros(3) if moves else at], [[0.15] * 3], [(0.9, 0.1, 0.1)])
    if moves:
        actor = Actor(
            id="ball", class_name="ball", size_lwh=(0.3, 0.3, 0.3), gaussians=ball, wet_sh=ball.sh,
            track=PoseTrack(np.zeros(1), at[None], np.array([[1.0, 0, 0, 0]]), np.ones(1, bool)),
        )  # fmt: skip
        scene = replace(scene, actors=(actor,))
    else:
        scene = replace(scene, layers=(*scene.layers, Layer("ball", ball, wet_sh=ball.sh)))
    scene = replace(scene, water=slope_map())
    eye = np.array([0.0, 0.0, height(0, 0) + 1.5])
    forward = np.array([1.0, 0, ALONG - 0.12])
    camera = Camera.from_fov(192, 120, 50.0, look_at(eye, eye + forward, np.array([0.0, 0, 1])))
    view = leveled_view(camera, scene.water, 0.0)
    assert view.camera.position[2] - view.ground_m == pytest.approx(1.5, abs=0.02)

    def picture(**changes):
        rain = {"mirror": True, "splashes": False, "streaks": False, "haze": "none"} | changes
        renderer = CpuRenderer()
        rainfall = RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), **rain))
        draw(renderer, FrameInput.of(scene, rainfall, OVERCAST, RenderView(camera, 1.0)))
        return renderer.read().rgba

    change = picture() - picture(mirror=False)
    red = change[..., 0] - change[..., 2]
    row, column = np.unravel_index(np.argmax(red), red.shape)
    x, y, z = (camera.world_to_camera @ np.append(at - (0, 0, 2.4), 1.0))[:3]
    expected = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    assert red[row, column] > 0.02 and np.hypot(column + 0.5 - expected[0], row + 0.5 - expected[1]) < 3


def test_lamps_over_a_slope_are_where_and_as_the_camera_sees_them():
    eye = np.array([0.0, 0.0, height(0, 0) + 1.5])
    camera = Camera.from_fov(192, 120, 50.0, look_at(eye, eye + np.array([1.0, 0, ALONG]), np.array([0.0, 0, 1])))
    view = leveled_view(camera, slope_map(), 0.0)
    lamps = LitLamps(
        np.array([[10.0, 2, 5], [4.0, -3, 1]]), np.array([[0.0, 0, -1], [0.6, 0, 0.8]]), np.ones((2, 3)),
        np.array([0.9, 0.8]), np.array([0.5, 0.4]),
    )  # fmt: skip
    leveled = leveled_lamps(lamps, view)
    for before, after, last in ((lamps.positions_m, leveled.positions_m, 1), (lamps.directions, leveled.directions, 0)):
        before, after = (np.column_stack([each, np.full(2, last)]) for each in (before, after))
        assert np.abs(after - before).max() > 0.01  # turned
        expected = before @ camera.world_to_camera.T
        np.testing.assert_allclose(after @ view.camera.world_to_camera.T, expected, atol=1e-9)
    for name in ("intensities", "cos_inner", "cos_outer"):
        assert getattr(leveled, name) is getattr(lamps, name)
    assert leveled_lamps(lamps, LeveledView(camera, 0.0)) is lamps and leveled_lamps(None, view) is None


def test_scattered_gaussians_of_the_ground_hold_water_but_not_the_wheels_of_an_actor():
    scene = captured_slope(scatter_m=0.06)
    water = replace(slope_map(), scatter_m=0.06)
    road = scene.layers[0].gaussians
    over = road.means[:, 2] - height(road.means[:, 0], road.means[:, 1])
    film = ground_membership(road, np.eye(4), 0.0, water).film
    assert film is not None and film[:, 1][(np.abs(over) < 0.11) & (np.abs(road.means[:, 1]) < 8)].all()
    round_ones = Gaussians(road.means, np.full_like(road.scales, 0.1), road.quaternions, road.opacities, road.sh)
    fixed, moving = (ground_membership(round_ones, np.eye(4), 0.0, water, is_fixed=each) for each in (True, False))
    assert fixed.is_low[over < 0.11].all() and not moving.is_low[over > 0.04].any()
