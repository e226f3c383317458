"""A real Parsivel in three days of rain, against numbers worked out independently of this program."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
from gsrain_engine.disdrometer.fit import calibrate_files
from gsrain_engine.rain.calibration import load_calibration

EXPECTED = {1.21: (210, 8.9, 0.088), 8.43: (464, 6.65, 0.154), 12.0: (530, 6.26, 0.172)}


@pytest.fixture(scope="module")
def fitted(test_data):
    return calibrate_files(
        [open_disdrometer_file(test_data / "disdrometer" / "locarno_parsivel_20181029.dat.gz")], name="locarno_2018"
    )


def test_rates_agree_with_the_instruments(fitted):
    assert fitted.records == 6526
    assert 0.95 < fitted.rate_check.ratio < 1.0
    assert fitted.rate_check.ratio == pytest.approx(0.981, abs=0.002)
    assert fitted.rate_check.correlation > 0.99


def test_rows_agree_with_the_independent_ones(fitted):
    rows = fitted.calibration.rows
    for intensity, expected in EXPECTED.items():
        row = min(rows, key=lambda row: abs(np.log(row.intensity_mm_h / intensity)))
        assert row.intensity_mm_h == pytest.approx(intensity, rel=0.05)
        assert (row.density_m3, row.shape, row.scale_mm) == pytest.approx(expected, rel=0.12)


def test_fall_speed_is_a_quadratic(fitted):
    velocity = fitted.calibration.velocity
    assert velocity.r2 > 0.99
    d = np.array([0.5, 1, 2, 3, 4])
    assert velocity(d) == pytest.approx(-0.404 * d**2 + 3.63 * d + 0.908, abs=0.1)


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


def test_a_2dvd_shows_axis_ratios(test_data):
    file = test_data / "disdrometer" / "corvdisdropsM1.b1.20181214.020816.cdf"
    fitted = calibrate_files([open_disdrometer_file(file)], name="corv")
    assert fitted.axis_ratios is not None
    assert fitted.axis_ratios.drops > 20_000
    near_round = fitted.axis_ratios.medians[
        (fitted.axis_ratios.diameters_mm > 1) & (fitted.axis_ratios.diameters_mm < 2)
    ]
    assert np.all((near_round > 0.9) & (near_round < 1.0))
    d = np.array([0.8, 1.5, 2.5, 3.5])
    assert fitted.calibration.velocity(d) == pytest.approx(-0.473 * d**2 + 3.96 * d + 0.138, rel=0.05)


def test_files_of_two_instruments_do_not_mix(test_data):
    files = [
        open_disdrometer_file(test_data / "disdrometer" / name)
        for name in ("nasa_gv_iphex_2dvd_test.txt", "parsivel_telegraph_testfile.mis")
    ]
    with pytest.raises(ValueError, match="calibrate each instrument by itself"):
        calibrate_files(files, name="both")
