"""Weather in the editor: keys, undo, saving, and what shows numbers."""

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
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
