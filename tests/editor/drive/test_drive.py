"""Roll-outs in the editor: setup, playback, files and overlays."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.drive import EGO_CAR, RolloutInScene
from gsrain_engine.editor.overlays_drive import planned_points_m, rollout_overlay
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.simulation.rollout_io import write_rollout

from .driven import driven, settled, stopped_session


def world_pose(scene, key, time_s):
    member = scene.member(key)
    return scene.scene_to_world @ member.pose_at(time_s)


@pytest.mark.parametrize(("start_s", "scale"), [(0.0, 1.0), (0.7, 0.25)])
def test_everybody_is_where_the_rollout_says_between_its_steps_too(start_s, scale):
    scene, rollout = driven(start_s=start_s, scale=scale)
    placed = RolloutInScene(rollout, scene)
    played = placed.scene(scene, with_ego=True)
    first, second = rollout.steps[2], rollout.steps[3]
    for part in (0.0, 0.3):
        time_s = start_s + (1 - part) * first.time_s + part * second.time_s
        x = (1 - part) * first.ego.x_m + part * second.ego.x_m
        rig = played.ego_to_world(time_s)
        assert rig[:3, 3] == pytest.approx((x, first.ego.y_m, 1.5), abs=0.01)
        body = world_pose(played, f"actors/{EGO_CAR}", time_s)
        assert body[:3, 3] == pytest.approx((x + placed.scenario.vehicle.middle_m, first.ego.y_m, 0.0), abs=0.01)
        lead = first.road_users[0]
        assert world_pose(played, "actors/lead", time_s)[:3, 3] == pytest.approx((lead.x_m, lead.y_m, lead.z_m))


def test_the_same_scene_gives_the_same_value_and_no_gaussians_are_copied():
    scene, rollout = driven()
    placed = RolloutInScene(rollout, scene)
    with_ego, without = placed.scene(scene, with_ego=True), placed.scene(scene, with_ego=False)
    assert placed.scene(scene, with_ego=True) is with_ego
    assert placed.scene(scene, with_ego=False) is without
    assert [each.id for each in without.actors] == ["lead"]
    assert all(a is b for a, b in zip(with_ego.layers, scene.layers, strict=True))
    edited = scene.with_member("layers/wall", visible=False)
    assert placed.fits(edited)
    assert placed.scene(edited, with_ego=True).actors[0].gaussians is with_ego.actors[0].gaussians
    assert not placed.fits(replace(scene, metres_per_unit=2.0))
    stranger = replace(without.actors[0], id="stranger")
    assert placed.fits(replace(scene, actors=(stranger,)))
    assert not placed.fits(replace(scene, actors=without.actors))  # it has an actor of its own called lead


@pytest.fixture
def placed():
    scene, rollout = driven()
    return RolloutInScene(rollout, scene)


def from_above(height_m=20.0):
    pose = look_at(np.array([5.0, 0, height_m]), np.array([5.0, 0.1, 0]), np.array([0, 1.0, 0]))
    return Camera.from_fov(600, 600, 60.0, pose)


def test_planned_points_lie_on_the_road_half_a_second_apart(placed):
    step = placed.played.rollout.steps[2]
    places = planned_points_m(placed, step, step.time_s)
    assert places[0, :2] == pytest.approx((step.ego.x_m, step.ego.y_m))
    assert np.diff(places[:, 0]) == pytest.approx(np.full(6, 1.0), abs=1e-2)  # 2 m/s
    assert places[:, 2] == pytest.approx(0.04, abs=0.01)
    later = planned_points_m(placed, step, step.time_s + 0.2)
    assert later[0, 0] == pytest.approx(step.ego.x_m + 0.4, abs=1e-2)
    assert later[1:] == pytest.approx(places[1:])  # the plan stays while it is followed


def test_who_is_hit_is_marked_when_it_is_hit(placed):
    camera = from_above()
    hit_s = placed.played.end_s
    early = {box.name: box for box in rollout_overlay(placed, 1.0, camera, from_inside=False).boxes}
    late = {box.name: box for box in rollout_overlay(placed, hit_s, camera, from_inside=False).boxes}
    assert [early[name].is_hit for name in ("lead", "ego")] == [False, False]
    assert [late[name].is_hit for name in ("lead", "ego")] == [True, True]
    assert late["lead"].lines_px.shape == (12, 2, 2)
    width = np.ptp(late["lead"].lines_px[..., 0])
    near = camera.fx / (20.0 - placed.played.rollout.users["lead"].size_lwh_m[2])
    assert width == pytest.approx(placed.played.rollout.users["lead"].size_lwh_m[0] * near, rel=0.05)


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


def test_an_opened_rollout_is_drawn_and_the_document_stays(editor, file):
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
