"""The OpenGL and the CPU back end draw the same: scenes to 50 dB, the rain's own light to 5 % (docs/physics.md)."""

import dataclasses
from functools import partial
from typing import get_args

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import RenderView, draw_view
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.renderer import Frame, Renderer, RenderMode
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.scene.camera import Camera, look_at, read_camera
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene

LEAST_PSNR_DB = 50.0
LARGEST_RAIN_DIFFERENCE = 0.05
UP = np.array([0.0, 0.0, 1.0])


def psnr_db(a: Frame, b: Frame) -> float:
    return float(-10 * np.log10(np.mean((a.rgba[..., :3] - b.rgba[..., :3]) ** 2)))


def small_scene() -> Scene:
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


def small_shot() -> RenderView:
    eye = np.array([0.0, 0.0, 1.6])
    camera = Camera.from_fov(320, 200, 45.0, look_at(eye, eye + np.array([1, 0.1, 0.1]), UP))
    return RenderView(camera, 2.0, np.array([8.0, 0.0, 0.0]))


@pytest.fixture(params=["small", "golden"])
def scene_and_shot(request) -> tuple[Scene, RenderView]:
    """Two scenes; the golden street is in meters, z up."""
    if request.param == "small":
        return small_scene(), small_shot()
    golden = request.getfixturevalue("golden")
    street = Scene("street", read_scene(golden / "street_sh3.ply").layers)
    return street, RenderView(read_camera(golden / "street_sh3.camera.json"), 2.0)


@pytest.fixture
def renderers(context) -> tuple[Renderer, Renderer]:
    return SplatRenderer(context), CpuRenderer()


def seen(renderer: Renderer, scene: Scene, shot: RenderView, rain: RainSettings, *, with_depth: bool = False) -> Frame:
    draw_view(renderer, scene, RainSimulation.start(rain), OVERCAST, shot, with_depth=with_depth)
    return renderer.read()


def raining(**changes) -> RainSettings:
    return msgspec.structs.replace(load_preset("8.5"), **changes)


def test_clear_scenes_agree(renderers, scene_and_shot):
    opengl, cpu = (seen(each, *scene_and_shot, load_preset("clear"), with_depth=True) for each in renderers)
    assert psnr_db(opengl, cpu) >= LEAST_PSNR_DB
    assert opengl.depth is not None
    assert cpu.depth is not None
    assert ((opengl.depth > 0) == (cpu.depth > 0)).mean() > 0.999
    both = (opengl.depth > 0) & (cpu.depth > 0)
    assert np.quantile(np.abs(cpu.depth / np.where(both, opengl.depth, 1) - 1)[both], 0.99) < 0.01


@pytest.mark.parametrize("mixing", ["linear", "display"])
@pytest.mark.parametrize("exposure_s", [0.003, 0.05])
@pytest.mark.parametrize("haze", [True, False], ids=["streaks and haze", "streaks"])
def test_the_rains_own_light_agrees(renderers, scene_and_shot, mixing, exposure_s, haze):
    rain = raining(rain_light=mixing, exposure_s=exposure_s, haze=haze)
    rainy = [seen(each, *scene_and_shot, rain) for each in renderers]
    assert psnr_db(*rainy) >= LEAST_PSNR_DB
    clear = [seen(each, *scene_and_shot, load_preset("clear")) for each in renderers]
    of_opengl, of_cpu = (wet.rgba - dry.rgba for wet, dry in zip(rainy, clear, strict=True))
    assert np.linalg.norm(of_opengl[..., :3]) > 0
    for channels in (slice(0, 3), slice(3, 4)):
        difference = np.linalg.norm((of_cpu - of_opengl)[..., channels])
        assert difference <= LARGEST_RAIN_DIFFERENCE * np.linalg.norm(of_opengl[..., channels])


@pytest.mark.parametrize("mixing", ["linear", "display"])
def test_depth_knows_no_rain(renderers, mixing):
    look = partial(seen, scene=small_scene(), shot=small_shot(), with_depth=True)
    for renderer in renderers:
        clear = look(renderer, rain=load_preset("clear"))
        rainy = look(renderer, rain=raining(rain_light=mixing))
        np.testing.assert_array_equal(rainy.depth, clear.depth)
        assert (rainy.rgba != clear.rgba).any()


def test_no_rain_is_no_rain_to_the_last_bit(renderers, scene_and_shot):
    scene, shot = scene_and_shot
    for renderer in renderers:
        none = seen(renderer, scene, shot, raining(intensity_mm_h=0.0)).rgba.tobytes()
        renderer.draw(scene.parts(shot.time_s), shot.camera)
        assert renderer.read().rgba.tobytes() == none


@pytest.mark.parametrize("mixing", ["linear", "display"])
def test_the_same_frame_is_the_same_bytes(renderers, mixing):
    for renderer in renderers:
        look = partial(seen, renderer, small_scene(), rain=raining(rain_light=mixing))
        first = look(small_shot()).rgba.tobytes()
        look(RenderView(small_shot().camera, 3.0))
        assert look(small_shot()).rgba.tobytes() == first


def test_the_sky_has_the_same_color(renderers):
    here = small_shot().camera
    opengl, cpu = (sky_color(each, small_scene(), here).color for each in renderers)
    np.testing.assert_allclose(cpu, opengl, atol=2e-3)


def test_both_count_the_same(renderers, scene_and_shot):
    for renderer in renderers:
        seen(renderer, *scene_and_shot, raining())
    opengl, cpu = (each.statistics for each in renderers)
    assert opengl.gaussians == cpu.gaussians
    assert cpu.splats_drawn == pytest.approx(opengl.splats_drawn, rel=1e-3)
    assert set(cpu.stages_ms) == set(opengl.stages_ms)


def test_parts_that_are_thinned_out_are_drawn_the_same(renderers):
    """Only the first of them, grown: as if the others had never been there."""
    scene, shot = small_scene(), small_shot()
    (part,) = scene.parts()
    thin = part._replace(limit=1000, growth=1.5)
    first = part.gaussians.take(slice(0, 1000))
    grown = part._replace(gaussians=dataclasses.replace(first, scales=first.scales * np.float32(1.5)))
    for renderer in renderers:
        renderer.draw([grown], shot.camera)
        expected = renderer.read().rgba
        renderer.draw([thin], shot.camera)
        assert renderer.statistics.gaussians == 1000
        np.testing.assert_allclose(renderer.read().rgba, expected, atol=2e-4)


@pytest.mark.parametrize("look", [each for each in get_args(RenderMode) if each != "splats"])
def test_every_look_agrees(renderers, look):
    """But for pixels where a threshold falls to one side here and to the other there."""
    scene, shot = small_scene(), small_shot()
    pictures: list[np.ndarray] = []
    for renderer in renderers:
        renderer.draw(scene.parts(), shot.camera, look=look)
        pictures.append(renderer.read().rgba)
    assert np.isfinite(pictures).all()
    assert pictures[0].std() > 0.01
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(axis=-1) > 0.02) < 0.02
