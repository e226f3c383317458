"""Opening, saving and questions before changes are lost, without a window."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest

from editor.driven import driven, settled
from editor.files.open_document import HeldJob, answer, delete_every_third, full_disk, keep_now, names_in, settle
from gsrain_engine.editor import files
from gsrain_engine.editor.background_edits import reconstruct
from gsrain_engine.editor.document import Recipe
from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.job_results import scene_results
from gsrain_engine.editor.jobs.drive import load_rollout
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.simulation.rollout_io import write_rollout
from small_scene import small_scene


def test_save_writes_changes_with_rain_and_view_where_the_document_came_from(editor, sessions, home):
    assert not editor.files.has_changes
    editor.files.save()  # from now on the files are in drawing order
    settle(editor)
    before, deleted = names_in(home), delete_every_third(editor)
    editor.document.change_rain("Intensity", intensity_mm_h=7.5)
    navigation, options = editor.viewport.navigation, editor.viewport.options
    navigation.position, navigation.heading = np.array([3.0, 2.0, 1.0]), 1.25
    options.gain_ev, options.look = 0.5, "depth"
    assert editor.files.has_changes
    editor.files.save()
    settle(editor)
    for change, has_changes in ((editor.document.undo, True), (editor.document.redo, False)):
        assert editor.files.has_changes != has_changes
        change()
        assert editor.files.has_changes == has_changes
    after = names_in(home)
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {"scene.json"}  # no Gaussians are written again
    again = sessions()
    again.files.open(str(home))
    settle(again)
    assert again.document.scene.members[0].marks.deleted.same_as(deleted)
    assert again.document.rain == editor.document.rain
    assert again.viewport.navigation.camera(9, 6).world_to_camera == pytest.approx(
        navigation.camera(9, 6).world_to_camera
    )
    assert again.viewport.options == options


def test_a_document_is_called_as_its_folder(editor, tmp_path):
    assert editor.files.title == "crossing"
    editor.files.save_as(tmp_path / "wet crossing")
    settle(editor)
    assert (editor.files.title, editor.files.proposed_name(".mp4")) == ("wet crossing", "wet_crossing.mp4")
    editor.document.change_rain("Intensity", intensity_mm_h=7.5)
    for ask in (editor.files.revert, editor.files.close_scene):
        ask()
        assert "wet crossing" in editor.status.question.text
        answer(editor, "Cancel")
    answered = editor.document.scene.name
    editor.files.open_now(str(tmp_path / "wet crossing"))
    settle(editor)
    assert (editor.files.title, editor.document.scene.name) == ("wet crossing", answered)


def test_opening_does_not_wait_for_what_is_no_longer_wanted(editor, tmp_path, monkeypatch):
    write_scene(small_scene("lane"), tmp_path / "lane")
    read, is_over = files.load_document, threading.Event()
    monkeypatch.setattr(files, "load_document", lambda path: is_over.wait(60) if path == "slow" else read(path))
    try:
        editor.files.open_now("slow")
        editor.files.open_now(str(tmp_path / "lane"))
        editor.background.tasks[1].future.result(timeout=30)
        editor.tick(0.0)
        editor.apply(DrawResult(editor.render_input(96, 64), is_pending_ready=True))
        assert editor.files.title == "lane"
    finally:
        is_over.set()
    settle(editor)
    assert (editor.files.title, editor.status.problem) == ("lane", None)


def test_rain_without_a_scene_is_nothing_to_save(sessions, home):
    editor = sessions()
    editor.document.change_rain("Intensity", intensity_mm_h=7.5)
    editor.files.open(str(home))
    assert editor.status.question is None
    settle(editor)
    assert editor.files.title == "crossing"


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
    autosaved, files = editor.files.recovery.autosaved_path, editor.files
    before = files.home, files.source, files.recent, editor.document.scene.name
    files.export_to(tmp_path / f"copy{suffix}")
    if editor.status.question is not None:
        answer(editor, "Export")
    settle(editor)
    assert read_scene(tmp_path / f"copy{suffix}").gaussian_count == editor.document.scene.gaussian_count
    assert editor.files.has_changes and editor.status.problem is None
    assert (files.home, files.source, files.recent, editor.document.scene.name) == before
    assert files.recovery.autosaved_path == autosaved and (autosaved / "scene" / "scene.json").is_file()
    editor.request_quit()
    assert editor.status.question.title == "Unsaved changes" and not editor.should_quit
    answer(editor, "Save")
    if source != "folder":
        files.place_request(tmp_path / "placed")
        settle(editor)
    assert editor.should_quit and files.home == (home if source == "folder" else tmp_path / "placed")


def test_an_export_over_the_open_scene_loses_nothing(sessions, home, tmp_path):
    flat = tmp_path / "flat.ply"
    write_scene(small_scene(), flat)
    editor, original = sessions(), flat.read_bytes()
    editor.files.open(str(flat))
    settle(editor)
    count, deleted = editor.document.scene.gaussian_count, delete_every_third(editor)
    editor.files.export_to(flat)
    assert "flat.ply that is there already is replaced" in editor.status.question.text
    answer(editor, "Cancel")
    assert flat.read_bytes() == original
    editor.files.export_to(flat)
    answer(editor, "Export")
    assert read_scene(flat).gaussian_count == count - len(deleted.indices) == editor.document.scene.gaussian_count
    assert editor.files.has_changes and editor.status.problem is None
    editor.document.undo()  # what was deleted is there still, and can be saved
    assert editor.document.scene.gaussian_count == count

    other = sessions()
    other.files.open(str(home))
    settle(other)
    before = {file: file.read_bytes() for file in home.rglob("*") if file.is_file()}
    for file in (next(each for each in before if each.suffix == ".ply"), home / "copy.ply"):
        other.files.export_to(file)
        settle(other)
        assert str(file) in other.status.problem and other.status.question is None
    assert {file: file.read_bytes() for file in home.rglob("*") if file.is_file()} == before


def test_an_export_says_before_what_it_leaves_out(editor, tmp_path):
    scene = editor.document.scene
    path = CameraPath(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.full(1, 40.0))
    hidden = SelectionFlags(hidden=BitMask.of(np.arange(len(scene.layers[1].gaussians)) < 5))
    scene = scene.with_member("layers/road", wet_sh=scene.layers[0].gaussians.sh)
    editor.document.edit("Edit", replace_scene, replace(scene.with_member("layers/wall", marks=hidden), path=path))
    editor.document.change_rain("Rain", intensity_mm_h=4.0)
    editor.views.save("Gate")
    editor.files.export_to(tmp_path / "out.ply")
    text = editor.status.question.text
    assert not (tmp_path / "out.ply").exists() and editor.files.busy is None
    held = ("3 layers", "sky", "5 hidden", "wet colors", "1 camera key\n", "1 named view\n", "the rain\n", "rig")
    for phrase in held:
        assert phrase in text
    for phrase in ("actor", "selection", "over time", "direction of view", "replaced"):
        assert phrase not in text
    answer(editor, "Cancel")
    assert not (tmp_path / "out.ply").exists()


def test_a_save_that_fails_does_not_leave(editor, monkeypatch):
    monkeypatch.setattr("gsrain_engine.editor.files.write_scene", full_disk)
    delete_every_third(editor)
    editor.request_quit()
    answer(editor, "Save")
    assert not editor.should_quit and editor.files.has_changes
    assert "No space left on device" in editor.status.problem


@pytest.mark.parametrize(("label", "on_disk", "here"), [
    ("Overwrite", "crossing", "crossing"), ("Reload", "theirs", "theirs"), ("Cancel", "theirs", "crossing"),
    ("Save as...", "theirs", "crossing"),
])  # fmt: skip
def test_a_file_changed_by_someone_else_is_noticed(editor, home, tmp_path, label, on_disk, here):
    delete_every_third(editor)
    values = json.loads((home / "scene.json").read_text())
    (home / "scene.json").write_text(json.dumps(values | {"name": "theirs"}))
    editor.files.save()
    assert editor.status.question.title == "Changed on disk"
    answer(editor, label)
    if label == "Save as...":
        editor.files.place_request(tmp_path / "mine")
        settle(editor)
        assert read_scene(tmp_path / "mine").name == "crossing"
    assert (read_scene(home).name, editor.document.scene.name) == (on_disk, here)


def bytes_in(folder):
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_what_a_job_or_a_program_makes_anew_has_no_folder_until_it_is_saved(editor, home, tmp_path):
    """Saving it over the scene that it has replaced would remove that one's layers and wet colors from the disk."""
    files, document, on_disk, made = editor.files, editor.document, bytes_in(home), tmp_path / "made"
    take = scene_results(editor.viewport, "Reconstruct", Recipe(reconstruct, {}), is_whole=True)
    scene = small_scene("made")
    for layers, is_final in ((scene.layers[:1], False), (scene.layers[:2], False), (scene.layers[:1], True)):
        take(replace(scene, layers=layers), is_final)
        settle(editor)
        assert (document.scene.layers, files.home) == (layers, None)
    assert document.history.labels == ["Opened", "Reconstruct"]
    document.change_rain("Intensity", intensity_mm_h=3.0)
    keep_now(editor)  # what is recovered later has no folder, too
    assert json.loads((files.recovery.autosaved_path / "autosave.json").read_text())["home"] is None
    files.export_to(home / "copy.ply")
    assert "copy.ply" in editor.status.problem
    files.save()
    settle(editor)
    assert files.place_request is not None and files.has_changes and bytes_in(home) == on_disk
    files.place_request(home)
    assert editor.status.question.title == "Replace a scene"
    answer(editor, "Cancel")
    assert bytes_in(home) == on_disk

    document.go_to_step(0)
    assert files.home == home
    document.go_to_step(2)
    files.save_as(made)
    settle(editor)
    assert files.home == made and not files.has_changes and len(read_scene(made).layers) == 1
    document.go_to_step(0)
    document.change_rain("Intensity", intensity_mm_h=4.0)
    files.save()  # each where it belongs, without a question
    settle(editor)
    assert editor.status.question is None and files.home == home
    assert (len(read_scene(home).layers), read_scene(home).rain["intensity_mm_h"]) == (3, 4.0)
    assert (len(read_scene(made).layers), read_scene(made).rain["intensity_mm_h"]) == (1, 3.0)
    document.set_contents("Scene of a program", scene, document.rain, "program")
    assert files.home is None


