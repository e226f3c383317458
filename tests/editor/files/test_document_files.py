"""Opening, saving and questions before changes are lost, without a window."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from editor.files.open_document import HeldJob, answer, delete_every_third, keep_now, names_in, settle
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.scene.transforms import lost_when_flattened
from small_scene import small_scene


def test_save_writes_where_the_document_came_from(editor, home):
    assert not editor.files.has_changes
    deleted = delete_every_third(editor)
    assert editor.files.has_changes
    editor.files.save()
    settle(editor)
    assert not editor.files.has_changes
    assert read_scene(home).members[0].marks.deleted.same_as(deleted)
    editor.document.undo()
    assert editor.files.has_changes
    editor.document.redo()
    assert not editor.files.has_changes


def test_saving_marks_writes_no_gaussians_again(editor, home):
    editor.files.save()  # from now on the files are in drawing order
    settle(editor)
    before = names_in(home)
    delete_every_third(editor)
    editor.files.save()
    settle(editor)
    after = names_in(home)
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {"scene.json"}


def test_marks_stay_on_their_gaussians_when_a_scene_is_opened_to_be_drawn(sessions, tmp_path):
    scene = small_scene()
    road = scene.layers[0]
    near = road.gaussians.means[:, 0] < 7
    marked = scene.with_member(road.key, marks=SelectionFlags(hidden=BitMask.of(near)))
    write_scene(marked, tmp_path / "marked")  # not in drawing order
    editor = sessions()
    editor.files.open(str(tmp_path / "marked"))
    settle(editor)
    found = editor.document.scene.layers[0]
    assert not np.array_equal(found.gaussians.means, road.gaussians.means)
    assert np.array_equal(found.gaussians.means[:, 0] < 7, found.marks.hidden.flags)


def test_what_was_saved_in_drawing_order_is_not_sorted_again(editor, sessions, home):
    delete_every_third(editor)
    editor.files.save()
    settle(editor)
    again = sessions()
    again.open(str(home))
    settle(again)
    for found, saved in zip(again.scene.layers, editor.document.scene.layers, strict=True):
        assert np.array_equal(found.gaussians.means, saved.gaussians.means)
    assert again.scene.layers[0].marks.deleted.same_as(editor.document.scene.layers[0].marks.deleted)


def test_a_recent_scene_that_is_gone_is_forgotten(editor, home, tmp_path):
    assert editor.files.recent == [home]
    home.rename(tmp_path / "moved")
    editor.files.open(str(home))
    settle(editor)
    assert str(home) in editor.status.problem
    assert editor.files.recent == []


def test_what_goes_with_a_scene(editor, sessions, home):
    editor.document.change_rain("Intensity", intensity_mm_h=7.5)
    editor.viewport.navigation.position = np.array([3.0, 2.0, 1.0])
    editor.viewport.navigation.heading = 1.25
    editor.viewport.options.gain_ev, editor.viewport.options.look = 0.5, "depth"
    editor.files.save()
    settle(editor)
    again = sessions()
    again.open(str(home))
    settle(again)
    assert again.rain.intensity_mm_h == 7.5
    assert again.navigation.position.tolist() == [3.0, 2.0, 1.0]
    assert (again.navigation.heading, again.view.gain_ev, again.view.look) == (1.25, 0.5, "depth")


def test_a_view_that_can_not_be_used_is_left(editor, sessions, home):
    values = json.loads((home / "scene.json").read_text())
    (home / "scene.json").write_text(json.dumps(values | {"view": {"position": "here"}}))
    again = sessions()
    again.open(str(home))
    settle(again)
    assert np.isfinite(again.navigation.position).all()
    assert any("saved view can't be used" in line.text for line in again.log.lines)


def test_what_has_no_folder_asks_for_a_place(sessions, tmp_path):
    editor = sessions(small_scene("new"))
    editor.files.save()
    editor.files.place_request(tmp_path / "placed")
    settle(editor)
    assert editor.files.home == tmp_path / "placed"
    assert read_scene(tmp_path / "placed").name == "new"


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz"])
@pytest.mark.parametrize("source", ["folder", "file", "nothing"])
def test_an_export_is_a_copy_and_the_document_stays_unsaved(sessions, home, tmp_path, source, suffix):
    editor = sessions(small_scene("new"))
    if source != "nothing":
        write_scene(small_scene(), tmp_path / "flat.ply")
        editor.files.open(str(home if source == "folder" else tmp_path / "flat.ply"))
        settle(editor)
    delete_every_third(editor)
    keep_now(editor)
    kept, files = editor.files.recovery.autosaved_path, editor.files
    before = files.home, files.source, files.recent, editor.document.scene.name
    assert (kept / "scene" / "scene.json").is_file()
    files.export_to(tmp_path / f"copy{suffix}")
    if editor.status.question is not None:
        answer(editor, "Export")
    settle(editor)
    assert read_scene(tmp_path / f"copy{suffix}").gaussian_count == editor.document.scene.gaussian_count
    assert editor.files.has_changes and editor.status.problem is None
    assert (files.home, files.source, files.recent, editor.document.scene.name) == before
    assert files.recovery.autosaved_path == kept and (kept / "scene" / "scene.json").is_file()
    editor.request_quit()
    assert editor.status.question.title == "Unsaved changes" and not editor.should_quit
    answer(editor, "Save")
    if source != "folder":
        files.place_request(tmp_path / "placed")
        settle(editor)
    assert editor.should_quit and files.home == (home if source == "folder" else tmp_path / "placed")


def test_an_export_says_before_what_it_leaves_out(editor, tmp_path):
    scene = editor.document.scene
    path = CameraPath(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.full(1, 40.0))
    hidden = SelectionFlags(hidden=BitMask.of(np.arange(len(scene.layers[1].gaussians)) < 5))
    scene = scene.with_member("layers/road", wet_sh=scene.layers[0].gaussians.sh)
    editor.document.edit("Edit", replace_scene, replace(scene.with_member("layers/wall", marks=hidden), path=path))
    editor.document.change_rain("Rain", intensity_mm_h=4.0)
    editor.files.export_to(tmp_path / "out.ply")
    text = editor.status.question.text
    assert not (tmp_path / "out.ply").exists() and not editor.files.work
    for phrase in (
        "3 layers",
        "which layer is the sky",
        "5 hidden",
        "wet colors",
        "1 camera key\n",
        "the rain\n",
        "rig",
    ):
        assert phrase in text
    for phrase in ("actor", "selection", "over time", "direction of view", "replaced"):
        assert phrase not in text
    answer(editor, "Cancel")
    assert not (tmp_path / "out.ply").exists()
    assert lost_when_flattened(Scene("one", (Layer("one", scene.layers[0].gaussians),))) == []


def test_an_export_asks_before_it_replaces_a_file_and_needs_the_name_of_one(sessions, tmp_path):
    editor = sessions(Scene("one", (Layer("one", small_scene().layers[0].gaussians),)))
    editor.files.export_to(tmp_path / "out.spz")
    assert editor.status.question is None
    settle(editor)
    written = (tmp_path / "out.spz").stat().st_ino
    editor.files.export_to(tmp_path / "out.spz")
    assert "replaced" in editor.status.question.text
    answer(editor, "Cancel")
    assert (tmp_path / "out.spz").stat().st_ino == written
    for name in ("out", "out.png", "out.ksplat"):
        editor.status.dismiss()
        editor.files.export_to(tmp_path / name)
        assert "ends in .ply, .splat or .spz" in editor.status.problem and not (tmp_path / name).exists()
    (tmp_path / "broken").write_text("no folder")
    editor.files.export_to(tmp_path / "broken" / "out.ply")
    settle(editor)
    assert "can't be exported" in editor.status.problem
    editor.files.export_to(tmp_path / "other.spz")
    settle(editor)
    assert editor.status.problem is None  # it is about what was tried before


@pytest.mark.parametrize("name", ["out.ply", "out.SPZ", "out.ksplat"])
def test_save_writes_no_single_file_but_names_export(editor, tmp_path, name):
    delete_every_third(editor)
    editor.request_quit()
    answer(editor, "Cancel")
    editor.files.save_as(tmp_path / name)
    assert "Export" in editor.status.question.text
    answer(editor, "Cancel")
    assert editor.files.has_changes and not (tmp_path / name).exists()
    editor.files.save_as(tmp_path / name)
    answer(editor, "Save as out")
    assert not editor.files.has_changes and editor.files.home == tmp_path / "out"
    assert read_scene(tmp_path / "out").members[0].marks.deleted is not None


def test_what_is_being_written_and_read_is_waited_for_before_the_end(editor, tmp_path):
    write_scene(small_scene("other"), tmp_path / "other.ply")
    editor.files.import_from(str(tmp_path / "other.ply"))
    editor.request_quit()
    assert editor.status.question.title == "Waiting" and not editor.should_quit
    settle(editor)
    assert editor.status.question.title == "Unsaved changes"  # the import is one
    answer(editor, "Save")
    assert editor.should_quit and "other" in [layer.name for layer in read_scene(editor.files.home).layers]


@pytest.mark.parametrize(("label", "is_saved", "is_opened"), [
    ("Save", True, True), ("Don't save", False, True), ("Cancel", False, False),
])  # fmt: skip
def test_opening_another_scene_asks_about_changes(editor, home, tmp_path, label, is_saved, is_opened):
    write_scene(small_scene("other"), tmp_path / "other")
    delete_every_third(editor)
    editor.files.open(str(tmp_path / "other"))
    assert editor.status.question.title == "Unsaved changes"
    assert not editor.files.is_opening
    answer(editor, label)
    assert (editor.document.scene.name == "other") == is_opened
    assert (read_scene(home).layers[0].marks.deleted is not None) == is_saved


@pytest.mark.parametrize(("label", "is_saved"), [("Save", True), ("Don't save", False), ("Cancel", False)])
def test_a_scene_that_was_being_read_waits_for_the_answer_about_the_present_one(
    editor, home, tmp_path, label, is_saved
):
    write_scene(small_scene("other"), tmp_path / "other")
    delete_every_third(editor)
    editor.files.open(str(tmp_path / "other"))
    editor.status.answer(editor.status.question.answers[1])
    editor.request_quit()
    settle(editor)
    assert "the changes of crossing before you quit" in editor.status.question.text and editor.files.has_changes
    answer(editor, label)
    assert editor.should_quit == (label != "Cancel")
    assert editor.document.scene.name == "other" or editor.should_quit
    assert (read_scene(home).layers[0].marks.deleted is not None) == is_saved


def test_a_capture_is_offered_as_one(editor, tmp_path):
    photos, broken = tmp_path / "photos", tmp_path / "broken"
    for folder in (photos, broken):
        folder.mkdir()
        Image.new("RGB", (32, 24)).save(folder / "one.jpg")
    (broken / "scene.json").write_text("{")
    editor.files.open(str(photos))
    settle(editor)
    assert "photos is a capture (image folder)" in editor.status.question.text and editor.status.problem is None
    answer(editor, "Open the capture")
    while editor.captures.busy is not None:
        editor.tick(0.0)
    assert editor.captures.path == photos and editor.document.scene.name == "crossing"
    editor.files.import_from(str(photos))
    settle(editor)
    assert "File > Open a capture" in editor.status.problem
    editor.files.open(str(broken))
    settle(editor)
    assert "scene.json" in editor.status.problem and editor.status.question is None


def test_leaving_asks_and_cancel_stays(editor):
    delete_every_third(editor)
    editor.request_quit()
    answer(editor, "Cancel")
    assert not editor.should_quit and editor.status.question is None
    editor.request_quit()
    answer(editor, "Don't save")
    assert editor.should_quit


def test_leaving_without_changes_asks_nothing(editor):
    editor.request_quit()
    assert editor.should_quit and editor.status.question is None


def test_a_save_that_fails_does_not_leave(editor, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gsrain_engine.editor.files.write_scene", full)
    delete_every_third(editor)
    editor.request_quit()
    answer(editor, "Save")
    assert not editor.should_quit and editor.files.has_changes
    assert "can't be saved: No space left on device" in editor.status.problem


def touched_by_someone_else(home):
    values = json.loads((home / "scene.json").read_text())
    (home / "scene.json").write_text(json.dumps(values | {"name": "theirs"}))


@pytest.mark.parametrize(("label", "on_disk", "here"), [
    ("Overwrite", "crossing", "crossing"), ("Reload", "theirs", "theirs"), ("Cancel", "theirs", "crossing"),
    ("Save as...", "theirs", "crossing"),
])  # fmt: skip
def test_a_file_changed_by_someone_else_is_noticed(editor, home, tmp_path, label, on_disk, here):
    delete_every_third(editor)
    touched_by_someone_else(home)
    editor.files.save()
    assert editor.status.question.title == "Changed on disk"
    answer(editor, label)
    if label == "Save as...":
        editor.files.place_request(tmp_path / "mine")
        settle(editor)
        assert read_scene(tmp_path / "mine").name == "crossing"
    assert (read_scene(home).name, editor.document.scene.name) == (on_disk, here)


def test_a_file_that_was_only_touched_is_no_change(editor, home):
    (home / "scene.json").write_bytes((home / "scene.json").read_bytes())
    delete_every_third(editor)
    editor.files.save()
    settle(editor)
    assert editor.status.question is None and not editor.files.has_changes


def test_another_scene_is_not_replaced_unasked(editor, tmp_path):
    write_scene(small_scene("precious"), tmp_path / "precious")
    editor.files.save_as(tmp_path / "precious")
    answer(editor, "Cancel")
    assert read_scene(tmp_path / "precious").name == "precious"
    editor.files.save_as(tmp_path / "precious")
    answer(editor, "Replace")
    assert read_scene(tmp_path / "precious").name == "crossing"
    assert editor.files.home == tmp_path / "precious"


def test_revert_asks_and_reads_again(editor):
    delete_every_third(editor)
    editor.files.revert()
    assert editor.files.has_changes
    answer(editor, "Revert")
    assert editor.document.scene.members[0].marks.deleted is None and not editor.files.has_changes


def test_import_is_one_step(editor, tmp_path):
    write_scene(small_scene("other"), tmp_path / "other.ply")
    editor.files.import_from(str(tmp_path / "other.ply"))
    settle(editor)
    assert editor.document.history.undo_label == "Import other"
    assert [layer.name for layer in editor.document.scene.layers] == ["road", "wall", "sky", "other"]
    editor.files.import_from(str(tmp_path / "missing.ply"))
    settle(editor)
    assert "missing.ply" in editor.status.problem


def test_a_newer_scene_is_refused_and_nothing_is_lost(editor, home, tmp_path):
    values = json.loads((home / "scene.json").read_text())
    (home / "scene.json").write_text(json.dumps(values | {"version": 99}))
    with pytest.raises(SceneFormatError, match="newer program"):
        read_scene(home)
    editor.files.open(str(home))
    settle(editor)
    assert "newer program" in editor.status.problem
    assert editor.document.scene.name == "crossing"
    delete_every_third(editor)
    editor.files.save()
    answer(editor, "Overwrite")
    assert "newer program" in editor.status.problem  # not even then
    assert editor.files.has_changes


def at_work(editor, *jobs):
    for job in jobs:
        job.start(editor)
    return jobs


@pytest.mark.parametrize("changes", [False, True])
def test_the_end_waits_for_a_job_and_takes_its_result_in(editor, changes):
    (job,) = at_work(editor, HeldJob())
    editor.request_quit()
    question = editor.status.question
    assert question.title == "Work goes on" and "Make it rainy" in question.text and not editor.should_quit
    assert question.progress().fraction == 0.4
    answer(editor, "Wait")
    assert editor.status.question.title == "Waiting" and not editor.status.question.enter_answers
    assert job.state == "running" and not editor.should_quit
    if changes:
        road = editor.document.scene.layers[0]
        job.end(editor.document.scene.with_member(road.key, gaussians=road.gaussians.with_sh(road.gaussians.sh + 1)))
        editor.tick(0.0)
        assert job.state == "finished" and editor.viewport.staged is not None and not editor.should_quit
        settle(editor)
        assert editor.document.history.undo_label == "Make it rainy"
        assert editor.status.question.title == "Unsaved changes" and not editor.should_quit
        answer(editor, "Don't save")
    else:
        job.end()
        editor.tick(0.0)
    assert editor.should_quit and editor.status.question is None


def test_stopping_a_job_goes_on_with_the_end(editor):
    jobs = at_work(editor, HeldJob(), HeldJob("Record clip.mp4", ends_with_scene=False))
    delete_every_third(editor)
    editor.request_quit()
    assert "Make it rainy and Record clip.mp4 are" in editor.status.question.text
    answer(editor, "Stop them")
    assert [job.state for job in jobs] == ["cancelled", "cancelled"]
    assert editor.status.question.title == "Unsaved changes"
    answer(editor, "Don't save")
    assert editor.should_quit


def test_cancelling_leaves_window_and_job_as_they_are(editor):
    (job,) = at_work(editor, HeldJob())
    editor.request_quit()
    answer(editor, "Cancel")
    assert (job.state, editor.should_quit, editor.status.question) == ("running", False, None)
    editor.request_quit()
    answer(editor, "Wait")
    answer(editor, "Cancel")
    job.end()
    settle(editor)
    assert (editor.should_quit, editor.status.question) == (False, None)
    editor.request_quit()
    assert editor.should_quit


def test_a_job_that_fails_while_it_is_waited_for_keeps_the_window_open(editor):
    (job,) = at_work(editor, HeldJob())
    editor.request_quit()
    answer(editor, "Wait")
    job.end(fails=True)
    settle(editor)
    assert not editor.should_quit and editor.status.question is None
    assert "third wheel" in editor.status.problem


@pytest.mark.parametrize("go", ["open", "close", "revert"])
def test_another_document_asks_about_jobs_that_end_with_this_one(editor, tmp_path, go):
    write_scene(small_scene("other"), tmp_path / "other")
    to_another = {
        "open": lambda: editor.files.open(str(tmp_path / "other")),
        "close": editor.files.close_scene,
        "revert": editor.files.revert,
    }[go]
    job, recording = at_work(editor, HeldJob(), HeldJob("Record clip.mp4", ends_with_scene=False))
    scene = editor.document.scene
    to_another()
    assert "Make it rainy is" in editor.status.question.text and not editor.files.is_opening
    answer(editor, "Cancel")
    assert editor.document.scene is scene and job.state == "running"
    to_another()
    answer(editor, "Wait")
    job.end()
    editor.tick(0.0)
    settle(editor)
    assert editor.document.scene is not scene and (job.state, recording.state) == ("finished", "running")
    at_work(editor, HeldJob())
    editor.request_quit()
    answer(editor, "Stop them")
    assert editor.should_quit
