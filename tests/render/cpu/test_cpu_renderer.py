from dataclasses import replace

import numpy as np
import pytest

from given_rain import GivenRain, given_rain
from gsrain_engine.render.cpu.compositing import OPEN, RAIN_LINES, RAIN_SHARE, SCENE_SHARE, add_rain_light
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.cpu.tiles import TILE
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.scene import DrawItem
from oracles.rasterizer import rasterize_in_linear_light_slowly, rasterize_slowly

from .raster_scenes import at_each_thread_count, drawn, random_gaussians, small_camera

LIGHT = np.array([0.6, 0.5, 0.4], np.float32)


def drops(model: str = "physical", opacity: float = 0.3, seed: int = 9, count: int = 80) -> GivenRain:
    g = random_gaussians(count, seed)
    scales = (g.scales * np.array([0.1, 0.1, 1])).astype(np.float32)
    color = np.tile(linear_to_srgb(LIGHT).astype(np.float32), (count, 1))
    gaussians = Gaussians(g.means, scales, g.quaternions, g.opacities * np.float32(opacity), sh_from_color(color))
    return given_rain(gaussians, LIGHT, model)


def scene(count: int = 120, opacity: float | None = None) -> list[DrawItem]:
    g = random_gaussians(count, 0, 1)
    opacities = g.opacities if opacity is None else np.full(count, opacity, np.float32)
    return [DrawItem(replace(g, opacities=opacities), np.eye(4))]


@pytest.mark.parametrize("model", ["physical", "paper"])
@pytest.mark.parametrize(
    ("parts", "of_drops"), [(scene(), 0.3), (scene(opacity=0.97), 0.3), (scene(opacity=0.05), 0.3), (scene(), 0.01),
                            (scene(), 1.0), ([], 0.02)],
    ids=["mixed", "opaque scene", "faint scene", "faint drops", "dense drops", "no scene"],
)  # fmt: skip
def test_rain_agrees_with_the_reference(model, parts, of_drops):
    rain = drops(model, of_drops)
    frame = drawn(CpuRenderer(), parts, rain, with_depth=True)
    everything = [*parts, DrawItem(rain.given, np.eye(4))]
    flags = [None] * len(parts) + [np.ones(len(rain.given), bool)]
    if rain.is_linear:
        slow = rasterize_in_linear_light_slowly(everything, small_camera(), flags, LIGHT)
    else:
        slow = rasterize_slowly(everything, small_camera(), flags)
    difference = np.abs(frame.rgba - slow[..., :4]).max(axis=-1)
    # A fragment at a cut may fall on either side of it in float32: rarely, and by little.
    assert np.median(difference) < 2e-5
    assert (difference > 3e-4).mean() < 0.01
    assert difference.max() < 2e-2
    assert frame.rgba[..., 3].max() > 0
    clear = drawn(CpuRenderer(), parts, with_depth=True)
    np.testing.assert_array_equal(frame.depth, clear.depth)
    assert drawn(CpuRenderer(), parts, rain).depth is None


def test_pixels_without_rain_and_behind_walls_keep_every_bit():
    one = given_rain(drops(opacity=1).given.take(np.arange(3)), LIGHT, "physical")
    clear, rainy = drawn(CpuRenderer(), scene(500)).rgba, drawn(CpuRenderer(), scene(500), one).rgba
    alone = drawn(CpuRenderer(), [], one).rgba[..., 3] > 0
    assert 0.01 < alone.mean() < 0.9
    np.testing.assert_array_equal(rainy[~alone], clear[~alone])
    assert (rainy[alone] != clear[alone]).any()
    numbers = [[0, 0, 0.5]] * 4, [[5] * 3] * 4, [[1, 0, 0, 0]] * 4, [1] * 4, np.zeros((4, 1, 3))
    wall = Gaussians(*(np.array(each, np.float32) for each in numbers))
    for rain in (drops(opacity=1), drops(opacity=0), drops(count=0)):
        assert drawn(CpuRenderer(), wall, rain).rgba.tobytes() == drawn(CpuRenderer(), wall).rgba.tobytes()


@pytest.mark.parametrize("model", ["physical", "paper"])
def test_the_same_bytes_again_and_at_any_thread_count(model):
    def picture() -> bytes:
        frame = drawn(CpuRenderer(), scene(2000), drops(model), camera=small_camera(300, 200), with_depth=True)
        return frame.rgba.tobytes() + frame.depth.tobytes()

    assert len(at_each_thread_count(picture)) == 1


def test_the_curve_of_light_is_the_standards():
    # From darkness through both branches' joints to far brighter than white; one row of a tile after the other.
    values = np.concatenate([np.linspace(0, 0.1, 2000), np.geomspace(0.1, 1e6, 2000)]).astype(np.float32)
    r = np.random.default_rng(0)
    for some in values.reshape(-1, TILE):
        rain, scene, passed = (r.uniform(*ends, TILE).astype(np.float32) for ends in ((1e-6, 0.5), (0, 1), (0.1, 0.2)))
        row = np.zeros((RAIN_LINES, TILE), np.float32)
        row[1:4], row[5] = some, 1
        row[OPEN // TILE], row[RAIN_SHARE // TILE], row[SCENE_SHARE // TILE] = passed, rain, scene
        add_rain_light(row.ravel(), LIGHT)
        share, rain = scene.astype(np.float64) + passed, rain.astype(np.float64)
        light = np.minimum(share, 1) * srgb_to_linear(some.astype(np.float64)) + rain * LIGHT[:, None]
        np.testing.assert_allclose(row[1:4], linear_to_srgb(light), rtol=3e-6)
        np.testing.assert_allclose(row[5], share + rain, rtol=1e-6)
