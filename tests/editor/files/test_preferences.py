"""Preferences and recent scenes: what several windows share."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gsrain_engine.editor.files import recent_files, update_recent_files
from gsrain_engine.editor.preferences import Preferences, load_preferences, preferences_file


def test_two_windows_keep_each_others_preferences(sessions):
    first, second = sessions(), sessions()
    first.preferences.set(theme="light")
    second.preferences.set(autosave_s=60.0)
    first.close()
    second.close()
    assert load_preferences()[0] == Preferences(theme="light", autosave_s=60.0)


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
