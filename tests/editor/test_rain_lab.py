"""Measurements of the rain panels, without a window."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.rain import CalibrationTools
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from measured_rain import measured_rain
from parsivel_text import rain, velocity_major


@pytest.fixture
def lab():
    lab = CalibrationTools()
    yield lab
    lab.close()


def wait(lab: CalibrationTools) -> None:
    while lab.busy is not None:
        for each in lab.pending:
            each.exception(timeout=120)
        lab.poll()


def test_the_rain_carries_what_was_asked_for(lab):
    lab.area_m2, lab.seconds = 0.2, 90.0
    lab.measure(RainSettings(intensity_mm_h=8.5))
    assert "90 s" in lab.busy
    lab.measure(RainSettings(intensity_mm_h=1.0))  # one at a time: this one is not begun
    wait(lab)
    assert lab.problem is None
    assert len(lab.counted.counts) == 2
    assert lab.counted.seconds.sum() == 90
    assert abs(lab.counted.rate_mm_h - 8.5) < 3 * lab.counted.standard_error_mm_h < 0.5


def test_what_goes_wrong_is_one_sentence_and_the_last_result_stays(lab, tmp_path):
    lab.area_m2 = 1e6
    lab.measure(RainSettings(intensity_mm_h=8.5))
    wait(lab)
    assert "area" in lab.problem
    bad = tmp_path / "bad.txt"
    bad.write_bytes(b"\x00\x01 no disdrometer")
    lab.fit([bad])
    wait(lab)
    assert "bad.txt" in lab.problem
    assert (lab.counted, lab.fitted) == (None, None)


def test_files_whose_rates_disagree_are_summed_up_and_fitted_only_by_force(lab, tmp_path):
    heavy = measured_rain(1190.0, 7.132, 0.114, minutes=20, seed=3)
    light = measured_rain(271.0, 9.705, 0.074, minutes=20, seed=4, start="2024-05-01T10:20")
    both = heavy.concatenate([heavy, light])
    snow = tmp_path / "snow.nc"
    write_spectra(snow, replace(both, reported_mm_h=both.reported_mm_h / 2.27))
    lab.fit([snow])
    wait(lab)
    assert lab.problem.startswith("snow.nc: its drops give 2.3") and lab.fitted is None
    assert lab.disagreeing == (snow,)
    assert [each.file for each in lab.measured] == ["snow.nc"]
    lab.fit(lab.disagreeing, force=True)
    wait(lab)
    assert (lab.problem, lab.disagreeing) == (None, ())
    assert "its drops give 2.3" in lab.fitted.calibration.source
    assert lab.measured[0].rate_check.agrees is False


def test_a_table_is_fitted_with_the_yaml_file_chosen_with_it(lab, tmp_path):
    table, columns = tmp_path / "table.csv", tmp_path / "columns.yaml"
    table.write_text("\n".join(["when|which", f"2024-02-19 00:01:00|{','.join(velocity_major(rain()))}"]))
    columns.write_text("{instrument: OTT Parsivel, separator: '|', time: when, drops: which}")
    lab.fit([columns, table])
    wait(lab)
    assert "too few drops to fit" in lab.problem and lab.disagreeing == ()
    assert lab.measured[0].records == 1
    lab.fit([columns])
    wait(lab)
    assert "choose disdrometer files, and at most one YAML file" in lab.problem and lab.measured == ()


def test_a_fit_is_kept_and_used(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    times = 60.0 * np.arange(9)
    for number, intensity in enumerate((2.0, 8.5)):
        instrument = VirtualDisdrometer(RainSimulation.start(RainSettings(intensity_mm_h=intensity)), 1.0)
        write_spectra(tmp_path / f"rain{number}.nc", instrument.measure(times).spectra)
    editor = Editor(rain=RainSettings(intensity_mm_h=8.5))
    editor.calibration.fit([tmp_path / "rain0.nc", tmp_path / "rain1.nc"])
    wait(editor.calibration)
    assert editor.calibration.error is None
    use_fitted_calibration(editor, editor.calibration)
    assert editor.document.rain.calibration.endswith("rain0.yaml")
    assert editor.document.rain.calibration in editor.calibration.calibrations
    kept = load_calibration(editor.document.rain.calibration)
    # Simulated by the published table with its density closed: the fit finds that table's sizes again.
    assert kept.rows[-1].shape == pytest.approx(editor.calibration.pass_file.rows[1].shape, rel=0.1)
    editor.document.undo()
    assert editor.document.rain.calibration == "published"
    editor.close()


def test_calibrations_that_are_not_there_are_reported(tmp_path):
    editor = Editor()
    use_calibration(editor, editor.calibration, str(tmp_path / "none.yaml"))
    assert "none.yaml" in editor.status.problem
    assert editor.document.rain.calibration == "published"
    editor.status.dismiss()
    compare_calibration(editor, editor.calibration, "nothing")
    assert "nothing" in editor.status.problem
    assert editor.calibration.compared == "published"
    editor.close()
