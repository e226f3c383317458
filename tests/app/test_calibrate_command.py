"""`gsrain calibrate` as a person runs it."""

import json

import pytest
from PIL import Image

from app.command_line import BAD_INPUT, run
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.disdrometer.netcdf_spectra import write_spectra
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rain_state import rain_state
from measured_rain import measured_rain

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


def test_the_calibration_can_rain(files, tmp_path):
    out = tmp_path / "cal.yaml"
    assert calibrate(files, out, "--resamples", "0", "--name", "mine") == 0
    assert load_calibration(str(out)).name == "mine"
    assert rain_state(Rain(intensity_mm_h=3.0), load_calibration(str(out))).implied_mm_h == pytest.approx(3)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--intensities", "1,x"], "--intensities 1,x: expected numbers in mm/h"),
        (["--intensities", "1,-2"], "--intensities: Expected `float` > 0.0"),
        (["--half-width", "1.5"], "--half-width: Expected `float` < 1.0"),
        (["--smallest-mm", "9"], "--smallest-mm: Expected `float` < 8.0"),
        (["--resamples", "-1"], "--resamples: Expected `int` >= 0"),
        (["--plot", "plot.txt"], "plot.txt: expected a name that ends with .png"),
        (["--intensities", "30,40"], "of 2 bins 0 have them"),
    ],
)
def test_bad_options_end_with_one_line(files, tmp_path, capsys, options, says):
    out = tmp_path / "cal.yaml"
    assert run(["calibrate", *files, "-o", str(out), *options]) == BAD_INPUT
    error = capsys.readouterr().err
    assert says in error
    assert error.count("gsrain:") == 1
    assert not out.exists()


def test_bad_files_end_with_one_line(tmp_path, capsys):
    out = tmp_path / "cal.yaml"
    for name, content in (("missing.dat", None), ("notes.txt", "not rain at all\n")):
        file = tmp_path / name
        if content is not None:
            file.write_text(content)
        assert run(["calibrate", str(file), "-o", str(out)]) == BAD_INPUT
        assert name in capsys.readouterr().err
    assert run(["calibrate", str(tmp_path / "x.dat"), "-o", str(tmp_path / "cal.json")]) == BAD_INPUT
    assert "ends with .yaml" in capsys.readouterr().err
    assert not out.exists()
