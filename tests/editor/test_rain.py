"""Rain of the document: keyframes, drops in the air, roofs, measurements and calibrations."""

from contextlib import closing, suppress
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from editor.files.open_document import settle
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.editor import viewport_state
from gsrain_engine.editor.document import OBJECT_AIR, with_preset
from gsrain_engine.editor.drawing.frame import DrawnImage, DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.level import set_length
from gsrain_engine.editor.edits.members import set_visible
from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.editor.jobs.job import JobError
from gsrain_engine.editor.scene_setup import SETUP_MM_H
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.keyframes import NO_KEYFRAMES, RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.scene import Layer, Scene
from oracles.drop_phases import displacement
from small_scene import patch, small_scene
from ui.commands.table import INTENSITIES_MM_H, set_intensity


def key_shower(editor, first_mm_h=0.0):
    rates = ((0.0, first_mm_h), (10.0, 10.0))
    keys = tuple(RainKeyframe(time_s=time, intensity_mm_h=rate) for time, rate in rates)
    editor.document.edit_keyframes("Shower", replace_keyframes, RainKeyframes(keys=keys))


def test_the_air_around_a_single_object_ends_at_any_intensity(editor, tmp_path):
    """Behind it, endless air would be as bright as the rain before it; what sets an intensity changes nothing else."""
    pot = patch((0, 0, 0), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), 5, (0.5, 0.4, 0.3))
    write_scene(Scene("pot", (Layer("pot", pot),)), tmp_path / "pot.ply")
    write_scene(small_scene(), tmp_path / "road")
    for name, air in (("pot.ply", OBJECT_AIR), ("road", None), ("pot.ply", OBJECT_AIR)):
        editor.files.give_up()
        editor.files.open(str(tmp_path / name))
        settle(editor)
        document, before = editor.document, editor.document.rain
        assert before.haze_region == air
        editor.scene_setup.rain()
        assert document.rain == msgspec.structs.replace(before, intensity_mm_h=SETUP_MM_H)
        for rate in INTENSITIES_MM_H.values():
            set_intensity(document, rate)
            assert document.rain == msgspec.structs.replace(before, intensity_mm_h=rate)
    document.edit("Scale", set_length, 1.0, 100.0)  # what was taken for a pot has the size of a street
    assert document.rain.haze_region is None and document.rain.intensity_mm_h > 0
    document.undo()
    assert document.rain.haze_region == OBJECT_AIR


def test_presets_of_an_intensity_change_nothing_else():
    own = RainSettings(intensity_mm_h=3.0, haze_region=OBJECT_AIR, glass="windshield", seed=4)
    for name in shipped_config_names("rain"):
        preset = load_preset(name)
        is_intensity = preset == RainSettings(intensity_mm_h=preset.intensity_mm_h)
        assert is_intensity == (name in ("clear", "1.2", "8.5", "12.0"))
        expected = msgspec.structs.replace(own, intensity_mm_h=preset.intensity_mm_h) if is_intensity else preset
        assert with_preset(own, preset) == expected


def test_a_change_of_a_keyed_field_is_a_key_at_the_present_time(editor):
    def key_times():
        return editor.document.keyframes.key_times["intensity_mm_h"].tolist()

    key_shower(editor)
    editor.playback.clock.time_s = 4.0
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=7.0)
    editor.playback.clock.time_s = 4.5  # time goes on while the mouse is held
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=8.0, haze="none")
    editor.document.end_gesture()
    assert key_times() == [0.0, 4.0, 10.0]
    assert editor.document.keyframes.key_at(4.0).intensity_mm_h == 8.0
    assert editor.document.rain.haze == "none"
    editor.document.change_rain("Intensity", "drag", intensity_mm_h=1.0)
    assert key_times() == [0.0, 4.0, 4.5, 10.0]
    editor.document.undo()
    editor.document.undo()
    assert key_times() == [0.0, 10.0]


