"""Drops in real air: the wind's profile, gusts, turbulence, and where drops are because of them."""

from itertools import pairwise

import msgspec
import numpy as np
import pytest
from scipy.integrate import quad

from given_rain import HERE, STILL, all_drops
from gsrain_engine.rain.air import OWN_STEPS, Wind, follows, profile
from gsrain_engine.rain.frame import RainCamera
from gsrain_engine.rain.keyframes import RainKeyframes
from gsrain_engine.rain.properties import CLASSES, rain_class, turbulent_fall_share
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.streaks import streak_gaussians
from gsrain_engine.scene.camera import Camera, look_at
from oracles.placed_drops import offsets_x, offsets_y, reference_drops

BREEZE = RainSettings(intensity_mm_h=2.0, seed=4)
STORM = RainSettings(intensity_mm_h=2.0, seed=4, wind_m_s=(14.0, -9.0), gust_m_s=6.0, turbulence_m_s=2.0)


def test_the_profile_is_the_logarithmic_law():
    """At 10 m the stated wind; twice the height adds the same everywhere; none below the roughness length."""
    heights = np.array([0.05, 0.1, 1.0, 2.0, 4.0, 10.0])
    shares = profile(heights, 0.1)
    assert shares[[0, 1, -1]] == pytest.approx([0, 0, 1])
    assert shares[3] - shares[2] == pytest.approx(shares[4] - shares[3]) == pytest.approx(np.log(2) / np.log(100))
    assert profile(heights, 1.0)[3] < shares[3]


def test_the_mean_wind_displaces_drops_by_its_integral():
    """Against numerical integration of dx = (u - u_drift) dz / v over the fall, to 1 mm for drops of 1 m/s and more."""
    sim = RainSimulation.start(msgspec.structs.replace(BREEZE, wind_m_s=(6.0, -4.0), gust_m_s=0.0, turbulence_m_s=0.0))
    wind, field = sim.motion.wind, sim.frame(33.0, HERE)
    classes = np.flatnonzero(sim.motion.fall_speed_m_s > 1.0)[::1500]
    for share in (0.02, 0.1, 0.5, 0.73, 0.999):
        z = np.full(len(classes), int(share * 2**32), np.uint32)
        none, height = np.zeros(len(classes), np.int32), 6.0 * share
        x = offsets_x(field.where.air, classes, z, none) * field.period_m[0]
        y = offsets_y(field.where.air, classes, z, none, z) * field.period_m[0]
        passed, _ = quad(
            lambda h: float(profile(np.array([h]), wind.roughness_m)[0]) - wind.drift_share, height, 3.0, limit=200
        )
        expected = passed / sim.motion.fall_speed_m_s[classes]
        assert x == pytest.approx(6.0 * expected, abs=1e-3)
        assert y == pytest.approx(-4.0 * expected, abs=1e-3)


@pytest.mark.parametrize("rain", [BREEZE, STORM], ids=["breeze", "storm"])
@pytest.mark.parametrize("time_s", [0.7, 8_765.4])
def test_velocities_are_the_derivatives_of_positions(rain, time_s):
    """Each drop moves within 2 ms as its velocity says, to 2 cm/s in a breeze, or has met a face of the lattice."""
    rainfall, dt = RainSimulation.start(rain), 1e-3
    fields = [rainfall.frame(time_s + step, HERE) for step in (-dt, 0.0, dt)]
    drops = [all_drops(field) for field in fields]
    before, now, after = (each.positions(field.period_m) for each, field in zip(drops, fields, strict=True))
    velocities = fields[1].falling(drops[1]).velocities_m_s
    found = (after - before) / (2 * dt)
    above = now[:, 2] + 3.0 > 0.3  # nodes of the tables are 2 cm apart: too far for the shear right at the ground
    met_a_face = np.any(np.abs(now) > fields[1].period_m / 2 - 0.1, axis=1)
    error = np.abs(found - velocities).max(axis=1)[above & ~met_a_face]
    scale = np.abs(velocities[:, :2]).max()
    assert np.quantile(error, 0.999) < 0.01 * scale
    assert error.max() < 0.05 * scale
    assert velocities[:, 0].std() > 0.2


