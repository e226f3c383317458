"""A calibration from drops of a known law: numbers, intervals, refusals, files and figure."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from PIL import Image

from gsrain_engine.disdrometer.fit import fit_calibration
from gsrain_engine.disdrometer.fit_models import AxisRatios, FitOptions
from gsrain_engine.disdrometer.fit_plot import draw_calibration, write_plot
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.properties import DropSizes, flux_mm_h
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from measured_rain import measured_rain

LIGHT, HEAVY = (271.0, 9.705, 0.074), (1190.0, 7.132, 0.114)
OPTIONS = FitOptions(intensities_mm_h=(0.8, 6.6), half_width=0.5, resamples=200)


def fit(rain, measured=None, **changes):
    options = msgspec.structs.replace(OPTIONS, **changes)
    return fit_calibration(rain, name="test", source="drawn", options=options, measured=measured)


@pytest.fixture(scope="module")
def rain():
    return [
        measured_rain(*LIGHT, minutes=60, seed=1),
        measured_rain(*HEAVY, minutes=30, seed=2, start="2024-05-01T12:00"),
    ]


@pytest.fixture(scope="module")
def fitted(rain):
    return fit(rain)


def test_laws_and_speeds_come_back_from_a_parsivels_counts(fitted):
    calibration = fitted.calibration
    for row, law in zip(calibration.rows, (LIGHT, HEAVY), strict=True):
        for name, true, rel in zip(("density_m3", "shape", "scale_mm"), law, (0.03, 0.05, 0.05), strict=True):
            value, (low, high) = getattr(row, name), getattr(row.confidence, name)
            assert value == pytest.approx(true, rel=rel)
            assert low < value < high and 0.9 * low < true < 1.1 * high
    assert [row.intensity_mm_h for row in calibration.rows] == pytest.approx([0.80, 6.59], rel=0.05)
    d = np.linspace(0.3, 2.5, 20)  # a class is taken at its middle
    assert calibration.velocity(d) == pytest.approx(-0.342 * d**2 + 3.379 * d + 0.340, rel=0.03)
    for (low, high), value in zip(fitted.velocity_confidence, calibration.velocity.coefficients, strict=True):
        assert low - 0.02 < value < high + 0.02 and 0.02 < high - low < 0.3
    for value in (*calibration.velocity.coefficients, calibration.velocity.r2):
        assert value == float(f"{value:.4g}")  # rounded
    assert calibration.velocity.r2 > 0.99 and fitted.fitted_range_mm == (0.25, 8.0)


def test_implied_rates_and_counts_add_up(fitted, rain):
    for each in fitted.rows:
        sizes = DropSizes(each.row.shape, each.row.scale_mm)
        implied = flux_mm_h(each.row.density_m3, sizes, fitted.calibration.velocity)
        assert each.implied_mm_h == pytest.approx(implied, rel=0.002)
        assert [each.implied_mm_h, each.moments_implied_mm_h] == pytest.approx([each.row.intensity_mm_h] * 2, rel=0.03)
        assert each.moments_shape == pytest.approx(each.row.shape, rel=0.1)
    assert fitted.records == fitted.records_used == sum(map(len, rain)) == sum(row.records for row in fitted.rows)
    assert [(row.minutes, row.middle_mm_h) for row in fitted.rows] == [(60, 0.8), (30, 6.6)]
    assert sum(row.drops for row in fitted.rows) == sum(each.counts.sum() for each in rain)
    first = rain[0].rate_mm_h[:2].mean(), rain[0].reported_mm_h[:2].mean()
    assert (fitted.minute_rate_mm_h[0], fitted.minute_reported_mm_h[0]) == pytest.approx(first)
    assert len(fitted.minute_rate_mm_h) == 90


def test_speeds_of_a_class_have_a_mean_and_a_deviation():
    parts = [
        measured_rain(*HEAVY, minutes=5, seed=5, scatter=0.15),
        measured_rain(*LIGHT, minutes=5, seed=6, start="2024-05-01T12:00", scatter=0.15),
    ]
    speeds = fit(parts, resamples=0).speeds
    counts = sum(each.counts.sum(axis=0) for each in parts).astype(int)
    for diameter in (3, 7, 11):
        drawn = np.repeat(parts[0].velocities_m_s, counts[diameter])
        assert speeds.drops[diameter] == len(drawn)
        found = (speeds.mean_m_s[diameter], speeds.deviation_m_s[diameter])
        assert found == pytest.approx((drawn.mean(), drawn.std()), rel=1e-6)
    assert np.isnan(speeds.mean_m_s[counts.sum(axis=1) == 0]).all()
    np.testing.assert_array_equal(speeds.fitted, (speeds.drops >= 10) & (parts[0].diameters_mm < 8))


def test_intervals_need_minutes_and_follow_the_seed(fitted, rain):
    def confidence(light_records: int):
        light, heavy = (replace(each, counts=40 * each.counts) for each in (rain[0][:light_records], rain[1][:2]))
        middles = (0.8 * 40, 6.6 * 40)
        return fit([light, heavy], intensities_mm_h=middles, half_width=0.6, resamples=50).velocity_confidence

    assert confidence(8) is not None and confidence(6) is None  # four light minutes and a heavy one, or three
    assert fit(rain).calibration == fitted.calibration
    row, other = fitted.calibration.rows[0], fit(rain, seed=1).calibration.rows[0]
    assert other.confidence != row.confidence and other.density_m3 == row.density_m3


def test_a_class_that_one_minute_alone_has_does_not_widen_the_intervals(rain):
    """Minutes that are not drawn are replaced by the mean over all minutes."""
    counts = rain[1].counts.copy()
    counts[:, 16:] = 0
    counts[0, 19, 23] = 12  # 4.75 mm at 9.2 m/s, in one of thirty minutes
    found = fit([rain[0], replace(rain[1], counts=counts)])
    assert found.speeds.fitted[19]
    assert max(high - low for low, high in found.velocity_confidence) < 0.2


def test_the_instruments_own_rate_is_checked_on_all_measured_drops(fitted, rain):
    assert fitted.rate_check.ratio == pytest.approx(1, abs=0.03) and fitted.rate_check.correlation > 0.99
    silent = [replace(each, reported_mm_h=np.full(len(each), np.nan)) for each in rain]
    assert fit(silent, resamples=0).rate_check is None
    splashes = rain[0].counts.copy()
    splashes[:, 12, 3] += 50
    found = fit(rain, [replace(rain[0], counts=splashes), rain[1]])
    assert found.rate_check.ratio > 1.3 and found.rows[0].row == fitted.rows[0].row


def test_without_speeds_the_fall_speed_is_assumed_and_small_drops_can_be_left_out(rain):
    flat = [replace(each, velocity_edges_m_s=None, counts=each.counts.sum(axis=2, keepdims=True)) for each in rain]
    found = fit(flat, resamples=0)
    assert found.speeds is None and found.velocity_confidence is None and found.calibration.velocity.r2 is None
    # Atlas's speeds are higher than those of these drops: the same counts are fewer drops in the air.
    assert 0.75 < found.calibration.rows[0].density_m3 / LIGHT[0] < 0.95
    found = fit(rain, smallest_mm=0.6, resamples=0)
    row = found.calibration.rows[0]
    assert found.fitted_range_mm == (0.625, 8.0) and row.confidence is None
    assert row.density_m3 == pytest.approx(LIGHT[0], rel=0.1)  # those below are known from the law
    assert found.rows[0].drops < 0.85 * rain[0].counts.sum()


@pytest.mark.parametrize(
    ("middles", "half_width", "overlap", "passed_over"),
    [
        ((0.8, 6.6), 0.1, False, ()),
        ((0.7, 0.9, 6.6), 0.3, True, ()),
        ((0.8, 3.0, 6.6, 50.0), 0.3, False, ("3 mm/h: no rain", "50 mm/h: no rain")),
        ((0.8, 0.81, 6.6), 0.9, True, ("0.81 mm/h: the same minutes as 0.8 mm/h",)),
    ],
)
def test_bins_without_minutes_of_their_own_are_named(middles, half_width, overlap, passed_over, rain):
    found = fit(rain, intensities_mm_h=middles, half_width=half_width, resamples=0)
    assert len(found.rows) == len(middles) - len(passed_over) and found.passed_over == passed_over
    assert (sum(row.records for row in found.rows) > found.records_used) == overlap
    assert 0 < found.records_used <= found.records == 180 and (found.records_used < 180) == (half_width == 0.1)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (lambda light, heavy: [light, heavy[:2]], r"of 2 bins 1 have them \(6.6 mm/h: 1 minutes"),
        (lambda light, heavy: [replace(light, counts=0 * light.counts)], "too few drops"),
        (lambda light, heavy: [light[:0]], "too few drops"),
        (lambda light, heavy: [light, replace(heavy, area_m2=2 * heavy.area_m2)], "area_m2"),
    ],
)
def test_too_little_rain_and_other_classes_are_refused(change, names, rain):
    light, heavy = rain[0], replace(rain[1], counts=rain[1].counts * (np.arange(32) > 6)[:, None])
    with pytest.raises(ValueError, match=names):
        fit(change(light, heavy), resamples=0, half_width=0.3)


@pytest.mark.parametrize("calibration", ["published", "locarno_2018", "marshall_palmer"])
def test_the_virtual_disdrometer_closes_the_loop(calibration):
    """Fits to its counts return the law that the drops were drawn from."""
    intensities = (1.2, 8.5, 12.0)
    paper = msgspec.to_builtins(load_preset("paper")) | {"calibration": calibration, "closure": "density"}
    rains = [msgspec.convert(paper | {"intensity_mm_h": each}, RainSettings) for each in intensities]
    counted = [
        VirtualDisdrometer(RainSimulation.start(each), area_m2=0.5).measure(np.arange(4) * 40.0) for each in rains
    ]
    found = fit([each.spectra for each in counted], intensities_mm_h=intensities, half_width=0.2, resamples=0)
    for row, each in zip(found.calibration.rows, counted, strict=True):
        for name, rel in (("density_m3", 0.03), ("shape", 0.05), ("scale_mm", 0.05), ("intensity_mm_h", 0.03)):
            assert getattr(row, name) == pytest.approx(getattr(each.state, name), rel=rel)
    d = np.linspace(0.5, 2, 7)
    assert found.calibration.velocity(d) == pytest.approx(load_calibration(calibration).velocity(d), rel=0.03)


def test_the_law_of_marshall_and_palmer():
    d, calibration = np.array([0.3, 1.0, 2.5]), load_calibration("marshall_palmer")
    for row in calibration.rows:
        slope = 4.1 * row.intensity_mm_h**-0.21
        inside = math.exp(-0.1 / row.scale_mm) - math.exp(-8 / row.scale_mm)
        spectrum = row.density_m3 * np.exp(-d / row.scale_mm) / (row.scale_mm * inside)
        assert row.shape == 1 and spectrum == pytest.approx(8000 * np.exp(-slope * d), rel=1e-3)


# Figure


def test_the_figure_shows_the_numbers_with_units(fitted):
    ratios = AxisRatios(
        diameters_mm=np.array([1.1, 2.0, 3.0]), medians=np.array([0.99, 0.93, 0.86]),
        quartiles=np.array([[0.9, 0.85, 0.8], [1.0, 0.98, 0.9]]), drops=300, offset=1.07, slope_per_mm=-0.07, r2=0.9,
    )  # fmt: skip
    bare = replace(fitted, axis_ratios=ratios, speeds=None, velocity_confidence=None)
    for each, letters in ((fitted, "abcde"), (bare, "abcdef")):
        panels = [axes for axes in draw_calibration(each).axes if axes.get_title(loc="left")]
        assert [axes.get_title(loc="left")[:3] for axes in panels] == [f"({letter})" for letter in letters]
        assert all("mm" in axes.get_xlabel() and axes.get_ylabel() and axes.get_legend() for axes in panels)
        points, law = panels[0].lines[2:4]  # of the second row
        row = fitted.rows[1]
        assert points.get_ydata() == pytest.approx(row.spectrum_m3_mm[row.spectrum_m3_mm > 0])
        assert np.trapezoid(law.get_ydata(), law.get_xdata()) == pytest.approx(row.row.density_m3, rel=0.01)


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_the_same_fit_gives_the_same_bytes(kind, fitted, tmp_path):
    first, second = tmp_path / f"a.{kind}", tmp_path / f"b.{kind}"
    write_plot(fitted, first)
    write_plot(fitted, second)
    assert first.read_bytes() == second.read_bytes() and len(first.read_bytes()) > 20_000
    if kind == "png":
        with Image.open(first) as picture:
            assert picture.size == (1950, 1140)
    with pytest.raises(ValueError, match=r"plot\.bmp"):
        write_plot(fitted, tmp_path / "plot.bmp")
    assert set(tmp_path.iterdir()) == {first, second}
