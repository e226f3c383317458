"""Sessions with a scene folder of their own."""

import pytest

from editor.files.open_document import settle
from gsrain_engine.editor.editor import Editor
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def sessions():
    every = []

    def make(scene=None):
        every.append(Editor(scene))
        return every[-1]

    yield make
    for editor in every:
        editor.close()


@pytest.fixture
def home(tmp_path):
    write_scene(small_scene("crossing"), tmp_path / "crossing")
    return tmp_path / "crossing"


@pytest.fixture
def editor(sessions, home):
    opened = sessions()
    opened.files.open(str(home))
    settle(opened)
    assert opened.document.scene.name == "crossing" and opened.status.question is None
    return opened