def test_a_scene_replaced_by_what_a_job_has_made_of_it_is_asked_about_after_undo(editor, home):
    take = scene_results(editor.viewport, "Reconstruct", Recipe(reconstruct, {}), is_whole=True)
    take(replace(small_scene("made"), layers=small_scene().layers[:1]), True)
    settle(editor)
    editor.files.save_as(home)
    answer(editor, "Replace")
    assert (read_scene(home).name, editor.files.home) == ("made", home)
    editor.document.undo()
    editor.files.save()
    assert editor.status.question.title == "Changed on disk"
    answer(editor, "Overwrite")
    assert len(read_scene(home).layers) == 3 and not editor.files.has_changes


def test_jobs_hold_the_scene_for_which_they_were_started(editor, tmp_path):
    """All kinds of the window that read the document; what becomes of their results is tested below."""
    editor.viewport.staged = PendingScene("Result of a job", editor.document.scene)  # until it is there, all wait
    editor.captures.capture, editor.captures.path = [], tmp_path
    write_rollout(tmp_path / "driven.jsonl", driven()[1])
    editor.rollouts.playing = load_rollout(tmp_path / "driven.jsonl")
    editor.wet_look.make()
    editor.wet_look.preview()
    editor.training.recolor()
    editor.rollouts.start()
    editor.rollouts.video_to(tmp_path / "drive.mp4")
    editor.render_queue.record_to(tmp_path / "clip.mp4")
    editor.render_queue.record_still_to(tmp_path / "still.png")
    editor.render_queue.draw_sheet_to(tmp_path / "sheet.png")
    waiting = editor.jobs.waiting
    editor.document.edit("Reconstruct", replace_scene, small_scene("made"), origin="job")
    for job in waiting:
        folder = tmp_path / f"{job.title}".replace("/", "_")
        folder.mkdir()
        job.inputs(folder)
        assert read_scene(folder / "scene").name == "crossing", job.title
    kinds = {"make rainy", "preview", "recolor", "drive", "drive video", "export"}
    assert {job.kind for job in waiting} == kinds and len(waiting) == 8