def test_gusts_are_smooth_bounded_and_steady_from_frame_to_frame():
    """Of one amplitude in space and time: velocities of drops without any other motion reach it, but not beyond 1.5."""
    rain = msgspec.structs.replace(BREEZE, intensity_mm_h=0.1, **STILL | {"gust_m_s": 3.0})
    rainfall, seen = RainSimulation.start(rain), []
    for time_s in np.arange(0.0, 60.0, 0.5):
        field = rainfall.frame(float(time_s), HERE)
        drops = all_drops(field)
        seen.append(field.falling(drops).velocities_m_s[:400, :2])
    reached = np.abs(np.stack(seen)).max(axis=(0, 1))
    assert np.all((reached > 1.5) & (reached < 4.5))
    assert np.abs(np.stack(seen).mean(axis=(0, 1))).max() < 0.4


def test_turbulence_has_the_rms_that_drops_can_follow():
    """Within 2 %: of 30,000 small drops and as many large ones, at one moment; independent along x and y."""
    rain = msgspec.structs.replace(BREEZE, intensity_mm_h=8.5, **STILL | {"turbulence_m_s": 1.5})
    rainfall = RainSimulation.start(rain)
    field = rainfall.frame(5.0, HERE)
    drops = all_drops(field)
    moves = field.falling(drops).velocities_m_s
    steps = reference_drops(drops.numbers, field.rain.seed, field.where).own_steps
    for low, high in ((0, 1_000), (CLASSES - 1_000, CLASSES)):
        some = (drops.class_index >= low) & (drops.class_index < high)
        expected = 1.5 * float(follows(rainfall.motion.fall_speed_m_s[low:high]).mean())
        assert moves[some, :2].std(axis=0) == pytest.approx([expected, expected], rel=0.02)
        assert abs(np.corrcoef(moves[some, 0], moves[some, 1])[0, 1]) < 0.02
    assert steps.std() == pytest.approx(OWN_STEPS, rel=0.01)
    assert abs(steps.mean()) < 1.0


def test_large_drops_follow_turbulence_less_than_small_ones():
    assert follows(np.array([0.0, 0.3, 9.0])) == pytest.approx([1.0, 0.998, 0.516], abs=2e-3)


def test_mean_fall_speed_is_lower_in_turbulence_and_the_rate_stays():
    assert turbulent_fall_share(0.0) == 1
    assert 0.97 < turbulent_fall_share(0.5) < 1
    assert 0.70 < turbulent_fall_share(5.0) < 0.75  # 25-30 % less (Thurai et al. 2019)
    calm, rough = (RainSimulation.start(msgspec.structs.replace(BREEZE, turbulence_m_s=each)) for each in (0.0, 3.0))
    share = turbulent_fall_share(3.0)
    assert rough.motion.fall_speed_m_s == pytest.approx(share * calm.motion.fall_speed_m_s)
    assert rough.state.density_m3 == pytest.approx(calm.state.density_m3 / share)
    assert rough.state.implied_mm_h == calm.state.implied_mm_h == 2.0


def seen_from(position=(0.0, 0.0, 1.5), ahead=(1.0, 0.0, 0.1), ground_m=None):
    eye, anchor = np.array(position), np.eye(4)
    anchor[:3, 3] = eye
    camera = Camera.from_fov(480, 320, 50.0, look_at(eye, eye + np.array(ahead), np.array([0, 0, 1.0])))
    return RainCamera(camera, anchor, np.zeros(3), ground_m=ground_m)


