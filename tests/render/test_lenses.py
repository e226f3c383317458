"""Lenses and rolling shutters: against OpenCV and f-theta's formula, pinhole pictures, and bands of global shutters."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from msgspec import structs

from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings, RegionBox
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput, Quality
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.lens import Lens
from gsrain_engine.scene.lens_faces import assemble, lens_faces
from gsrain_engine.scene.rolling_shutter import RollingShutter
from gsrain_engine.scene.scene import Actor, DrawItem, Layer, PoseTrack, Scene

CAMERA = Camera(1920, 1080, 1100.0, 1090.0, 951.0, 548.0)
LENSES = {
    "radial-tangential": Lens("opencv", (-0.31, 0.09, 0.001, -0.002)),
    "k3": Lens("opencv", (-0.3, 0.12, 0.0005, 0.001, -0.02)),
    "rational": Lens("opencv", (0.4, 0.12, -0.0007, 0.0009, 0.01, 0.7, 0.2, 0.02)),
    "thin prism": Lens("opencv", (-0.2, 0.05, 0.001, 0.0, 0.0, 0.01, 0.0, 0.0, 0.001, -0.001, 0.002, 0.0005)),
    "fisheye": Lens("fisheye", (0.05, -0.02, 0.004, -0.0005)),
    "f-theta": Lens("ftheta", (1.0, 0.01, -0.06, 0.004, 0.001), 1.5, (0.003, -0.002)),
}
SKY = SkyLight.uniform((0.7, 0.75, 0.8))


def reference_pixels(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels by OpenCV, whose first center is 0, or by f-theta's formula, in GSRAIN's coordinates."""
    lens, matrix = camera.lens, np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    if lens.model == "ftheta":
        angles = np.arctan2(np.linalg.norm(points[:, :2], axis=1), points[:, 2])
        lengths = sum(k * angles ** (n + 1) for n, k in enumerate(lens.coefficients))
        around = points[:, :2] / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
        bent = (lengths[:, None] * around) @ np.array([[1, lens.shear[0]], [lens.shear[1], 1]]).T
        return bent * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    find = cv2.fisheye.projectPoints if lens.model == "fisheye" else cv2.projectPoints
    pixels, _ = find(points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(lens.coefficients))
    return pixels[:, 0] + 0.5


def specks(points: np.ndarray, size_m: float = 1e-3, color: tuple[float, float, float] = (0.8, 0.4, 0.2)) -> Gaussians:
    n, f = len(points), np.float32
    turns = np.tile(np.array([1, 0, 0, 0], f), (n, 1))
    sh = sh_from_color(np.tile(np.array(color, f), (n, 1)))
    return Gaussians(points.astype(f), np.full((n, 3), size_m, f), turns, np.full(n, 0.9, f), sh)


@pytest.mark.parametrize("name", LENSES)
def test_splats_are_where_the_lens_images_their_gaussians(name: str) -> None:
    """At 1,000 random points, to 0.1 px; and the rays of those pixels go back to them."""
    camera, random = replace(CAMERA, lens=LENSES[name]), np.random.default_rng(7)
    if camera.lens.model != "opencv":
        camera = replace(camera, fx=500.0, fy=495.0)
    places = random.uniform([0, 0], [camera.width, camera.height], (4000, 2))
    rays = camera.directions(places)
    in_front = rays[:, 2] > (0.02 if camera.lens.model == "fisheye" else -1)  # OpenCV has no other fisheye points
    rays, places = rays[in_front][:1000], places[in_front][:1000]
    points = rays * random.uniform(1, 80, (1000, 1))
    expected = reference_pixels(points, camera)
    np.testing.assert_allclose(expected, places, atol=0.02)
    splats = project([DrawItem(specks(points), np.eye(4))], camera)
    drawn = np.flatnonzero(splats.colors[:, 3])
    assert len(drawn) == 1000
    assert np.linalg.norm(splats.shapes[drawn, :2] - expected[splats.indices[drawn]], axis=1).max() < 0.1
    np.testing.assert_allclose(splats.colors[drawn, 3], np.linalg.norm(points, axis=1), rtol=1e-5)
    np.testing.assert_allclose(camera.pixels(points), expected, atol=1e-6)


def test_nothing_folds_back_into_the_picture() -> None:
    """Points far outside would be imaged again where the radial polynomial falls."""
    camera = replace(CAMERA, lens=Lens("opencv", (-0.4, 0.0, 0.0, 0.0)))  # r - 0.4 r^3 rises up to 0.91
    outside = np.array([[1.4, 0.0, 1.0], [0.0, 1.2, 1.0], [-5.0, 2.0, 3.0], [0.1, 0.1, -2.0]])
    assert np.isnan(camera.pixels(outside)).all()
    splats = project([DrawItem(specks(outside), np.eye(4))], camera)
    assert not splats.colors.any()


def wall_scene() -> Scene:
    """A colored wall around a street of 30 m, and a car that crosses in front of the camera."""
    random, n = np.random.default_rng(3), 5000
    angle, height = random.uniform(-1.4, 1.4, n), random.uniform(-6, 8, n)
    points = np.stack([14 * np.cos(angle), 14 * np.sin(angle), height], axis=1)
    g = specks(points, 0.16)
    color = 0.5 + 0.4 * np.sin(np.stack([3 * angle, height, angle + 0.5 * height], axis=1))
    wall = replace(g, sh=sh_from_color(color.astype(np.float32)), opacities=np.full(n, 0.8, np.float32))
    times = np.array([-1.0, 2.0])
    places = np.array([[9.0, 8.0, -0.5], [9.0, -16.0, -0.5]])  # 8 m/s to the right
    turns = np.tile([1.0, 0, 0, 0], (2, 1))
    body = specks(random.uniform([-0.8, -1.6, 0.0], [0.8, 1.6, 1.4], (300, 3)), 0.2, (0.1, 0.3, 0.9))
    car = Actor("car", "car", (1.6, 3.2, 1.4), body, PoseTrack(times, places, turns, np.ones(2, bool)))
    return Scene("wall", (Layer("wall", wall),), (car,))


AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
SMALL = Camera(160, 100, 90.0, 90.0, 81.0, 49.0, AHEAD)


def shown(
    renderer: CpuRenderer, scene: Scene, camera: Camera, rain: RainSimulation | None = None, **view
) -> np.ndarray:
    draw(renderer, FrameInput.of(scene, rain, SKY, RenderView(camera, **view), Quality(with_depth=True)))
    return renderer.read().over((0.2, 0.3, 0.4))


def finer(camera: Camera, factor: int) -> Camera:
    return camera.resized(factor * camera.width, factor * camera.height)


def averaged(picture: np.ndarray, factor: int) -> np.ndarray:
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    return picture.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))


def psnr_db(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


NEAR = RegionBox(minimum_m=(-2.0, -6.0, -3.0), maximum_m=(10.0, 6.0, 3.0))
RAIN = RainSettings(intensity_mm_h=30.0, sensor="pinhole", exposure_s=0.01, seed=4, streak_region=NEAR)


@pytest.mark.parametrize("name", ["radial-tangential", "rational", "fisheye", "f-theta"])
def test_a_picture_through_a_lens_is_that_of_warped_pinhole_pictures(name: str) -> None:
    """Of three times the resolution, averaged: 38 dB with scene, streaks and medium."""
    renderer, scene, rainfall = CpuRenderer(), wall_scene(), RainSimulation.start(RAIN)
    camera = replace(SMALL, lens=LENSES[name])
    fine = finer(camera, 3)
    through = averaged(shown(renderer, scene, fine, rainfall, focal_px=90.0), 3)
    faces = lens_faces(fine)
    pictures = [shown(renderer, scene, face.of(fine), rainfall, focal_px=90.0).astype(np.float32) for face in faces]
    warped = averaged(assemble(faces, pictures), 3)
    assert psnr_db(through, warped) > 38
    straight = averaged(shown(renderer, scene, fine.pinhole, rainfall, focal_px=90.0), 3)
    assert psnr_db(through, straight) < 30


@pytest.mark.parametrize(("name", "direction"), [(None, "down"), ("fisheye", "left")])
def test_a_rolling_shutter_is_put_together_from_bands_of_global_ones(name: str | None, direction: str) -> None:
    """Scene, a car that passes and rain: 45 dB against 25 pictures, each giving its band at that band's time."""
    renderer, scene, rainfall = CpuRenderer(), wall_scene(), RainSimulation.start(RAIN)
    rolling = RollingShutter(0.03, direction, (0.06, -0.02, 0.36), (0.003, 0.02, -0.004))
    camera = replace(SMALL, lens=LENSES[name] if name else None, rolling=rolling)
    velocity = camera.camera_to_world[:3, :3] @ rolling.velocity_m_s
    rolled = shown(renderer, scene, camera, rainfall, time_s=0.5, velocity_m_s=velocity)
    again = shown(renderer, scene, camera, rainfall, time_s=0.5, velocity_m_s=velocity)
    assert rolled.tobytes() == again.tobytes()
    banded, axis = np.zeros_like(rolled), 1 if direction == "left" else 0
    size = rolled.shape[axis]
    ends = np.linspace(0, size, 26).astype(int)
    for first, last in pairwise(ends):
        part = (first + last) / 2 / size - 0.5
        part = part if direction == "down" else -part
        at = camera.at_readout(part)
        band = shown(renderer, scene, at, rainfall, time_s=0.5 + part * rolling.readout_s, velocity_m_s=velocity)
        rows = (slice(first, last), slice(None)) if axis == 0 else (slice(None), slice(first, last))
        banded[rows] = band[rows]
    assert psnr_db(rolled, banded) > 45
    still = shown(renderer, scene, replace(camera, rolling=None), rainfall, time_s=0.5, velocity_m_s=velocity)
    assert psnr_db(still, banded) < 35


@pytest.mark.parametrize("name", ["rational", "fisheye"])
def test_tiles_draw_what_the_cpu_does(name: str, open_kind) -> None:
    """To 50 dB, and the rain's own light to 5 %, with a rolling shutter and a medium that ends."""
    scene, rolling = wall_scene(), RollingShutter(0.03, "down", (0.06, -0.02, 0.36), (0.003, 0.02, -0.004))
    camera = replace(SMALL, lens=LENSES[name], rolling=rolling)
    rain = RainSimulation.start(structs.replace(RAIN, haze_region=NEAR))
    frames = {}
    for kind in ("cpu", "opengl-tiles"):
        renderer = open_kind(kind)
        frames[kind] = [shown(renderer, scene, camera, each, time_s=0.5) for each in (None, rain)]
    for cpu, tiles in zip(*frames.values(), strict=True):
        assert psnr_db(cpu, tiles) > 50
    falling = [rainy - clear for clear, rainy in frames.values()]
    assert np.linalg.norm(falling[0] - falling[1]) < 0.05 * np.linalg.norm(falling[0])


def test_quads_say_what_draws_a_lens(open_kind) -> None:
    with pytest.raises(ValueError, match="opengl-quads draws pinhole cameras .* cpu or opengl-tiles"):
        shown(open_kind("opengl"), wall_scene(), replace(SMALL, lens=LENSES["fisheye"]))
