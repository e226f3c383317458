"""Summaries of disdrometer files, their quality control, and whether their rates agree."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import parsivel_text
from gsrain_engine.disdrometer.file_summary import RateCheck, check_rates, open_disdrometer_file
from gsrain_engine.disdrometer.filter import apply_quality_control
from gsrain_engine.disdrometer.fit import RatesDisagreeError, calibrate
from gsrain_engine.disdrometer.fit_models import FitOptions
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.spectra import DropSpectra
from measured_rain import measured_rain
from parsivel_text import DRY, RAIN_MM_H, rain, station_line


@pytest.fixture(scope="module")
def shower():
    """Twenty heavy minutes and ten light ones: 40 and 20 records of 30 s."""
    heavy = measured_rain(1190.0, 7.132, 0.114, minutes=20, seed=3)
    light = measured_rain(271.0, 9.705, 0.074, minutes=10, seed=4, start="2024-05-01T10:20")
    return heavy.concatenate([heavy, light])


@pytest.fixture
def write(tmp_path: Path):
    """Write spectra with their own rates times a factor."""

    def write_file(name: str, spectra, factor: float = 1.0) -> Path:
        write_spectra(tmp_path / name, replace(spectra, reported_mm_h=factor * spectra.reported_mm_h))
        return tmp_path / name

    return write_file


def fit(*paths: Path, **more):
    options = FitOptions(intensities_mm_h=(0.8, 6.6), half_width=0.5, resamples=0)
    return calibrate(paths, name="test", options=options, **more)


def test_a_summary_adds_up(tmp_path: Path):
    few = DRY.copy()
    few[5, 15] = 4
    slow = DRY.copy()
    slow[12, 3] = 40  # 1.75 mm at 0.35 m/s: splashes
    lines = [
        station_line(0),
        station_line(10, rain(), "0000.772"),
        station_line(20, rain() + slow, "0000.772"),
        station_line(30, few),
        station_line(40, rate="X0001.000"),
        station_line(41, rate="Y0002.000"),
        "garbage",
    ]
    (tmp_path / "log.txt").write_text("\n".join(lines))
    measured = open_disdrometer_file(tmp_path / "log.txt").measured()
    numbers = measured.numbers()
    splashes_mm = 40 * np.pi / 6 * 1.875**3 / (180 * (30 - 1.875 / 2))
    few_mm = 4 * np.pi / 6 * 0.6875**3 / (180 * (30 - 0.6875 / 2))
    reasons = numbers["rejected"].pop("reasons")
    assert reasons[0] == {"reason": "rain rate 'X0001.000' is not a number", "records": 2} and len(reasons) == 2
    expected = {
        "file": "log.txt",
        "instrument": "OTT Parsivel",
        "records": 4,
        "record_s": 60,
        "first": "2019-04-10T23:07:00",
        "last": "2019-04-10T23:07:30",
        "drops": 2 * rain().sum() + 40 + 4,
        "rain_mm": pytest.approx(2 * RAIN_MM_H / 60 + splashes_mm + few_mm, rel=1e-4),
        "reported_rain_mm": pytest.approx(2 * 0.772 / 60),
        "records_used": 2,
        "rejected": {"unreadable": 3, "without_drops": 1, "few_drops": 1},
        "rate_records": 2,
        "rates_agree": None,
    }
    assert {name: numbers[name] for name in expected} == expected
    assert numbers["quality"]["records_kept"] == 2
    text = "\n".join(measured.lines)
    assert "4 records of 60 s" in text and "2 unreadable: " in text and "40 drops removed as splashes" in text


def test_names_from_files_do_not_steer_a_terminal(shower, write):
    odd = replace(shower, instrument="a\x1b[31m\u202e[/x]" + 200 * "b")
    path = write("s\x1b[2Jnow.nc", odd, factor=0.4)
    lines = open_disdrometer_file(path).measured().lines
    assert all(line.isprintable() for line in lines) and len(lines[0]) < 300
    assert lines[0].startswith(r"s\x1b[2Jnow.nc: a\x1b[31m\u202e[/x]b")
    with pytest.raises(RatesDisagreeError) as caught:
        fit(path)
    assert str(caught.value).isprintable()


def test_of_simulated_drops_nothing_is_rejected(shower, write):
    dry = replace(shower, counts=np.zeros_like(shower.counts), instrument="GSRAIN virtual disdrometer")
    measured = open_disdrometer_file(write("dry.nc", dry)).measured()
    assert measured.records_without_drops == measured.records_with_few_drops == 0


@pytest.mark.parametrize(
    ("records", "ratio", "correlation", "agrees"),
    [
        (30, 0.7, 0.9, True), (30, 1.4, 0.9, True), (30, 1.0, None, True),
        (30, 0.69, 0.95, False), (30, 1.41, 0.95, False), (30, 1.0, 0.89, False),
        (29, 1.41, 0.2, None), (29, 0.69, 0.2, None), (5, 3.01, 1.0, False), (5, 0.33, 1.0, False),
        (5, 2.99, 1.0, None), (4, 80.0, 0.1, None),
    ],
)  # fmt: skip
def test_rates_agree_within_bounds(records, ratio, correlation, agrees):
    check = RateCheck(records=records, ratio=ratio, correlation=correlation)
    assert check.agrees is agrees and (check.problem is None) == (agrees is not False)


def test_rates_are_compared_above_half_a_millimeter_an_hour(shower):
    quiet = replace(shower, reported_mm_h=np.where(np.arange(60) < 20, shower.reported_mm_h, 0.5))
    rate, reported = shower.rate_mm_h[:20], shower.reported_mm_h[:20]
    for parts in ([quiet], [quiet[:10], quiet[10:]]):
        check = check_rates(parts)
        assert check.records == 20
        assert check.ratio == pytest.approx(rate.sum() / reported.sum())
        assert check.correlation == pytest.approx(np.corrcoef(rate, reported)[0, 1])
    assert check_rates([quiet[19:]]) is None  # one record alone
    alike = replace(shower[:2], counts=np.stack([shower.counts[0]] * 2), reported_mm_h=np.array([5.0, 6.0]))
    assert check_rates([alike]).correlation is None


def test_drops_that_do_not_give_the_instruments_rate_are_refused(shower, write):
    good, bad = write("good.nc", shower), write("bad.nc", shower, factor=1 / 2.27)
    assert len(fit(good).rows) == 2
    with pytest.raises(RatesDisagreeError, match=r"^bad.nc: "):
        fit(good, bad)
    assert "its drops give 2.3" in fit(bad, force=True).calibration.source
    assert "its drops" not in fit(good, force=True).calibration.source
    # Files with too few records each are judged together.
    halves = [write(f"{i}.nc", part, factor=0.5) for i, part in enumerate((shower[:20], shower[20:]))]
    with pytest.raises(RatesDisagreeError, match="2 files together"):
        fit(*halves)


def test_a_phantom_drop_spoils_r_and_the_drops_that_are_used_show_it(shower, write):
    counts = shower.counts.copy()
    counts[5, 29, 5] += 1  # 19 mm at 0.55 m/s
    measured = open_disdrometer_file(write("phantom.nc", replace(shower, counts=counts))).measured()
    assert measured.rate_check.correlation < 0.5 and measured.rate_check.agrees is False
    assert measured.used_rate_check.correlation > 0.97 and measured.used_rate_check.ratio == pytest.approx(1, abs=0.05)


def test_without_a_rate_of_its_own_nothing_is_judged(shower, write):
    path = write("silent.nc", shower, factor=np.nan)
    measured = open_disdrometer_file(path).measured()
    assert measured.reported_rain_mm is None and measured.rate_check is None
    assert "not checked" in measured.lines[-1] and measured.numbers()["rates_agree"] is None
    assert len(fit(path).rows) == 2
    low = open_disdrometer_file(write("low.nc", shower, factor=1e-3)).measured()
    assert low.rate_check is None and low.reported_rain_mm > 0


# Quality control


def dirty_spectra(*drops: tuple[float, float, int]) -> DropSpectra:
    """One record with so many drops of each diameter and speed, and 20 good ones of 1.05 mm at 4.5 m/s; a dry one."""
    counts = np.zeros((2, 100, 150))
    for diameter, speed, count in ((1.05, 4.55, 20), *drops):
        counts[0, int(diameter / 0.1), int(speed / 0.1)] += count
    return DropSpectra(
        instrument="test",
        times=np.array(["2018-10-29T00:00", "2018-10-29T00:01"], "M8[ms]"),
        seconds=np.full(2, 60.0),
        diameter_edges_mm=0.1 * np.arange(101),
        velocity_edges_m_s=0.1 * np.arange(151),
        counts=counts,
        area_m2=np.full(100, 0.005),
        reported_mm_h=np.full(2, np.nan),
    )


# Atlas et al.: 0.1 mm/s at 0.15 mm, 4.16 m/s at 1.05 mm, 9.15 m/s at 5.05 mm.
DIRT = (0.15, 0.45, 1), (1.05, 6.95, 2), (1.05, 1.45, 4), (5.05, 1.05, 8), (2.15, 1.05, 16)


@pytest.mark.parametrize(
    ("dirt", "options", "removed"),
    [
        (DIRT, {}, {"small drops": 1, "margin fallers": 2, "splashes": 4, "fall speed": 24, "few drops": 0}),
        # 6.55 m/s is 57 % above 4.16 m/s, 6.75 m/s is 62 %; 1.75 m/s 58 % below, 1.55 m/s 63 %.
        (((1.05, 6.55, 1), (1.05, 6.75, 2), (1.05, 1.75, 4), (1.05, 1.55, 8)), {},
         {"margin fallers": 2, "splashes": 8}),
        (((1.05, 6.75, 2),), {"speed_tolerance": 0.7}, {"margin fallers": 0}),
        (((1.05, 9.95, 100),), {"fewest_drops": 21}, {"margin fallers": 100, "few drops": 20}),
    ],
)  # fmt: skip
def test_each_mask_takes_its_own(dirt, options, removed):
    dirty = dirty_spectra(*dirt)
    trusted, report = apply_quality_control(dirty, **options)
    found = {mask.name: mask for mask in report.masks}
    assert {name: found[name].drops for name in removed} == removed
    assert report.drops == dirty.counts.sum() == 20 + sum(count for *_, count in dirt)
    assert report.drops - sum(mask.drops for mask in report.masks) == report.drops_kept == trusted.counts.sum()
    assert report.records - sum(mask.records for mask in report.masks) == report.records_kept == len(trusted)
    assert all(f"{mask.name} ({mask.rule}): {mask.drops:.0f} drops" in "\n".join(report.lines) for mask in report.masks)


def test_without_speeds_the_masks_of_speed_are_left_out_and_named():
    measured = dirty_spectra((1.05, 9.95, 5), (0.15, 0.45, 3))
    flat = replace(measured, velocity_edges_m_s=None, counts=measured.counts.sum(axis=2, keepdims=True))
    trusted, report = apply_quality_control(flat)
    assert trusted.counts.sum() == 25
    assert [mask.name for mask in report.masks if mask.not_applied] == ["margin fallers", "splashes", "fall speed"]
    assert "not applied" in report.lines[3]


# Files of one record each


def records(count: int) -> list[parsivel_text.Row]:
    """Records of 30 s: light rain, then eight times as many drops."""
    start = np.datetime64("2024-02-19T00:00:30")
    times = [str(start + np.timedelta64(30 * k, "s")).replace("T", " ") for k in range(count)]
    return [(time, "NAN", rain() * (1 if k < count // 2 else 8)) for k, time in enumerate(times)]


def write_records(folder: Path, dialect, rows: list[parsivel_text.Row], per_file: int) -> list[Path]:
    folder.mkdir()
    for k in range(0, len(rows), per_file):
        lines = [line for line in dialect(rows[k : k + per_file]) if per_file > 1 or not line.startswith("09:")]
        (folder / f"{k:03d}.txt").write_text("\n".join(lines) + "\n")
    return sorted(folder.iterdir())


@pytest.mark.parametrize("dialect", [parsivel_text.locarno, parsivel_text.telegrams, parsivel_text.asdo])
def test_files_of_one_record_are_fitted_like_one_file(dialect, tmp_path):
    """A minute lies in two files, none of which tells that its record lasts half a minute."""
    rows = records(40)
    options = FitOptions(intensities_mm_h=(1.5, 12), half_width=0.5, resamples=20)
    one = write_records(tmp_path / "one", parsivel_text.locarno, rows, 40)
    whole = calibrate(one, name="rain", options=options)
    assert len(whole.minute_rate_mm_h) == 20 and whole.minute_rate_mm_h[0] == pytest.approx(2 * RAIN_MM_H, 1e-3)
    apart = calibrate(write_records(tmp_path / "many", dialect, rows, 1), name="rain", options=options)
    np.testing.assert_allclose(apart.minute_rate_mm_h, whole.minute_rate_mm_h, rtol=1e-12)
    assert (apart.records, apart.records_used) == (whole.records, whole.records_used) == (40, 40)
    assert apart.calibration.rows == whole.calibration.rows
    assert apart.calibration.provenance is not None and len(apart.calibration.provenance.files) == 40
    assert len(apart.calibration.source) < 200


def test_files_of_two_places_at_one_time_keep_their_minutes(tmp_path):
    rows, options = records(40), FitOptions(intensities_mm_h=(1.5, 12), half_width=0.5, resamples=0)
    files = [write_records(tmp_path / name, parsivel_text.locarno, rows, each)
             for name, each in (("a", 10), ("b", 40))]  # fmt: skip
    fitted = calibrate([*files[0], *files[1]], name="rain", options=options)
    assert len(fitted.minute_rate_mm_h) == 40 and fitted.records == 80
