"""Autosaves of unsaved changes, and recovery in the next editor."""

import multiprocessing

from editor.files.open_document import answer, delete_every_third, keep_now, names_in, settle
from gsrain_engine.editor.autosave import autosave_folder
from gsrain_engine.editor.editor import Editor
from gsrain_engine.scene.formats.scene_files import read_scene


def deleted_in(scene):
    return scene.members[0].marks.deleted


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
    saved = autosave_folder(home) / "scene"
    assert deleted_in(read_scene(saved)).same_as(deleted)
    assert deleted_in(read_scene(home)) is None
    linked = set(names_in(saved).values()) & set(names_in(home).values())
    assert len(linked) == 3  # the PLY files have a second name instead of a copy
    editor.files.save()
    settle(editor)
    assert not autosave_folder(home).exists()
    editor.document.undo()
    keep_now(editor)
    assert autosave_folder(home).exists()  # the document differs from the saved one again
    editor.files.give_up()


def test_an_autosave_can_be_put_off_and_discarded(sessions, home, editor):
    delete_every_third(editor)
    keep_now(editor)
    editor.close()
    later = sessions()
    later.files.open(str(home))
    settle(later)
    answer(later, "Later")
    assert deleted_in(later.document.scene) is None
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


def edit_and_wait(home, pipe):
    """Change a scene in a process of its own, let the autosave come, and wait to be killed."""
    editor = Editor()
    editor.files.open(str(home))
    settle(editor)
    delete_every_third(editor)
    editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    keep_now(editor)
    pipe.send("autosaved")
    pipe.recv()


def test_the_autosave_of_a_living_process_is_untouched_and_that_of_a_killed_one_recovered(sessions, home):
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=edit_and_wait, args=(home, theirs), daemon=True)
    process.start()
    assert ours.poll(120) and ours.recv() == "autosaved"
    before = names_in(autosave_folder(home))
    early = sessions()
    early.files.recovery.look()
    for label, scene in (("Close it here", "no scene"), ("Go on", "crossing")):
        early.files.open(str(home))
        settle(early)
        assert early.status.question.title == "Open twice"
        answer(early, label)
        assert (early.status.question, early.document.scene.name) == (None, scene)
    early.document.change_rain("Intensity", intensity_mm_h=3.0)
    keep_now(early)
    assert names_in(autosave_folder(home)) == before
    early.files.give_up()
    early.close()
    process.kill()
    process.join()
    late = sessions()
    late.files.recovery.look()
    settle(late)
    question = late.status.question
    assert question.title == "Recover unsaved changes" and "crossing" in question.text and str(home) in question.text
    answer(late, "Recover")
    assert (deleted_in(late.document.scene).size, late.document.rain.intensity_mm_h) == (134, 8.5)
    assert late.files.home == home and late.files.has_changes
    assert deleted_in(read_scene(home)) is None
    late.files.save()
    settle(late)
    assert deleted_in(read_scene(home)).size == 134
    assert not autosave_folder(home).exists()
