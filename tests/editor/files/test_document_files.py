"""Opening, saving and questions before changes are lost, without a window."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from editor.files.open_document import HeldJob, answer, delete_every_third, keep_now, names_in, settle
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.scene.transforms import lost_when_flattened
from small_scene import small_scene


def test_save_writes_where_the_document_came_from(session, home):
    assert not session.has_changes
    deleted = delete_every_third(session)
    assert session.has_changes
    session.files.save()
    settle(session)
    assert not session.has_changes
    assert read_scene(home).members[0].marks.deleted.same_as(deleted)
    session.undo()
    assert session.has_changes
    session.redo()
    assert not session.has_changes


def test_saving_marks_writes_no_gaussians_again(session, home):
    session.files.save()  # from now on the files are in drawing order
    settle(session)
    before = names_in(home)
    delete_every_third(session)
    session.files.save()
    settle(session)
    after = names_in(home)
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {"scene.json"}


def test_marks_stay_on_their_gaussians_when_a_scene_is_opened_to_be_drawn(sessions, tmp_path):
    scene = small_scene()
    road = scene.layers[0]
    near = road.gaussians.means[:, 0] < 7
    marked = scene.with_member(road.key, marks=SelectionFlags(hidden=BitMask.of(near)))
    write_scene(marked, tmp_path / "marked")  # not in drawing order
    session = sessions()
    session.open(str(tmp_path / "marked"))
    settle(session)
    found = session.scene.layers[0]
    assert not np.array_equal(found.gaussians.means, road.gaussians.means)
    assert np.array_equal(found.gaussians.means[:, 0] < 7, found.marks.hidden.flags)


def test_what_was_saved_in_drawing_order_is_not_sorted_again(session, sessions, home):
    delete_every_third(session)
    session.files.save()
    settle(session)
    again = sessions()
    again.open(str(home))
    settle(again)
    for found, saved in zip(again.scene.layers, session.scene.layers, strict=True):
        assert np.array_equal(found.gaussians.means, saved.gaussians.means)
    assert again.scene.layers[0].marks.deleted.same_as(session.scene.layers[0].marks.deleted)


def test_a_recent_scene_that_is_gone_is_forgotten(session, home, tmp_path):
    assert session.files.recent == [home]
    home.rename(tmp_path / "moved")
    session.open(str(home))
    settle(session)
    assert str(home) in session.problem
    assert session.files.recent == []


def test_what_goes_with_a_scene(session, sessions, home):
    session.change_rain("Intensity", intensity_mm_h=7.5)
    session.navigation.position = np.array([3.0, 2.0, 1.0])
    session.navigation.heading = 1.25
    session.view.gain_ev, session.view.look = 0.5, "depth"
    session.files.save()
    settle(session)
    again = sessions()
    again.open(str(home))
    settle(again)
    assert again.rain.intensity_mm_h == 7.5
    assert again.navigation.position.tolist() == [3.0, 2.0, 1.0]
    assert (again.navigation.heading, again.view.gain_ev, again.view.look) == (1.25, 0.5, "depth")


def test_a_view_that_can_not_be_used_is_left(session, sessions, home):
    values = json.loads((home / "scene.json").read_text())
    (home / "scene.json").write_text(json.dumps(values | {"view": {"position": "here"}}))
    again = sessions()
    again.open(str(home))
    settle(again)
    assert np.isfinite(again.navigation.position).all()
    assert any("saved view can't be used" in line.text for line in again.log.lines)


def test_what_has_no_folder_asks_for_a_place(sessions, tmp_path):
    session = sessions(small_scene("new"))
    session.files.save()
    session.files.place_request(tmp_path / "placed")
    settle(session)
    assert session.files.home == tmp_path / "placed"
    assert read_scene(tmp_path / "placed").name == "new"


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz"])
@pytest.mark.parametrize("source", ["folder", "file", "nothing"])
def test_an_export_is_a_copy_and_the_document_stays_unsaved(sessions, home, tmp_path, source, suffix):
    session = sessions(small_scene("new"))
    if source != "nothing":
        write_scene(small_scene(), tmp_path / "flat.ply")
        session.open(str(home if source == "folder" else tmp_path / "flat.ply"))
        settle(session)
    delete_every_third(session)
    keep_now(session)
    kept, files = session.files.recovery.autosaved_path, session.files
    before = files.home, files.source, files.recent, session.scene.name
    assert (kept / "scene" / "scene.json").is_file()
    files.export_to(tmp_path / f"copy{suffix}")
    if session.questions.present is not None:
        answer(session, "Export")
    settle(session)
    assert read_scene(tmp_path / f"copy{suffix}").gaussian_count == session.scene.gaussian_count
    assert session.has_changes and session.problem is None
    assert (files.home, files.source, files.recent, session.scene.name) == before
    assert files.recovery.autosaved_path == kept and (kept / "scene" / "scene.json").is_file()
    session.request_quit()
    assert session.questions.present.title == "Unsaved changes" and not session.is_leaving
    answer(session, "Save")
    if source != "folder":
        files.place_request(tmp_path / "placed")
        settle(session)
    assert session.is_leaving and files.home == (home if source == "folder" else tmp_path / "placed")


def test_an_export_says_before_what_it_leaves_out(session, tmp_path):
    scene = session.scene
    path = CameraPath(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.full(1, 40.0))
    hidden = SelectionFlags(hidden=BitMask.of(np.arange(len(scene.layers[1].gaussians)) < 5))
    scene = scene.with_member("layers/road", wet_sh=scene.layers[0].gaussians.sh)
    session.set_scene("Edit", replace(scene.with_member("layers/wall", marks=hidden), path=path))
    session.change_rain("Rain", intensity_mm_h=4.0)
    session.files.export_to(tmp_path / "out.ply")
    text = session.questions.present.text
    assert not (tmp_path / "out.ply").exists() and not session.files.work
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
    answer(session, "Cancel")
    assert not (tmp_path / "out.ply").exists()
    assert lost_when_flattened(Scene("one", (Layer("one", scene.layers[0].gaussians),))) == []


def test_an_export_asks_before_it_replaces_a_file_and_needs_the_name_of_one(sessions, tmp_path):
    session = sessions(Scene("one", (Layer("one", small_scene().layers[0].gaussians),)))
    session.files.export_to(tmp_path / "out.spz")
    assert session.questions.present is None
    settle(session)
    written = (tmp_path / "out.spz").stat().st_ino
    session.files.export_to(tmp_path / "out.spz")
    assert "replaced" in session.questions.present.text
    answer(session, "Cancel")
    assert (tmp_path / "out.spz").stat().st_ino == written
    for name in ("out", "out.png", "out.ksplat"):
        session.problem = None
        session.files.export_to(tmp_path / name)
        assert "ends in .ply, .splat or .spz" in session.problem and not (tmp_path / name).exists()
    (tmp_path / "broken").write_text("no folder")
    session.files.export_to(tmp_path / "broken" / "out.ply")
    settle(session)
    assert "can't be exported" in session.problem
    session.files.export_to(tmp_path / "other.spz")
    settle(session)
    assert session.problem is None  # it is about what was tried before


@pytest.mark.parametrize("name", ["out.ply", "out.SPZ", "out.ksplat"])
def test_save_writes_no_single_file_but_names_export(session, tmp_path, name):
    delete_every_third(session)
    session.request_quit()
    answer(session, "Cancel")
    session.files.save_as(tmp_path / name)
    assert "Export" in session.questions.present.text
    answer(session, "Cancel")
    assert session.has_changes and not (tmp_path / name).exists()
    session.files.save_as(tmp_path / name)
    answer(session, "Save as out")
    assert not session.has_changes and session.files.home == tmp_path / "out"
    assert read_scene(tmp_path / "out").members[0].marks.deleted is not None


def test_what_is_being_written_and_read_is_waited_for_before_the_end(session, tmp_path):
    write_scene(small_scene("other"), tmp_path / "other.ply")
    session.files.import_from(str(tmp_path / "other.ply"))
    session.request_quit()
    assert session.questions.present.title == "Waiting" and not session.is_leaving
    settle(session)
    assert session.questions.present.title == "Unsaved changes"  # the import is one
    answer(session, "Save")
    assert session.is_leaving and "other" in [layer.name for layer in read_scene(session.files.home).layers]


@pytest.mark.parametrize(("label", "is_saved", "is_opened"), [
    ("Save", True, True), ("Don't save", False, True), ("Cancel", False, False),
])  # fmt: skip
def test_opening_another_scene_asks_about_changes(session, home, tmp_path, label, is_saved, is_opened):
    write_scene(small_scene("other"), tmp_path / "other")
    delete_every_third(session)
    session.open(str(tmp_path / "other"))
    assert session.questions.present.title == "Unsaved changes"
    assert not session.files.is_opening
    answer(session, label)
    assert (session.scene.name == "other") == is_opened
    assert (read_scene(home).layers[0].marks.deleted is not None) == is_saved


@pytest.mark.parametrize(("label", "is_saved"), [("Save", True), ("Don't save", False), ("Cancel", False)])
def test_a_scene_that_was_being_read_waits_for_the_answer_about_the_present_one(
    session, home, tmp_path, label, is_saved
):
    write_scene(small_scene("other"), tmp_path / "other")
    delete_every_third(session)
    session.open(str(tmp_path / "other"))
    session.questions.answer(session.questions.present.answers[1])
    session.request_quit()
    settle(session)
    assert "the changes of crossing before you quit" in session.questions.present.text and session.has_changes
    answer(session, label)
    assert session.is_leaving == (label != "Cancel")
    assert session.scene.name == "other" or session.is_leaving
    assert (read_scene(home).layers[0].marks.deleted is not None) == is_saved


def test_a_capture_is_offered_as_one(session, tmp_path):
    photos, broken = tmp_path / "photos", tmp_path / "broken"
    for folder in (photos, broken):
        folder.mkdir()
        Image.new("RGB", (32, 24)).save(folder / "one.jpg")
    (broken / "scene.json").write_text("{")
    session.open(str(photos))
    settle(session)
    assert "photos is a capture (image folder)" in session.questions.present.text and session.problem is None
    answer(session, "Open the capture")
    while session.captures.busy is not None:
        session.update(0.0)
    assert session.captures.path == photos and session.scene.name == "crossing"
    session.files.import_from(str(photos))
    settle(session)
    assert "File > Open a capture" in session.problem
    session.open(str(broken))
    settle(session)
    assert "scene.json" in session.problem and session.questions.present is None


def test_leaving_asks_and_cancel_stays(session):
    delete_every_third(session)
    session.request_quit()
    answer(session, "Cancel")
    assert not session.is_leaving and session.questions.present is None
    session.request_quit()
    answer(session, "Don't save")
    assert session.is_leaving


def test_leaving_without_changes_asks_nothing(session):
    session.request_quit()
    assert session.is_leaving and session.questions.present is None


def test_a_save_that_fails_does_not_leave(session, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gsrain_engine.editor.files.write_scene", full)
    delete_every_third(session)
    session.request_quit()
    answer(session, "Save")
    assert not session.is_leaving and session.has_changes
    assert "can't be saved: No space left on device" in session.problem


def touched_by_someone_else(home):
    values = json.loads((home / "scene.json").read_text())
    (home / "scene.json").write_text(json.dumps(values | {"name": "theirs"}))


@pytest.mark.parametrize(("label", "on_disk", "here"), [
    ("Overwrite", "crossing", "crossing"), ("Reload", "theirs", "theirs"), ("Cancel", "theirs", "crossing"),
    ("Save as...", "theirs", "crossing"),
])  # fmt: skip
def test_a_file_changed_by_someone_else_is_noticed(session, home, tmp_path, label, on_disk, here):
    delete_every_third(session)
    touched_by_someone_else(home)
    session.files.save()
    assert session.questions.present.title == "Changed on disk"
    answer(session, label)
    if label == "Save as...":
        session.files.place_request(tmp_path / "mine")
        settle(session)
        assert read_scene(tmp_path / "mine").name == "crossing"
    assert (read_scene(home).name, session.scene.name) == (on_disk, here)


def test_a_file_that_was_only_touched_is_no_change(session, home):
    (home / "scene.json").write_bytes((home / "scene.json").read_bytes())
    delete_every_third(session)
    session.files.save()
    settle(session)
    assert session.questions.present is None and not session.has_changes


def test_another_scene_is_not_replaced_unasked(session, tmp_path):
    write_scene(small_scene("precious"), tmp_path / "precious")
    session.files.save_as(tmp_path / "precious")
    answer(session, "Cancel")
    assert read_scene(tmp_path / "precious").name == "precious"
    session.files.save_as(tmp_path / "precious")
    answer(session, "Replace")
    assert read_scene(tmp_path / "precious").name == "crossing"
    assert session.files.home == tmp_path / "precious"


def test_revert_asks_and_reads_again(session):
    delete_every_third(session)
    session.files.revert()
    assert session.has_changes
    answer(session, "Revert")
    assert session.scene.members[0].marks.deleted is None and not session.has_changes


def test_import_is_one_step(session, tmp_path):
    write_scene(small_scene("other"), tmp_path / "other.ply")
    session.files.import_from(str(tmp_path / "other.ply"))
    settle(session)
    assert session.history.undo_label == "Import other"
    assert [layer.name for layer in session.scene.layers] == ["road", "wall", "sky", "other"]
    session.files.import_from(str(tmp_path / "missing.ply"))
    settle(session)
    assert "missing.ply" in session.problem


def test_a_newer_scene_is_refused_and_nothing_is_lost(session, home, tmp_path):
    values = json.loads((home / "scene.json").read_text())
    (home / "scene.json").write_text(json.dumps(values | {"version": 99}))
    with pytest.raises(SceneFormatError, match="newer program"):
        read_scene(home)
    session.open(str(home))
    settle(session)
    assert "newer program" in session.problem
    assert session.scene.name == "crossing"
    delete_every_third(session)
    session.files.save()
    answer(session, "Overwrite")
    assert "newer program" in session.problem  # not even then
    assert session.has_changes


def at_work(session, *jobs):
    for job in jobs:
        job.start(session)
    return jobs


@pytest.mark.parametrize("changes", [False, True])
def test_the_end_waits_for_a_job_and_takes_its_result_in(session, changes):
    (job,) = at_work(session, HeldJob())
    session.request_quit()
    question = session.questions.present
    assert question.title == "Work goes on" and "Make it rainy" in question.text and not session.is_leaving
    assert question.progress().fraction == 0.4
    answer(session, "Wait")
    assert session.questions.present.title == "Waiting" and not session.questions.present.enter_answers
    assert job.state == "running" and not session.is_leaving
    if changes:
        road = session.scene.layers[0]
        job.end(session.scene.with_member(road.key, gaussians=road.gaussians.with_sh(road.gaussians.sh + 1)))
        session.update(0.0)
        assert job.state == "finished" and session.staged is not None and not session.is_leaving
        settle(session)
        assert session.history.undo_label == "Make it rainy"
        assert session.questions.present.title == "Unsaved changes" and not session.is_leaving
        answer(session, "Don't save")
    else:
        job.end()
        session.update(0.0)
    assert session.is_leaving and session.questions.present is None


def test_stopping_a_job_goes_on_with_the_end(session):
    jobs = at_work(session, HeldJob(), HeldJob("Record clip.mp4", ends_with_scene=False))
    delete_every_third(session)
    session.request_quit()
    assert "Make it rainy and Record clip.mp4 are" in session.questions.present.text
    answer(session, "Stop them")
    assert [job.state for job in jobs] == ["cancelled", "cancelled"]
    assert session.questions.present.title == "Unsaved changes"
    answer(session, "Don't save")
    assert session.is_leaving


def test_cancelling_leaves_window_and_job_as_they_are(session):
    (job,) = at_work(session, HeldJob())
    session.request_quit()
    answer(session, "Cancel")
    assert (job.state, session.is_leaving, session.questions.present) == ("running", False, None)
    session.request_quit()
    answer(session, "Wait")
    answer(session, "Cancel")
    job.end()
    settle(session)
    assert (session.is_leaving, session.questions.present) == (False, None)
    session.request_quit()
    assert session.is_leaving


def test_a_job_that_fails_while_it_is_waited_for_keeps_the_window_open(session):
    (job,) = at_work(session, HeldJob())
    session.request_quit()
    answer(session, "Wait")
    job.end(fails=True)
    settle(session)
    assert not session.is_leaving and session.questions.present is None
    assert "third wheel" in session.problem


@pytest.mark.parametrize("go", ["open", "close", "revert"])
def test_another_document_asks_about_jobs_that_end_with_this_one(session, tmp_path, go):
    write_scene(small_scene("other"), tmp_path / "other")
    to_another = {
        "open": lambda: session.open(str(tmp_path / "other")),
        "close": session.files.close_scene,
        "revert": session.files.revert,
    }[go]
    job, recording = at_work(session, HeldJob(), HeldJob("Record clip.mp4", ends_with_scene=False))
    scene = session.scene
    to_another()
    assert "Make it rainy is" in session.questions.present.text and not session.files.is_opening
    answer(session, "Cancel")
    assert session.scene is scene and job.state == "running"
    to_another()
    answer(session, "Wait")
    job.end()
    session.update(0.0)
    settle(session)
    assert session.scene is not scene and (job.state, recording.state) == ("finished", "running")
    at_work(session, HeldJob())
    session.request_quit()
    answer(session, "Stop them")
    assert session.is_leaving
