"""The OpenGL back ends draw as the CPU does: scenes to 50 dB, the rain's own light to 5 % (docs/physics/streaks.md)."""

from dataclasses import replace
from typing import get_args

import msgspec
import numpy as np
import pytest

from gsrain_engine.choices import RenderMode
from gsrain_engine.rain.settings import RegionBox, load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput, Quality
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at, read_camera
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.ground_water import GroundWater
from gsrain_engine.scene.scene import DrawItem, Layer, Scene
from render.cpu.raster_scenes import drawn, psnr_db, random_gaussians, similarity, small_camera
from simulation.small_drive import box_actor
from small_scene import patch

MIN_PSNR_DB = 50.0
MAX_RAIN_DIFFERENCE = 0.05


def small_scene():
    """Colored Gaussians above a floor, solid ones and faint ones, from 2 to 40 m."""
    r = np.random.default_rng(5)
    n, floor = 2500, 1500
    means = np.stack([r.uniform(2, 40, n), r.uniform(-12, 12, n), r.uniform(0, 9, n)], axis=1)
    scales = np.exp(r.normal(np.log(0.25), 0.6, (n, 3)))
    quaternions = r.normal(size=(n, 4))
    opacities = r.uniform(0.02, 1, n)
    means[:floor, 2], scales[:floor], quaternions[:floor], opacities[:floor] = 0, (0.8, 0.8, 0.05), (1, 0, 0, 0), 0.95
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    numbers = (means, scales, quaternions, opacities, r.normal(0, 0.4, (n, 4, 3)))
    gaussians = Gaussians(*(np.ascontiguousarray(each, np.float32) for each in numbers))
    return Scene("small", (Layer("all", gaussians),))


def small_shot(width=320, height=200):
    eye = np.array([0.0, 0.0, 1.6])
    pose = look_at(eye, eye + np.array([1, 0.1, 0.1]), np.array([0.0, 0.0, 1.0]))
    full = Camera.from_fov(320, 200, 45.0, pose)
    return RenderView(full.resized(width, height), 2.0, np.array([8.0, 0.0, 0.0]), focal_px=full.fx)


def frame_of(renderer, scene, shot, rain):
    draw(renderer, FrameInput.of(scene, RainSimulation.start(rain), OVERCAST, shot, Quality(with_depth=True)))
    return renderer.read()


def raining(**changes):
    return msgspec.structs.replace(load_preset("8.5"), **changes)


@pytest.fixture(params=["opengl", "opengl-tiles"])
def other(request, open_kind):
    return open_kind(request.param)


PLACES = [("opengl", "small"), ("opengl", "golden"), ("opengl-tiles", "small"), ("opengl-tiles", "golden")]


@pytest.fixture(scope="module")
def drawn_frames():
    """Frames by renderer, place and rain: each is drawn once for all tests that compare it."""
    return {}


@pytest.fixture
def frame_at(request, open_kind, drawn_frames):
    """Draw a place in rain by a kind of renderer; the golden street is in meters, z up."""

    def drawn_once(kind, place, rain):
        if (kind, place, rain) not in drawn_frames:
            scene, shot = small_scene(), small_shot()
            if place == "golden":
                golden = request.getfixturevalue("golden")
                scene = Scene("street", read_scene(golden / "street_sh3.ply").layers)
                shot = RenderView(read_camera(golden / "street_sh3.camera.json"), 2.0)
            renderer = open_kind(kind)
            drawn_frames[kind, place, rain] = frame_of(renderer, scene, shot, rain), renderer.statistics
        return drawn_frames[kind, place, rain]

    return drawn_once


LIGHTS = [
    {"model": "physical", "exposure_s": 0.003},
    {"model": "paper", "exposure_s": 0.05},
    {"model": "physical", "exposure_s": 0.05, "haze": "none"},
    {"model": "paper", "exposure_s": 0.003, "haze": "none"},
    {"model": "physical", "exposure_s": 0.003, "haze": "gaussians"},
    {"intensity_mm_h": 0.0, "visibility_m": 40.0},
    {"intensity_mm_h": 80.0, "visibility_m": 40.0, "model": "paper"},
    {
        "model": "physical",
        "intensity_mm_h": 80.0,
        "haze_region": RegionBox(minimum_m=(-9, -9, -1), maximum_m=(30, 9, 20)),
    },
]
"""Settings of the rain. It meets a scene as depth and colors alone: three of them are enough for a second place."""
SCENES_IN_RAIN = [
    (kind, place, each) for kind, place in PLACES for each in (LIGHTS if place == "small" else LIGHTS[::3])
]


