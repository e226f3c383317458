"""Lamps light drops and medium, against single scattering by brute force (docs/physics/night.md)."""

import numpy as np
import pytest

from gsrain_engine.rain.frame import RainCamera, SkyLight
from gsrain_engine.rain.lamp_light import light_in_picture, light_of_drops, share_of_depth
from gsrain_engine.rain.phase import ANGLES, fog_phase, rain_phase
from gsrain_engine.rain.settings import RainSettings, RegionBox
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.lamps import MAX_LAMPS, LitLamps

UP = np.array([0.0, 0, 1])
CAMERA = Camera.from_fov(320, 200, 60.0, look_at(np.zeros(3), np.array([1.0, 0, 0]), UP))
DARK = SkyLight.uniform((0.0, 0.0, 0.0))


def lamps_of(*rows):
    """Rows: position, axis, intensity, full and half angle of the cone in degrees (None: all around)."""
    positions, axes, intensities, inner, outer = [], [], [], [], []
    for position, axis, intensity, cone in rows:
        positions.append(position)
        axes.append(np.array(axis) / np.linalg.norm(axis))
        intensities.append(intensity)
        inner.append(-1.0 if cone is None else np.cos(np.radians(cone[0])))
        outer.append(-1.0 if cone is None else np.cos(np.radians(cone[1])))
    return LitLamps(*(np.array(each, np.float64) for each in (positions, axes, intensities, inner, outer)))


BULB = lamps_of(((20.0, 3.0, 1.0), (1.0, 0, 0), (9.0, 7.0, 4.0), None))
HEADLIGHTS = lamps_of(
    ((1.5, 0.7, -0.8), (1.0, 0, -0.03), (80.0, 80.0, 90.0), (8.0, 16.0)),
    ((1.5, -0.7, -0.8), (1.0, 0, -0.03), (80.0, 80.0, 90.0), (8.0, 16.0)),
    ((40.0, 2.0, -0.5), (-1.0, 0.1, 0), (90.0, 80.0, 60.0), (12.0, 25.0)),
)


def frame_of(lamps, camera=CAMERA, time_s=0.0, **fields):
    rainfall = RainSimulation.start(RainSettings(**{"intensity_mm_h": 25.0, "streaks": False} | fields))
    return rainfall.frame(time_s, RainCamera(camera, np.eye(4), np.zeros(3)), DARK, lamps)