@pytest.mark.parametrize("rain", [BREEZE, STORM], ids=["breeze", "storm"])
@pytest.mark.parametrize("ahead", [(1.0, 0.0, 0.1), (0.1, -1.0, 0.6), (-0.2, 0.1, -1.0)])
def test_the_search_misses_no_streak_of_the_image(rain, ahead):
    """Drops that the cheap tests leave out make no streak within the image."""
    field = RainSimulation.start(msgspec.structs.replace(rain, exposure_s=0.02)).frame(4.5, seen_from(ahead=ahead))
    here = field.visible_drops()
    everywhere = field.visible_drops(in_view=False)
    near = (everywhere.positions_m - field.shutter.camera.position) @ field.shutter.camera.world_to_camera[2, :3]
    near_enough = near <= field.culling.class_far_m[everywhere.class_index]
    left_out = everywhere.only(near_enough & ~np.isin(everywhere.numbers, here.numbers))
    streaks = streak_gaussians(
        left_out.positions_m, left_out.diameters_mm, left_out.velocities_m_s, field.shutter, field.rain, field.color
    )
    camera = field.shutter.camera
    p = streaks.means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    u, v = camera.fx * p[:, 0] / p[:, 2] + camera.cx, camera.fy * p[:, 1] / p[:, 2] + camera.cy
    inside = (p[:, 2] > 0.2) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
    assert not inside.any()
    assert len(here.numbers) > 50


def tilts_deg(rainfall, diameters_mm, times_s=range(0, 40, 4)):
    """Angles to the vertical, across a view along x, of drops in a range of sizes."""
    found = []
    for time_s in times_s:
        drops = rainfall.frame(float(time_s), seen_from()).visible_drops(in_view=False)
        some = (drops.diameters_mm >= diameters_mm[0]) & (drops.diameters_mm < diameters_mm[1])
        found.append(np.degrees(np.arctan2(drops.velocities_m_s[some, 1], -drops.velocities_m_s[some, 2])))
    return np.concatenate(found)


def test_streaks_lean_with_the_wind_and_scatter_as_real_ones():
    """RainSense's streaks lean by 3 to 10 degrees, and their 10th and 90th percentiles are 10 to 24 degrees apart."""
    calm, breeze = (RainSimulation.start(msgspec.structs.replace(BREEZE, **air)) for air in (STILL, {}))
    assert np.all(tilts_deg(calm, (1.0, 3.0), [3.0]) == 0)
    angles = tilts_deg(breeze, (1.0, 2.5))
    assert 3 < np.median(angles) < 15
    assert 10 < np.subtract(*np.percentile(angles, [90, 10])) < 24


def test_wind_is_a_compass_direction_and_a_speed():
    west = RainSettings(wind_from_deg=270.0, wind_speed_m_s=3.0)
    assert west.wind_vector_m_s == (3.0, 0.0)  # it blows to the east, along world x
    assert RainSettings(wind_from_deg=0.0, wind_speed_m_s=2.0).wind_vector_m_s == (0.0, -2.0)
    for vector in ((2.0, -1.0), (0.3, 17.0), (-40.0, 40.0), (0.0, 0.0)):
        rain = RainSettings(wind_m_s=vector)
        assert rain.wind_vector_m_s == vector
        assert rain.wind_m_s is None
        assert msgspec.convert(msgspec.to_builtins(rain), RainSettings) == rain
    assert msgspec.structs.replace(RainSettings(wind_m_s=(2.0, 0.0)), wind_speed_m_s=5.0).wind_vector_m_s == (5.0, 0.0)
    assert RainSettings(wind_m_s=(0.0, 0.0)).wind_from_deg == RainSettings().wind_from_deg


def test_the_paper_falls_in_calm_air():
    rainfall = RainSimulation.start(load_preset("paper"))
    velocities = rainfall.frame(3.0, seen_from()).drops.velocities_m_s
    assert len(velocities) > 500
    assert np.all(velocities[:, :2] == 0)
    assert rainfall.state.implied_mm_h == pytest.approx(6.586, abs=1e-3)


