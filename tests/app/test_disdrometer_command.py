"""`gsrain calibrate`, `gsrain info` of measured rain, and `gsrain disdrometer`."""

import json
from dataclasses import replace

import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.rain.calibration import load_calibration
from measured_rain import measured_rain

KEYS = {"records", "records_used", "rate_ratio", "rate_correlation", "velocity", "rows", "quality", "records_skipped"}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Light and heavy rain, and snow as a Parsivel counts it: more than twice the rain that it reports."""
    folder = tmp_path_factory.mktemp("measured")
    for name, law, minutes in (("light", (271.0, 9.705, 0.074), 20), ("heavy", (1190.0, 7.132, 0.114), 6)):
        write_spectra(folder / f"{name}.nc", measured_rain(*law, minutes=minutes, seed=3))
    heavy = measured_rain(1190.0, 7.132, 0.114, minutes=20, seed=3)
    light = measured_rain(271.0, 9.705, 0.074, minutes=10, seed=4, start="2024-05-01T10:20")
    both = heavy.concatenate([heavy, light])
    write_spectra(folder / "snow.nc", replace(both, reported_mm_h=both.reported_mm_h / 2.27))
    return folder


def calibrate(files, out, *options):
    return run([
        "calibrate", *map(str, files), "-o", str(out), "--intensities", "0.8,6.6", "--half-width", "0.5", *options
    ])  # fmt: skip


def test_calibrate_writes_what_the_program_can_load(files, tmp_path, capsys):
    out, plot, numbers = tmp_path / "new" / "street.yaml", tmp_path / "plot.png", tmp_path / "numbers.json"
    options = ("--plot", str(plot), "--json", str(numbers), "--resamples", "50")
    assert calibrate([files / "light.nc", files / "heavy.nc"], out, *options) == 0
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
    assert all(str(path) in printed for path in (out, plot, numbers)) and "R² = " in printed


def test_rates_that_disagree_are_refused_unless_forced(files, tmp_path, capsys):
    out, numbers, snow = tmp_path / "cal.yaml", tmp_path / "numbers.json", files / "snow.nc"
    assert calibrate([snow], out) == BAD_INPUT and not out.exists()
    printed = capsys.readouterr()
    error = printed.err.splitlines()[-1]
    assert "snow.nc" in error and "--force" in error and "DISAGREES" in printed.out
    assert run(["info", str(snow), "--json", str(numbers)]) == 0
    assert capsys.readouterr().out == printed.out
    info = json.loads(numbers.read_text())
    assert info["records"] == 60 and info["rate_records"] >= 40 and info["rates_agree"] is False
    assert calibrate([snow], out, "--force", "--resamples", "0", "--json", str(numbers)) == 0
    report = json.loads(numbers.read_text())
    assert set(report) >= KEYS and report["files"] == [info]
    assert report["rate_ratio"] == info["rate_ratio"] == pytest.approx(2.27, rel=0.03)
    assert report["rain_mm"] == pytest.approx(2.27 * info["reported_rain_mm"], rel=0.03)
    assert "its drops give 2.3" in load_calibration(str(out)).source


REPORTED = {"requested_mm_h", "measured_mm_h", "standard_error_mm_h", "drops_counted", "mean_diameter_mm"}


def test_reports_what_was_asked_for_and_what_fell(reported, capsys):
    command = ("disdrometer", "--rain", "8.5", "--area", "0.5", "--seconds", "60")
    report = reported(*command)
    assert set(report) >= REPORTED
    assert report["requested_mm_h"] == report["implied_mm_h"] == 8.5
    assert abs(report["measured_mm_h"] - 8.5) < 3 * report["standard_error_mm_h"]
    assert report["standard_error_mm_h"] == pytest.approx(0.036, abs=0.001)
    assert report["drops_counted"] == sum(report["spectrum"]["drops"]) == 130_769
    assert report["mean_diameter_mm"] == pytest.approx(report["requested_mean_diameter_mm"], rel=0.01)
    assert 0.1 * sum(report["spectrum"]["drops_per_m3_mm"]) == pytest.approx(report["density_m3"])  # 0.1 mm wide
    printed = capsys.readouterr().out
    assert "8.5 mm/h asked (heavy); 8.533 ± 0.036 mm/h measured: 130,769 drops on 0.5 m² in 60 s" in printed
    assert "beyond calibration" not in printed
    assert reported(*command) == report != reported(*command, "--seed", "1")


@pytest.mark.parametrize(
    ("rate", "shape", "scale_mm"), [("1.2", 9.705, 0.074), ("8.5", 7.132, 0.114), ("12.0", 10.466, 0.085)]
)
def test_the_gamma_law_of_the_counted_drops_is_the_one_that_is_set(reported, capsys, rate, shape, scale_mm):
    """Table III of the paper. With some 30,000 drops or more, shape and scale have standard errors of about 1 %."""
    report = reported("disdrometer", "--preset", rate, "--drop-density", "table", "--seconds", "60", "--area", "1")
    assert (report["requested_shape"], report["requested_scale_mm"]) == (shape, scale_mm)
    assert (report["shape"], report["scale_mm"]) == (pytest.approx(shape, rel=0.05), pytest.approx(scale_mm, rel=0.05))
    printed = capsys.readouterr().out
    assert (
        f"gamma law of diameters: shape {shape:.4g}, scale {scale_mm:.3g} mm asked; {report['shape']:.4g}, " in printed
    )


def test_too_few_drops_have_no_fitted_law(reported, capsys):
    report = reported("disdrometer", "--rain", "0.1", "--area", "0.0001", "--seconds", "1")
    assert report["shape"] is report["scale_mm"] is None and "fitted" not in capsys.readouterr().out


def test_writes_spectra_that_read_back(reported, tmp_path, capsys):
    file = tmp_path / "new" / "rain.nc"
    reported("disdrometer", "--rain", "20", "--seconds", "25", "--record", "10", "--seed", "2", "-o", file)
    printed = capsys.readouterr().out
    assert f"{file}: 3 spectra" in printed and "beyond calibration" in printed
    spectra = read_disdrometer(file).spectra
    assert spectra.seconds.tolist() == [10, 10, 5]
    assert spectra.rate_mm_h == pytest.approx([20, 20, 20], rel=0.05)
