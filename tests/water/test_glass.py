"""Water on glass: impacts by the flux, mass, replay, merging and running off."""

import numpy as np
import pytest

from gsrain_engine.rain.air import profile
from gsrain_engine.rain.properties import CLASSES
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.water.glass import CameraMotion, GlassHistory
from gsrain_engine.water.glass_drops import TICK_S, GlassDrops, Impacts, Wetting
from gsrain_engine.water.pane import WINDSHIELD_SLOPE_DEG, pane_of
from gsrain_engine.water.wiper import PIVOT_M, Wiper

MPH = 0.44704
POSE = look_at(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
CAMERA = Camera.from_fov(960, 640, 40.0, POSE)
STILL_AIR = np.zeros(2)
NO_RAIN = Impacts(0.0, 0.0, np.zeros(CLASSES), np.zeros(CLASSES), 1.0)


def past_at(speed_m_s):
    motion = CameraMotion(CAMERA.camera_to_world[:3, :3], np.array([speed_m_s, 0.0, 0.0]))
    return lambda time_s: motion


def history(speed_m_s=0.0, *, seed=0, kind="windshield", wiper="off", wet_s=2.0, intensity=8.5, angle=50.0):
    rain = RainSimulation.start(RainSettings(intensity_mm_h=intensity, seed=seed))
    return GlassHistory(
        pane_of(kind, CAMERA), rain, past_at(speed_m_s), contact_angle_deg=angle, wet_s=wet_s, wiper=wiper
    )


def flux_integral(rain, speed_m_s, area_m2, seconds):
    """Sum over the drop sizes of density times relative speed along the normal, written out."""
    slope = np.radians(WINDSHIELD_SLOPE_DEG)
    wind_x = rain.motion.wind.mean_m_s[0] * profile(np.array([1.3]), rain.motion.wind.roughness_m)[0]
    inward = (speed_m_s - wind_x) * np.sin(slope) + rain.motion.fall_speed_m_s * np.cos(slope)
    return rain.state.density_m3 * np.mean(np.maximum(inward, 0)) * area_m2 * seconds


@pytest.mark.parametrize("mph", [0, 25, 35])
def test_impacts_follow_the_flux_through_the_moving_pane(mph):
    for seed in range(20):
        glass = history(mph * MPH, seed=seed, wet_s=1.0)
        state = glass.at(0.5)
        rain = RainSimulation.start(RainSettings(intensity_mm_h=8.5, seed=seed))
        expected = flux_integral(rain, mph * MPH, glass.pane.area_m2, 1.5)
        assert state.expected_impacts == pytest.approx(expected, rel=1e-9)
        assert state.seconds == pytest.approx(1.5)
        assert abs(state.impacts - expected) < 3 * np.sqrt(expected)


def test_counts_scatter_as_those_of_a_poisson_process():
    states = [history(seed=seed, wet_s=1.0).at(0.0) for seed in range(60)]
    deviates = [(each.impacts - each.expected_impacts) / np.sqrt(each.expected_impacts) for each in states]
    assert abs(np.mean(deviates)) < 4 / np.sqrt(60)
    assert 0.6 < np.std(deviates) < 1.4


@pytest.mark.parametrize(("mph", "wiper", "kind"), [
    (0, "off", "windshield"), (35, "off", "windshield"), (35, "auto", "windshield"), (0, "low", "windshield"),
    (70, "high", "windshield"), (35, "off", "lens"),
])  # fmt: skip
def test_water_in_is_water_out_and_water_stored(mph, wiper, kind):
    glass = history(mph * MPH, wiper=wiper, kind=kind, intensity=40.0, wet_s=60.0 if wiper == "off" else 5.0)
    glass.at(3.0)
    drops = glass.drops
    assert drops.landed_m3 > 0
    if kind == "windshield":
        assert drops.left_m3 > 0
    assert abs(drops.landed_m3 - drops.left_m3 - drops.stored_m3) < 1e-6 * drops.landed_m3


def test_any_time_alone_has_the_state_of_a_sequence():
    together, times = history(35 * MPH, wiper="low"), [0.0, 0.04, 0.213, 1.7, 2.0]
    for time_s in times:
        together.at(time_s)
        alone = history(35 * MPH, wiper="low")
        alone.at(time_s)
        assert together.drops.present().tobytes() == alone.drops.present().tobytes()
        assert together.drops.film_m.tobytes() == alone.drops.film_m.tobytes()
        assert together.wiper.angle_rad == alone.wiper.angle_rad
    last = together.drops.present().tobytes()
    together.at(0.04)
    together.at(2.0)
    assert together.drops.present().tobytes() == last


def test_the_past_begins_anew_each_minute_and_what_is_wiped_goes_on():
    glass, late = (history(wiper="low", intensity=3.0, wet_s=4.0) for _ in range(2))
    assert glass.at(59.99).seconds == pytest.approx(63.99)
    before, home = glass.drops.present().copy(), glass.wiper.angle_rad
    assert not glass.wiper.is_moving
    assert glass.at(60.0).seconds == pytest.approx(4.0)
    assert glass.wiper.angle_rad == home
    rows = []
    for drops in (before, glass.drops.present()):
        x, y = drops[:, 0] - PIVOT_M[0], drops[:, 1] - PIVOT_M[1]
        wiped = (abs(np.hypot(x, y) - 0.42) < 0.28) & (abs(np.degrees(np.arctan2(y, x)) - 60) < 50)
        rows.append(set(map(bytes, np.ascontiguousarray(drops[wiped, :4]))))
    assert len(rows[0]) > 30 and len(rows[0] & rows[1]) > 0.95 * len(rows[0])
    glass.at(70.0)
    glass.at(61.234)  # from a saved state
    late.at(61.234)
    assert glass.drops.present().tobytes() == late.drops.present().tobytes()
    assert glass.wiper.angle_rad == late.wiper.angle_rad
    glass.past = past_at(20.0)
    glass.at(60.5)
    late = history(20.0, wiper="low", intensity=3.0, wet_s=4.0)
    late.at(60.5)
    assert glass.drops.present().tobytes() == late.drops.present().tobytes()


def test_another_seed_has_other_drops():
    first, second = history(seed=0), history(seed=1)
    first.at(0.0), second.at(0.0)
    assert first.drops.present().shape != second.drops.present().shape or not np.allclose(
        first.drops.present(), second.drops.present()
    )


def test_drops_that_touch_merge_and_no_two_overlap():
    glass = history(wet_s=10.0)
    glass.at(0.0)
    drops = glass.drops.present()
    assert len(drops) < glass.drops.impacts
    distance = np.hypot(*(drops[:, None, axis] - drops[None, :, axis] for axis in (0, 1)))
    both = drops[:, None, 3] + drops[None, :, 3]
    np.fill_diagonal(distance, 1.0)
    assert np.all(distance >= both - 1e-12)


def test_a_cap_has_its_volume_and_the_largest_drop_that_stays_balances_gravity():
    wetting = Wetting(90.0)
    assert wetting.volume_factor == pytest.approx(2 / 3 * np.pi)  # half a ball
    assert wetting.frontal_factor == pytest.approx(np.pi / 2)
    # rho g r^3 = 2 gamma r (cos 75 - cos 105)
    assert wetting.holding_n_m == pytest.approx(4 * 0.0728 * np.cos(np.radians(75)))


@pytest.mark.parametrize(("radius_mm", "runs"), [(1.5, False), (6.5, True)])
def test_only_heavy_drops_run_down(radius_mm, runs):
    pane, wetting = pane_of("windshield", CAMERA), Wetting(50.0)
    drops = GlassDrops(pane, wetting, seed=3)
    drops.place(0.0, 0.0, wetting.volume_factor * (1e-3 * radius_mm) ** 3)
    down = np.array([0.0, -9.81 * np.sin(np.radians(WINDSHIELD_SLOPE_DEG))])
    drops.advance(0, NO_RAIN, down, STILL_AIR, np.zeros((50, 2)))
    lowest = drops.present()[:, 1].min()
    assert (lowest < -0.005) == runs
    assert len(drops.present()) > 1 if runs else len(drops.present()) == 1


def test_the_air_at_speed_blows_drops_up_the_pane():
    pane, wetting = pane_of("windshield", CAMERA), Wetting(50.0)
    down = np.array([0.0, -9.81 * np.sin(np.radians(WINDSHIELD_SLOPE_DEG))])
    heights = []
    for speed in (0.0, 30.0):
        drops = GlassDrops(pane, wetting, seed=3)
        drops.place(0.0, -0.03, wetting.volume_factor * 2.5e-3**3)
        drops.advance(0, NO_RAIN, down, np.array([0.0, 0.82 * speed]), np.zeros((20, 2)))
        heights.append(drops.present()[:, 1].max() if len(drops.present()) else np.inf)
    assert heights[0] == pytest.approx(-0.03) and heights[1] > -0.01


def test_the_air_drags_drops_alike_in_all_directions():
    pane, wetting = pane_of("windshield", CAMERA), Wetting(50.0)
    ways = []
    for air_m_s in np.array([(24.0, 0.0), (0.0, 24.0), (-24.0, 0.0), (14.4, 19.2)]):
        drops = GlassDrops(pane, wetting, seed=3)
        drops.place(0.0, 0.0, wetting.volume_factor * 2.5e-3**3)
        drops.advance(0, NO_RAIN, np.zeros(2), air_m_s, np.zeros((4, 2)))
        ways.append((drops.present()[:, :2] @ air_m_s).max() / 24.0)
    assert ways == pytest.approx([0.024] * 4, rel=0.02)


def test_a_sweep_clears_the_view_and_leaves_streaks():
    glass = history(wiper="low", wet_s=3.0)
    areas = []
    for step in range(28):
        glass.at(0.05 * step)
        areas.append((glass.drops.present()[:, 3] ** 2).sum())
    assert min(areas) < 0.35 * max(areas)
    assert glass.drops.film_m.max() > 1e-7


def test_a_sweep_and_its_pauses():
    modes = {}
    for mode in ("off", "interval", "low", "high"):
        wiper = Wiper(mode)
        for _ in range(round(60 / TICK_S)):
            wiper.advance(TICK_S, 1e-6)
        modes[mode] = wiper.sweeps
    assert modes == {"off": 0, "interval": 12, "low": 45, "high": 65} or (
        modes["off"] == 0 and modes["interval"] in (11, 12) and 44 <= modes["low"] <= 45 and 63 <= modes["high"] <= 65
    )


def test_the_rain_sensor_wipes_more_often_the_more_water_lands():
    sweeps = []
    for depth_m_s in (0.0, 2e-6, 9e-6, 60e-6):
        wiper = Wiper("auto")
        for _ in range(6000):
            wiper.advance(TICK_S, depth_m_s * TICK_S)
        sweeps.append(wiper.sweeps)
    assert sweeps[0] == 0 and sweeps[1] < sweeps[2] < sweeps[3]
    assert sweeps[1] == pytest.approx(60 * 2e-6 / 20e-6, abs=1)


def test_cameras_that_look_aside_have_no_windshield():
    def turned(degrees):
        a = np.radians(degrees)
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        return turn @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

    for degrees, has in ((0, True), (45, True), (75, False), (180, False)):
        assert (pane_of("windshield", CAMERA, None, turned(degrees)) is not None) == has
        assert pane_of("lens", CAMERA, None, turned(degrees)) is not None
