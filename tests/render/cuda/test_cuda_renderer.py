"""The cuda back end around a stand-in for gsplat, on torch's CPU: it agrees with the CPU back end."""

import importlib.util
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine import backends
from gsrain_engine.backends import NoCudaError, open_renderer
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.cuda import SLABS, split_into_depth_slabs
from gsrain_engine.render.draw import RenderView, draw_view
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem, Layer, Scene
from render.cpu.raster_scenes import random_gaussians, small_camera
from render.cpu.test_marked_parts import COLORS, some_of

LEAST_PSNR_DB = 50.0
LARGEST_RAIN_DIFFERENCE = 0.05
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def cuda():
    pytest.importorskip("torch", reason="torch is not installed: pip install gsrain[jobs]")
    from gsrain_engine.render.cuda import CudaRenderer
    from render.cuda.gsplat_stand_in import rasterization

    return CudaRenderer(rasterization, "cpu")


def similarity(scale, angle, shift):
    matrix = np.eye(4)
    c, s = np.cos(angle), np.sin(angle)
    matrix[:3, :3] = scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    matrix[:3, 3] = shift
    return matrix


def drawn(renderer, *arguments, **options):
    renderer.draw(*arguments, **options)
    return renderer.read()


def psnr_db(a, b):
    return -10 * np.log10(max(np.mean((a.rgba - b.rgba) ** 2), 1e-20))


def streetlike():
    """Solid ground and walls, faint things before them, 2 to 40 m ahead (+x), z up."""
    r = np.random.default_rng(5)
    n, floor = 2500, 1500
    means = np.stack([r.uniform(2, 40, n), r.uniform(-12, 12, n), r.uniform(0, 9, n)], axis=1)
    scales = np.exp(r.normal(np.log(0.25), 0.6, (n, 3)))
    quaternions = r.normal(size=(n, 4))
    opacities = r.uniform(0.02, 1, n)
    means[:floor, 2], scales[:floor], quaternions[:floor], opacities[:floor] = 0, (0.8, 0.8, 0.05), (1, 0, 0, 0), 0.95
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    numbers = (means, scales, quaternions, opacities, r.normal(0, 0.4, (n, 4, 3)))
    scene = Scene("small", (Layer("all", Gaussians(*(np.ascontiguousarray(each, np.float32) for each in numbers))),))
    eye = np.array([0.0, 0.0, 1.6])
    camera = Camera.from_fov(240, 150, 45.0, look_at(eye, eye + np.array([1, 0.1, 0.1]), UP))
    return scene, RenderView(camera, 2.0, np.array([8.0, 0.0, 0.0]))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_parts_in_any_place_are_one_picture(cuda, degree):
    parts = [
        DrawItem(random_gaussians(300, 1, degree), np.eye(4)),
        DrawItem(random_gaussians(200, 2, degree), similarity(1.7, 0.4, (0.3, -0.2, 0.5))),
        DrawItem(random_gaussians(200, 3, 0), similarity(0.3, -1.1, (0.0, 0.4, 3.0)), limit=50),
    ]
    camera = replace(small_camera(), world_to_camera=similarity(1.0, 0.1, (0.1, 0.0, 0.2)))
    parts[2] = DrawItem(parts[2].gaussians.take(slice(0, 50)), parts[2].to_world)
    expected = drawn(CpuRenderer(), parts, camera, with_depth=True)
    parts[2] = DrawItem(random_gaussians(200, 3, 0), parts[2].to_world, limit=50)
    found = drawn(cuda, parts, camera, with_depth=True)
    assert psnr_db(found, expected) > 80
    assert ((found.depth > 0) == (expected.depth > 0)).mean() > 0.999
    both = (found.depth > 0) & (expected.depth > 0)
    np.testing.assert_allclose(found.depth[both], expected.depth[both], rtol=1e-3)
    assert cuda.statistics.gaussians == 550
    assert 0 < cuda.statistics.splats_drawn <= 550


@pytest.mark.parametrize("mixing", ["linear", "display"])
@pytest.mark.parametrize("exposure_s", [0.003, 0.05])
@pytest.mark.parametrize("haze", [True, False], ids=["streaks and haze", "streaks"])
def test_rain_adds_the_same_light(cuda, mixing, exposure_s, haze):
    scene, shot = streetlike()
    rain = msgspec.structs.replace(load_preset("8.5"), rain_light=mixing, exposure_s=exposure_s, haze=haze)
    frames = []
    for renderer in (CpuRenderer(), cuda):
        for each in (load_preset("clear"), rain):
            draw_view(renderer, scene, RainSimulation.start(each), OVERCAST, shot, with_depth=True)
            frames.append(renderer.read())
    expected_clear, expected, clear, rainy = frames
    assert psnr_db(rainy, expected) >= LEAST_PSNR_DB
    of_cpu, of_cuda = expected.rgba - expected_clear.rgba, rainy.rgba - clear.rgba
    assert np.linalg.norm(of_cpu[..., :3]) > 0
    for channels in (slice(0, 3), slice(3, 4)):
        difference = np.linalg.norm((of_cuda - of_cpu)[..., channels])
        assert difference <= LARGEST_RAIN_DIFFERENCE * np.linalg.norm(of_cpu[..., channels])
    np.testing.assert_array_equal(rainy.depth, clear.depth)
    assert cuda.statistics.haze_drawn > 0 or not haze


