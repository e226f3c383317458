"""The mirror of wet ground: geometry, reflectance, blur over distance, lamps, and pictures of a small scene with it."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.rain.wetness import water_depth_mm
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput, Quality
from gsrain_engine.render.view import RenderView
from gsrain_engine.render.view_reuse import ViewReuse
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.ground_water import GroundWater, ground_membership
from gsrain_engine.scene.lamps import Lamp, lit_lamps
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.scene.water_surface import WATER_INDEX, reflectance
from gsrain_engine.water.films import flooded_share
from gsrain_engine.water.mirror import SCALES, facet_table, make_mirror, mirrored_camera, rows_of_ground

UP = np.array([0.0, 0.0, 1.0])
EYE_M = 1.5


def camera(width=192, height=120, down=0.12):
    eye = np.array([0.0, 0.0, EYE_M])
    return Camera.from_fov(width, height, 50.0, look_at(eye, eye + np.array([1.0, 0.0, -down]), UP))


def gaussians(means, scales, colors, coefficients=1):
    n = len(means)
    sh = np.zeros((n, coefficients, 3))
    sh[:, 0] = (np.asarray(colors) - 0.5) / SH_C0
    numbers = means, scales, np.tile([1.0, 0, 0, 0], (n, 1)), np.full(n, 0.99), sh
    return Gaussians(*(np.ascontiguousarray(each, np.float32) for each in numbers))


def pond(standing=255, film=0, box=(12.0, 1.0, 2.0)):
    """Level dark ground with water, and a red ball above it."""
    x, y = np.meshgrid(np.arange(0.5, 40, 0.5), np.arange(-12, 12.1, 0.5))
    ground = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    floor = gaussians(ground, np.tile([0.5, 0.5, 0.004], (len(ground), 1)), np.full((len(ground), 3), 0.15))
    ball = gaussians([box], [[0.15, 0.15, 0.15]], [(0.9, 0.1, 0.1)])
    cover = np.zeros((24, 40, 2), np.uint8)
    cover[..., 0], cover[..., 1] = film, standing
    layers = Layer("ground", floor, wet_sh=floor.sh), Layer("ball", ball, wet_sh=ball.sh)
    return Scene("pond", layers, ground_m=0.0, water=GroundWater((0.0, -12.0), 1.0, cover))


def picture(scene, shot=None, renderer=None, reuse=None, **changes):
    rain = msgspec.structs.replace(load_preset("8.5"), **{"mirror": True, "streaks": False, "haze": "none"} | changes)
    renderer = renderer or CpuRenderer()
    shot = shot or RenderView(camera(), 1.0)
    draw(renderer, FrameInput.of(scene, RainSimulation.start(rain), OVERCAST, shot, Quality(reuse=reuse)))
    return renderer.read().rgba


def test_a_mirrored_camera_sees_points_where_the_ground_reflects_them():
    seen_from, ground_m = camera(201, 121), 0.3
    below = mirrored_camera(seen_from, ground_m)
    assert np.linalg.det(below.world_to_camera[:3, :3]) == pytest.approx(1)
    points = np.random.default_rng(1).uniform((5, -2, 0.4), (30, 2, 3), (50, 3))
    image = points * (1, 1, -1) + (0, 0, 2 * ground_m)

    def projected(view, at):
        x, y, z = (np.c_[at, np.ones(len(at))] @ view.world_to_camera.T)[:, :3].T
        return np.stack([view.fx * x / z + view.cx, view.fy * y / z + view.cy], axis=1)

    last = rows_of_ground(seen_from)[1]
    found = projected(below, points)
    expected = SCALES * projected(seen_from, image)
    np.testing.assert_allclose(found[:, 0], expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(last - found[:, 1], expected[:, 1], atol=1e-9)


def test_only_rows_with_rays_to_the_ground_are_mirrored():
    first, last = rows_of_ground(camera(down=0.0))
    assert (first, last) == (15, 30)
    assert rows_of_ground(camera(down=-3.0)) == (0, 0)


def test_smooth_water_reflects_by_fresnels_law_and_rough_water_moves_reflections_up():
    roots = np.linspace(0, 1, 128)
    smooth, rough = facet_table(0.002), facet_table(0.1)
    steep = roots**2 > 0.05
    expected = [reflectance(root * root, WATER_INDEX) for root in roots[steep]]
    np.testing.assert_allclose(smooth[steep, 0], expected, rtol=0.02)
    assert np.abs(smooth[steep, 1]).max() < 0.002
    assert rough[10, 1] > 0.05 > abs(rough[-1, 1])
    assert (rough[:, 0] > 0).all() and (rough[:, 0] < 1).all()
    assert np.diff(rough[40:, 0]).max() < 0  # less from above


def test_the_reflection_of_a_ball_is_where_geometry_puts_it():
    scene, shot = pond(), RenderView(camera())
    plain = picture(scene, shot, mirror=False)
    red = picture(scene, shot)[..., 0] - plain[..., 0] - (picture(scene, shot) - plain)[..., 2]
    x, y, z = (shot.camera.world_to_camera @ np.array([12.0, 1.0, -2.0, 1.0]))[:3]
    expected = shot.camera.fx * x / z + shot.camera.cx, shot.camera.fy * y / z + shot.camera.cy
    row, column = np.unravel_index(np.argmax(red), red.shape)
    assert red[row, column] > 0.02
    assert np.hypot(column + 0.5 - expected[0], row + 0.5 - expected[1]) < 3


def test_films_reflect_blurred_and_higher_objects_more_blurred():
    light = {"intensity_mm_h": 1.0}  # hardly floods a film

    def extent(scene):
        both = picture(scene, mirror=False, **light), picture(scene, **light)
        red = np.maximum((both[1] - both[0])[..., 0] - (both[1] - both[0])[..., 2], 0).sum(axis=1)
        rows = np.arange(len(red))
        mean = (red * rows).sum() / red.sum()
        return np.sqrt((red * (rows - mean) ** 2).sum() / red.sum())

    low, high = pond(0, 255, (12.0, 0.0, 0.5)), pond(0, 255, (12.0, 0.0, 1.3))
    assert extent(high) > 1.3 * extent(low)
    assert extent(low) > extent(pond(255, 0, (12.0, 0.0, 0.5)))


def test_reflections_never_exceed_the_light_that_arrives():
    view = camera()
    first, last = rows_of_ground(view)
    image = np.random.default_rng(2).uniform(0, 3, (last - first, 96, 3)).astype(np.float32)
    mirror = make_mirror(image, np.full(image.shape[:2], 30, np.float32), view, 0.0, 1.0)
    film = np.full((view.height, view.width, 2), 0.5, np.float32)
    assert 0 < mirror.reflected(film).max() <= image.max()
    uniform = make_mirror(np.ones_like(image), np.zeros(image.shape[:2], np.float32), view, 0.0, 0.5)
    assert uniform.light.max() < 0.5 * max(facet_table(0.1)[:, 0].max(), facet_table(0.02)[:, 0].max()) + 1e-4


def test_lamps_have_long_reflections_under_their_mirror_image():
    view = camera(384, 240)
    first, last = rows_of_ground(view)
    image = np.zeros((last - first, 192, 3), np.float32)
    lamp = Lamp(position=(14.0, 0.0, 0.8), intensity_m2=10.0)
    lamps = lit_lamps([(lamp, np.eye(4))])
    depth = np.zeros(image.shape[:2], np.float32)
    light = make_mirror(image, depth, view, 0.0, 1.0, lamps=lamps).light[..., 0]
    dimmed = make_mirror(image, depth, view, 0.0, 1.0, lamps=lamps, extinction_per_m=0.05).light[..., 0]
    film, standing = light[..., 0], light[..., 1]
    _, y, z = (view.world_to_camera @ np.array([14.0, 0.0, -0.8, 1.0]))[:3]
    at = SCALES[1] * (view.fy * y / z + view.cy) - first
    row, column = np.unravel_index(np.argmax(standing), standing.shape)
    assert abs(row + 0.5 - at) < 2 and abs(column + 0.5 - 96) < 2
    assert standing.max() > 2 * film.max() > 0

    def spread(image, axis):
        weights = image.sum(axis=axis)
        places = np.arange(len(weights))
        mean = (weights * places).sum() / weights.sum()
        return np.sqrt((weights * (places - mean) ** 2).sum() / weights.sum())

    assert spread(film, 1) / SCALES[1] > 3 * spread(film, 0) / SCALES[0]  # along columns
    assert 0 < dimmed[..., 1].max() < 0.5 * standing.max()  # about 20 m through the medium


def test_what_stands_before_a_lamp_hides_its_reflections():
    view = camera(384, 240)
    first, last = rows_of_ground(view)
    lamps = lit_lamps([(Lamp(position=(30.0, 0.0, 5.0), intensity_m2=100.0), np.eye(4))])
    image, depth = np.zeros((last - first, 192, 3), np.float32), np.zeros((last - first, 192), np.float32)
    _, y, z = (view.world_to_camera @ np.array([30.0, 0.0, -5.0, 1.0]))[:3]
    row = int(SCALES[1] * (view.fy * y / z + view.cy)) - first

    def light_behind(columns, depth_m):
        wall = depth.copy()
        wall[::-1][row - 8 : row + 4, columns] = depth_m  # as drawn: the first row is on top
        return make_mirror(image, wall, view, 0.0, 1.0, lamps=lamps).light[row - 1 : row + 2, :, 1, 0]

    free = light_behind(slice(0, 0), 12.0)
    assert free.max() > 0 and light_behind(slice(80, 112), 12.0).max() == 0
    assert np.array_equal(light_behind(slice(130, 192), 12.0), free)  # next to it
    assert np.array_equal(light_behind(slice(80, 112), 60.0), free)  # behind it
    half = light_behind(slice(96, 192), 12.0)
    assert 0 < half.sum() < free.sum()


def test_all_reflections_of_a_lamp_are_as_bright_as_its_mirror_image():
    eye = np.array([0.0, 0.0, 4.0])
    view = Camera.from_fov(400, 400, 60.0, look_at(eye, np.array([4.0, 0.0, 0.0]), UP))
    first, last = rows_of_ground(view)
    lamps = lit_lamps([(Lamp(position=(8.0, 0.0, 4.0), intensity_m2=10.0), np.eye(4))])
    dark = np.zeros((last - first, 200, 3), np.float32)
    standing = make_mirror(dark, dark[..., 0], view, 0.0, 1.0, lamps=lamps).light[:, :, 1, 0]
    x, y = np.meshgrid(np.arange(200) + 0.5 - 100, np.arange(first, last) + 0.5 - 50)
    fx, fy = np.array(SCALES) * (view.fx, view.fy)
    steradians = (1 + (x / fx) ** 2 + (y / fy) ** 2) ** -1.5 / (fx * fy)
    irradiance = 10.0 / (8.0**2 + 8.0**2) * reflectance(np.sqrt(0.5), WATER_INDEX)
    assert (standing * steradians).sum() == pytest.approx(irradiance, rel=0.05)


def test_water_belongs_to_level_gaussians_on_the_ground():
    cover = np.zeros((2, 2, 2), np.uint8)
    cover[0, 1] = 255, 51
    water = GroundWater((-1.0, -1.0), 1.0, cover)
    means = [(0.5, -0.5, 0.0), (-0.5, -0.5, 0.0), (0.5, -0.5, 0.12), (0.5, -0.5, 0.12), (0.5, -0.5, 1.0), (5, 5, 0)]
    flat, ball = (0.3, 0.3, 0.01), (0.3, 0.3, 0.3)
    some = gaussians(means, [flat, flat, flat, ball, flat, flat], np.zeros((6, 3)))
    found = ground_membership(some, np.eye(4), 0.0, water)
    np.testing.assert_allclose(found.film[:, 0], [1, 0, 1, 0, 0, 0])
    np.testing.assert_allclose(found.film[:, 1], [0.2, 0, 0.2, 0, 0, 0], atol=1e-6)
    assert found.is_low.tolist() == [True, True, True, False, False, True]


def test_the_same_bytes_and_nothing_without_water():
    scene, renderer = pond(), CpuRenderer()
    first = picture(scene, renderer=renderer)
    other = picture(scene, RenderView(camera(), 2.0), renderer)
    assert np.array_equal(first, picture(scene, renderer=renderer))  # any frame alone
    assert np.array_equal(first, picture(scene))
    assert first.shape == other.shape
    dry = replace(scene, water=None)
    assert np.array_equal(picture(dry), picture(dry, mirror=False))
    assert np.array_equal(picture(scene, wetness=0.0), picture(scene, mirror=False, wetness=0.0))
    assert not np.array_equal(first, picture(scene, mirror=False))


def test_fast_pictures_share_a_mirror_which_is_drawn_anew_for_every_third_and_for_another_size():
    scene, reuse = pond(), ViewReuse(3)
    shots = [RenderView(camera(), time_s) for time_s in (1.0, 2.0, 3.0, 4.0)]  # rings differ
    shots.append(RenderView(camera(96, 60), 4.0))
    is_exact = [np.array_equal(picture(scene, shot, reuse=reuse), picture(scene, shot)) for shot in shots]
    assert is_exact == [True, False, False, True, True]


def test_half_as_wet_ground_reflects_half_as_much():
    mirror_of = {}
    view = camera()
    first, last = rows_of_ground(view)
    for wetness in (0.5, 1.0):
        image, depth = np.ones((last - first, 96, 3), np.float32), np.zeros((last - first, 96), np.float32)
        mirror_of[wetness] = make_mirror(image, depth, view, 0.0, wetness).light
    np.testing.assert_allclose(mirror_of[0.5], 0.5 * mirror_of[1.0], rtol=1e-6)


def test_heavy_rain_floods_films():
    dry, light, moderate, heavy = (flooded_share(water_depth_mm(rate)) for rate in (0.0, 1.0, 8.5, 30.0))
    assert dry == 0 and 0.05 < light < 0.1
    assert moderate == pytest.approx(0.5, abs=0.05) and heavy > 0.95
    view = camera()
    first, last = rows_of_ground(view)
    image = np.random.default_rng(4).random((last - first, 96, 3), np.float32)
    none, half, all_ = (make_mirror(image, image[..., 0] * 50, view, 0.0, 1.0, each).light for each in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(half[:, :, 0], 0.5 * (none + all_)[:, :, 0], atol=1e-6)
    np.testing.assert_allclose(all_[:, :, 0], none[:, :, 1], atol=1e-6)


def test_scene_folders_hold_the_map_of_water(tmp_path):
    scene = pond(200, 40)
    write_scene(scene, tmp_path / "pond")
    found = read_scene(tmp_path / "pond").water
    assert found is not None and (found.corner_m, found.cell_m) == ((0.0, -12.0), 1.0)
    np.testing.assert_array_equal(found.cover, scene.water.cover)
    text = (tmp_path / "pond" / "scene.json").read_text()
    (tmp_path / "pond" / "scene.json").write_text(text.replace('"rows": 24', '"rows": 25'))
    with pytest.raises(ValueError, match="a map of 25 x 40 cells takes 2000 bytes, this one has 1920"):
        read_scene(tmp_path / "pond")
