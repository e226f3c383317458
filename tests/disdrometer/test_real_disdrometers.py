"""Real files of many stations, where the test data are."""

from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.disdrometer.filter import apply_quality_control
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError, DisdrometerReading


@pytest.fixture(scope="module")
def folder(test_data: Path) -> Path:
    return test_data / "disdrometer"


@pytest.fixture(scope="module")
def locarno(folder: Path) -> DisdrometerReading:
    return read_disdrometer(folder / "locarno_parsivel_20181029.dat.gz")


def test_locarno_agrees_with_its_own_rate(locarno: DisdrometerReading):
    spectra = locarno.spectra
    assert len(spectra) == 6526 and locarno.skipped == ()
    assert (spectra.reported_mm_h > 0).sum() == 4114
    assert spectra.reported_mm_h.max() == pytest.approx(38.5, abs=0.05)
    np.testing.assert_array_equal(spectra.seconds, np.full(6526, 30.0))
    rainy = spectra.reported_mm_h > 0.5
    measured, reported = spectra.rate_mm_h[rainy], spectra.reported_mm_h[rainy]
    assert measured.sum() / reported.sum() == pytest.approx(0.981, abs=0.002)
    assert np.corrcoef(measured, reported)[0, 1] > 0.99


def test_locarno_under_quality_control(locarno: DisdrometerReading, folder: Path):
    trusted, report = apply_quality_control(locarno.spectra)
    assert report.drops == locarno.spectra.counts.sum() == 1_013_869
    # The first two diameter classes of a Parsivel are always empty.
    assert report.masks[0].drops == 0
    assert 0.75 < report.drops_kept / report.drops < 0.95
    mask = np.loadtxt(folder / "parsivel_conditional_matrix.txt", delimiter=",", usecols=range(32)).T == 1
    stricter, _ = apply_quality_control(locarno.spectra, classes=mask)
    assert 0.9 < stricter.counts.sum() / trusted.counts.sum() < 1


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
    assert reading.spectra.counts.shape == shape
    assert reading.spectra.counts.sum() == drops
    assert len(reading.skipped) == skipped
    assert (np.diff(reading.spectra.times) > np.timedelta64(0)).all()


def test_reported_rates_of_other_instruments(folder: Path):
    for name in (
        "parsivel/granada.dat",
        "parsivel/palaiseau.txt",
        "sgpdisdrometerC1.b1.20110427.000000_test_jwd_b1.cdf",
    ):
        spectra = read_disdrometer(folder / name).spectra
        np.testing.assert_allclose(spectra.rate_mm_h, spectra.reported_mm_h, rtol=0.03)
        assert spectra.reported_mm_h.max() > 0


def test_the_bad_log_says_what_is_wrong_with_it(folder: Path):
    assert read_disdrometer(folder / "parsivel/parsivel_bad.log").skipped == (
        "line 1: the line doesn't begin with a time: the record is cut off",
        "line 3: rain rate 'U0000.000' is not a number",
    )


def test_apu_densities(folder: Path):
    spectra = read_disdrometer(folder / "apu_nasa_mc3e_dsd.txt").spectra
    assert spectra.counts.shape == (3, 32, 1)
    np.testing.assert_allclose(spectra.rate_mm_h, [0.0145, 0.0131, 0.106], rtol=0.01)


def test_single_drops_of_a_2dvd(folder: Path):
    reading = read_disdrometer(folder / "corvdisdropsM1.b1.20181214.020816.cdf")
    drops, spectra = reading.drops, reading.spectra
    assert drops is not None and len(drops) == 37_303 == spectra.counts.sum()
    assert np.isfinite(drops.axis_ratios).all()
    # A file that gives heights and widths too: the ratio is the one over the other.
    assert np.median(drops.axis_ratios[np.abs(drops.diameters_mm - 4.5) < 0.25]) == pytest.approx(0.773, abs=0.001)
    np.testing.assert_allclose((spectra.rate_mm_h * spectra.seconds).sum() / 3600, 2.457, rtol=0.02)


def test_class_mask_is_refused_as_a_measurement(folder: Path):
    with pytest.raises(DisdrometerFileError, match="a mask of diameters and speeds"):
        read_disdrometer(folder / "parsivel_conditional_matrix.txt")


def test_rainsense_intensities(test_data: Path):
    files = sorted((test_data / "weather" / "rainsense").glob("*/*/*/context/rainfall_intensity.txt"))
    rates = sorted(float(read_disdrometer(file).spectra.reported_mm_h[0]) for file in files)
    assert rates == [0, 1.376, 2.654, 4.75, 9.245]
