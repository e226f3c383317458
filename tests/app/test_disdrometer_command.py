"""`gsrain disdrometer` as a person runs it."""

import json

import pytest

from app.main import run
from gsrain_engine.disdrometer.open import read_disdrometer


def disdrometer(*options):
    return run(["disdrometer", *options])


def test_reports_what_was_asked_for_and_what_fell(tmp_path, capsys):
    numbers = tmp_path / "numbers.json"
    assert disdrometer("--rain", "8.5", "--area", "0.5", "--seconds", "60", "--json", str(numbers)) == 0
    report = json.loads(numbers.read_text())
    assert {"requested_mm_h", "measured_mm_h", "standard_error_mm_h", "drops_counted", "mean_diameter_mm"} <= set(
        report
    )
    assert report["requested_mm_h"] == report["implied_mm_h"] == 8.5
    assert abs(report["measured_mm_h"] - 8.5) < 3 * report["standard_error_mm_h"]
    assert report["standard_error_mm_h"] == pytest.approx(0.036, abs=0.001)
    assert report["drops_counted"] == sum(report["spectrum"]["drops"]) > 100_000
    assert report["mean_diameter_mm"] == pytest.approx(report["requested_mean_diameter_mm"], rel=0.01)
    widths = 0.1
    assert sum(report["spectrum"]["drops_per_m3_mm"]) * widths == pytest.approx(report["density_m3"])
    said = capsys.readouterr().out
    assert "8.5 mm/h asked; 8.49 ± 0.036 mm/h measured: 130,581 drops on 0.5 m² in 60 s" in said
    assert "beyond calibration" not in said


def test_writes_spectra_that_read_back(tmp_path, capsys):
    file = tmp_path / "new" / "rain.nc"
    assert disdrometer("--rain", "20", "--seconds", "25", "--record", "10", "--seed", "2", "-o", str(file)) == 0
    said = capsys.readouterr().out
    assert f"{file}: 3 spectra" in said
    assert "beyond calibration" in said
    spectra = read_disdrometer(file).spectra
    assert spectra.seconds.tolist() == [10, 10, 5]
    assert spectra.rate_mm_h == pytest.approx([20, 20, 20], rel=0.05)


def test_the_seed_is_another_rain_and_the_same_seed_the_same(tmp_path):
    counts = []
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        assert disdrometer("--rain", "1", "--seed", seed, "--json", str(tmp_path / name)) == 0
        counts.append((tmp_path / name).read_bytes())
    assert counts[0] == counts[1] != counts[2]
