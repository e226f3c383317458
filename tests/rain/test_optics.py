"""Optics of rain, measured in float images of the CPU renderer (docs/physics/extinction.md, streaks.md)."""

from dataclasses import replace

import numpy as np
import pytest

from given_rain import STILL, given_rain
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.frame import RainCamera
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.streaks import ShutterModel, streak_gaussians
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.scene import DrawItem
from gsrain_engine.scene.sensor import Sensor, ThinLens

FOCAL = 1000.0
UP, AHEAD = np.array([0.0, 0, 1]), np.array([1.0, 0, 0])
PUBLISHED = load_calibration("published")
PHASES = np.random.default_rng(7).random((20, 2))
SPACING_PX = 12  # of drops side by side: none is wider, and all are near the middle of the picture


@pytest.fixture(scope="module")
def renderer():
    return CpuRenderer()


def eye_at(position, width, height, focal):
    pose = look_at(np.array(position), np.array(position) + AHEAD, UP)
    return Camera(width, height, focal, focal, width / 2, height / 2, pose)


def wall(distance_m, gray):
    """An opaque plane across the view, flat along x."""
    numbers = ([[distance_m, 0, 0]], [[1e-3, 1e4, 1e4]], [[1, 0, 0, 0]], [1])
    color = sh_from_color(np.full((1, 3), gray, np.float32))
    return DrawItem(Gaussians(*(np.array(each, np.float32) for each in numbers), color), np.eye(4))


def fall_speed(diameter_mm):
    return float(PUBLISHED.velocity(np.array([diameter_mm]))[0])


def streak_picture(
    renderer, diameter_mm, distance_m, exposure_s, phases=((0.0, 0.0),), parts=(), gray=0.8, lens=None, **fields
):
    """Float picture (h, w, 4) of drops that fall side by side straight ahead, each moved by a part of a pixel."""
    length_px, count = fall_speed(diameter_mm) * exposure_s * FOCAL / distance_m, len(phases)
    camera = eye_at((0.0, 0, 0), 48 + SPACING_PX * (count - 1), int(3 * length_px) + 48, FOCAL)
    px = np.array(phases) + np.outer(SPACING_PX * (np.arange(count) - (count - 1) / 2), [1, 0])
    at = np.column_stack([np.full(count, distance_m), px * distance_m / FOCAL])
    velocities = np.tile([0.0, 0, -fall_speed(diameter_mm)], (count, 1))
    rain = RainSettings(**fields)
    color = np.full(3, gray)
    shutter = ShutterModel(camera, np.zeros(3), exposure_s, FOCAL, lens or ThinLens())
    drops = streak_gaussians(at, np.full(count, diameter_mm), velocities, shutter, rain, color)
    renderer.draw(list(parts), camera, given_rain(drops, srgb_to_linear(color).astype(np.float32), rain.model))
    return renderer.read().rgba.astype(np.float64)


@pytest.mark.parametrize("share_of_dm", [0.25, 0.5, 1.0, 1.4, 1.99])
@pytest.mark.parametrize(
    ("exposure_s", "diameter_mm", "tolerance"),
    [
        (0.001, 1.0, 0.1), (0.001, 2.0, 0.1), (0.001, 5.0, 0.1), (0.003, 1.0, 0.05), (0.003, 5.0, 0.05),
        (0.004, 1.0, 0.05), (0.016, 1.5, 0.05), (0.05, 1.0, 0.05),
    ],
)  # fmt: skip
def test_a_streak_hides_as_much_as_its_drop(renderer, exposure_s, diameter_mm, tolerance, share_of_dm):
    """The sum of alpha over the picture is pi D^2 / 4 (f / d)^2 px^2, averaged over sub-pixel phases."""
    distance = share_of_dm * FOCAL * diameter_mm * 1e-3
    picture = streak_picture(renderer, diameter_mm, distance, exposure_s, PHASES)
    mean = picture[..., 3].sum() / len(PHASES)
    assert mean == pytest.approx(np.pi / 4 * (diameter_mm * 1e-3 * FOCAL / distance) ** 2, rel=tolerance)