def test_a_change_of_the_air_moves_no_drop_at_once_and_each_within_a_second():
    """All sizes and places, wind, gusts and turbulence: no jump at the change, within 3 m in the second after it."""
    rainfall = RainSimulation.start(BREEZE)
    changed = rainfall.changed(msgspec.structs.replace(STORM, roughness_m=1.5), 20.0)
    steps = [rainfall.frame(20.0, HERE), *(changed.frame(20.0 + 0.05 * k, HERE) for k in range(24))]
    before, after = all_drops(steps[0]), all_drops(steps[1])
    n = min(len(before.numbers), len(after.numbers))
    assert np.abs((after.fractions[:n] - before.fractions[:n]).astype(np.int32)).max() < 2**9
    settled = RainSimulation.start(msgspec.structs.replace(STORM, roughness_m=1.5))
    assert np.array_equal(steps[-1].where.air.by_class, settled.frame(21.15, HERE).where.air.by_class)
    large = np.flatnonzero(changed.motion.fall_speed_m_s > 3.0)
    for earlier, later in pairwise(steps[1:]):
        a, b = all_drops(earlier), all_drops(later)
        moved = (b.fractions - a.fractions).astype(np.int32) * 2.0**-32 * earlier.period_m
        some = np.isin(a.class_index, large) & np.all(np.abs(a.positions(earlier.period_m)) < 1.8, axis=1)
        assert np.abs(moved[some]).max() < 2.0


def test_keyed_wind_turns_without_a_jump():
    wind = RainKeyframes().with_key(0.0, wind_m_s=(1.0, 0.0)).with_key(10.0, wind_m_s=(-6.0, 5.0))
    rainfall, dt = RainSimulation.start(BREEZE, weather=wind), 1e-3
    for time_s in (0.0, 5.0, 10.0):
        fields = [rainfall.frame(time_s + step, HERE) for step in (-dt, dt)]
        a, b = (all_drops(each) for each in fields)
        inner = np.all(np.abs(a.positions(fields[0].period_m)) < fields[0].period_m / 2 - 0.1, axis=1)
        moved = (b.fractions - a.fractions).astype(np.int32) * 2.0**-32 * fields[0].period_m
        assert np.abs(moved[inner]).max() < 2 * dt * 15.0
    assert Wind((-6.0, 5.0)).drift_m_s == pytest.approx(rainfall.frozen_at(12.0).motion.wind.drift_m_s)


def test_the_ground_of_a_scene_carries_the_profile():
    """High above the ground the wind is stronger: a camera at 10 m sees the stated wind."""
    rain = msgspec.structs.replace(BREEZE, gust_m_s=0.0, turbulence_m_s=0.0)
    high = RainSimulation.start(rain).frame(2.0, seen_from((0.0, 0.0, 10.0), ground_m=0.0)).drops
    speeds = np.hypot(*high.velocities_m_s[:, :2].T)
    assert speeds.mean() == pytest.approx(rain.wind_speed_m_s, rel=0.05)
    low = RainSimulation.start(rain).frame(2.0, seen_from()).drops
    assert np.hypot(*low.velocities_m_s[:, :2].T).mean() < 0.8 * speeds.mean()


def test_rain_has_the_classes_of_open_simulation_interface():
    rates = (0.0, 0.09, 0.1, 0.5, 1.9, 8.0, 8.1, 34.0, 149.0)
    names = ("", "", "very light", "light", "moderate", "moderate", "heavy", "very heavy", "very heavy")
    assert tuple(rain_class(each) for each in rates) == names


def test_frames_differ_by_seed_and_time_alone():
    rainfall = RainSimulation.start(STORM)
    alone = rainfall.frame(7.0, HERE).where
    rainfall.frame(3.0, HERE)
    later = RainSimulation.start(STORM).frame(7.0, HERE).where
    assert all(np.array_equal(a, b) for a, b in zip(alone.air, later.air, strict=True))
    other = RainSimulation.start(replace_seed(STORM)).frame(7.0, HERE).where
    assert not np.array_equal(alone.air.rows, other.air.rows)


def replace_seed(rain):
    return msgspec.structs.replace(rain, seed=rain.seed + 1)
