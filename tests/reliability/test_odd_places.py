"""Scenes under odd names and behind links: opened, kept, recovered and saved like any other."""

import logging
import os
import sys
from concurrent.futures import wait

import numpy as np
import pytest

from app.main import run
from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.jobs.folder import new_report
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
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
def sessions():
    every = []

    def make():
        every.append(Editor())
        return every[-1]

    yield make
    for editor in every:
        editor.files.give_up()
        editor.close()


def settle(editor):
    for _ in range(4):
        wait(editor.pending_files, timeout=60)
        editor.tick(0.0)
        editor.apply(DrawResult(is_pending_ready=True))


def opened(editor, path):
    editor.files.open(str(path))
    settle(editor)
    assert editor.status.problem is None
    return editor


def answer(editor, label):
    question = editor.status.question
    editor.status.answer(next(each for each in question.answers if each.label == label))
    settle(editor)


def edited_and_kept(editor):
    member = editor.document.scene.members[0]
    marks = SelectionFlags(deleted=BitMask.of(np.arange(len(member.gaussians)) < 7))
    editor.document.edit("Delete", replace_scene, editor.document.scene.with_member(member.key, marks=marks))
    editor.tick(0.0)
    late = editor.files.recovery.now() + editor.preferences.value.autosave_s
    editor.files.recovery.now = lambda: late
    settle(editor)
    assert editor.status.problem is None


def deleted_in(scene):
    marked = scene.members[0].marks.deleted
    return 0 if marked is None else marked.size


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_a_scene_of_any_name_is_kept_recovered_and_saved(sessions, tmp_path, name):
    home = tmp_path / "scenes" / name
    write_scene(small_scene("plain"), tmp_path / "scenes" / "plain")
    (tmp_path / "scenes" / "plain").rename(home)
    first = opened(sessions(), home)
    edited_and_kept(first)
    first.close()
    again = opened(sessions(), home)
    answer(again, "Recover")
    assert deleted_in(again.document.scene) == 7
    again.files.save_to(home)
    settle(again)
    assert again.status.problem is None
    assert deleted_in(read_scene(home)) == 7
    assert [os.fsencode(each) for each in (tmp_path / "scenes").iterdir()] == [os.fsencode(home)]


@pytest.mark.parametrize("name", NAMES[:-1], ids=range(len(NAMES) - 1))
def test_commands_take_any_name(tmp_path, capsys, name):
    write_scene(small_scene("plain"), tmp_path / "in")
    name = name[:70]
    assert run(["convert", str(tmp_path / "in"), str(tmp_path / f"{name}.ply")]) == 0
    clip = tmp_path / f"{name}.png"
    line = ["render", str(tmp_path / f"{name}.ply"), "-o", str(clip), "--size", "32x32", "--backend", "cpu"]
    assert run(line) == 0, capsys.readouterr().err
    assert clip.is_file()


def test_one_scene_behind_two_links_is_one_scene(sessions, tmp_path):
    write_scene(small_scene("far"), tmp_path / "disk" / "far")
    (tmp_path / "near").symlink_to(tmp_path / "disk")
    (tmp_path / "nearer").symlink_to(tmp_path / "disk" / "far")
    first = opened(sessions(), tmp_path / "near" / "far")
    second = opened(sessions(), tmp_path / "nearer")
    assert second.status.question.title == "Open twice"
    edited_and_kept(first)
    first.files.save()
    settle(first)
    assert (tmp_path / "nearer").is_symlink()
    assert deleted_in(read_scene(tmp_path / "nearer")) == 7


def test_a_report_s_name_fits_on_any_disk():
    file = new_report("雨" * 200 + "/\0\n")
    assert len(os.fsencode(file.name)) <= 255
    assert file.name.isprintable()
    file.parent.mkdir(parents=True)
    file.write_text("")
    assert new_report("雨" * 200 + "/\0\n") != file  # in the same second