def test_a_drop_out_of_focus_is_wider_by_the_circle_of_confusion_and_hides_as_much(renderer):
    """c = f A |1/d - 1/d_focus| px; a disc of diameter c has c^2 / 16 as its variance along each axis."""
    diameter_mm, distance, exposure_s = 1.0, 0.5, 0.004
    lens = {"lens": ThinLens(4e-3, 8.0)}
    sharp, blurred = (
        np.mean([streak_picture(renderer, diameter_mm, distance, exposure_s, [phase], **fields)[..., 3] for phase in
                 PHASES[:6]], axis=0) for fields in ({}, lens)
    )  # fmt: skip
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=0.03)
    circle_px = FOCAL * 4e-3 * (1 / distance - 1 / 8.0)
    for axis, tolerance in ((0, 0.01), (1, 0.05)):
        assert _variance(blurred, axis) == pytest.approx(_variance(sharp, axis) + circle_px**2 / 16, rel=tolerance)


@pytest.mark.parametrize("direction", ["down", "up", "right"])
def test_a_rolling_shutter_conserves_light_and_moves_drops_to_their_own_time(renderer, direction):
    """Drops that move with the readout get rarer, and their streaks longer: the mean of alpha stays."""
    random, count = np.random.default_rng(5), 60_000
    camera = eye_at((0.0, 0, 0), 96, 72, 90.0)
    positions = np.stack([random.uniform(0.9, 1.1, count), *random.uniform(-1.5, 1.5, (2, count))], axis=1)
    velocities, diameters = np.tile([0.0, 2.0, -5.0], (count, 1)), np.full(count, 2.0)
    rain, means = RainSettings(), {}
    for readout_s in (0.0, 0.04):
        sensor = Sensor(readout_s=readout_s, readout_direction=direction)
        shutter = ShutterModel(camera, np.zeros(3), 0.016, 90.0, readout=sensor.readout(camera))
        drops = streak_gaussians(positions, diameters, velocities, shutter, rain, np.ones(3))
        light = np.ones(3, np.float32)
        # Alpha saturates where drops overlap: its logarithm adds up.
        renderer.draw([], camera, given_rain(drops, light, rain.model))
        means[readout_s] = -np.log(1 - renderer.read().rgba[12:-12, 12:-12, 3].astype(float)).mean()
    assert means[0.0] > 0.05
    assert means[0.04] == pytest.approx(means[0.0], rel=0.05)


def test_a_drop_is_exposed_when_the_readout_meets_it(renderer):
    """The middle of its streak is where it is at t + (v / H - 1/2) T_r, with v its own row then."""
    camera, readout_s = eye_at((0.0, 0, 0), 64, 400, 300.0), 0.03
    velocity = np.array([0.0, 0.0, -4.0])
    shutter = ShutterModel(camera, np.zeros(3), 0.004, 300.0, readout=Sensor(readout_s=readout_s).readout(camera))
    for height in (-0.5, -0.2, 0.0, 0.3, 0.55):
        at = np.array([[1.0, 0.0, height]])
        later = 0.0
        for _ in range(60):
            later = readout_s * ((200 - 300 * (height - 4.0 * later)) / 400 - 0.5)
        drops = streak_gaussians(at, np.array([2.0]), velocity[None], shutter, RainSettings(), np.ones(3))
        assert drops.means[:, 2].mean() == pytest.approx(height - 4.0 * later, abs=1e-5)
        first, last = drops.means[:, 2].max(), drops.means[:, 2].min()
        rate = 300 * 4.0 / 400  # of the picture's height a second
        assert first - last == pytest.approx(0.75 * 4.0 * 0.004 / (1 - readout_s * rate), rel=1e-4)