def test_results_of_jobs_are_left_out_of_a_scene_that_is_another(editor):
    take = scene_results(editor.viewport, "Apply wet look", Recipe(reconstruct, {}))
    scene = editor.document.scene
    rainy = scene.with_member("layers/road", wet_sh=scene.layers[0].gaussians.sh)
    editor.document.edit("Reconstruct", replace_scene, small_scene("made"), origin="job")
    assert "crossing" in take(rainy, True)
    settle(editor)
    assert not editor.document.scene.has_wet_colors
    editor.document.undo()
    assert take(rainy, True) is None
    settle(editor)
    assert editor.document.scene.has_wet_colors and editor.files.home is not None


def test_a_drive_plays_in_the_scene_that_it_was_started_in_alone(editor, tmp_path, monkeypatch):
    receivers = []
    monkeypatch.setattr(editor.jobs, "start", lambda _, receiver: receivers.append(receiver))
    editor.rollouts.start()
    write_rollout(tmp_path / "driven.jsonl", driven()[1])
    found = [load_rollout(tmp_path / "driven.jsonl")]
    editor.document.edit("Reconstruct", replace_scene, small_scene("made"), origin="job")
    assert "not open any more" in receivers[0](found, True)
    settled(editor)
    assert editor.rollouts.opened == found and editor.rollouts.playing is None
    editor.document.undo()
    assert receivers[0](found, True) == "collision with lead after 2.25 s"
    settled(editor)
    assert editor.rollouts.playing is found[0]