def brute_force(frame, lamps, pixel, distance_m, steps=20_000):
    """Sum of the light of each millimeter to decimeter of one ray; dense where it passes near a lamp."""
    camera, beta = frame.view.camera, frame.extinction_per_m
    to_world = np.linalg.inv(camera.world_to_camera)
    ray = np.array([(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy, 1.0])
    ray = to_world[:3, :3] @ (ray / np.linalg.norm(ray))
    region, total = frame.rain.haze_region, np.zeros(3)
    fog = frame.fog_extinction_per_m / beta
    row = (1 - fog) * rain_phase(frame.rain.intensity_mm_h) + fog * fog_phase()
    angles = np.linspace(0, np.pi, ANGLES)

    def length_inside(start, ends):
        if region is None:
            return np.linalg.norm(ends - start, axis=1)
        shares = (np.arange(200) + 0.5) / 200
        points = start + shares[:, None, None] * (ends - start)
        inside = np.all((points > region.minimum_m) & (points < region.maximum_m), axis=2)
        return inside.mean(axis=0) * np.linalg.norm(ends - start, axis=1)

    for position, axis, intensity, inner, outer in zip(*lamps, strict=True):
        nearest = ray @ (position - camera.position)
        b = np.linalg.norm(position - camera.position - nearest * ray)
        ends = np.arctan((np.array([0.0, distance_m]) - nearest) / b)
        turned = np.linspace(*ends, steps + 1)
        s = nearest + b * np.tan(turned)
        middle, ds = 0.5 * (s[1:] + s[:-1]), np.diff(s)
        points = camera.position + middle[:, None] * ray
        offsets = points - position
        d = np.linalg.norm(offsets, axis=1)
        cosine = np.clip((offsets @ axis / d - outer) / max(inner - outer, 1e-6), 0, 1)
        cone = cosine**2 * (3 - 2 * cosine)
        scattering = np.interp(np.arccos(np.clip(-offsets @ ray / d, -1, 1)), angles, row)
        inside = np.ones(len(d), bool)
        if region is not None:
            inside = np.all((points > region.minimum_m) & (points < region.maximum_m), axis=1)
        depth = beta * (length_inside(camera.position, points) + length_inside(position, points))
        total += intensity * np.sum(ds * inside * beta * scattering / (4 * np.pi) * cone / d**2 * np.exp(-depth))
    return total


def light_at(frame, distance_m):
    """Light at each pixel up to an equal distance along its ray."""
    camera = frame.view.camera
    x, y = np.meshgrid(np.arange(camera.width) + 0.5 - camera.cx, np.arange(camera.height) + 0.5 - camera.cy)
    depth = distance_m / np.sqrt(1 + (x / camera.fx) ** 2 + (y / camera.fy) ** 2)
    return light_in_picture(
        frame.lamp_light, share_of_depth(depth.astype(np.float32)), np.ones(depth.shape, np.float32)
    )


def compare(frame, lamps, distance_m, count=40, steps=20_000):
    """Our green light and that by brute force at random pixels."""
    ours, camera = light_at(frame, distance_m), frame.view.camera
    picks = np.random.default_rng(5).integers(0, (camera.width, camera.height), (count, 2))
    expected = [brute_force(frame, lamps, pick + 0.5, distance_m, steps)[1] for pick in picks]
    return ours[picks[:, 1], picks[:, 0], 1], np.array(expected)


# Medium


@pytest.mark.parametrize("distance_m", [5.0, 15.0, 19.0, 21.0, 40.0, 1e5])
def test_a_bulb_lights_the_medium_within_two_percent(distance_m):
    """Before, around and behind the lamp, and the whole path to the sky."""
    ours, expected = compare(frame_of(BULB), BULB, distance_m)
    assert expected.min() > 0
    assert ours == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("distance_m", [5.0, 19.0, 1e5])
def test_headlights_light_the_medium_in_their_cones(distance_m):
    """One's own and those of a car that comes; the table is coarse at the edges of near cones."""
    ours, expected = compare(frame_of(HEADLIGHTS), HEADLIGHTS, distance_m)
    assert np.median(np.abs(ours / expected - 1)[expected > 0.01 * expected.max()]) < 0.01
    assert ours == pytest.approx(expected, rel=0.02, abs=0.025 * expected.max())


def test_pixels_at_a_lamp_are_within_two_percent():
    """In a row, 1 to 40 px off the lamp, for which the table's floor alone is too dark."""
    frame = frame_of(BULB)
    light, lamp, camera = light_at(frame, 1e5), frame.lamp_light.lamps[0], frame.view.camera
    column, row = (int(camera.fx * lamp[0] / lamp[2] + camera.cx), int(camera.fy * lamp[1] / lamp[2] + camera.cy))
    for offset in (1, 2, 4, 8, 16, 24, 32, 40):
        expected = brute_force(frame, BULB, (column + offset + 0.5, row + 0.5), 1e5)
        assert light[row, column + offset] == pytest.approx(expected, rel=0.02)
    assert light[row, column + 1, 1] > 10 * light[row, column + 40, 1]


def test_only_the_part_of_a_region_scatters():
    region = RegionBox(minimum_m=(8.0, -6.0, -2.0), maximum_m=(30.0, 9.0, 4.0))
    frame = frame_of(BULB, haze_region=region, intensity_mm_h=100.0)
    ours, expected = compare(frame, BULB, 1e5, count=25, steps=3000)
    everywhere = light_at(frame_of(BULB, intensity_mm_h=100.0), 1e5)
    assert np.count_nonzero(expected) > 10
    assert ours == pytest.approx(expected, abs=0.03 * expected.max())
    assert np.all(light_at(frame, 1e5).sum(axis=(0, 1)) < 0.9 * everywhere.sum(axis=(0, 1)))


@pytest.mark.parametrize("visibility_m", [50.0, 500.0])
def test_fog_and_rain_mix_their_phase_functions(visibility_m):
    frame = frame_of(BULB, visibility_m=visibility_m, intensity_mm_h=8.5)
    ours, expected = compare(frame, BULB, 40.0)
    assert 0.5 < frame.fog_extinction_per_m / frame.extinction_per_m < 1
    assert ours == pytest.approx(expected, rel=0.02)


def test_light_grows_with_distance_and_mixes_with_the_share_of_the_scene():
    frame = frame_of(HEADLIGHTS)
    near, far, sky = (light_at(frame, each) for each in (4.0, 30.0, 1e6))
    assert np.all(near <= far + 1e-6) and np.all(far <= sky + 1e-6) and near.mean() < 0.9 * far.mean()
    size = frame.view.camera.height, frame.view.camera.width
    nothing = np.zeros(size, np.float32)
    assert light_in_picture(frame.lamp_light, nothing, nothing) == pytest.approx(sky, rel=1e-3, abs=1e-6)
    depth = share_of_depth(np.full(size, 20.0, np.float32))
    half = light_in_picture(frame.lamp_light, 0.5 * depth, np.full(size, 0.5, np.float32))
    full = light_in_picture(frame.lamp_light, depth, np.ones(size, np.float32))
    assert half == pytest.approx(0.5 * (full + sky), rel=1e-3, abs=1e-6)


def test_more_lamps_than_the_limit_leave_the_brightest():
    rows = [((10.0 + k, 0.0, 0.0), (1.0, 0, 0), (1.0, 1.0, 1.0), None) for k in range(MAX_LAMPS + 9)]
    lamps = frame_of(lamps_of(*rows)).lamp_light.lamps
    assert lamps[:, 2] == pytest.approx(10.0 + np.arange(MAX_LAMPS))


# Drops


def test_a_drop_has_the_light_that_it_scatters():
    """Twice the cross-section times p / 4 pi, in front of a lamp and behind it, off and in the cone."""
    lamps = lamps_of(((6.0, 0.0, 0.0), (1.0, 0, 0), (2.0, 3.0, 4.0), (10.0, 20.0)))
    frame = frame_of(lamps)
    points = np.array([[12.0, 1.0, 0.0], [12.0, 3.0, 0.0], [4.0, 0.1, 0.0]], np.float32)
    light = light_of_drops(frame.lamp_light, points, CAMERA)
    d, r = np.hypot(6.0, 1.0), np.hypot(12.0, 1.0)
    angle = np.pi - np.arccos((6.0 * 12.0 + 1.0) / (d * r))
    phase = np.interp(angle, np.linspace(0, np.pi, ANGLES), rain_phase(25.0))
    dims = np.exp(-frame.extinction_per_m * (d + r))
    assert light[0] == pytest.approx(np.array([2.0, 3.0, 4.0]) / d**2 * dims * 2 * phase / (4 * np.pi), rel=0.01)
    assert np.all(light[1:] == 0)


def test_streaks_light_up_in_the_cone():
    spot = lamps_of(((1.0, 0.0, 2.0), (0.0, 0, -1), (5.0, 5.0, 5.0), (16.0, 22.0)))
    frame = frame_of(spot, streaks=True, haze="none")
    streaks, light = frame.lit_streaks, light_of_drops(frame.lamp_light, frame.streaks.means, CAMERA)
    assert streaks.sh[:, 0] * 0.28209479 + 0.5 == pytest.approx(light, abs=1e-5)
    assert 0.02 < np.mean(light[:, 1] > 0.001) < 0.98
    renderer = CpuRenderer()
    renderer.draw([], CAMERA, frame)
    lit = srgb_to_linear(renderer.read().rgba[..., :3].astype(float))
    renderer.draw([], CAMERA, frame_of(None, streaks=True, haze="none"))
    dark = srgb_to_linear(renderer.read().rgba[..., :3].astype(float))
    assert dark.max() < 1e-6
    assert lit.max() > 0.001 and np.isfinite(lit).all()


# Pictures


def test_the_picture_is_the_medium_s_light():
    frame, renderer = frame_of(HEADLIGHTS), CpuRenderer()
    renderer.draw([], CAMERA, frame, with_depth=True)
    image = renderer.read()
    assert srgb_to_linear(image.rgba[..., :3].astype(float)) == pytest.approx(light_at(frame, 1e6), rel=1e-3, abs=1e-5)
    assert np.all(image.rgba[..., 3] == 1) and image.depth is not None and image.depth.max() == 0


def test_without_lamps_pictures_have_the_same_bytes():
    renderer, images = CpuRenderer(), []
    for lamps in (None, lamps_of()):
        frame = frame_of(lamps, streaks=True)
        assert frame.lamp_light is None
        renderer.draw([], CAMERA, frame)
        images.append(renderer.read().rgba)
    assert images[0].tobytes() == images[1].tobytes()
