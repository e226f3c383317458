import hashlib

import numba
import numpy as np
import pytest

from given_rain import GivenRain, given_rain
from gsrain_engine.render.cpu.compositing import RAIN_LINES, add_rain_light
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.cpu.tiles import TILE
from gsrain_engine.render.renderer import Frame
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.scene import DrawItem
from oracles.rasterizer import rasterize_in_linear_light_slowly, rasterize_slowly

from .raster_scenes import random_gaussians, small_camera

LIGHT = np.array([0.6, 0.5, 0.4], np.float32)


def scene(count: int = 120, seed: int = 0, opacity: float | None = None) -> list[DrawItem]:
    g = random_gaussians(count, seed, 1)
    opacities = g.opacities if opacity is None else np.full(count, opacity, np.float32)
    return [DrawItem(Gaussians(g.means, g.scales, g.quaternions, opacities, g.sh), np.eye(4))]


def drops(mixing: str = "linear", opacity: float = 0.3, seed: int = 9, count: int = 80) -> GivenRain:
    g = random_gaussians(count, seed)
    scales = (g.scales * np.array([0.1, 0.1, 1])).astype(np.float32)
    color = np.tile(linear_to_srgb(LIGHT).astype(np.float32), (count, 1))
    gaussians = Gaussians(g.means, scales, g.quaternions, g.opacities * np.float32(opacity), sh_from_color(color))
    return given_rain(gaussians, LIGHT, mixing)


def drawn(parts, rain=None, camera=None, with_depth=True) -> Frame:
    renderer = CpuRenderer()
    renderer.draw(parts, camera or small_camera(), rain, with_depth=with_depth)
    return renderer.read()


def slowly(parts, rain: GivenRain) -> np.ndarray:
    everything = [*parts, DrawItem(rain.given, np.eye(4))]
    flags = [None] * len(parts) + [np.ones(len(rain.given), bool)]
    if rain.is_linear:
        return rasterize_in_linear_light_slowly(everything, small_camera(), flags, LIGHT)
    return rasterize_slowly(everything, small_camera(), flags)


@pytest.mark.parametrize("mixing", ["linear", "display"])
@pytest.mark.parametrize(
    ("opacity", "of_drops"), [(None, 0.3), (0.97, 0.3), (0.05, 0.3), (None, 0.01), (None, 1.0)],
    ids=["mixed", "opaque scene", "faint scene", "faint drops", "dense drops"],
)  # fmt: skip
def test_agrees_with_the_reference(mixing, opacity, of_drops):
    parts, rain = scene(opacity=opacity), drops(mixing, of_drops)
    difference = np.abs(drawn(parts, rain).rgba - slowly(parts, rain)[..., :4]).max(axis=-1)
    # A fragment at a cut may fall on either side of it in float32: rarely, and by little.
    assert np.median(difference) < 2e-5
    assert (difference > 3e-4).mean() < 0.01
    assert difference.max() < 2e-2


@pytest.mark.parametrize("mixing", ["linear", "display"])
def test_rain_alone_agrees_with_the_reference(mixing):
    rain = drops(mixing, 0.02)
    frame = drawn([], rain)
    np.testing.assert_allclose(frame.rgba, slowly([], rain)[..., :4], atol=2e-4)
    assert frame.rgba[..., 3].max() > 0
    assert (frame.depth == 0).all()


@pytest.mark.parametrize("rain", [drops(opacity=0), drops(count=0)], ids=["invisible", "none"])
def test_rain_that_is_not_seen_changes_no_bit(rain):
    clear, same = drawn(scene()), drawn(scene(), rain)
    assert clear.rgba.tobytes() == same.rgba.tobytes()
    assert clear.depth.tobytes() == same.depth.tobytes()


def test_pixels_without_rain_keep_every_bit():
    one = drops(opacity=1).given.take(np.arange(3))
    clear, rainy = drawn(scene(500)), drawn(scene(500), given_rain(one, LIGHT, "linear"))
    alone = drawn([], given_rain(one, LIGHT, "linear")).rgba[..., 3] > 0
    assert 0.01 < alone.mean() < 0.9
    np.testing.assert_array_equal(rainy.rgba[~alone], clear.rgba[~alone])
    assert (rainy.rgba[alone] != clear.rgba[alone]).any()


@pytest.mark.parametrize("mixing", ["linear", "display"])
def test_depth_is_the_clear_scenes_own(mixing):
    clear, rainy = drawn(scene()), drawn(scene(), drops(mixing, 1.0))
    assert (clear.depth > 0).any()
    np.testing.assert_array_equal(rainy.depth, clear.depth)
    assert drawn(scene(), drops(mixing), with_depth=False).depth is None


def test_rain_behind_a_wall_is_not_seen():
    wall = Gaussians(
        np.array([[0, 0, 0.5]] * 4, np.float32), np.full((4, 3), 5, np.float32),
        np.array([[1, 0, 0, 0]] * 4, np.float32), np.ones(4, np.float32), np.zeros((4, 1, 3), np.float32),
    )  # fmt: skip
    parts = [DrawItem(wall, np.eye(4))]
    np.testing.assert_array_equal(drawn(parts, drops(opacity=1)).rgba, drawn(parts).rgba)


@pytest.mark.parametrize("mixing", ["linear", "display"])
def test_the_same_bytes_again_and_at_any_thread_count(mixing):
    camera, digests, before = small_camera(300, 200), set(), numba.get_num_threads()
    try:
        for threads in (*range(1, numba.config.NUMBA_NUM_THREADS + 1), before):
            numba.set_num_threads(threads)
            frame = drawn(scene(2000), drops(mixing), camera)
            digests.add(hashlib.sha256(frame.rgba.tobytes() + frame.depth.tobytes()).hexdigest())
    finally:
        numba.set_num_threads(before)
    assert len(digests) == 1


def test_counts_and_times_what_it_drew():
    renderer = CpuRenderer()
    renderer.draw(scene(), small_camera(), drops())
    assert renderer.statistics.gaussians == 120
    assert 0 < renderer.statistics.splats_drawn <= 200
    assert list(renderer.statistics.stages_ms) == ["project", "sort", "draw"]
    assert all(value > 0 for value in renderer.statistics.stages_ms.values())


def test_the_curve_of_light_is_the_standards():
    # From darkness through both branches' joints to far brighter than white; one row of a tile after the other.
    values = np.concatenate([np.linspace(0, 0.1, 2000), np.geomspace(0.1, 1e6, 2000)]).astype(np.float32)
    r = np.random.default_rng(0)
    for some in values.reshape(-1, TILE):
        rain, scene, passed = (r.uniform(*ends, TILE).astype(np.float32) for ends in ((1e-6, 0.5), (0, 1), (0.1, 0.2)))
        row = np.zeros((RAIN_LINES, TILE), np.float32)
        row[1:4], row[5], row[6], row[7], row[8] = some, 1, passed, rain, scene
        add_rain_light(row.ravel(), LIGHT)
        share, rain = scene.astype(np.float64) + passed, rain.astype(np.float64)
        light = np.minimum(share, 1) * srgb_to_linear(some.astype(np.float64)) + rain * LIGHT[:, None]
        np.testing.assert_allclose(row[1:4], linear_to_srgb(light), rtol=3e-6)
        np.testing.assert_allclose(row[5], share + rain, rtol=1e-6)