@pytest.mark.parametrize(("kind", "place", "changes"), SCENES_IN_RAIN)
def test_scenes_and_the_rains_own_light_agree(frame_at, kind, place, changes):
    clear, rainy = (
        [frame_at(each, place, rain)[0] for each in (kind, "cpu")]
        for rain in (load_preset("clear"), raining(**changes))
    )
    assert psnr_db(*clear) >= MIN_PSNR_DB
    assert psnr_db(*rainy) >= MIN_PSNR_DB
    ours, expected = (wet.rgba - dry.rgba for wet, dry in zip(rainy, clear, strict=True))
    for channels in (slice(0, 3), slice(3, 4)):
        light = np.linalg.norm(expected[..., channels])
        assert np.linalg.norm((ours - expected)[..., channels]) <= MAX_RAIN_DIFFERENCE * light > 0
    found, depth = (each.depth for each in clear)
    assert ((found > 0) == (depth > 0)).mean() > 0.999
    both = (found > 0) & (depth > 0)
    assert np.quantile(np.abs(depth / np.where(both, found, 1) - 1)[both], 0.99) < 0.01
    for wet, dry in zip(rainy, clear, strict=True):  # without the rain's
        np.testing.assert_array_equal(wet.depth, dry.depth)


@pytest.mark.parametrize("kind", ["opengl", "opengl-tiles"])
def test_wet_ground_mirrors_and_splashes_the_same_on_all(kind, open_kind):
    cover = np.random.default_rng(3).integers(0, 120, (24, 40, 2), np.uint8)
    scene = replace(small_scene(), ground_m=0.0, water=GroundWater((0.0, -12.0), 1.0, cover))
    scene = replace(scene, layers=tuple(replace(each, wet_sh=each.gaussians.sh.copy()) for each in scene.layers))
    shot, rain = small_shot(), raining(mirror=True, exposure_s=0.003)
    renderers = open_kind(kind), CpuRenderer()
    found, expected = (frame_of(each, scene, shot, rain) for each in renderers)
    plain = frame_of(renderers[1], scene, shot, raining(mirror=False, exposure_s=0.003))
    assert psnr_db(found, expected) >= MIN_PSNR_DB
    assert np.abs(expected.rgba - plain.rgba).max() > 0.05
    np.testing.assert_array_equal(frame_of(renderers[0], scene, shot, rain).rgba, found.rgba)
    ground = patch((7, -1.5, 0), np.array([4.0, 0, 0]), np.array([0, 3.0, 0]), 40, (0.05, 0.05, 0.05))
    floor = replace(scene, layers=(Layer("floor", ground, wet_sh=ground.sh.copy()),))
    eye = np.array([8.0, 0.0, 0.7])
    low = look_at(eye, eye + np.array([1.5, 0.0, -0.6]), np.array([0.0, 0.0, 1.0]))
    near = RenderView(Camera.from_fov(shot.camera.width, shot.camera.height, 40.0, low), 0.4)
    found, expected = (frame_of(each, floor, near, raining(exposure_s=0.003)) for each in renderers)
    calm = frame_of(renderers[1], floor, near, raining(exposure_s=0.003, splashes=False))
    assert psnr_db(found, expected) >= MIN_PSNR_DB
    assert np.abs(expected.rgba - calm.rgba).max() > 0.05


@pytest.mark.parametrize("kind", ["opengl", "opengl-tiles"])
def test_spray_is_the_same_on_all(kind, open_kind):
    """A block that drives ahead at 25 m/s, 10 m from the camera at 2 s."""
    scene = small_scene()
    wet = replace(scene.layers[0], wet_sh=scene.layers[0].gaussians.sh.copy())
    block = box_actor(times=(0.0, 4.0), positions=((-40.0, 0, 0), (60.0, 0, 0)))
    scene, shot = replace(scene, layers=(wet,), actors=(block,)), small_shot(64, 40)
    found, expected = (frame_of(each, scene, shot, raining()) for each in (open_kind(kind), CpuRenderer()))
    plain = frame_of(CpuRenderer(), scene, shot, raining(spray=False))
    assert psnr_db(found, expected) >= MIN_PSNR_DB
    assert np.abs(expected.rgba - plain.rgba).max() > 0.1


@pytest.mark.parametrize(("kind", "place"), PLACES)
def test_both_count_the_same(frame_at, kind, place):
    ours, cpu = (frame_at(each, place, raining(haze="gaussians"))[1] for each in (kind, "cpu"))
    assert ours.haze_drawn == cpu.haze_drawn > 0
    assert ours.drops_drawn == pytest.approx(cpu.drops_drawn, rel=2e-3)
    assert ours.gaussians == cpu.gaussians
    assert ours.splats_drawn == pytest.approx(cpu.splats_drawn, rel=1e-3)
    assert set(ours.stages_ms) <= set(cpu.stages_ms)  # which finds drops in stages of their own


