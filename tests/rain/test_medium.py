"""Haze as a medium: extinction along rays, in numbers and in float images (docs/physics/extinction.md)."""

import msgspec
import numpy as np
import pytest

from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.frame import RainCamera, SkyLight
from gsrain_engine.rain.keyframes import rain_of
from gsrain_engine.rain.settings import HAZE_REGION, RainSettings, RegionBox, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.scene import DrawItem, Layer, Scene

UP = np.array([0.0, 0, 1])
INTENSITIES, DISTANCES_M = [2.5, 8.5, 25.0, 50.0, 100.0], np.array([10.0, 50.0, 161.0, 500.0])
AIRLIGHT = np.array([0.5, 0.55, 0.6])  # linear
SKY = tuple(linear_to_srgb(AIRLIGHT).tolist())
LIGHT = SkyLight((0.9, 0.9, 0.9), SKY)


def camera_at(eye=(0.0, 0, 0), target=(1.0, 0, 0), size=(60, 40), fov_deg=50.0):
    return Camera.from_fov(*size, fov_deg, look_at(np.array(eye, float), np.array(target, float), UP))


def frame_of(camera=None, anchor=None, time_s=0.0, focal_px=None, **fields):
    rainfall = RainSimulation.start(RainSettings(**fields))
    anchor = np.eye(4) if anchor is None else anchor
    return rainfall.frame(time_s, RainCamera(camera or camera_at(), anchor, np.zeros(3), focal_px), LIGHT)


def beta_of(frame):
    """Twice the cross-sections of all drops of a cubic meter."""
    per_m3 = frame.count / np.prod(frame.period_m)
    return 2 * per_m3 * np.mean(np.pi / 4 * (1e-3 * frame.diameters_mm) ** 2)


def directions(count=40, seed=3):
    """Unit vectors in the camera's frame, up to about 50 degrees off the axis; the first is the axis."""
    found = np.random.default_rng(seed).uniform(-0.85, 0.85, (count, 3))
    found[:, 2], found[0] = 1, (0, 0, 1)
    return found / np.linalg.norm(found, axis=1, keepdims=True)


# Numbers


@pytest.mark.parametrize("intensity_mm_h", INTENSITIES)
def test_points_keep_exp_of_minus_beta_r(intensity_mm_h):
    frame = frame_of(intensity_mm_h=intensity_mm_h, streaks=False)
    rays = directions()
    for distance_m in DISTANCES_M:
        expected = np.exp(-beta_of(frame) * distance_m)
        assert frame.medium.transmittance(rays * distance_m) == pytest.approx(np.full(len(rays), expected), rel=0.01)


