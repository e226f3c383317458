"""Color of the medium: that of the sky just above the horizon (docs/physics/extinction.md)."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gsrain_engine.editor.viewport.camera import find_scene_core, home_camera
from gsrain_engine.rain.frame import RainCamera, SkyLight
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.sky_color import SkyColor, sky_color
from gsrain_engine.render.view import RenderView, rain_camera
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.scene.scene import Layer, Scene

DARK, BRIGHT = 0.4, 0.8  # display values at the horizon and at the zenith
WALL = 0.2


def dome(first_deg, kind="sky", radius_m=900.0, tall_m=25.0):
    """Sky from an elevation upward, brighter with the sine of its elevation; opaque."""
    angles = np.radians(np.arange(first_deg, 90.0, 1.2))
    rings = [np.arange(0, 2 * np.pi, np.radians(1.2) / max(np.cos(each), 0.02)) for each in angles]
    rise = np.concatenate([np.full(len(ring), each) for ring, each in zip(rings, angles, strict=True)])
    turn = np.concatenate(rings)
    means = radius_m * np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1)
    return layer("sky", kind, means, tall_m, DARK + (BRIGHT - DARK) * np.sin(rise))


def layer(name, kind, means, sigma_m, gray):
    count = len(means)
    gray = np.broadcast_to(np.asarray(gray, np.float32), count)
    numbers = means, np.full((count, 3), sigma_m), np.tile([1.0, 0, 0, 0], (count, 1)), np.full(count, 0.99)
    arrays = (np.asarray(each, np.float32) for each in numbers)
    return Layer(name, Gaussians(*arrays, sh_from_color(np.repeat(gray[:, None], 3, axis=1))), kind=kind)


def camera(size=(96, 64), target=(1.0, 0.0, 0.05)):
    return Camera.from_fov(*size, 30.0, look_at(np.zeros(3), np.array(target), np.array([0.0, 0, 1])))


def test_airlight_is_the_lowest_visible_sky_and_drops_have_its_mean():
    street, court = (sky_color(CpuRenderer(), Scene("a", (dome(low),)), camera()).light for low in (-5.0, 30.0))
    assert street.airlight == pytest.approx([DARK] * 3, abs=0.03)
    assert court.airlight == pytest.approx([DARK + (BRIGHT - DARK) * np.sin(np.radians(31.0))] * 3, abs=0.03)
    assert min(street.drops) > DARK + 0.1
    assert court.drops != court.airlight


def test_a_scene_without_a_sky_layer_has_one_color():
    """Distant pixels right above the horizon may be houses."""
    light = sky_color(CpuRenderer(), Scene("a", (dome(-5.0, kind="background"),)), camera()).light
    assert light.airlight == light.drops
    assert min(light.drops) > DARK + 0.1
    assert sky_color(CpuRenderer(), Scene("nothing"), camera()).light == OVERCAST


def test_a_hidden_sky_layer_gives_its_color_all_the_same():
    """From inside of a truck, drops have the light of the dusk around it instead of that of a gray day."""
    y, z = (each.ravel() for each in np.meshgrid(np.arange(-6.0, 7, 0.5), np.arange(-6.0, 7, 0.5)))
    faces = [np.array([np.full(y.size, at), y, z]) for at in (-5.0, 5.0)]
    box = np.concatenate([np.roll(face, axis, axis=0).T for face in faces for axis in range(3)])
    scene, truck = Scene("a", (dome(0.0),)), layer("truck", "background", box, 0.5, WALL)
    hidden = replace(scene, layers=(*scene.layers, truck))
    open_air, inside = (sky_color(CpuRenderer(), each, camera()) for each in (scene, hidden))
    assert open_air.found and inside.found
    np.testing.assert_allclose(inside.light, open_air.light, atol=0.01)


@pytest.mark.parametrize("own", [None, (0.3, 0.5, 0.6)])
def test_a_far_wall_fades_into_the_horizon(own):
    """In heavy rain, its silhouette is gone at 700 m; a chosen color replaces both."""
    y, z = (each.ravel() for each in np.meshgrid(np.arange(-90.0, 95, 9), np.arange(-40.0, 45, 9)))
    wall = layer("wall", "background", np.stack([np.full(y.size, 700.0), y, z], axis=1), 8.0, WALL)
    scene, renderer = Scene("a", (dome(-30.0), wall)), CpuRenderer()
    rain = RainSettings(intensity_mm_h=50.0, streaks=False, drop_color=own)
    sequence = FrameSequence(scene, RainSimulation.start(rain), camera(target=(1.0, 0.0, 0.0)), 96, 64)
    sky = sequence.sky(renderer)
    clear, rainy = (sequence.frame(renderer, 0, each).rgba[..., :3] for each in (None, sky))
    assert clear[32, 48, 0] == pytest.approx(WALL, abs=0.01) and clear[12, 48, 0] > DARK
    assert rainy[[32, 12], 48] == pytest.approx(np.array([own or sky.light.airlight] * 2), abs=0.006)
    below = rainy[:, 48] * 255
    assert np.abs(np.diff(below, axis=0)).max() < 1  # gray levels


@pytest.mark.parametrize("name", ["plant.splat", "biker.spz"])
def test_a_captured_object_has_no_edge_of_fog_from_any_side(test_data, name):
    """The background, all airlight, is even from 8 sides; with streaks, their median over some moments is."""
    scene = load_sorted_scene(str(test_data / "scenes" / name))
    home, middle = home_camera(scene, 80, 60), find_scene_core(scene).middle
    renderer, rain = CpuRenderer(), RainSettings(intensity_mm_h=25.0, wetness=0.0)
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        pose = look_at(middle + turn @ (home.position - middle), middle, np.array([0.0, 0, 1]))
        around = replace(home, world_to_camera=pose)
        clear = FrameSequence(scene, RainSimulation.start(rain), around, 80, 60).frame(renderer, 0, None)
        empty = clear.rgba[..., 3] < 1e-3
        assert 0.5 < empty.mean() < 0.98
        for moments, own in ((1, {"streaks": False}), (3, {})):
            falling = RainSimulation.start(msgspec.structs.replace(rain, **own))
            sequence = FrameSequence(scene, falling, around, 80, 60, fps=2.0)
            drawn = [sequence.frame(renderer, k, SkyColor(OVERCAST, False)).rgba for k in range(moments)]
            levels = 255 * np.median(drawn, axis=0)[..., :3]
            for axis in (0, 1):
                both = empty & np.roll(empty, -1, axis)
                steps = np.abs(np.roll(levels, -1, axis) - levels).max(axis=-1)
                assert np.delete(np.where(both, steps, 0), -1, axis).max() < 1
            assert np.abs(levels[empty] - 255 * np.array(OVERCAST.airlight)).max() < 1


def test_there_are_no_clouds_before_black():
    """At 12 mm/h in front of a black wall at 60 m: less than half a gray level, where haze Gaussians have seven."""
    y, z = (each.ravel() for each in np.meshgrid(np.arange(-24.0, 25, 2), np.arange(-16.0, 17, 2)))
    x = np.sqrt(60.0**2 - y**2 - z**2)  # all rays have one length
    wall = layer("wall", "background", np.stack([x, y, z], axis=1), 2.0, 0.0)
    renderer, size = CpuRenderer(), (480, 320)
    deviations = {}
    for name, own in (("medium", {"streaks": False}), ("all", {}), ("gaussians", {"haze": "gaussians"})):
        rain = RainSimulation.start(RainSettings(intensity_mm_h=12.0, **own))
        sequence = FrameSequence(Scene("wall", (wall,)), rain, camera(size, (1.0, 0.0, 0.0)), *size)
        levels = 255 * sequence.frame(renderer, 0, SkyColor(OVERCAST, False)).rgba[..., 1]
        deviations[name] = levels.std(), gaussian_filter(levels, 8.0).std()
    assert deviations["medium"][0] < 0.5
    assert deviations["all"][1] < 0.5
    assert deviations["gaussians"][1] > 3


def test_a_single_object_has_no_horizon():
    """Behind it is the same air everywhere; a wide ground, or one under a sky, ends the rays that go down."""
    rain = RainSimulation.start(RainSettings(intensity_mm_h=50.0))
    pot = layer("pot", "background", np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3)), 0.05, WALL)
    field = layer("field", "background", np.random.default_rng(0).uniform(-50.0, 50.0, (500, 3)), 0.05, WALL)
    floors = [
        rain_camera(Scene("a", layers, ground_m=-1.0), rain, RenderView(camera())).floor_m
        for layers in ((pot,), (pot, field), (pot, dome(0.0)))
    ]
    assert floors == [None, -1.0, -1.0]


def test_gaps_in_the_ground_show_no_air_from_beyond_it(any_renderer):
    """Without anything drawn, rays that go down end at the floor, those that go up don't."""
    pose = look_at(np.array([0.0, 0, 2]), np.array([1.0, 0.3, 1.9]), np.array([0.0, 0, 1]))
    eye = Camera.from_fov(60, 40, 50.0, pose)
    rain = RainSimulation.start(RainSettings(intensity_mm_h=50.0, streaks=False))
    view = RainCamera(eye, np.eye(4), np.zeros(3), floor_m=0.5)
    frame = rain.frame(0.0, view, SkyLight.uniform((0.8, 0.8, 0.8)))
    any_renderer.draw([], eye, frame)
    alpha = any_renderer.read().rgba[..., 3]
    x, y = np.meshgrid((np.arange(60) + 0.5 - eye.cx) / eye.fx, (np.arange(40) + 0.5 - eye.cy) / eye.fy)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ eye.world_to_camera[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    length = np.where(rays[..., 2] < 0, 1.5 / np.maximum(-rays[..., 2], 1e-9), np.inf)
    np.testing.assert_allclose(alpha, 1 - np.exp(-frame.extinction_per_m * length), atol=2e-3)
    assert alpha[-1].max() < 0.1 < 0.99 < alpha[0].min()
    any_renderer.draw([], eye, replace(frame, view=replace(view, floor_m=None)))
    np.testing.assert_allclose(any_renderer.read().rgba[..., 3], 1, atol=1e-3)