@pytest.mark.parametrize("model", ["physical", "paper"])
def test_the_same_frame_is_the_same_bytes_and_no_rain_is_no_rain(any_renderer, model):
    scene, shot = small_scene(), small_shot(64, 40)
    rain = raining(model=model)
    first, _, again, none = (
        frame_of(any_renderer, scene, replace(shot, time_s=time_s), each).rgba.tobytes()
        for time_s, each in ((2.0, rain), (3.0, rain), (2.0, rain), (2.0, raining(intensity_mm_h=0.0)))
    )
    assert first == again != none
    assert drawn(any_renderer, scene.parts(shot.time_s), camera=shot.camera).rgba.tobytes() == none


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_parts_in_any_place_are_one_picture(other, degree):
    parts = [
        DrawItem(random_gaussians(300, 1, degree), np.eye(4)),
        DrawItem(random_gaussians(200, 2, degree), similarity(1.7, 1)),
        DrawItem(random_gaussians(200, 3), similarity(0.3, 2), limit=50),
    ]
    parts[1].to_world[:3, 3], parts[2].to_world[:3, 3] = (0.3, -0.2, 6.0), (0.0, 0.4, 5.0)
    camera = replace(
        small_camera(), world_to_camera=look_at(np.array([0.1, 0, -0.2]), np.array([0, 0.1, 5.0]), -np.eye(3)[1])
    )
    expected, found = (drawn(each, parts, camera=camera, with_depth=True) for each in (CpuRenderer(), other))
    assert psnr_db(found, expected) > (60 if other.name == "opengl" else 80)
    both = (found.depth > 0) & (expected.depth > 0)
    assert (both == (expected.depth > 0)).mean() > 0.999
    np.testing.assert_allclose(found.depth[both], expected.depth[both], rtol=3e-3)
    assert other.statistics.gaussians == 550
    assert 0 < other.statistics.splats_drawn <= 550


@pytest.mark.parametrize("kind", ["opengl", "opengl-tiles"])
def test_antialiased_gaussians_agree_and_thin_ones_do_not_grow(open_kind, kind):
    some = random_gaussians(600, 4)
    thin = replace(some, scales=some.scales * np.float32([1, 0.05, 0.05]), antialiased=True)
    expected, found = (drawn(each, thin) for each in (CpuRenderer(), open_kind(kind)))
    assert psnr_db(found, expected) >= MIN_PSNR_DB
    assert psnr_db(drawn(CpuRenderer(), replace(thin, antialiased=False)), expected) < 35
    # Balls of 0.2 px keep their integral of alpha; through the filter of 3DGS they would have 8.5 times as much.
    camera, depth, count = small_camera(), 10.0, 25
    px = np.stack(np.meshgrid(np.arange(5), np.arange(5)), axis=2).reshape(-1, 2) * 8.2 + 10
    means = np.column_stack([(px - [camera.cx, camera.cy]) * depth / [camera.fx, camera.fy], np.full(count, depth)])
    sigmas, opacities = np.full((count, 3), 0.2 * depth / camera.fx), np.full(count, 0.9)
    balls = random_gaussians(count)
    balls = Gaussians(*(np.float32(each) for each in (means, sigmas, balls.quaternions, opacities, balls.sh)))
    alpha = drawn(open_kind(kind), replace(balls, antialiased=True)).rgba[..., 3].sum()
    assert alpha == pytest.approx(count * 0.9 * 2 * np.pi * 0.2**2, rel=0.12)  # larger off the axis
    assert drawn(open_kind(kind), balls).rgba[..., 3].sum() > 6 * alpha


def test_nothing_is_nothing_and_rain_falls_before_it(any_renderer):
    for parts in ([], Gaussians.empty(), random_gaussians(5, depth_m=(-9, 0.2))):
        frame = drawn(any_renderer, parts, with_depth=True)
        assert frame.rgba.shape == (53, 75, 4)
        assert not frame.rgba.any()
        assert not frame.depth.any()
    rainy, expected = (
        frame_of(each, Scene("empty"), small_shot(64, 40), load_preset("12.0")).rgba
        for each in (any_renderer, CpuRenderer())
    )
    assert expected[..., 3].max() > 0.02
    np.testing.assert_allclose(rainy, expected, atol=2e-3)


def test_the_sky_has_the_same_color(open_kind):
    here = small_shot().camera
    opengl, cpu = (sky_color(each, small_scene(), here).light for each in (open_kind("opengl"), CpuRenderer()))
    np.testing.assert_allclose(cpu, opengl, atol=2e-3)


@pytest.mark.parametrize("kind", ["opengl", "opengl-tiles"])
@pytest.mark.parametrize("look", [each for each in get_args(RenderMode) if each != "splats"])
def test_every_look_agrees(open_kind, kind, look):
    """But for pixels where a threshold falls to one side here and to the other there."""
    first, second = (
        drawn(each, small_scene().parts(), camera=small_shot().camera, mode=look).rgba
        for each in (open_kind(kind), CpuRenderer())
    )
    assert np.isfinite(first).all()
    assert first.std() > 0.01
    assert np.mean(np.abs(first - second).max(axis=-1) > 0.02) < 0.02
