import re

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from given_rain import STILL, gaussians_of
from gsrain_engine.rain.calibration import calibration_names, load_calibration
from gsrain_engine.rain.frame import RainCamera
from gsrain_engine.rain.properties import (
    extinction_note,
    fall_speed,
    flux_mm_h,
    intensity_for_density,
    rain_properties,
    turbulent_fall_share,
)
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation, mean_linear_color
from gsrain_engine.scene.camera import Camera, look_at
from repository import REPOSITORY

UP = np.array([0.0, 0, 1])


def view(position=(0.0, 0, 1.5), heading=0.0, velocity=(0.0, 0, 0), anchor_at=None):
    eye = np.array(position)
    pose = look_at(eye, eye + [np.cos(heading), np.sin(heading), 0], UP)
    anchor = np.eye(4)
    anchor[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
    anchor[:3, 3] = eye if anchor_at is None else anchor_at
    return RainCamera(Camera.from_fov(960, 640, 36.0, pose), anchor, np.array(velocity))


def test_same_seed_and_time_same_bytes():
    def means(**changes):
        rain = msgspec.structs.replace(load_preset("8.5"), **changes)
        return gaussians_of(RainSimulation.start(rain).frame(4.2, view())).means.tobytes()

    assert means() == means() != means(seed=1)
    assert means(intensity_mm_h=0.0) == b""


def test_paper_preset_has_exactly_its_drops_in_the_region():
    rainfall = RainSimulation.start(load_preset("paper"))
    assert drops_in_region(rainfall, 0.7, view()) == 257_040
    assert drops_in_region(rainfall, 31.0, view((12.0, 3, 2), 1.0)) == 257_040


def test_cameras_of_a_rig_see_the_same_drops():
    """Two cameras on one anchor: streaks that both draw stand at the same places."""
    rainfall = RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), haze="none"))
    left, right = (rainfall.frame(2.0, view((0.0, y, 1.5), anchor_at=(0.0, 0, 1.5))) for y in (0.05, -0.05))
    places = [{tuple(np.round(p, 4)) for p in gaussians_of(each).means} for each in (left, right)]
    assert len(places[0] & places[1]) > 0.5 * len(places[0])


def test_reduced_preview_keeps_the_same_drops():
    rainfall = RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), haze="none"))
    full = view()
    half = RainCamera(full.camera.resized(480, 320), full.anchor_to_world, full.velocity_m_s, focal_px=full.camera.fx)
    a, b = rainfall.frame(1.0, full), rainfall.frame(1.0, half)
    assert np.array_equal(a.visible_drops().numbers, b.visible_drops().numbers)


