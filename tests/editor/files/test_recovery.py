"""Autosaves of unsaved changes, and recovery in the next editor."""

import subprocess
import sys
from pathlib import Path

from editor.files.open_document import answer, delete_every_third, keep_now, names_in, settle
from gsrain_engine.editor.autosave import autosave_folder
from gsrain_engine.scene.formats.scene_files import read_scene


def test_a_failed_autosave_is_reported_once_and_tried_again(editor, home, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    delete_every_third(editor)
    with monkeypatch.context() as patched:
        patched.setattr("gsrain_engine.editor.autosave.write_scene_folder", full)
        keep_now(editor)
        assert "autosave can't be written: No space left" in editor.status.problem
        editor.status.dismiss()
        keep_now(editor)
        assert editor.status.problem is None
    keep_now(editor)
    assert (autosave_folder(home) / "scene" / "scene.json").exists()
    editor.files.give_up()


def test_an_autosave_comes_in_time_and_goes_with_a_save(editor, home):
    editor.tick(0.0)
    keep_now(editor)
    assert not autosave_folder(home).exists()  # nothing has changed
    editor.files.save()
    settle(editor)
    deleted = delete_every_third(editor)
    editor.tick(0.0)
    settle(editor)
    assert not autosave_folder(home).exists()  # not yet
    keep_now(editor)
    kept = autosave_folder(home) / "scene"
    assert read_scene(kept).members[0].marks.deleted.same_as(deleted)
    assert read_scene(home).members[0].marks.deleted is None
    linked = set(names_in(kept).values()) & set(names_in(home).values())
    assert len(linked) == 3  # the PLY files have a second name instead of a copy
    editor.files.save()
    settle(editor)
    assert not autosave_folder(home).exists()


def test_closing_without_an_answer_loses_nothing(sessions, home, editor):
    delete_every_third(editor)
    keep_now(editor)
    editor.close()  # the display is gone, say
    again = sessions()
    again.files.recovery.look()
    settle(again)
    assert "crossing" in again.status.question.text and str(home) in again.status.question.text
    answer(again, "Recover")
    assert again.document.scene.members[0].marks.deleted is not None
    assert again.files.has_changes and again.files.home == home
    again.files.save()
    settle(again)
    assert read_scene(home).members[0].marks.deleted is not None
    assert not autosave_folder(home).exists()


def test_discard_and_later(sessions, home, editor):
    delete_every_third(editor)
    keep_now(editor)
    editor.close()
    later = sessions()
    later.files.open(str(home))
    settle(later)
    answer(later, "Later")
    assert later.document.scene.members[0].marks.deleted is None
    delete_every_third(later)
    before = names_in(autosave_folder(home))
    keep_now(later)
    assert names_in(autosave_folder(home)) == before  # what was put off is not overwritten
    later.files.give_up()
    later.close()
    again = sessions()
    again.files.open(str(home))
    settle(again)
    answer(again, "Discard")
    assert again.status.question is None
    again.close()
    assert not autosave_folder(home).exists()


def test_an_autosave_of_a_living_session_is_not_offered_and_not_overwritten(sessions, home, editor):
    delete_every_third(editor)
    keep_now(editor)
    before = names_in(autosave_folder(home))
    other = sessions()
    other.files.recovery.look()
    other.files.open(str(home))
    settle(other)
    assert other.status.question.title == "Open twice"
    answer(other, "Go on")
    assert other.status.question is None
    other.document.change_rain("Intensity", intensity_mm_h=3.0)
    keep_now(other)
    assert names_in(autosave_folder(home)) == before
    other.files.give_up()


def test_what_a_killed_process_has_kept_is_offered_and_what_a_living_one_has_is_not(sessions, home):
    program = Path(__file__).with_name("session_to_be_killed.py")
    with subprocess.Popen(
        [sys.executable, program, home], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "kept\n"
        early = sessions()
        early.files.open(str(home))
        early.files.recovery.look()
        settle(early)
        assert early.status.question.title == "Open twice"
        answer(early, "Close it here")
        assert early.status.question is None
        process.kill()
    late = sessions()
    late.files.recovery.look()
    settle(late)
    assert late.status.question.title == "Recover unsaved changes"
    answer(late, "Recover")
    assert late.document.scene.layers[0].marks.deleted.size == 100
    assert late.document.rain.intensity_mm_h == 8.5
    assert late.files.home == home and late.files.has_changes
    assert read_scene(home).layers[0].marks.deleted is None
    late.files.give_up()