def test_drops_go_on_from_where_they_are_when_rain_or_keys_change(editor):
    editor.document.change_rain("Intensity", intensity_mm_h=3.0)
    editor.playback.clock.time_s = 6.0

    def moved():
        return displacement(editor.live_rain.simulation.frozen_at(6.0).motion, 6.0)

    before, document = moved(), editor.document
    for change in (
        lambda: document.change_rain("Intensity", intensity_mm_h=4.5),
        lambda: key_shower(editor),
        lambda: document.edit_keyframes("Wind", RainKeyframes.with_key, 2.0, wind_m_s=(5.0, 1.0)),
        document.undo,
        document.undo,
    ):
        change()
        assert np.allclose(moved(), before, atol=1e-9)


def test_rain_falls_through_roofs_until_they_are_found():
    with closing(Editor(small_scene(), RainSettings(intensity_mm_h=8.5, roofs=True))) as editor:
        assert editor.busy == "Finding roofs"
        assert not editor.split_panes[0].rainfall.rain.roofs
        editor.tick(0.0)
        editor.background.wait(60)
        assert editor.busy is None
        assert editor.split_panes[0].rainfall is editor.live_rain.simulation
        editor.document.edit("Show or hide", set_visible, "layers/road", False)  # another scene, as seen from above
        assert editor.busy == "Finding roofs"


# Measurements and calibrations


@pytest.fixture
def rainy():
    with closing(Editor(rain=RainSettings(intensity_mm_h=8.5))) as editor:
        yield editor


def wait(lab):
    with suppress(JobError):
        lab.job.wait(120)


def test_a_measurement_that_fails_leaves_one_sentence(rainy, tmp_path):
    lab = rainy.calibration
    lab.area_m2 = 1e6
    lab.measure()
    assert "60 s" in lab.busy
    wait(lab)
    assert "area" in lab.error
    (tmp_path / "bad.txt").write_bytes(b"\x00\x01 no disdrometer")
    lab.fit([tmp_path / "bad.txt"])
    wait(lab)
    assert "bad.txt" in lab.error
    assert (lab.counted, lab.fitted) == (None, None)


def test_a_fit_is_saved_and_used(rainy, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    files = [tmp_path / "rain0.nc", tmp_path / "rain1.nc"]
    for file, intensity in zip(files, (2.0, 8.5), strict=True):
        instrument = VirtualDisdrometer(RainSimulation.start(RainSettings(intensity_mm_h=intensity)), 0.1)
        write_spectra(file, instrument.measure(60.0 * np.arange(5)).spectra)
    lab, document = rainy.calibration, rainy.document
    lab.fit(files)
    wait(lab)
    assert lab.error is None
    lab.use_fitted()
    assert document.rain.calibration.endswith("rain0.yaml")
    assert document.rain.calibration in lab.calibrations
    # Simulated by the published table with its density closed: the fit finds that table's sizes again.
    fitted = load_calibration(document.rain.calibration)
    assert fitted.rows[-1].shape == pytest.approx(lab.pass_file.rows[1].shape, rel=0.1)
    document.undo()
    assert document.rain.calibration == "published"


@pytest.mark.parametrize("keys", [NO_KEYFRAMES, NO_KEYFRAMES.with_key(0.0, wetness=0.0).with_key(9.0, wetness=1.0)])
def test_rain_before_a_still_camera_has_one_quality_with_and_without_keyframes(monkeypatch, keys):
    now_s = 0.0
    monkeypatch.setattr(viewport_state, "time", SimpleNamespace(perf_counter=lambda: now_s))
    with closing(Editor(small_scene(), RainSettings(intensity_mm_h=8.5))) as editor:
        editor.document.edit_keyframes("Keys", replace_keyframes, keys)
        editor.viewport.backend = "cpu"
        for _ in range(40):
            now_s += 0.05
            editor.playback.clock.advance(0.05)
            frame = editor.render_input(96, 64)
            cost_ms = 60.0 if frame.quality.has_backdrop else 200.0
            image = DrawnImage(frame.quality, cost_ms, "cpu", "", {"megapixels": 0.006})
            editor.apply(DrawResult(frame, drawn=image, is_settled=True))
        assert frame.quality.has_backdrop and frame.quality.gaussians == 1
        editor.viewport.full_ms_per_megapixel = 1e6  # a backdrop would take seconds, again and again
        now_s += 0.05
        assert editor.render_input(96, 64).quality.has_backdrop == (keys is NO_KEYFRAMES)