def test_sky_is_averaged_in_linear_light():
    color = mean_linear_color(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    assert color == pytest.approx((0.7354,) * 3, abs=1e-3)  # enc(1/2)


def drops_in_region(rainfall, time_s, view):
    return len(rainfall.frame(time_s, view).visible_drops(in_view=False).numbers)


PUBLISHED = load_calibration("published")


def state(**fields):
    return rain_properties(RainSettings(**fields), PUBLISHED)


@pytest.mark.parametrize(
    ("intensity", "density", "shape", "scale", "implied"),
    [(1.2, 271, 9.705, 0.074, 0.80), (8.5, 1190, 7.132, 0.114, 6.59), (12.0, 1710, 10.466, 0.085, 11.03)],
)
def test_published_rows_come_back_exactly(intensity, density, shape, scale, implied):
    row = state(intensity_mm_h=intensity, closure="published", **STILL)
    assert (row.density_m3, row.shape, row.scale_mm) == (density, shape, scale)
    assert row.implied_mm_h == row.table_implied_mm_h == pytest.approx(implied, abs=0.005)


def test_paper_preset_has_its_drops():
    rain = load_preset("paper")
    paper = rain_properties(rain, PUBLISHED)
    assert msgspec.yaml.decode(msgspec.yaml.encode(rain), type=RainSettings) == rain
    assert rain.streak_region.volume_m3 == 216
    assert paper.drops == 257_040
    assert rain.exposure_s == 0.05
    assert paper.haze_gaussians == 553  # beta V_f / (2 pi s_h^2 alpha_m)
    assert np.exp(-paper.extinction_per_m * paper.visibility_m) == pytest.approx(0.05)


@given(st.floats(0.01, 99), st.floats(1e-3, 1))
@settings(max_examples=60, deadline=None)
def test_more_rain_has_larger_drops_and_takes_more_light(intensity, more):
    weaker, stronger = state(intensity_mm_h=intensity), state(intensity_mm_h=intensity + more)
    assert stronger.mean_diameter_mm > weaker.mean_diameter_mm
    assert stronger.extinction_per_m > weaker.extinction_per_m
    assert stronger.table_density_m3 > weaker.table_density_m3


@given(st.floats(0.01, 149), st.sampled_from(calibration_names()), st.sampled_from(["density", "published"]))
@settings(max_examples=60, deadline=None)
def test_every_calibration_closes_goes_on_smoothly_and_is_found_again_by_its_density(intensity, name, closure):
    rain, calibration = RainSettings(intensity_mm_h=intensity, closure=closure), load_calibration(name)
    here = rain_properties(rain, calibration)
    carried = flux_mm_h(here.density_m3, here.sizes, fall_speed(rain, calibration))
    of_table = here.table_implied_mm_h * turbulent_fall_share(rain.turbulence_m_s)
    assert carried == pytest.approx(intensity if closure == "density" else of_table, rel=1e-9)
    beside = rain_properties(msgspec.structs.replace(rain, intensity_mm_h=intensity * (1 - 1e-6)), calibration)
    for number in ("density_m3", "shape", "scale_mm", "extinction_per_m"):
        assert getattr(beside, number) == pytest.approx(getattr(here, number), rel=1e-4)
    assert beside.table_density_m3 < here.table_density_m3
    found = rain_properties(
        msgspec.structs.replace(rain, intensity_mm_h=intensity_for_density(here.density_m3, rain, calibration)),
        calibration,
    )
    assert found.density_m3 == pytest.approx(here.density_m3, rel=1e-6)


def test_page_of_the_physics_has_the_extinction_of_each_calibration():
    """Per km at each intensity of its table, and that of the published one over Marshall and Palmer's."""
    page = (REPOSITORY / "docs" / "physics" / "drops.md").read_text("utf-8").split("## Which calibration to take")[1]
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if re.match(r"\| [\d.]+ \|", line)][:7]
    assert [float(row[0]) for row in rows] == [1, 2.5, 8.5, 13, 25, 50, 100]
    for intensity, *extinctions, times in rows:
        for name, per_km in zip(("published", "marshall_palmer", "locarno_2018"), extinctions, strict=True):
            rain = rain_properties(RainSettings(intensity_mm_h=float(intensity)), load_calibration(name))
            assert f"{1000 * rain.extinction_per_m:.2f}" == per_km
            share = rain.extinction_per_m / rain.marshall_palmer_extinction_per_m
            assert rain.extinction_text.endswith(f"/km ({share:.2g} times Marshall-Palmer's)")
            assert f"{1000 * rain.marshall_palmer_extinction_per_m:.2f}" == extinctions[1]
        assert f"{float(extinctions[0]) / float(extinctions[1]):.1f}" == times
    foggy = rain_properties(RainSettings(intensity_mm_h=50.0, visibility_m=100.0), load_calibration("published"))
    assert foggy.extinction_text == "6.98 /km (1.7 times Marshall-Palmer's)"
    assert extinction_note([RainSettings()]) == ""
    note = extinction_note([RainSettings(intensity_mm_h=rate) for rate in (50.0, 0.0, 8.5)])
    lighter = "1.87 /km (1.5 times Marshall-Palmer's) at 8.5 mm/h"
    assert note == f"Extinction of the rain: {lighter}, {foggy.extinction_text} at 50 mm/h."