def test_rain_falls_before_nothing(cuda):
    _, shot = streetlike()
    rainy, expected = (
        (draw_view(each, Scene("empty"), RainSimulation.start(load_preset("12.0")), OVERCAST, shot), each.read())[1]
        for each in (cuda, CpuRenderer())
    )
    assert expected.rgba[..., 3].max() > 0.02
    np.testing.assert_allclose(rainy.rgba, expected.rgba, atol=2e-3)


def test_the_same_frame_is_the_same_bytes(cuda):
    scene, shot = streetlike()
    falling = RainSimulation.start(load_preset("8.5"))
    frames = []
    for moment in (2.0, 3.0, 2.0):
        draw_view(cuda, scene, falling, OVERCAST, replace(shot, time_s=moment))
        frames.append(cuda.read().rgba.tobytes())
    assert frames[0] == frames[2] != frames[1]


@pytest.mark.parametrize("field", ["means", "scales", "quaternions", "opacities", "sh"])
def test_what_is_not_finite_is_left_out(cuda, field):
    g = random_gaussians(60)
    arrays = {name: getattr(g, name).copy() for name in ("means", "scales", "quaternions", "opacities", "sh")}
    arrays[field].reshape(60, -1)[7, 0] = np.nan
    expected = drawn(CpuRenderer(), [DrawItem(g.take(np.delete(np.arange(60), 7)), np.eye(4))], small_camera())
    assert psnr_db(drawn(cuda, [DrawItem(Gaussians(**arrays), np.eye(4))], small_camera()), expected) > 80


def test_nothing_is_nothing(cuda):
    for parts in ([], [DrawItem(Gaussians.empty(), np.eye(4))]):
        frame = drawn(cuda, parts, small_camera(), with_depth=True)
        assert not frame.rgba.any()
        assert not frame.depth.any()


def test_other_looks_are_refused(cuda):
    with pytest.raises(ValueError, match="shows splats only; look at normals with --backend opengl or cpu"):
        cuda.draw([], small_camera(), look="normals")


def test_slabs_weigh_the_same():
    splats = project([DrawItem(random_gaussians(3000), np.eye(4))], small_camera())
    slabs = split_into_depth_slabs(splats)
    assert len(slabs.starts) == len(slabs.edges_m) == SLABS + 1
    assert (slabs.starts[0], slabs.starts[-1]) == (0, len(splats.nearest_first())) == (0, len(slabs.shapes))
    assert (np.diff(slabs.edges_m) >= 0).all()
    shapes = slabs.shapes.astype(np.float64)
    weights = np.exp(shapes[:, 5]) / np.sqrt(shapes[:, 3] * shapes[:, 4])
    of_slab = np.add.reduceat(weights, slabs.starts[:-1])
    assert np.abs(of_slab - weights.sum() / SLABS).max() <= weights.max()
    none = split_into_depth_slabs(project([DrawItem(Gaussians.empty(), np.eye(4))], small_camera()))
    assert (len(none.shapes), len(none.edges_m)) == (0, SLABS + 1)


@pytest.mark.parametrize("missing", ["torch", "gsplat"])
def test_what_is_missing_is_named(missing, monkeypatch):
    found = {"torch", "gsplat"} - {missing}
    monkeypatch.setattr(backends.importlib.util, "find_spec", lambda name: object() if name in found else None)
    with (
        pytest.raises(NoCudaError, match=f"needs {missing}, which is not installed: pip install"),
        open_renderer("cuda"),
    ):
        pass


@pytest.mark.skipif(importlib.util.find_spec("gsplat") is None, reason="gsplat is not installed: gsrain[cuda]")
def test_gsplat_draws_the_same():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("no NVIDIA GPU")
    parts = [DrawItem(random_gaussians(3000, 1, 3), np.eye(4))]
    with open_renderer("cuda") as renderer:
        found = drawn(renderer, parts, small_camera())
    assert psnr_db(found, drawn(CpuRenderer(), parts, small_camera())) >= LEAST_PSNR_DB


def test_marks_opacity_and_colours_are_obeyed(cuda):
    parts = [
        DrawItem(
            random_gaussians(400, 1, 2), np.eye(4), limit=300, growth=1.2, opacity=0.6, colors=COLORS,
            left_out=some_of(400), selected=some_of(400, 0.5, 1),
        ),
        DrawItem(random_gaussians(200, 2), similarity(1.7, 0.4, (0.3, -0.2, 0.5)), selected=some_of(200)),
        DrawItem(random_gaussians(100, 3), np.eye(4), opacity=0.0),
    ]  # fmt: skip
    expected = drawn(CpuRenderer(), parts, small_camera())
    assert psnr_db(drawn(cuda, parts, small_camera()), expected) > 80
    unmarked = [DrawItem(part.gaussians, part.to_world) for part in parts]
    assert psnr_db(drawn(cuda, unmarked, small_camera()), expected) < 30
