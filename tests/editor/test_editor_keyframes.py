"""Weather in the editor: keys, undo, saving, and what shows numbers."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes, shower_keyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.formats.scene_files import write_scene
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


def test_weather_is_part_of_the_document_and_is_undone(editor):
    editor.document.edit_keyframes("Shower", replace_keyframes, keys((0.0, 0.0), (10.0, 10.0)))
    editor.playback.clock.time_s = 5.0
    assert editor.document.rain_now.intensity_mm_h == 5.0
    assert editor.live_rain.simulation.state_at(5.0).intensity_mm_h == 5.0
    editor.document.undo()
    assert editor.document.keyframes.keys == ()
    assert editor.live_rain.simulation.state_at(5.0).intensity_mm_h == 0.0
    editor.document.redo()
    assert editor.document.rain_now.intensity_mm_h == 5.0


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


def test_weather_is_saved_with_the_scene_and_comes_back(editor, tmp_path):
    shower = shower_keyframes(2.0)
    editor.document.edit_keyframes("Shower", replace_keyframes, shower)
    editor.files.save_to(tmp_path / "wet")
    settle(editor)
    other = Editor()
    other.open(str(tmp_path / "wet"))
    settle(other)
    other.swap_in()
    other.close()
    assert other.weather == shower
    assert other.rain_now == shower.rain_at(other.rain, other.clock.time_s)


def test_weather_that_cannot_be_used_is_logged_and_ignored(editor, tmp_path):
    bad = msgspec.to_builtins(shower_keyframes())
    bad["keys"][1]["intensity_mm_h"] = 5000.0
    write_scene(
        replace(small_scene(), weather=bad, rain=msgspec.to_builtins(RainSettings(intensity_mm_h=2.0))),
        tmp_path / "bad",
    )
    editor.files.open(str(tmp_path / "bad"))
    settle(editor)
    editor.apply(DrawResult(is_pending_ready=True))
    assert editor.document.keyframes.keys == ()
    assert editor.document.rain.intensity_mm_h == 2.0
    assert any("weather can't be used" in line.text and "5000" in line.text for line in editor.status.log.lines)


def settle(editor):
    for future in editor.pending_files:
        future.result()
    editor.tick(0.0)


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
