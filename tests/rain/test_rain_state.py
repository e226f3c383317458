import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.rain.calibration import calibration_names, load_calibration
from gsrain_engine.rain.properties import fall_speed, flux_mm_h, intensity_for_density, rain_properties
from gsrain_engine.rain.settings import RainSettings, load_preset

PUBLISHED = load_calibration("published")


def state(**fields):
    return rain_properties(RainSettings(**fields), PUBLISHED)


@pytest.mark.parametrize(
    ("intensity", "density", "shape", "scale", "implied"),
    [(1.2, 271, 9.705, 0.074, 0.80), (8.5, 1190, 7.132, 0.114, 6.59), (12.0, 1710, 10.466, 0.085, 11.03)],
)
def test_published_rows_come_back_exactly(intensity, density, shape, scale, implied):
    row = state(intensity_mm_h=intensity, closure="published")
    assert (row.density_m3, row.shape, row.scale_mm) == (density, shape, scale)
    assert row.implied_mm_h == pytest.approx(implied, abs=0.005)


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


@given(st.floats(0.01, 100), st.sampled_from(calibration_names()), st.sampled_from(["density", "published"]))
@settings(max_examples=60, deadline=None)
def test_every_calibration_closes_goes_on_smoothly_and_is_found_again_by_its_density(intensity, name, closure):
    rain, calibration = RainSettings(intensity_mm_h=intensity, closure=closure), load_calibration(name)
    here = rain_properties(rain, calibration)
    carried = flux_mm_h(here.density_m3, here.sizes, fall_speed(rain, calibration))
    assert carried == pytest.approx(intensity if closure == "density" else here.table_implied_mm_h, rel=1e-9)
    beside = rain_properties(msgspec.structs.replace(rain, intensity_mm_h=intensity * (1 - 1e-6)), calibration)
    for number in ("density_m3", "shape", "scale_mm", "extinction_per_m"):
        assert getattr(beside, number) == pytest.approx(getattr(here, number), rel=1e-4)
    assert beside.table_density_m3 < here.table_density_m3
    found = rain_properties(
        msgspec.structs.replace(rain, intensity_mm_h=intensity_for_density(here.density_m3, rain, calibration)),
        calibration,
    )
    assert found.density_m3 == pytest.approx(here.density_m3, rel=1e-6)


def test_more_drops_than_100_mm_h_have_no_intensity():
    assert intensity_for_density(0.0, RainSettings(), PUBLISHED) == 0
    assert intensity_for_density(1190, RainSettings(closure="published"), PUBLISHED) == pytest.approx(8.5)
    for density in (1e9, -1.0, float("nan")):
        with pytest.raises(ValueError, match="at 100 mm/h"):
            intensity_for_density(density, RainSettings(), PUBLISHED)


@pytest.mark.parametrize("intensity", [0.0, 2.2250738585072014e-308])
def test_nothing_is_hidden_by_no_rain_nor_by_the_faintest_that_can_be_written(intensity):
    clear = state(intensity_mm_h=intensity)
    assert (round(clear.density_m3, 9), clear.drops, clear.haze_gaussians) == (0, 0, 0)
    assert clear.visibility_m == float("inf")
    assert clear.extinction_per_m == 0 or intensity > 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("intensity_mmh: 3", "unknown field `intensity_mmh`"),
        ("intensity_mm_h: 101", "<= 100.0 - at `$.intensity_mm_h`"),
        ("exposure_s: 2", "exposure_s must be within 0.00001..1 s"),
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
