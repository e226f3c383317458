"""What a session opens, saves and asks: no window needed."""

import json

import numpy as np
import pytest

from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene, write_scene
from gsrain_engine.scene.marks import Marks
from gsrain_engine.scene.mask import Mask
from session.files.open_document import answer, delete_every_third, names_in, settle
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
    marked = scene.with_member(road.key, marks=Marks(hidden=Mask.of(near)))
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
    session.files.place_wanted(tmp_path / "placed")
    settle(session)
    assert session.files.home == tmp_path / "placed"
    assert read_scene(tmp_path / "placed").name == "new"


def test_a_single_file_beside_a_scene_folder_is_only_a_copy(session, tmp_path):
    delete_every_third(session)
    session.save(tmp_path / "copy.ply")
    settle(session)
    assert len(read_scene(tmp_path / "copy.ply").layers[0].gaussians) == session.scene.gaussian_count
    assert session.has_changes


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


def test_leaving_asks_and_cancel_stays(session):
    delete_every_third(session)
    session.leave()
    answer(session, "Cancel")
    assert not session.is_leaving and session.questions.present is None
    session.leave()
    answer(session, "Don't save")
    assert session.is_leaving


def test_leaving_without_changes_asks_nothing(session):
    session.leave()
    assert session.is_leaving and session.questions.present is None


def test_a_save_that_fails_does_not_leave(session, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gsrain_engine.session.files.scene_files.write_scene", full)
    delete_every_third(session)
    session.leave()
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
        session.files.place_wanted(tmp_path / "mine")
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
