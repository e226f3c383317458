import numpy as np
import pytest
from scipy.spatial import cKDTree

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.streaks import ShutterModel, streak_gaussians
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.geometry import matrices_from_quaternions
from oracles.streaks import make_streaks

F = 1000.0
PUBLISHED = load_calibration("published")
EYE = look_at(np.zeros(3), np.array([1.0, 0, 0]), np.array([0.0, 0, 1.0]))


def shutter(exposure_s=0.004, velocity=(0.0, 0, 0)):
    return ShutterModel(Camera(960, 640, F, F, 480.0, 320.0, EYE), np.array(velocity, float), exposure_s, F)


def streak(distance_m, diameter_mm, fall_m_s=4.0, exposure_s=0.004, velocity=(0.0, 0, 0), **rain):
    return make_streaks(
        np.array([[distance_m, 0.0, 0.0]]),
        np.array([diameter_mm]),
        np.array([[0.0, 0, -fall_m_s]]),
        shutter(exposure_s, velocity),
        RainSettings(**rain),
    )


def test_copies_lie_along_the_path_of_the_drop():
    made = streak(1.0, 1.0, exposure_s=0.02, max_copies=4)
    length = 4.0 * 0.02
    assert len(made.means) == 4
    assert np.sort(made.means[:, 2]) == pytest.approx(length * np.array([-0.375, -0.125, 0.125, 0.375]), abs=1e-6)
    assert made.scales[:, 2] == pytest.approx(length / 4)


def test_a_moving_camera_slants_lengthens_and_fades_the_streak():
    still, moving = streak(1.0, 1.0), streak(1.0, 1.0, velocity=(0.0, 10.0, 0.0))
    axis = matrices_from_quaternions(moving.quaternions.astype(float))[0][:, 2]
    expected = np.array([0.0, -10.0, -4.0]) / np.hypot(10, 4)
    assert abs(axis @ expected) == pytest.approx(1, abs=1e-6)
    assert np.ptp(moving.means[:, 1]) > 0.02
    assert moving.opacities[0] < 0.5 * still.opacities[0]
    world = streak(1.0, 1.0, velocity=(0.0, 10.0, 0.0), streak_frame="world")
    assert np.array_equal(world.means, still.means)


def test_the_paper_s_form_takes_the_fall_speed_whatever_the_line_of_sight():
    """Eq. 5: D / (V T), for a drop that is seen at 30 degrees above the horizon too."""
    for frame, speed in (("world", 4.0), ("camera", 4.0 * np.cos(np.pi / 6))):
        position = np.array([[np.cos(np.pi / 6), 0, np.sin(np.pi / 6)]])
        rain = RainSettings(streak_frame=frame, max_copies=1)
        made = make_streaks(position, np.array([2.0]), np.array([[0.0, 0, -4.0]]), shutter(0.01), rain)
        alpha = 1 - (1 - float(made.opacities[0])) ** np.sqrt(2 * np.pi)
        assert alpha == pytest.approx(2e-3 / (speed * 0.01), rel=1e-5)


def test_opacity_falls_beyond_the_visible_distance():
    near, at, beyond = streak(0.5, 1.0), streak(1.0, 1.0), streak(1.6, 1.0)
    alpha = [1 - (1 - float(s.opacities[0])) ** np.sqrt(2 * np.pi) for s in (near, at, beyond)]
    assert alpha[0] == pytest.approx(alpha[1], rel=1e-5)
    assert alpha[2] == pytest.approx(alpha[1] / 1.6, rel=1e-5)


@pytest.mark.parametrize(
    "fields",
    [
        {}, {"streak_frame": "world"}, {"far_drops": "published"}, {"aperture_mm": 6.0}, {"streak_gain": 30.0},
        {"exposure_s": 1e-4},  # shorter than the larger drops need for their own diameters
    ],
)  # fmt: skip
def test_the_compiled_form_makes_the_same_streaks_and_leaves_out_what_is_not_seen(fields):
    random = np.random.default_rng(11)
    positions = random.uniform((-0.5, -2, -2), (4, 2, 2), (3000, 3))
    diameters = random.uniform(0.1, 4, 3000)
    velocities = np.stack([random.normal(size=3000), random.normal(size=3000), -PUBLISHED.velocity(diameters)], axis=1)
    rain = RainSettings(**fields)
    given = (positions, diameters, velocities, shutter(rain.exposure_s or 0.004, (8.0, 1.0, 0.0)), rain)
    plain, compiled = make_streaks(*given), streak_gaussians(*given, np.ones(3))
    away, rows = cKDTree(plain.means).query(compiled.means)
    assert away.max() < 1e-5
    assert np.all(np.diff(rows) > 0) and 0 < len(rows) < 0.5 * len(plain.means)
    for name in ("means", "scales", "quaternions", "opacities"):
        ours, theirs = getattr(compiled, name), getattr(plain, name)[rows]
        np.testing.assert_allclose(ours, theirs, rtol=2e-5, atol=2e-6, err_msg=name)
    in_view = np.all(abs(plain.means[:, 1:]) < np.array([0.48, 0.32]) * plain.means[:, :1], axis=1)
    assert set(np.flatnonzero(in_view)) <= set(rows)


def test_a_tilted_camera_away_from_the_origin_leaves_out_what_is_outside_its_own_picture():
    """From 4.8 standard deviations of its length on; the middle of this picture is off its center."""
    eye = np.array([5.0, -3.0, 2.0])
    camera = Camera(
        960, 640, 1000.0, 800.0, 300.0, 400.0, look_at(eye, eye + [1.0, 0.7, 0.4], np.array([0.3, -0.2, 1.0]))
    )
    random = np.random.default_rng(12)
    positions = eye + random.uniform(-4, 4, (4000, 3))
    diameters = random.uniform(0.3, 4, 4000)
    velocities = np.stack([random.normal(size=4000), random.normal(size=4000), -PUBLISHED.velocity(diameters)], axis=1)
    given = (
        positions,
        diameters,
        velocities,
        ShutterModel(camera, np.array([8.0, 1.0, 0.5]), 0.008, F),
        RainSettings(),
    )
    plain, compiled = make_streaks(*given), streak_gaussians(*given, np.ones(3))
    m, reach = camera.world_to_camera, 4.8 * plain.scales[:, 2]
    u, v, depth = (plain.means.astype(np.float64) @ m[:3, :3].T + m[:3, 3]).T
    wide = np.maximum(depth + reach, 0)
    seen = (depth >= 0) & (u >= -0.3 * wide - reach) & (u <= 0.66 * wide + reach)
    seen &= (v >= -0.5 * wide - reach) & (v <= 0.3 * wide + reach)
    assert 100 < seen.sum() < 0.3 * len(seen)
    np.testing.assert_allclose(compiled.means, plain.means[seen], atol=1e-5)
    np.testing.assert_allclose(compiled.scales, plain.scales[seen], rtol=2e-5)
    np.testing.assert_allclose(compiled.quaternions, plain.quaternions[seen], atol=2e-6)
    np.testing.assert_allclose(compiled.opacities, plain.opacities[seen], rtol=2e-5)
