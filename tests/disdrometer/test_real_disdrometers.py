"""Real files of many stations, where the test data are, against numbers worked out independently of this program."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
from gsrain_engine.disdrometer.fit import calibrate_files
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from gsrain_engine.rain.calibration import load_calibration

LOCARNO, CORV = "locarno_parsivel_20181029.dat.gz", "corvdisdropsM1.b1.20181214.020816.cdf"


@pytest.fixture(scope="module")
def folder(test_data: Path) -> Path:
    return test_data / "disdrometer"


@pytest.fixture(scope="module")
def locarno(folder: Path):
    return open_disdrometer_file(folder / LOCARNO)


@pytest.fixture(scope="module")
def fitted(locarno):
    return calibrate_files([locarno], name="locarno_2018")


def test_three_days_of_locarno_and_their_quality(locarno):
    spectra, report = locarno.reading.spectra, locarno.quality
    assert len(spectra) == 6526 and locarno.reading.skipped == ()
    assert (spectra.reported_mm_h > 0).sum() == 4114
    assert spectra.reported_mm_h.max() == pytest.approx(38.5, abs=0.05)
    assert set(spectra.seconds) == {30.0}
    assert report.drops == spectra.counts.sum() == 1_013_869
    assert report.masks[0].drops == 0  # the first two diameter classes of a Parsivel are always empty
    assert 0.75 < report.drops_kept / report.drops < 0.95


def test_the_fit_to_locarno_agrees_with_an_independent_one(fitted):
    assert fitted.records == 6526 and fitted.rate_check.correlation > 0.99
    assert fitted.rate_check.ratio == pytest.approx(0.981, abs=0.002)
    rows, velocity = fitted.calibration.rows, fitted.calibration.velocity
    for intensity, expected in {1.21: (210, 8.9, 0.088), 8.43: (464, 6.65, 0.154), 12.0: (530, 6.26, 0.172)}.items():
        row = min(rows, key=lambda row: abs(np.log(row.intensity_mm_h / intensity)))
        assert row.intensity_mm_h == pytest.approx(intensity, rel=0.05)
        assert (row.density_m3, row.shape, row.scale_mm) == pytest.approx(expected, rel=0.12)
    d = np.array([0.5, 1, 2, 3, 4])
    assert velocity(d) == pytest.approx(-0.404 * d**2 + 3.63 * d + 0.908, abs=0.1) and velocity.r2 > 0.99


def test_the_shipped_calibration_is_this_fit(fitted):
    shipped = load_calibration("locarno_2018")
    for ours, theirs in zip(shipped.rows, fitted.calibration.rows, strict=True):
        for limits, expected in zip(*map(msgspec.structs.astuple, (ours.confidence, theirs.confidence)), strict=True):
            assert limits == pytest.approx(expected, rel=1e-3)
        for name in ("intensity_mm_h", "density_m3", "shape", "scale_mm"):
            assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-3)
    assert shipped.velocity.coefficients == pytest.approx(fitted.calibration.velocity.coefficients, rel=1e-3)
    assert shipped.provenance == fitted.calibration.provenance
    assert Path(shipped.provenance.files[0].name).name == shipped.provenance.files[0].name


def test_single_drops_of_a_2dvd_and_their_axis_ratios(folder):
    file = open_disdrometer_file(folder / CORV)
    drops, spectra = file.reading.drops, file.reading.spectra
    assert len(drops) == 37_303 == spectra.counts.sum() and np.isfinite(drops.axis_ratios).all()
    # A file that gives heights and widths too: the ratio is the one over the other.
    assert np.median(drops.axis_ratios[np.abs(drops.diameters_mm - 4.5) < 0.25]) == pytest.approx(0.773, abs=0.001)
    np.testing.assert_allclose((spectra.rate_mm_h * spectra.seconds).sum() / 3600, 2.457, rtol=0.02)
    found = calibrate_files([file], name="corv")
    ratios, d = found.axis_ratios, np.array([0.8, 1.5, 2.5, 3.5])
    near_round = ratios.medians[(ratios.diameters_mm > 1) & (ratios.diameters_mm < 2)]
    assert ratios.drops > 20_000 and np.all((near_round > 0.9) & (near_round < 1.0))
    assert found.calibration.velocity(d) == pytest.approx(-0.473 * d**2 + 3.96 * d + 0.138, rel=0.05)


@pytest.mark.parametrize(
    ("name", "shape", "drops", "skipped"),
    [
        ("parsivel/Lindenberg_Parsivel_20231204.log", (3, 32, 32), 0, 0),
        ("parsivel/granada.dat", (3, 32, 32), 1100, 0),
        ("parsivel/palaiseau.txt", (3, 32, 32), 66, 0),
        ("parsivel/parsivel_bad.log", (4, 32, 32), 0, 2),
        ("parsivel_telegraph_testfile.mis", (6, 32, 32), 0, 0),
        ("thies_lnm/2021091507.txt", (60, 22, 20), 79, 0),
        ("thies_lnm/2024041723-leipzig-lim.txt", (3, 0, 1), 0, 0),
        ("thies_lnm/20241003_lnm_lindenberg.csv", (3, 22, 20), 0, 0),
        ("thies_lnm/2025060200.txt", (3, 22, 20), 0, 0),
        ("thies_lnm/PAY_DDTH01_20240702_actris.csv", (3, 22, 20), 3, 0),
        ("thies_lnm/THIES_LMP_2024_04_14_00_00.dat", (3, 22, 20), 1, 0),
        ("nasa_gv_iphex_2dvd_test.txt", (10, 50, 1), 7366, 0),
        ("sgpdisdrometerC1.b1.20110427.000000_test_jwd_b1.cdf", (2, 20, 1), 11, 0),
    ],
)
def test_every_file_loads(folder: Path, name: str, shape: tuple[int, int, int], drops: int, skipped: int):
    reading = read_disdrometer(folder / name)
    spectra = reading.spectra
    assert spectra.counts.shape == shape and spectra.counts.sum() == drops and len(reading.skipped) == skipped
    assert (np.diff(spectra.times) > np.timedelta64(0)).all()
    if "granada" in name or "palaiseau" in name or "jwd" in name:  # these report a rate
        np.testing.assert_allclose(spectra.rate_mm_h, spectra.reported_mm_h, rtol=0.03)
        assert spectra.reported_mm_h.max() > 0


def test_densities_rates_and_what_is_no_measurement(folder, test_data):
    spectra = read_disdrometer(folder / "apu_nasa_mc3e_dsd.txt").spectra
    np.testing.assert_allclose(spectra.rate_mm_h, [0.0145, 0.0131, 0.106], rtol=0.01)
    files = sorted((test_data / "weather" / "rainsense").glob("*/*/*/context/rainfall_intensity.txt"))
    rates = sorted(float(read_disdrometer(file).spectra.reported_mm_h[0]) for file in files)
    assert rates == [0, 1.376, 2.654, 4.75, 9.245]
    with pytest.raises(DisdrometerFileError, match="mask"):
        read_disdrometer(folder / "parsivel_conditional_matrix.txt")
    names = ("nasa_gv_iphex_2dvd_test.txt", "parsivel_telegraph_testfile.mis")
    with pytest.raises(ValueError, match="2DVD and OTT Parsivel"):
        calibrate_files([open_disdrometer_file(folder / name) for name in names], name="both")
