"""`gsrain calibrate` as a person runs it."""

import json
from dataclasses import replace

import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.rain.calibration import load_calibration
from measured_rain import measured_rain
from parsivel_text import rain, velocity_major

KEYS = {"records", "records_used", "rate_ratio", "rate_correlation", "velocity", "rows", "quality", "records_skipped"}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    for name, law, minutes in (("light", (271.0, 9.705, 0.074), 20), ("heavy", (1190.0, 7.132, 0.114), 6)):
        write_spectra(folder / f"{name}.nc", measured_rain(*law, minutes=minutes, seed=3))
    return [str(folder / "light.nc"), str(folder / "heavy.nc")]


def calibrate(files, out, *options):
    return run(["calibrate", *files, "-o", str(out), "--intensities", "0.8,6.6", "--half-width", "0.5", *options])


def test_calibrate_writes_what_the_program_can_load(files, tmp_path, capsys):
    out, plot, numbers = tmp_path / "new" / "street.yaml", tmp_path / "plot.png", tmp_path / "numbers.json"
    assert calibrate(files, out, "--plot", str(plot), "--json", str(numbers), "--resamples", "50") == 0
    calibration = load_calibration(str(out))
    assert calibration.name == "street"
    assert calibration.rows[0].density_m3 == pytest.approx(271, rel=0.1)
    assert [file.name for file in calibration.provenance.files] == ["light.nc", "heavy.nc"]
    with Image.open(plot) as picture:
        assert picture.width > 1500
    report = json.loads(numbers.read_text())
    assert set(report) >= KEYS
    assert (report["records"], report["records_used"]) == (52, 52)
    assert report["rate_ratio"] == pytest.approx(1, abs=0.05)
    assert report["velocity"]["coefficients"] == list(calibration.velocity.coefficients)
    assert report["velocity"]["r2"] > 0.99
    assert [row["density_m3"] for row in report["rows"]] == [row.density_m3 for row in calibration.rows]
    assert set(report["rows"][0]) >= {"intensity_mm_h", "shape", "scale_mm", "confidence", "moments", "implied_mm_h"}
    assert [each["file"] for each in report["quality"]] == ["light.nc", "heavy.nc"]
    printed = capsys.readouterr().out
    assert all(str(path) in printed for path in (out, plot, numbers))
    assert "R² = " in printed


@pytest.fixture(scope="module")
def disagreeing(tmp_path_factory):
    """A day of snow, as a Parsivel counts it: more than twice the rain that it reports."""
    heavy = measured_rain(1190.0, 7.132, 0.114, minutes=20, seed=3)
    light = measured_rain(271.0, 9.705, 0.074, minutes=10, seed=4, start="2024-05-01T10:20")
    both = heavy.concatenate([heavy, light])
    file = tmp_path_factory.mktemp("snow") / "snow.nc"
    write_spectra(file, replace(both, reported_mm_h=both.reported_mm_h / 2.27))
    return str(file)


def test_rates_that_disagree_end_with_one_line_unless_forced(disagreeing, tmp_path, capsys):
    out, numbers = tmp_path / "cal.yaml", tmp_path / "numbers.json"
    assert calibrate([disagreeing], out) == BAD_INPUT
    said = capsys.readouterr()
    assert not out.exists()
    assert "gsrain: snow.nc: its drops give 2.3" in said.err and "--force fits all the same" in said.err
    assert said.err.count("gsrain:") == 1
    assert "snow.nc: OTT Parsivel, 60 records of 30 s" in said.out and "DISAGREES" in said.out
    assert calibrate([disagreeing], out, "--force", "--resamples", "0", "--json", str(numbers)) == 0
    report = json.loads(numbers.read_text())
    assert set(report) >= KEYS
    assert report["instrument"] == "OTT Parsivel"
    assert report["files"][0]["rates_agree"] is False
    assert report["rate_ratio"] == report["files"][0]["rate_ratio"] == pytest.approx(2.27, rel=0.03)
    assert report["rain_mm"] == pytest.approx(2.27 * report["files"][0]["reported_rain_mm"], rel=0.03)
    assert "its drops give 2.3" in load_calibration(str(out)).source


def test_info_prints_what_calibrate_prints(disagreeing, files, tmp_path, capsys):
    numbers = tmp_path / "numbers.json"
    assert run(["info", disagreeing, "--json", str(numbers)]) == 0
    printed = capsys.readouterr().out
    assert calibrate([disagreeing], tmp_path / "cal.yaml") == BAD_INPUT
    assert capsys.readouterr().out == printed
    report = json.loads(numbers.read_text())
    assert report["records"] == 60 and report["rate_records"] >= 40 and report["rates_agree"] is False
    assert set(report) >= {"instrument", "drops", "rain_mm", "rejected", "rate_ratio", "rate_correlation", "quality"}
    assert run(["info", files[0]]) == 0
    assert "agrees)" in capsys.readouterr().out


def test_any_table_by_its_columns(tmp_path, capsys):
    table, columns = tmp_path / "table.csv", tmp_path / "columns.yaml"
    rows = [f"2024-02-19 00:{minute:02d}:00|0.772|{','.join(velocity_major(rain()))}" for minute in range(3)]
    table.write_text("\n".join(["when|how much|which", *rows]))
    columns.write_text("{instrument: OTT Parsivel, separator: '|', time: when, rate: how much, drops: which}")
    assert run(["info", str(table)]) == BAD_INPUT
    assert run(["info", str(table), "--columns", str(columns)]) == 0
    assert "table.csv: OTT Parsivel, 3 records of 60 s" in capsys.readouterr().out
    assert run(["calibrate", str(table), "--columns", str(columns), "-o", str(tmp_path / "cal.yaml")]) == BAD_INPUT
    said = capsys.readouterr()
    assert "table.csv: OTT Parsivel, 3 records" in said.out and "a calibration needs two intensities" in said.err
    columns.write_text("{instrument: OTT Parsivel, tyme: when}")
    assert run(["info", str(table), "--columns", str(columns)]) == BAD_INPUT
    assert f"{columns}: Object contains unknown field `tyme`; did you mean `time`?" in capsys.readouterr().err