@pytest.mark.parametrize("intensity_mm_h", INTENSITIES)
def test_medium_and_streaks_extinguish_beta_together(intensity_mm_h):
    """Against the cross-sections of the drawn drops, summed along each ray by brute force."""
    anchor = np.eye(4)
    anchor[:2, :2] = [[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]
    eye = camera_at((0.5, 0.2, 0.3))
    frame = frame_of(eye, anchor, focal_px=1200.0, intensity_mm_h=intensity_mm_h)
    per_m3 = frame.count / np.prod(frame.period_m)
    areas = np.pi / 4 * (1e-3 * frame.diameters_mm) ** 2
    order = np.argsort(frame.culling.class_far_m)
    beyond = np.append(np.cumsum(areas[order][::-1])[::-1], 0.0) / len(areas)
    steps = (np.arange(20_000) + 0.5) * 12.0 / 20_000
    to_world = np.linalg.inv(frame.view.camera.world_to_camera)
    low, high = np.array(frame.rain.streak_region.minimum_m), np.array(frame.rain.streak_region.maximum_m)
    total, ours = [], []
    for ray in directions():
        points = steps[:, None] * ray
        local = (points @ to_world[:3, :3].T + to_world[:3, 3]) @ anchor[:3, :3]
        drawn = np.all((local > low) & (local < high), axis=1) & (points[:, 2] > 0.2)
        area = beyond[np.searchsorted(frame.culling.class_far_m[order], points[:, 2])]
        ours.append(per_m3 * np.sum(area * drawn) * 12.0 / 20_000)
        total.append(ours[-1] - np.log(frame.medium.transmittance(12.0 * ray[None])[0]))
    assert min(ours) > 0.05 * 12.0 * beta_of(frame)
    assert total == pytest.approx(np.full(len(total), 12.0 * beta_of(frame)), rel=0.01)


def test_drawn_streaks_hide_what_the_medium_leaves_to_them():
    """Mean optical depth of 30 images of streaks alone, against the gap in the medium before a far wall."""
    camera = camera_at(size=(120, 80), fov_deg=20.0)
    rain = {"intensity_mm_h": 50.0, "exposure_s": 0.004}
    frame, points = frame_of(camera, **rain), 10.0 * directions()[:1]
    alone = frame_of(camera, **rain, streaks=False)
    gap = np.log(frame.medium.transmittance(points)[0] / alone.medium.transmittance(points)[0])
    renderer, depths = CpuRenderer(), []
    for time_s in range(30):
        renderer.draw([], camera, frame_of(camera, time_s=0.5 * time_s, **rain, haze="none"))
        depths.append(np.mean(-np.log1p(-renderer.read().rgba[..., 3].astype(float))))
    error = np.std(depths) / np.sqrt(len(depths))
    assert error < 0.1 * gap
    assert abs(np.mean(depths) - gap) < 3.5 * error


@pytest.mark.parametrize("eye", [(0.0, 0.0, 0.0), (-30.0, 4.0, 3.0), (12.0, -25.0, 9.0)])
@pytest.mark.parametrize("streaks", [False, True])
def test_a_region_counts_its_part_of_each_ray(eye, streaks):
    """Against an integral in steps of 1 cm, from inside and from outside."""
    region = RegionBox(minimum_m=(-5.0, -8.0, -1.0), maximum_m=(25.0, 6.0, 7.0))
    anchor = np.eye(4)
    anchor[:2, :2], anchor[:3, 3] = [[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]], (1.0, -2.0, 0.5)
    camera = camera_at(eye, (8.0, 0.0, 2.0))
    frame = frame_of(camera, anchor, intensity_mm_h=80.0, haze_region=region, streaks=streaks)
    everywhere = frame_of(camera, anchor, intensity_mm_h=80.0, streaks=streaks).medium
    to_world, steps = np.linalg.inv(camera.world_to_camera), (np.arange(7000) + 0.5) * 0.01
    lengths, rays, gaps = [], directions(60), []
    for ray in rays:
        local = ((steps[:, None] * ray) @ to_world[:3, :3].T + to_world[:3, 3] - anchor[:3, 3]) @ anchor[:3, :3]
        inside = np.all((local > region.minimum_m) & (local < region.maximum_m), axis=1)
        lengths.append(0.01 * np.sum(inside))
        gaps.append(frame.extinction_per_m * 70.0 + np.log(everywhere.transmittance(70.0 * ray[None])[0]))
    assert np.ptp(lengths) > 5
    depths = -np.log(frame.medium.transmittance(70.0 * rays))
    if streaks:  # the region has all of that of streaks
        depths += gaps
    assert depths == pytest.approx(frame.extinction_per_m * np.array(lengths), abs=frame.extinction_per_m * 0.03)


def test_camera_and_lidar_have_one_beta():
    frame = frame_of(intensity_mm_h=50.0, streaks=False)
    sensor = SENSORS["64"]
    clear, rainy = (sensor.signal(DISTANCES_M, np.full(4, 0.2), beta) for beta in (0.0, frame.extinction_per_m))
    once = frame.medium.transmittance(DISTANCES_M[:, None] * directions(1))
    assert rainy / clear == pytest.approx(once.astype(float) ** 2, rel=1e-3)


# Images


def wall(distance_m, linear):
    """Opaque planes across the view, flat along x; several, since no Gaussian is quite opaque."""
    x = distance_m + 1e-3 * np.arange(4)
    means, count = np.stack([x, 0 * x, 0 * x], axis=1), len(x)
    scales, turns = np.tile([1e-4, 1e5, 1e5], (count, 1)), np.tile([1.0, 0, 0, 0], (count, 1))
    color = sh_from_color(np.tile(linear_to_srgb(np.array(linear)), (count, 1)).astype(np.float32))
    numbers = (np.asarray(each, np.float32) for each in (means, scales, turns, np.ones(count)))
    return DrawItem(Gaussians(*numbers, color), np.eye(4))


@pytest.mark.parametrize("intensity_mm_h", INTENSITIES)
@pytest.mark.parametrize("distance_m", DISTANCES_M)
def test_a_wall_keeps_its_share_of_contrast(intensity_mm_h, distance_m):
    """A dark wall against the airlight, in linear light: the contrast falls by exp(-beta r) (Koschmieder 1924)."""
    camera = camera_at(size=(24, 16), fov_deg=6.0)
    frame, renderer, dark = frame_of(camera, intensity_mm_h=intensity_mm_h, streaks=False), CpuRenderer(), 0.02
    renderer.draw([wall(distance_m, np.full(3, dark))], camera, frame)
    image = srgb_to_linear(renderer.read().rgba[..., :3].astype(float))
    contrast = (AIRLIGHT - image) / (AIRLIGHT - dark)
    expected = np.exp(-beta_of(frame) * distance_m)
    tolerance = 0.01 * expected if expected > 0.05 else 0.002
    assert contrast == pytest.approx(np.full(contrast.shape, expected), abs=tolerance)


@pytest.mark.parametrize("model", ["physical", "paper"])
@pytest.mark.parametrize("streaks", [False, True])
def test_sky_is_airlight(model, streaks):
    camera, renderer = camera_at(), CpuRenderer()
    renderer.draw([], camera, frame_of(camera, intensity_mm_h=8.5, model=model, streaks=streaks))
    rgba = renderer.read().rgba
    assert rgba == pytest.approx(np.broadcast_to([*SKY, 1.0], rgba.shape), abs=1e-3)


def test_an_object_has_no_edge_of_fog_from_any_side():
    """Around a ball of Gaussians, the background is the same at every pixel and from all sides."""
    r = np.random.default_rng(4)
    means = r.normal(size=(400, 3))
    means *= 0.6 / np.linalg.norm(means, axis=1, keepdims=True)
    numbers = means, np.full((400, 3), 0.08), np.tile([1.0, 0, 0, 0], (400, 1)), np.full(400, 0.95)
    colors = sh_from_color(np.full((400, 3), 0.2, np.float32))
    ball = DrawItem(Gaussians(*(np.asarray(each, np.float32) for each in numbers), colors), np.eye(4))
    renderer = CpuRenderer()
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        camera = camera_at((6 * np.cos(angle), 6 * np.sin(angle), 1.0), (0.0, 0, 0), size=(96, 96))
        frame = frame_of(camera, intensity_mm_h=50.0, streaks=False)
        renderer.draw([ball], camera, None)
        empty = renderer.read().rgba[..., 3] == 0
        renderer.draw([ball], camera, frame)
        rgba = renderer.read().rgba
        assert 0.5 < empty.mean() < 0.95
        assert rgba[empty] == pytest.approx(np.broadcast_to([*SKY, 1.0], rgba[empty].shape), abs=1e-4)
        assert rgba[48, 48, 0] < 0.5 * SKY[0]


# Settings


def test_haze_is_a_medium_everywhere_but_the_paper_s_is_of_gaussians():
    rain, paper = RainSettings(intensity_mm_h=8.5), load_preset("paper")
    assert (rain.haze, rain.haze_region, rain.haze_box) == ("medium", None, HAZE_REGION)
    assert (paper.haze, paper.haze_region) == ("gaussians", HAZE_REGION)
    camera = camera_at()
    view = RainCamera(camera, np.eye(4), np.zeros(3))
    ours, theirs = (RainSimulation.start(each).frame(0.0, view) for each in (rain, paper))
    assert ours.medium is not None and len(ours.haze) == 0
    assert theirs.medium is None and len(theirs.haze) > 0
    assert rain.without_medium == msgspec.structs.replace(rain, haze="gaussians") and paper.without_medium is paper
    assert frame_of(intensity_mm_h=0.0).medium is frame_of(intensity_mm_h=8.5, haze="none").medium is None


def test_a_saved_haze_box_remains_the_region(tmp_path):
    box = {"minimum_m": (-10.0, -10.0, -1.5), "maximum_m": (60.0, 10.0, 20.5)}
    saved = {"intensity_mm_h": 8.5, "haze": True, "haze_region": box}
    write_scene(Scene("one", (Layer("wall", wall(9.0, (0.2, 0.2, 0.2)).gaussians),), rain=saved), tmp_path / "one")
    rain = rain_of(read_scene(tmp_path / "one"))
    assert (rain.haze, rain.haze_region) == ("medium", RegionBox(**box))
    assert frame_of(**msgspec.structs.asdict(rain)).medium.has_region