@pytest.mark.parametrize("intensity", [13.5, 25.0, 50.0, 149.0])
def test_beyond_the_table_drops_grow_as_measured_ones_do(intensity):
    """Extinction rises as Marshall and Palmer's does. The paper's model keeps the slopes of the table's rows."""
    published, end, at = load_calibration("published"), state(intensity_mm_h=13.0), state(intensity_mm_h=intensity)
    growth = published.diameter_growth
    assert growth is not None and 0.154 < growth < 0.21  # Locarno from 1 mm/h on, and Marshall and Palmer
    assert at.mean_diameter_mm / end.mean_diameter_mm == pytest.approx((intensity / 13) ** growth, rel=1e-3)
    assert at.table_implied_mm_h / intensity == pytest.approx(end.table_implied_mm_h / 13, rel=1e-9)
    risen = (each.extinction_per_m / each.marshall_palmer_extinction_per_m for each in (end, at))
    assert next(risen) == pytest.approx(next(risen), rel=0.03)
    slope = np.polyfit(*np.log([(row.intensity_mm_h, row.shape * row.scale_mm) for row in published.rows]).T, 1)[0]
    paper = [state(intensity_mm_h=each, closure="published").mean_diameter_mm for each in (13.0, intensity)]
    assert paper[1] / paper[0] == pytest.approx((intensity / 13) ** slope, rel=1e-3)


@pytest.mark.parametrize("scale", [0.5, 1.5])
def test_scaled_diameters_keep_the_rate(scale):
    usual, rain = RainSettings(intensity_mm_h=8.5), RainSettings(intensity_mm_h=8.5, diameter_scale=scale)
    before, scaled = (rain_properties(each, load_calibration("published")) for each in (usual, rain))
    velocity = fall_speed(rain, load_calibration("published"))
    assert flux_mm_h(scaled.density_m3, scaled.sizes, velocity) == pytest.approx(8.5, rel=1e-12)
    assert scaled.scale_mm == scale * before.scale_mm and scaled.shape == before.shape
    assert (scaled.density_m3 > before.density_m3) == (scaled.extinction_per_m > before.extinction_per_m) == (scale < 1)
    steady, growing = RainSimulation.start(rain), RainSimulation.start(usual).changed(rain, 3.0)
    assert steady.diameters_mm.mean() == pytest.approx(scaled.mean_diameter_mm, rel=1e-3)
    assert np.array_equal(steady.diameters_mm, growing.diameters_mm)


def test_more_drops_than_149_mm_h_have_no_intensity():
    assert intensity_for_density(0.0, RainSettings(), PUBLISHED) == 0
    assert intensity_for_density(1190, RainSettings(closure="published"), PUBLISHED) == pytest.approx(8.5)
    for density in (1e9, -1.0, float("nan")):
        with pytest.raises(ValueError, match="at 149 mm/h"):
            intensity_for_density(density, RainSettings(), PUBLISHED)


@pytest.mark.parametrize("intensity", [0.0, 2.2250738585072014e-308])
def test_nothing_is_hidden_by_no_rain_nor_by_the_faintest_that_can_be_written(intensity):
    clear = state(intensity_mm_h=intensity)
    assert (round(clear.density_m3, 9), clear.drops, clear.haze_gaussians) == (0, 0, 0)
    assert clear.visibility_m == float("inf")
    assert (clear.extinction_per_m, clear.table_density_m3, clear.table_implied_mm_h) == (0, 0, 0) or intensity > 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("intensity_mmh: 3", "unknown field `intensity_mmh`"),
        ("intensity_mm_h: 150", "150 must be at most 149 - at `$.intensity_mm_h`"),
        ("exposure_s: 2", "2 must be at most 1 - at `$.exposure_s`"),
        ("streak_region: {minimum_m: [0, 0, 0], maximum_m: [1, 0, 1]}", "on y"),
        ("streak_region: {minimum_m: [-1000.1, 0, 0], maximum_m: [1, 1, 1]}", "on x"),
        ("haze_region: {minimum_m: [0, 0, 0], maximum_m: [1, 1, 1000.1]}", "on z"),
    ],
)
def test_bad_presets_name_file_field_and_range(tmp_path, text, words):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match="mine.yaml") as error:
        load_preset(str(file))
    assert words in str(error.value)
