"""Roll-outs in a session: opened, played, saved, closed; the document stays as it is."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.files import LoadedDocument
from gsrain_engine.editor.jobs.drive import load_rollout
from gsrain_engine.scene.formats.scene_folder import FileCache
from gsrain_engine.simulation.rollout_io import read_rollout, write_rollout

from .driven import driven, settled, stopped_session


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "crash.jsonl"
    write_rollout(path, driven()[1])
    return path


@pytest.fixture
def session(file):
    session = stopped_session(driven()[0])
    session.drives.open(session, file)
    settled(session)
    yield session
    session.close()


def test_an_opened_rollout_is_shown_and_the_document_stays(session, file):
    scene, drives = session.scene, session.drives
    assert (session.problem, drives.trouble) == (None, None)
    assert drives.playing.path == file
    assert [each.id for each in session.displayed_scene.actors] == ["lead", "ego car"]
    assert session.split_panes[0].scene is session.displayed_scene
    assert session.scene.actors == ()
    assert (session.history.cursor, session.has_changes) == (0, False)
    assert session.span_s == (0.0, drives.playing.duration_s)
    drives.close(session, drives.playing)
    assert session.displayed_scene is scene
    assert session.span_s == (0.0, 5.0)  # of the recorded drive
    assert drives.opened == []


def test_it_rains_as_it_was_driven_unless_a_person_wants_the_scene_s_rain(session):
    assert session.split_panes[0].rainfall.rain.intensity_mm_h == 8.5
    assert session.displayed_rain is session.displayed_rain
    session.drives.rain_as_driven = False
    assert session.split_panes[0].rainfall.rain.intensity_mm_h == 0.0


def test_a_comparison_has_the_same_traffic_on_both_sides(session):
    session.view.split = "clear | rainy"
    clear, rainy = session.split_panes
    assert clear.scene is rainy.scene
    assert (clear.rainfall.rain.intensity_mm_h, rainy.rainfall.rain.intensity_mm_h) == (0.0, 8.5)


def test_an_edit_of_the_document_is_seen_while_a_rollout_plays(session):
    session.show_member("layers/wall", False)
    assert not session.displayed_scene.member("layers/wall").visible
    assert [each.id for each in session.displayed_scene.actors] == ["lead", "ego car"]
    session.undo()
    assert session.displayed_scene.member("layers/wall").visible


def test_jumps_stop_at_the_collision_and_at_the_smallest_ttc(session):
    drives, playing = session.drives, session.drives.playing
    hit = next(step for step in playing.rollout.steps if step.collision == "lead")
    assert playing.collision_s == hit.time_s
    session.clock.playing = True
    drives.jump(session, playing.collision_s)
    assert not session.clock.playing
    assert drives.step_now(session).collision == "lead"
    drives.jump(session, playing.curves.min_ttc_time_s)
    assert playing.curves.ttc_s.min() == 0.0  # where it was hit
    assert session.clock.time_s == hit.time_s


def test_curves_follow_the_drive(session):
    curves = session.drives.playing.curves
    assert curves.speed_m_s == pytest.approx(np.full(len(curves.times_s), 2.0), abs=1e-3)
    before = curves.times_s < session.drives.playing.collision_s
    gap = curves.gap_m[before]
    assert np.diff(gap) == pytest.approx(np.full(len(gap) - 1, -0.5), abs=1e-3)  # 2 m/s, 0.25 s
    assert curves.ttc_s[before] == pytest.approx(gap / 2.0, rel=1e-3)


def test_several_stay_open_and_one_of_them_plays(session, tmp_path):
    write_rollout(tmp_path / "dry.jsonl", driven(0.0)[1])
    session.drives.open(session, tmp_path / "dry.jsonl")
    settled(session)
    first, second = session.drives.opened
    assert session.drives.playing is second
    assert (first.intensity_mm_h, second.intensity_mm_h) == (8.5, 0.0)
    session.drives.play(session, first)
    settled(session)
    assert session.split_panes[0].rainfall.rain.intensity_mm_h == 8.5
    session.drives.close(session, first)
    settled(session)
    assert session.drives.playing is second


@pytest.mark.parametrize("damage", ["not a roll-out", "torn", "absent"])
def test_what_is_no_rollout_is_told_and_nothing_changes(session, tmp_path, damage):
    bad, playing = tmp_path / "bad.jsonl", session.drives.playing
    if damage == "not a roll-out":
        bad.write_text("hello\n")
    elif damage == "torn":
        lines = (tmp_path / "crash.jsonl").read_bytes().splitlines()
        bad.write_bytes(b"\n".join([*lines[:3], lines[3][:20]]))
    session.drives.open(session, bad)
    settled(session)
    assert "bad.jsonl" in session.problem
    assert session.drives.playing is playing


def test_a_rollout_that_was_not_saved_is_asked_about_before_it_is_lost(session, tmp_path):
    session.request_quit()
    assert session.is_leaving  # it came from a file
    session.is_leaving = False
    own = replace(session.drives.playing, path=None)
    session.drives.opened, session.drives.playing = [own], own
    session.request_quit()
    question = session.questions.present
    assert own.title in question.text and not question.enter_answers and not session.is_leaving
    session.questions.answer(question.answers[-1])
    assert not session.is_leaving
    session.drives.save_as(session, tmp_path / "mine")
    settled(session)
    session.request_quit()
    assert session.is_leaving and session.questions.present is None


def test_a_rollout_is_saved_as_it_is(session, tmp_path, file):
    session.drives.save_as(session, tmp_path / "copy")
    settled(session)
    assert session.problem is None
    assert session.drives.playing.path == tmp_path / "copy.jsonl"
    assert (tmp_path / "copy.jsonl").read_bytes() == file.read_bytes()
    (tmp_path / "copy.jsonl").write_bytes(b"of somebody")
    session.drives.save_as(session, tmp_path / "copy")
    settled(session)
    assert (tmp_path / "copy.jsonl").read_bytes() == b"of somebody"
    session.questions.answer(session.questions.present.answers[0])
    settled(session)
    assert (tmp_path / "copy.jsonl").read_bytes() == file.read_bytes()
    session.drives.save_as(session, file / "copy.jsonl")  # a file is no folder
    settled(session)
    assert "can't be written" in session.problem


def test_another_document_closes_them(session):
    session.enter(LoadedDocument(driven(scale=0.25)[0], "", None, None, FileCache()))
    assert (session.drives.playing, session.drives.opened) == (None, [])


def test_a_rollout_that_does_not_belong_here_has_plots_but_no_picture(session, tmp_path):
    rollout = driven()[1]
    strange = msgspec.structs.replace(rollout, scenario={**rollout.scenario, "road_users": []}, scene="elsewhere")
    write_rollout(tmp_path / "strange.jsonl", strange)
    session.drives.open(session, tmp_path / "strange.jsonl")
    settled(session)
    assert "elsewhere" in session.drives.trouble
    assert session.problem == session.drives.trouble
    assert session.displayed_scene is session.scene
    assert session.drives.playing.metrics.collided_with == "lead"


def test_metrics_are_those_of_the_file(file):
    opened = load_rollout(file)
    assert opened.rollout == read_rollout(file)
    assert (opened.metrics.end, opened.metrics.collided_with) == ("collision", "lead")
    assert opened.title == "crash, 8.5 mm/h, constant-velocity"
