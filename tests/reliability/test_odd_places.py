"""Scenes under odd names and behind links: opened, autosaved, recovered and saved like any other."""

import logging
import os
import sys

import pytest

from app.main import run
from gsrain_engine.editor.jobs.folder import new_report
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from reliability.editors import answer, autosave_now, delete_first, deleted_in, opened, settle
from small_scene import small_scene

NAMES = [
    "with spaces and 'quotes\"", "Straße 雨 🌧", "line\nbreak\tand tab", "--output", "%s {0} $HOME ~", ".hidden",
    "scene.v2", "n" * 255, "雨" * 85, os.fsdecode(b"latin-1 \xfc"),
]  # fmt: skip

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="disks elsewhere take fewer names")


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    # A captured log that names what is not UTF-8 can't be sent by pytest-xdist.
    monkeypatch.setattr(logging.getLogger("gsrain"), "disabled", True)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


@pytest.fixture
def open_editor():
    every = []

    def open_one(path):
        every.append(opened(path))
        return every[-1]

    yield open_one
    for editor in every:
        editor.files.give_up()
        editor.close()


def edit_and_autosave(editor):
    delete_first(editor, 7)
    autosave_now(editor)
    assert editor.status.problem is None


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_scenes_of_any_name_are_autosaved_recovered_and_saved(open_editor, tmp_path, name):
    home = tmp_path / "scenes" / name
    write_scene(small_scene("plain"), tmp_path / "scenes" / "plain")
    (tmp_path / "scenes" / "plain").rename(home)
    first = open_editor(home)
    edit_and_autosave(first)
    first.close()
    second = open_editor(home)
    answer(second, "Recover")
    assert deleted_in(second.document.scene) == 7
    second.files.save_to(home)
    settle(second)
    assert second.status.problem is None
    assert deleted_in(read_scene(home)) == 7
    assert [os.fsencode(each) for each in (tmp_path / "scenes").iterdir()] == [os.fsencode(home)]


@pytest.mark.parametrize("name", NAMES[:-1], ids=range(len(NAMES) - 1))
def test_commands_accept_any_name(tmp_path, capsys, name):
    write_scene(small_scene("plain"), tmp_path / "in")
    name = name[:70]
    assert run(["convert", str(tmp_path / "in"), str(tmp_path / f"{name}.ply")]) == 0
    line = ["render", str(tmp_path / f"{name}.ply"), "-o", str(tmp_path / f"{name}.png")]
    assert run([*line, "--size", "32x32", "--backend", "cpu"]) == 0, capsys.readouterr().err
    assert (tmp_path / f"{name}.png").is_file()


def test_scenes_behind_two_links_are_one_scene(open_editor, tmp_path):
    write_scene(small_scene("far"), tmp_path / "disk" / "far")
    (tmp_path / "near").symlink_to(tmp_path / "disk")
    (tmp_path / "nearer").symlink_to(tmp_path / "disk" / "far")
    first = open_editor(tmp_path / "near" / "far")
    second = open_editor(tmp_path / "nearer")
    assert second.status.question.title == "Open twice"
    edit_and_autosave(first)
    first.files.save()
    settle(first)
    assert (tmp_path / "nearer").is_symlink()
    assert deleted_in(read_scene(tmp_path / "nearer")) == 7


def test_names_of_reports_fit_on_any_disk():
    file = new_report("雨" * 200 + "/\0\n")
    assert len(os.fsencode(file.name)) <= 255
    assert file.name.isprintable()
    file.parent.mkdir(parents=True)
    file.write_text("")
    assert new_report("雨" * 200 + "/\0\n") != file  # in the same second
