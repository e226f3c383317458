"""Summaries of disdrometer files: what is in them, what is rejected and why, and whether their rates agree."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.disdrometer.file_summary import RateCheck, check_rates, open_disdrometer_file
from gsrain_engine.disdrometer.fit import RatesDisagreeError, calibrate, calibrate_files
from gsrain_engine.disdrometer.fit_models import FitOptions
from gsrain_engine.disdrometer.netcdf import write_spectra
from measured_rain import measured_rain
from parsivel_text import DRY, RAIN_MM_H, rain, station_line

OPTIONS = FitOptions(intensities_mm_h=(0.8, 6.6), half_width=0.5, resamples=0)


@pytest.fixture(scope="module")
def shower():
    """Twenty heavy minutes and ten light ones: 40 and 20 records of 30 s."""
    heavy = measured_rain(1190.0, 7.132, 0.114, minutes=20, seed=3)
    light = measured_rain(271.0, 9.705, 0.074, minutes=10, seed=4, start="2024-05-01T10:20")
    return heavy.concatenate([heavy, light])


def written(folder: Path, name: str, spectra, factor: float = 1.0) -> Path:
    write_spectra(folder / name, replace(spectra, reported_mm_h=factor * spectra.reported_mm_h))
    return folder / name


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
    assert (measured.file, measured.instrument) == ("log.txt", "OTT Parsivel")
    assert (measured.records, measured.seconds) == (4, 60)
    assert (measured.first, measured.last) == ("2019-04-10T23:07:00", "2019-04-10T23:07:30")
    assert measured.drops == 2 * rain().sum() + 40 + 4
    splashes_mm = 40 * np.pi / 6 * 1.875**3 / (180 * (30 - 1.875 / 2))
    few_mm = 4 * np.pi / 6 * 0.6875**3 / (180 * (30 - 0.6875 / 2))
    assert measured.rain_mm == pytest.approx(2 * RAIN_MM_H / 60 + splashes_mm + few_mm, rel=1e-4)
    assert measured.reported_rain_mm == pytest.approx(2 * 0.772 / 60)
    assert measured.quality.records_kept == 2
    assert (measured.records_without_drops, measured.records_with_few_drops) == (1, 1)
    assert [count for _, count in measured.skipped] == [2, 1]
    assert measured.skipped[0][0] == "rain rate 'X0001.000' is not a number"
    text = "\n".join(measured.lines)
    for words in (
        "OTT Parsivel, 4 records of 60 s",
        "used: 2 records",
        "2 unreadable: ",
        "40 drops removed as splashes",
    ):
        assert words in text
    numbers = measured.numbers()
    assert numbers["rejected"]["unreadable"] == 3 and numbers["rejected"]["few_drops"] == 1
    assert numbers["rate_records"] == 2 and numbers["rates_agree"] is None
    assert numbers["records_used"] == 2 and numbers["quality"]["records_kept"] == 2


def test_names_out_of_files_do_not_steer_a_terminal(tmp_path: Path, shower):
    odd = replace(shower, instrument="a\x1b[31m\u202e[/x]" + 200 * "b")
    path = written(tmp_path, "s\x1b[2Jnow.nc", odd, factor=0.4)
    measured = open_disdrometer_file(path).measured()
    assert all(line.isprintable() for line in measured.lines) and len(measured.lines[0]) < 300
    assert measured.lines[0].startswith(r"s\x1b[2Jnow.nc: a\x1b[31m\u202e[/x]b")
    with pytest.raises(RatesDisagreeError) as caught:
        calibrate([path], name="test", options=OPTIONS)
    assert str(caught.value).isprintable()


def test_of_simulated_drops_nothing_is_rejected(tmp_path: Path, shower):
    dry = replace(shower, counts=np.zeros_like(shower.counts), instrument="GSRAIN virtual disdrometer")
    write_spectra(tmp_path / "dry.nc", dry)
    measured = open_disdrometer_file(tmp_path / "dry.nc").measured()
    assert measured.records_without_drops == measured.records_with_few_drops == 0


@pytest.mark.parametrize(
    ("records", "ratio", "correlation", "agrees"),
    [
        (30, 1.0, 0.95, True),
        (30, 0.7, 0.9, True),
        (30, 1.4, 0.9, True),
        (30, 1.0, None, True),
        (30, 0.69, 0.95, False),
        (30, 1.41, 0.95, False),
        (30, 1.0, 0.89, False),
        (29, 1.41, 0.2, None),
        (29, 0.69, 0.2, None),
        (5, 3.01, 1.0, False),
        (5, 0.33, 1.0, False),
        (5, 2.99, 1.0, None),
        (4, 80.0, 0.1, None),
        (161, 2.267, 0.804, False),
    ],
)
def test_rates_agree_within_bounds(records, ratio, correlation, agrees):
    check = RateCheck(records=records, ratio=ratio, correlation=correlation)
    assert check.agrees is agrees
    assert (check.problem is None) == (agrees is not False)


def test_rates_are_compared_above_half_a_millimeter_an_hour(shower):
    quiet = replace(shower, reported_mm_h=np.where(np.arange(60) < 20, shower.reported_mm_h, 0.5))
    check = check_rates([quiet])
    assert check is not None and check.records == 20
    assert check.ratio == pytest.approx(shower.rate_mm_h[:20].sum() / shower.reported_mm_h[:20].sum())
    assert check.correlation == pytest.approx(np.corrcoef(shower.rate_mm_h[:20], shower.reported_mm_h[:20])[0, 1])
    together = check_rates([quiet[:10], quiet[10:]])
    assert together is not None and together.ratio == pytest.approx(check.ratio)
    assert check_rates([quiet[19:]]) is None  # one record alone
    two = check_rates([replace(shower[:2], reported_mm_h=np.array([5.0, 5.0]))])
    assert two is not None and two.records == 2 and two.correlation is None
    same = replace(shower[:2], counts=np.stack([shower.counts[0]] * 2), reported_mm_h=np.array([5.0, 6.0]))
    alike = check_rates([same])
    assert alike is not None and alike.correlation is None


def test_drops_that_do_not_give_the_instruments_rate_are_refused(tmp_path: Path, shower):
    good, bad = written(tmp_path, "good.nc", shower), written(tmp_path, "bad.nc", shower, factor=1 / 2.27)
    options = {"name": "test", "options": OPTIONS}
    assert len(calibrate([good], **options).rows) == 2
    with pytest.raises(RatesDisagreeError, match=r"^bad.nc: .* 2.3 times .*, in 4\d records"):
        calibrate([good, bad], **options)
    fitted = calibrate([bad], force=True, **options)
    assert "its drops give 2.3" in fitted.calibration.source
    assert "its drops" not in calibrate([good], force=True, **options).calibration.source


def test_a_phantom_drop_spoils_r_and_the_drops_that_are_used_show_it(tmp_path: Path, shower):
    counts = shower.counts.copy()
    counts[5, 29, 5] += 1  # 19 mm at 0.55 m/s
    path = written(tmp_path, "phantom.nc", replace(shower, counts=counts))
    measured = open_disdrometer_file(path).measured()
    assert measured.rate_check.correlation < 0.5 and measured.rate_check.agrees is False
    assert measured.used_rate_check.correlation > 0.97 and measured.used_rate_check.ratio == pytest.approx(1, abs=0.05)
    assert measured.numbers()["rate_ratio_used"] == measured.used_rate_check.ratio
    with pytest.raises(RatesDisagreeError, match=r"phantom.nc: .*r = (0\.9|1\.0)"):
        calibrate([path], name="test", options=OPTIONS)


def test_files_that_only_together_have_enough_records_are_judged_together(tmp_path: Path, shower):
    halves = [written(tmp_path, f"{i}.nc", part, factor=0.5) for i, part in enumerate((shower[:20], shower[20:]))]
    with pytest.raises(RatesDisagreeError, match="2 files together"):
        calibrate_files([open_disdrometer_file(path) for path in halves], name="test", options=OPTIONS)


def test_without_a_rate_of_its_own_nothing_is_judged(tmp_path: Path, shower):
    silent = open_disdrometer_file(written(tmp_path, "silent.nc", shower, factor=np.nan))
    measured = silent.measured()
    assert measured.reported_rain_mm is None and measured.rate_check is None
    assert "not checked" in measured.lines[-1] and measured.numbers()["rates_agree"] is None
    assert len(calibrate_files([silent], name="test", options=OPTIONS).rows) == 2
    low = open_disdrometer_file(written(tmp_path, "low.nc", shower, factor=1e-3)).measured()
    assert low.rate_check is None and low.reported_rain_mm > 0