def test_no_drop_whose_blur_reaches_the_picture_is_left_out(renderer):
    """The search looks at drops as far beside the picture as a circle of confusion is wide."""
    lens = {"aperture_mm": 50.0, "focus_distance_m": 0.3, "exposure_s": 5e-4, "haze": "none"}
    camera = eye_at((0.0, 0, 1.5), 32, 24, 60.0)
    anchor = np.eye(4)
    anchor[:3, 3] = 0.0, 0.0, 1.5
    view = RainCamera(camera, anchor, np.zeros(3), focal_px=FOCAL)
    field = RainSimulation.start(RainSettings(intensity_mm_h=1.2, **lens)).frame(3.0, view)
    culling = field.culling._replace(slopes=np.array([-9.0, 9, -9, 9]))
    wider = replace(field, find_drops=lambda: (field.where, culling))
    alphas = []
    for each in (field, wider):
        renderer.draw([], camera, each)
        alphas.append(renderer.read().rgba[..., 3])
    assert alphas[0].max() > 0.002
    assert len(wider.visible_drops().numbers) > 1.3 * len(field.visible_drops().numbers)
    np.testing.assert_allclose(alphas[0], alphas[1], atol=1e-6)


def _variance(alpha, axis):
    """Of where alpha lies along an axis, in px^2."""
    weight = alpha.sum(axis=1 - axis) / alpha.sum()
    places = np.arange(len(weight))
    return weight @ (places - weight @ places) ** 2


@pytest.mark.parametrize(("model", "rise"), [("physical", 8.0), ("paper", 3.0)])
def test_a_streak_before_grey_52_under_a_sky_of_200_rises_as_light_adds(renderer, model, rise):
    """A 1.5 mm drop at 16 ms covers 2 %: 8 levels where light adds, 3 where display values are mixed."""
    drop = {"diameter_mm": 1.5, "distance_m": 0.25, "exposure_s": 0.016, "phases": [(0.5, 0.5)]}
    drop |= {"gray": 200 / 255, "model": model}
    alpha = streak_picture(renderer, **drop)[..., 3]
    before = streak_picture(renderer, **drop, parts=[wall(9.0, 52 / 255)], streak_gain=0.0)[..., 0]
    after = streak_picture(renderer, **drop, parts=[wall(9.0, 52 / 255)])[..., 0]
    assert alpha.max() == pytest.approx(1.5e-3 / (0.016 * fall_speed(1.5)), rel=0.1)
    if model == "physical":
        mixed = linear_to_srgb((1 - alpha) * srgb_to_linear(before) + alpha * srgb_to_linear(np.array(200 / 255)))
    else:
        mixed = (1 - alpha) * before + alpha * 200 / 255
    np.testing.assert_allclose(after, mixed, atol=2e-4)
    assert 255 * (after - before).max() == pytest.approx(rise, abs=0.7)


def test_a_ray_inside_the_haze_keeps_exp_of_minus_beta_l(renderer):
    """Black haze before white walls: mean transmittance over 150 fields a life of the haze apart, so independent.

    Of 6 m, of which the ramp before the camera leaves 2 m, and of 20, 40 and 60 m more, which all lie in the region.
    """
    rain = RainSettings(
        intensity_mm_h=12.0, streaks=False, haze="gaussians", drop_color=(0.0, 0.0, 0.0), **STILL
    )  # fmt: skip
    rainfall, camera, anchor = RainSimulation.start(rain), eye_at((0.0, 0, 0), 20, 16, 70.0), np.eye(4)
    anchor[:3, 3] = 9.0, 0.0, -9.5
    walls = [wall(distance, 1.0) for distance in (6.0, 26.0, 46.0, 66.0)]

    def light(part, haze=None):
        renderer.draw([part], camera, haze)
        return srgb_to_linear(renderer.read().rgba[..., 0].astype(np.float64))

    clear, total = light(walls[0]), np.zeros(4)
    for field in range(150):
        haze = rainfall.frame(4.0 * field, RainCamera(camera, anchor, np.zeros(3)))
        total += [np.mean(light(each, haze) / clear) for each in walls]
    depths, beta = -np.log(total / 150), rainfall.state.extinction_per_m
    assert beta == pytest.approx(2.53e-3, rel=0.01)
    # Slanted rays of this narrow view are 0.5 % longer on average.
    assert depths[1:] - depths[0] == pytest.approx(1.005 * beta * np.array([20.0, 40.0, 60.0]), rel=0.05)
    assert depths[0] == pytest.approx(2 * beta, rel=0.35)
