"""`gsrain disdrometer`: what was asked for, what fell, and the file of spectra."""

import pytest

from gsrain_engine.disdrometer.open import read_disdrometer

KEYS = {"requested_mm_h", "measured_mm_h", "standard_error_mm_h", "drops_counted", "mean_diameter_mm"}


def test_reports_what_was_asked_for_and_what_fell(reported, capsys):
    command = ("disdrometer", "--rain", "8.5", "--area", "0.5", "--seconds", "60")
    report = reported(*command)
    assert set(report) >= KEYS
    assert report["requested_mm_h"] == report["implied_mm_h"] == 8.5
    assert abs(report["measured_mm_h"] - 8.5) < 3 * report["standard_error_mm_h"]
    assert report["standard_error_mm_h"] == pytest.approx(0.036, abs=0.001)
    assert report["drops_counted"] == sum(report["spectrum"]["drops"]) == 130_581
    assert report["mean_diameter_mm"] == pytest.approx(report["requested_mean_diameter_mm"], rel=0.01)
    assert 0.1 * sum(report["spectrum"]["drops_per_m3_mm"]) == pytest.approx(report["density_m3"])  # 0.1 mm wide
    printed = capsys.readouterr().out
    assert "8.5 mm/h asked; 8.49 ± 0.036 mm/h measured: 130,581 drops on 0.5 m² in 60 s" in printed
    assert "beyond calibration" not in printed
    assert reported(*command) == report != reported(*command, "--seed", "1")


def test_writes_spectra_that_read_back(reported, tmp_path, capsys):
    file = tmp_path / "new" / "rain.nc"
    reported("disdrometer", "--rain", "20", "--seconds", "25", "--record", "10", "--seed", "2", "-o", file)
    printed = capsys.readouterr().out
    assert f"{file}: 3 spectra" in printed and "beyond calibration" in printed
    spectra = read_disdrometer(file).spectra
    assert spectra.seconds.tolist() == [10, 10, 5]
    assert spectra.rate_mm_h == pytest.approx([20, 20, 20], rel=0.05)
