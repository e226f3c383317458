"""Roll-outs in a editor: opened, played, saved, closed; the document stays as it is."""

from dataclasses import replace

import msgspec
import pytest

from gsrain_engine.editor.edits.members import set_visible
from gsrain_engine.simulation.rollout_io import write_rollout

from .driven import driven, settled, stopped_session


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "crash.jsonl"
    write_rollout(path, driven()[1])
    return path


@pytest.fixture
def editor(file):
    editor = stopped_session(driven()[0])
    editor.rollouts.open(file)
    settled(editor)
    yield editor
    editor.close()


def test_an_opened_rollout_is_shown_and_the_document_stays(editor, file):
    scene, drives = editor.document.scene, editor.rollouts
    assert (editor.status.problem, drives.why_hidden) == (None, None)
    assert drives.playing.path == file
    assert [each.id for each in editor.rollouts.displayed_scene.actors] == ["lead", "ego car"]
    assert editor.split_panes[0].scene is editor.rollouts.displayed_scene
    assert editor.document.scene.actors == ()
    assert (editor.document.history.cursor, editor.files.has_changes) == (0, False)
    assert editor.playback.span_s == (0.0, drives.playing.duration_s)
    drives.close(drives.playing)
    assert editor.rollouts.displayed_scene is scene
    assert editor.playback.span_s == (0.0, 5.0)  # of the recorded drive
    assert drives.opened == []


def test_it_rains_as_it_was_driven_unless_a_person_wants_the_scene_s_rain(editor):
    assert editor.split_panes[0].rainfall.rain.intensity_mm_h == 8.5
    assert editor.live_rain.displayed is editor.live_rain.displayed
    editor.rollouts.rain_as_driven = False
    assert editor.split_panes[0].rainfall.rain.intensity_mm_h == 0.0


def test_an_edit_of_the_document_is_seen_while_a_rollout_plays(editor):
    editor.document.edit("Show or hide", set_visible, "layers/wall", False)
    assert not editor.rollouts.displayed_scene.member("layers/wall").visible
    assert [each.id for each in editor.rollouts.displayed_scene.actors] == ["lead", "ego car"]
    editor.document.undo()
    assert editor.rollouts.displayed_scene.member("layers/wall").visible


def test_several_stay_open_and_one_of_them_plays(editor, tmp_path):
    write_rollout(tmp_path / "dry.jsonl", driven(0.0)[1])
    editor.rollouts.open(tmp_path / "dry.jsonl")
    settled(editor)
    first, second = editor.rollouts.opened
    assert editor.rollouts.playing is second
    assert (first.intensity_mm_h, second.intensity_mm_h) == (8.5, 0.0)
    editor.rollouts.play(first)
    settled(editor)
    assert editor.split_panes[0].rainfall.rain.intensity_mm_h == 8.5
    editor.rollouts.close(first)
    settled(editor)
    assert editor.rollouts.playing is second


def test_a_rollout_that_was_not_saved_is_asked_about_before_it_is_lost(editor, tmp_path):
    editor.request_quit()
    assert editor.should_quit  # it came from a file
    editor.should_quit = False
    own = replace(editor.rollouts.playing, path=None)
    editor.rollouts.opened, editor.rollouts.playing = [own], own
    editor.request_quit()
    question = editor.status.question
    assert own.title in question.text and not question.enter_answers and not editor.should_quit
    editor.status.answer(question.answers[-1])
    assert not editor.should_quit
    editor.rollouts.save_as(tmp_path / "mine")
    settled(editor)
    editor.request_quit()
    assert editor.should_quit and editor.status.question is None


def test_a_rollout_is_saved_as_it_is(editor, tmp_path, file):
    editor.rollouts.save_as(tmp_path / "copy")
    settled(editor)
    assert editor.status.problem is None
    assert editor.rollouts.playing.path == tmp_path / "copy.jsonl"
    assert (tmp_path / "copy.jsonl").read_bytes() == file.read_bytes()
    (tmp_path / "copy.jsonl").write_bytes(b"of somebody")
    editor.rollouts.save_as(tmp_path / "copy")
    settled(editor)
    assert (tmp_path / "copy.jsonl").read_bytes() == b"of somebody"
    editor.status.answer(editor.status.question.answers[0])
    settled(editor)
    assert (tmp_path / "copy.jsonl").read_bytes() == file.read_bytes()
    editor.rollouts.save_as(file / "copy.jsonl")  # a file is no folder
    settled(editor)
    assert "can't be written" in editor.status.problem


def test_another_document_closes_them(editor):
    editor.files.close_scene()
    while editor.status.question is not None:
        editor.status.answer(editor.status.question.answers[0])
    assert (editor.rollouts.playing, editor.rollouts.opened) == (None, [])


def test_a_rollout_that_does_not_belong_here_has_plots_but_no_picture(editor, tmp_path):
    rollout = driven()[1]
    strange = msgspec.structs.replace(rollout, scenario={**rollout.scenario, "road_users": []}, scene="elsewhere")
    write_rollout(tmp_path / "strange.jsonl", strange)
    editor.rollouts.open(tmp_path / "strange.jsonl")
    settled(editor)
    assert "elsewhere" in editor.rollouts.why_hidden
    assert editor.status.problem == editor.rollouts.why_hidden
    assert editor.rollouts.displayed_scene is editor.document.scene
    assert editor.rollouts.playing.metrics.collided_with == "lead"
