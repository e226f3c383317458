"""What the rain panels measure, without a window."""

import numpy as np
import pytest

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.disdrometer.netcdf_spectra import write_spectra
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.rain.virtual_disdrometer import VirtualDisdrometer
from gsrain_engine.session.rain.calibrations import compare_calibration, use_calibration, use_fitted_calibration
from gsrain_engine.session.rain.rain_lab import RainLab
from gsrain_engine.session.session import Session


@pytest.fixture
def lab():
    lab = RainLab()
    yield lab
    lab.close()


def wait(lab: RainLab) -> None:
    while lab._task is not None:
        lab._task.result.exception(timeout=120)
        lab.poll()


def test_the_rain_carries_what_was_asked_for(lab):
    lab.area_m2, lab.seconds = 0.2, 90.0
    lab.measure(Rain(intensity_mm_h=8.5))
    assert "90 s" in lab.busy
    lab.measure(Rain(intensity_mm_h=1.0))  # one at a time: this one is not begun
    wait(lab)
    assert lab.problem is None
    assert len(lab.counted.counts) == 2
    assert lab.counted.seconds.sum() == 90
    assert abs(lab.counted.rate_mm_h - 8.5) < 3 * lab.counted.standard_error_mm_h < 0.5


def test_what_goes_wrong_is_one_sentence_and_the_last_result_stays(lab, tmp_path):
    lab.area_m2 = 1e6
    lab.measure(Rain(intensity_mm_h=8.5))
    wait(lab)
    assert "area" in lab.problem
    bad = tmp_path / "bad.txt"
    bad.write_bytes(b"\x00\x01 no disdrometer")
    lab.fit([bad])
    wait(lab)
    assert "bad.txt" in lab.problem
    assert (lab.counted, lab.fitted) == (None, None)


def test_a_fit_is_kept_and_used(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    times = 60.0 * np.arange(9)
    for number, intensity in enumerate((2.0, 8.5)):
        instrument = VirtualDisdrometer(Rainfall.start(Rain(intensity_mm_h=intensity)), 1.0)
        write_spectra(tmp_path / f"rain{number}.nc", instrument.measure(times).spectra)
    session = Session(rain=Rain(intensity_mm_h=8.5))
    session.lab.fit([tmp_path / "rain0.nc", tmp_path / "rain1.nc"])
    wait(session.lab)
    assert session.lab.problem is None
    use_fitted_calibration(session, session.lab)
    assert session.rain.calibration.endswith("rain0.yaml")
    assert session.rain.calibration in session.lab.calibrations
    kept = load_calibration(session.rain.calibration)
    # Simulated by the published table with its density closed: the fit finds that table's sizes again.
    assert kept.rows[-1].shape == pytest.approx(session.lab.beside.rows[1].shape, rel=0.1)
    session.undo()
    assert session.rain.calibration == "published"
    session.close()


def test_calibrations_that_are_not_there_are_told(tmp_path):
    session = Session()
    use_calibration(session, session.lab, str(tmp_path / "none.yaml"))
    assert "none.yaml" in session.problem
    assert session.rain.calibration == "published"
    session.problem = None
    compare_calibration(session, session.lab, "nothing")
    assert "nothing" in session.problem
    assert session.lab.compared == "published"
    session.close()
