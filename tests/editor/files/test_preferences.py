"""Preferences and recent scenes: what several windows share."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest

from gsrain_engine.editor.files import recent_files, update_recent_files
from gsrain_engine.editor.preferences import Preferences, load_preferences, preferences_file, save_preferences
from gsrain_engine.render.export_settings import EXPORT_PRESETS, ExportSettings

_DEFAULT = ExportSettings(output="", size_px=(960, 640), codec="h264")


def test_two_windows_keep_each_others_preferences(sessions):
    first, second = sessions(), sessions()
    first.preferences.set(theme="light")
    second.preferences.set(autosave_s=60.0)
    first.close()
    second.close()
    assert load_preferences()[0] == Preferences(theme="light", autosave_s=60.0)


def test_the_settings_of_the_record_panel_stay_for_the_next_start(sessions):
    editor = sessions()
    assert editor.render_queue.preset.title == "Draft video"
    dataset = next(each for each in EXPORT_PRESETS if each.title == "Dataset")
    editor.render_queue.use_preset(dataset)
    assert editor.render_queue.preset is dataset
    editor.render_queue.change(first_s=1.5, last_s=4.0, twin="sunny", cameras=("front",))
    editor.playback.timeline.fps = 12.0  # in the Timeline panel
    assert editor.render_queue.preset is None
    settings = editor.render_queue.settings
    editor.close()
    again = sessions()
    assert again.render_queue.settings == msgspec.structs.replace(settings, cameras=())
    assert not again.render_queue.follows_range
    again.render_queue.change(**{name: getattr(_DEFAULT, name) for name in _DEFAULT.__struct_fields__})
    again.close()
    assert not load_preferences()[0].recording


def test_record_settings_of_another_version_are_left_out(sessions):
    save_preferences(recording={"codec": "vp9", "sharpness": 3})
    assert sessions().render_queue.settings.codec == "vp9"
    save_preferences(recording={"codec": "mpeg2"})
    settings = sessions().render_queue.settings
    assert msgspec.structs.replace(settings, last_s=None) == _DEFAULT


@pytest.mark.parametrize("text", ["theme: [", "theme: pink", "- 1", "\x00"])
def test_a_bad_file_is_reported_once_and_put_aside(sessions, text):
    preferences_file().parent.mkdir(parents=True)
    preferences_file().write_text(text)
    editor = sessions()
    assert str(preferences_file()) in editor.status.question.text
    assert editor.preferences.value == Preferences()
    assert preferences_file().with_name("preferences.bad.yaml").read_text() == text
    assert sessions().status.question is None


def test_windows_do_not_lose_each_others_recent_files():
    def add(first):
        for n in range(first, first + 3):
            update_recent_files(Path(f"/scenes/{n}"))

    with ThreadPoolExecutor(3) as windows:  # locks hold between threads as between processes
        list(windows.map(add, (0, 10, 20)))
    assert {int(path.name) for path in recent_files()} == {0, 1, 2, 10, 11, 12, 20, 21, 22}