@pytest.mark.parametrize("saves_first", [False, True])
def test_a_layer_changed_by_someone_else_is_noticed(editor, home, saves_first):
    delete_every_third(editor)
    if saves_first:
        editor.files.save()
        settle(editor)
        assert editor.status.question is None and not editor.files.has_changes
        editor.document.edit("Rename", replace_scene, replace(editor.document.scene, name="later"))
    first, second, *_ = sorted(home.rglob("*.ply"))
    first.unlink()  # can't be overwritten
    content = second.read_bytes() + b"theirs"
    second.write_bytes(content)
    editor.files.save()
    assert editor.status.question.title == "Changed on disk" and second.read_bytes() == content
    answer(editor, "Overwrite")
    assert editor.status.question is None and not editor.files.has_changes
    assert read_scene(home).gaussian_count == editor.document.scene.gaussian_count


def test_revert_asks_and_reads_again(editor):
    delete_every_third(editor)
    editor.files.revert()
    assert editor.files.has_changes
    answer(editor, "Revert")
    assert editor.document.scene.members[0].marks.deleted is None and not editor.files.has_changes


def test_the_end_waits_for_a_job_and_takes_its_result_in(editor):
    job = HeldJob()
    job.start(editor)
    editor.request_quit()
    question = editor.status.question
    assert question.title == "Work goes on" and "Make it rainy" in question.text
    assert question.progress().fraction == 0.4
    answer(editor, "Wait")
    assert editor.status.question.title == "Waiting" and not editor.status.question.enter_answers
    assert job.state == "running" and not editor.should_quit
    road = editor.document.scene.layers[0]
    job.let_end(editor.document.scene.with_member(road.key, gaussians=road.gaussians.with_sh(road.gaussians.sh + 1)))
    job.wait(60)
    editor.tick(0.0)
    assert job.state == "finished" and editor.viewport.staged is not None and not editor.should_quit
    settle(editor)
    assert editor.document.history.undo_label == "Make it rainy"
    assert editor.status.question.title == "Unsaved changes" and not editor.should_quit
    answer(editor, "Don't save")
    assert editor.should_quit and editor.status.question is None


@pytest.mark.parametrize("go", [pytest.param("open", marks=pytest.mark.street), "close", "revert"])
def test_another_document_asks_about_jobs_that_end_with_this_one(editor, go):
    files = editor.files
    to_another = {"open": lambda: files.open("street"), "close": files.close_scene, "revert": files.revert}[go]
    job, recording = HeldJob(), HeldJob("Record clip.mp4", ends_with_scene=False)
    for each in (job, recording):
        each.start(editor)
    scene = editor.document.scene
    to_another()
    assert "Make it rainy is" in editor.status.question.text and not editor.viewport.is_opening
    answer(editor, "Cancel")
    assert editor.document.scene is scene and job.state == "running"
    to_another()
    answer(editor, "Wait")
    job.let_end()
    job.wait(60)
    editor.tick(0.0)
    settle(editor)
    assert editor.document.scene is not scene and (job.state, recording.state) == ("finished", "running")
    editor.request_quit()
    answer(editor, "Stop it")
    assert editor.should_quit
