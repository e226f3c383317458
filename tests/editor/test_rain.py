"""Rain of the document: keyframes, measurements and calibrations."""

import numpy as np
import pytest

from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.editor.rain import CalibrationTools
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from oracles.drop_phases import displacement
from small_scene import small_scene


@pytest.fixture
def editor():
    editor = Editor(small_scene())
    editor.playback.clock.playing = False
    yield editor
    editor.close()


def keys(*pairs):
    return RainKeyframes(keys=tuple(RainKeyframe(time_s=time, intensity_mm_h=rate) for time, rate in pairs))


def test_a_change_of_a_keyed_field_is_a_key_at_the_present_time(editor):
    editor.document.edit_keyframes("Shower", replace_keyframes, keys((0.0, 0.0), (10.0, 10.0)))
    editor.playback.clock.time_s = 4.0
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=7.0)
    editor.playback.clock.time_s = 4.5  # time goes on while the mouse is held
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=8.0, haze=False)
    editor.document.end_gesture()
    assert editor.document.keyframes.key_times["intensity_mm_h"].tolist() == [0.0, 4.0, 10.0]
    assert editor.document.keyframes.key_at(4.0).intensity_mm_h == 8.0
    assert not editor.document.rain.haze
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=1.0)
    assert editor.document.keyframes.key_times["intensity_mm_h"].tolist() == [0.0, 4.0, 4.5, 10.0]
    editor.document.undo()
    editor.document.undo()
    assert editor.document.keyframes.key_times["intensity_mm_h"].tolist() == [0.0, 10.0]


def test_drops_go_on_from_where_they_are_when_keys_change(editor):
    editor.document.change_rain("Intensity", intensity_mm_h=3.0)
    editor.playback.clock.time_s = 6.0

    def moved():
        return displacement(editor.live_rain.simulation.frozen_at(6.0).motion, 6.0)

    before = moved()
    editor.document.edit_keyframes("Shower", replace_keyframes, keys((0.0, 0.0), (10.0, 10.0)))
    assert np.allclose(moved(), before, atol=1e-9)
    editor.document.edit_keyframes(
        "Wind", replace_keyframes, editor.document.keyframes.with_key(2.0, wind_m_s=(5.0, 1.0))
    )
    assert np.allclose(moved(), before, atol=1e-9)
    editor.document.undo()
    editor.document.undo()
    assert np.allclose(moved(), before, atol=1e-9)


def test_before_and_after_each_have_their_weather(editor):
    editor.document.edit_keyframes("Shower", replace_keyframes, keys((0.0, 6.0), (10.0, 10.0)))
    editor.viewport.options.split = "before | after"
    before, after = editor.split_panes
    assert before.rainfall.state_at(5.0).intensity_mm_h == 0.0
    assert after.rainfall.state_at(5.0).intensity_mm_h == 8.0
    editor.viewport.options.split = "clear | rainy"
    clear, rainy = editor.split_panes
    assert clear.rainfall.state_at(5.0).intensity_mm_h == 0.0
    assert rainy.rainfall.state_at(5.0).intensity_mm_h == 8.0


@pytest.fixture
def lab():
    editor = Editor(rain=RainSettings(intensity_mm_h=8.5))
    yield editor.calibration
    editor.close()


def wait(lab: CalibrationTools) -> None:
    while lab.busy is not None:
        for each in lab.pending:
            each.exception(timeout=120)
        lab.poll()


def test_the_rain_carries_what_was_asked_for(lab):
    lab.area_m2, lab.seconds = 0.2, 90.0
    lab.measure()
    assert "90 s" in lab.busy
    lab.measure()  # one at a time: this one is not begun
    wait(lab)
    assert lab.error is None
    assert len(lab.counted.counts) == 2
    assert lab.counted.seconds.sum() == 90
    assert abs(lab.counted.rate_mm_h - 8.5) < 3 * lab.counted.standard_error_mm_h < 0.5


def test_what_goes_wrong_is_one_sentence_and_the_last_result_stays(lab, tmp_path):
    lab.area_m2 = 1e6
    lab.measure()
    wait(lab)
    assert "area" in lab.error
    bad = tmp_path / "bad.txt"
    bad.write_bytes(b"\x00\x01 no disdrometer")
    lab.fit([bad])
    wait(lab)
    assert "bad.txt" in lab.error
    assert (lab.counted, lab.fitted) == (None, None)


def test_a_fit_is_saved_and_used(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    times = 60.0 * np.arange(9)
    for number, intensity in enumerate((2.0, 8.5)):
        instrument = VirtualDisdrometer(RainSimulation.start(RainSettings(intensity_mm_h=intensity)), 1.0)
        write_spectra(tmp_path / f"rain{number}.nc", instrument.measure(times).spectra)
    editor = Editor(rain=RainSettings(intensity_mm_h=8.5))
    editor.calibration.fit([tmp_path / "rain0.nc", tmp_path / "rain1.nc"])
    wait(editor.calibration)
    assert editor.calibration.error is None
    editor.calibration.use_fitted()
    assert editor.document.rain.calibration.endswith("rain0.yaml")
    assert editor.document.rain.calibration in editor.calibration.calibrations
    kept = load_calibration(editor.document.rain.calibration)
    # Simulated by the published table with its density closed: the fit finds that table's sizes again.
    assert kept.rows[-1].shape == pytest.approx(editor.calibration.pass_file.rows[1].shape, rel=0.1)
    editor.document.undo()
    assert editor.document.rain.calibration == "published"
    editor.close()
