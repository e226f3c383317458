import numpy as np
import pytest

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.streaks import ShutterModel, camera_slopes, streak_gaussians
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.geometry import matrices_from_quaternions
from gsrain_engine.scene.sensor import Sensor, ThinLens
from oracles.streaks import make_streaks

F = 1000.0
PUBLISHED = load_calibration("published")
AHEAD = Camera(960, 640, F, F, 480.0, 320.0, look_at(np.zeros(3), np.array([1.0, 0, 0]), np.array([0.0, 0, 1.0])))


def shutter(exposure_s=0.004, velocity=(0.0, 0, 0)):
    return ShutterModel(AHEAD, np.array(velocity, float), exposure_s, F)


def streak(position, diameter_mm, exposure_s=0.004, velocity=(0.0, 0, 0), **rain):
    """Gaussians of one drop that falls at 4 m/s."""
    drop = np.array([position], float), np.array([diameter_mm]), np.array([[0.0, 0, -4.0]])
    return streak_gaussians(*drop, shutter(exposure_s, velocity), RainSettings(**rain), np.ones(3))


def test_copies_lie_along_the_path_of_the_drop():
    made = streak((1.0, 0, 0), 1.0, exposure_s=0.02, max_copies=4)
    length = 4.0 * 0.02
    assert len(made.means) == 4
    assert np.sort(made.means[:, 2]) == pytest.approx(length * np.array([-0.375, -0.125, 0.125, 0.375]), abs=1e-6)
    assert made.scales[:, 2] == pytest.approx(length / 4)


def test_a_moving_camera_slants_lengthens_and_fades_the_streak():
    drop, velocity = ((1.0, 0, 0), 1.0), (0.0, 10.0, 0.0)
    still, moving = streak(*drop), streak(*drop, velocity=velocity)
    axis = matrices_from_quaternions(moving.quaternions.astype(float))[0][:, 2]
    expected = np.array([0.0, -10.0, -4.0]) / np.hypot(10, 4)
    assert abs(axis @ expected) == pytest.approx(1, abs=1e-6)
    assert np.ptp(moving.means[:, 1]) > 0.02
    assert moving.opacities[0] < 0.5 * still.opacities[0]
    world = streak(*drop, velocity=velocity, model="paper")
    assert np.array_equal(world.means, still.means)


@pytest.mark.parametrize(
    ("position", "model", "expected"),
    [
        ((0.5, 0, 0), "physical", 0.2), ((2.0, 0, 0), "physical", 0.2), ((3.2, 0, 0), "physical", 0.2 / 1.6),
        # A drop 16 degrees above the horizon: the paper's form takes V whatever the line of sight.
        ((0.96, 0, 0.28), "physical", 0.2 / 0.96), ((0.96, 0, 0.28), "paper", 0.2),
    ],
)  # fmt: skip
def test_opacity_is_the_diameter_by_the_way_across_and_falls_beyond_the_visible_distance(position, model, expected):
    """Eq. 5: D / (v T), for 2 mm, 4 m/s and 2.5 ms; from d_m = 2 m on eq. 7."""
    made = streak(position, 2.0, 0.0025, max_copies=1, model=model)
    assert 1 - (1 - float(made.opacities[0])) ** np.sqrt(2 * np.pi) == pytest.approx(expected, rel=1e-5)


TILTED = Camera(
    960, 640, 1000.0, 800.0, 300.0, 400.0,
    look_at(np.array([5.0, -3.0, 2.0]), np.array([6.0, -2.3, 2.4]), np.array([0.3, -0.2, 1.0])),
)  # fmt: skip


ROLLING, SIDEWAYS = Sensor(readout_s=0.016), Sensor(readout_s=0.044, readout_direction="right")


@pytest.mark.parametrize(
    ("camera", "fields"),
    [
        (AHEAD, {}), (AHEAD, {"model": "paper"}),
        (AHEAD, {"lens": ThinLens(6e-3, 10.0)}), (AHEAD, {"streak_gain": 30.0}),
        (AHEAD, {"readout": ROLLING.readout(AHEAD)}),
        (AHEAD, {"exposure_s": 1e-4}),  # shorter than the larger drops need for their own diameters
        (TILTED, {"exposure_s": 0.008}), (TILTED, {"readout": SIDEWAYS.readout(TILTED), "lens": ThinLens(3e-3, 5.0)}),
    ],
)  # fmt: skip
def test_the_compiled_form_makes_the_same_streaks_but_those_outside_the_picture(camera, fields):
    """Outside is more than 4.8 standard deviations of its length away; a picture's middle may be off its center."""
    random = np.random.default_rng(11)
    positions, diameters = camera.position + random.uniform(-4, 4, (4000, 3)), random.uniform(0.1, 4, 4000)
    velocities = np.stack([random.normal(size=4000), random.normal(size=4000), -PUBLISHED.velocity(diameters)], axis=1)
    optics = {name: fields[name] for name in ("lens", "readout") if name in fields}
    rain = RainSettings(**{name: each for name, each in fields.items() if name not in optics})
    model = ShutterModel(camera, np.array([8.0, 1.0, 0.5]), rain.exposure_s or 0.004, F, **optics)
    given = positions, diameters, velocities, model, rain
    plain, compiled = make_streaks(*given), streak_gaussians(*given, np.ones(3))
    m, reach = camera.world_to_camera, 4.8 * plain.scales[:, 2]
    u, v, depth = (plain.means.astype(np.float64) @ m[:3, :3].T + m[:3, 3]).T
    wide, (left, right, top, bottom) = np.maximum(depth + reach, 0), camera_slopes(camera)
    seen = (depth >= 0) & (u >= left * wide - reach) & (u <= right * wide + reach)
    seen &= (v >= top * wide - reach) & (v <= bottom * wide + reach)
    assert 100 < seen.sum() < 0.3 * len(seen)
    for name in ("means", "scales", "quaternions", "opacities"):
        np.testing.assert_allclose(
            getattr(compiled, name), getattr(plain, name)[seen], rtol=2e-5, atol=1e-5 * (name == "means") + 2e-6
        )
