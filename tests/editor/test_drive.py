"""Drives in the editor: placed in scenes, drawn over them, opened and saved, and driven in a worker process."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.drive import EGO_CAR, RolloutInScene
from gsrain_engine.editor.edits.members import set_visible
from gsrain_engine.editor.jobs.drive import DriveSettings
from gsrain_engine.editor.overlays_drive import planned_points_m, rollout_overlay
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.simulation.rollout_io import write_rollout
from gsrain_engine.simulation.scenario import Scenario

from .driven import CRASH, driven, settled

UP = np.array([0.0, 0.0, 1.0])


def world_position(scene, key, time_s):
    return (scene.scene_to_world @ scene.member(key).pose_at(time_s))[:3, 3]


def test_a_drive_is_in_the_scenes_rain_or_another_or_the_papers_four():
    present = RainSettings(intensity_mm_h=3.0, seed=7)
    expected = {"as the scene": [3.0], "one intensity": [25.0], "paper's four": [0.0, 1.2, 8.5, 12.0]}
    for rain, rates in expected.items():
        found = DriveSettings(agent="constant-velocity", rain=rain, intensity_mm_h=25.0).rains(present)
        assert [each.intensity_mm_h for each in found] == rates and {each.seed for each in found} == {7}


@pytest.mark.parametrize(("start_s", "scale"), [(0.0, 1.0), (0.7, 0.25)])
def test_everybody_is_where_the_rollout_says_between_its_steps_too(start_s, scale):
    scene, rollout = driven(start_s=start_s, scale=scale)
    placed = RolloutInScene(rollout, scene)
    played = placed.scene(scene, with_ego=True)
    first, second = rollout.steps[2], rollout.steps[3]
    for part in (0.0, 0.3):
        time_s = start_s + (1 - part) * first.time_s + part * second.time_s
        x = (1 - part) * first.ego.x_m + part * second.ego.x_m
        assert played.ego_to_world(time_s)[:3, 3] == pytest.approx((x, first.ego.y_m, 1.5), abs=0.01)
        middle = (x + placed.scenario.vehicle.middle_m, first.ego.y_m, 0.0)
        assert world_position(played, f"actors/{EGO_CAR}", time_s) == pytest.approx(middle, abs=0.01)
        lead = first.road_users[0]
        assert world_position(played, "actors/lead", time_s) == pytest.approx((lead.x_m, lead.y_m, lead.z_m))


def test_a_placed_rollout_copies_no_gaussians_and_fits_scenes_without_its_actors():
    scene, rollout = driven()
    placed = RolloutInScene(rollout, scene)
    with_ego, without = placed.scene(scene, with_ego=True), placed.scene(scene, with_ego=False)
    assert placed.scene(scene, with_ego=True) is with_ego
    assert [each.id for each in without.actors] == ["lead"]
    assert all(a is b for a, b in zip(with_ego.layers, scene.layers, strict=True))
    edited = scene.with_member("layers/wall", visible=False)
    assert placed.scene(edited, with_ego=True).actors[0].gaussians is with_ego.actors[0].gaussians
    stranger = replace(without.actors[0], id="stranger")
    assert placed.fits(edited) and placed.fits(replace(scene, actors=(stranger,)))
    assert not placed.fits(replace(scene, metres_per_unit=2.0)) and not placed.fits(without)


def test_plan_and_boxes_lie_on_the_road_and_who_is_hit_is_marked_then():
    scene, rollout = driven()
    placed, step = RolloutInScene(rollout, scene), rollout.steps[2]
    places = planned_points_m(placed, step, step.time_s)
    assert places[0, :2] == pytest.approx((step.ego.x_m, step.ego.y_m))
    assert np.diff(places[:, 0]) == pytest.approx(np.full(6, 1.0), abs=1e-2)  # half a second apart, at 2 m/s
    assert places[:, 2] == pytest.approx(0.04, abs=0.01)
    later = planned_points_m(placed, step, step.time_s + 0.2)
    assert later[0, 0] == pytest.approx(step.ego.x_m + 0.4, abs=1e-2)
    assert later[1:] == pytest.approx(places[1:])  # the plan stays while it is followed
    camera = Camera.from_fov(600, 600, 60.0, look_at(np.array([5.0, 0, 20]), np.array([5.0, 0.1, 0]), UP))
    for time_s, is_hit in ((1.0, False), (placed.played.end_s, True)):
        boxes = {box.name: box for box in rollout_overlay(placed, time_s, camera, from_inside=False).boxes}
        assert {name: box.is_hit for name, box in boxes.items()} == {"lead": is_hit, "ego": is_hit}
    length_m, _, height_m = rollout.users["lead"].size_lwh_m
    assert np.ptp(boxes["lead"].lines_px[..., 0]) == pytest.approx(length_m * camera.fx / (20 - height_m), rel=0.05)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "crash.jsonl"
    write_rollout(path, driven()[1])
    return path


@pytest.fixture
def player(editor, file):
    editor.rollouts.open(file)
    settled(editor)
    return editor.rollouts


def test_the_last_opened_rollout_plays_in_place_of_the_traffic_until_it_is_closed(editor, player, file, tmp_path):
    scene, first = editor.document.scene, player.playing
    assert (editor.status.problem, player.why_hidden, first.path) == (None, None, file)
    assert [each.id for each in player.displayed_scene.actors] == ["lead", "ego car"]
    assert editor.split_panes[0].scene is player.displayed_scene
    assert (editor.document.scene, editor.files.has_changes) == (scene, False)
    assert editor.playback.span_s == (0.0, first.duration_s)
    write_rollout(tmp_path / "dry.jsonl", driven(0.0)[1])
    player.open(tmp_path / "dry.jsonl")
    settled(editor)
    assert [each.intensity_mm_h for each in player.opened] == [8.5, 0.0] and player.playing is player.opened[1]
    player.play(first)
    assert player.is_placing and player.playing is not first
    settled(editor)
    assert player.playing is first and not player.is_placing
    assert first.outcome == f"collision with lead after {first.duration_s:.2f} s"
    assert editor.split_panes[0].rainfall.rain.intensity_mm_h == 8.5
    player.close(first)
    settled(editor)
    assert player.playing is player.opened[0]
    player.close(player.playing)
    assert (player.opened, player.displayed_scene) == ([], scene)
    assert editor.playback.span_s == (0.0, 5.0)  # of the recorded drive


def test_a_rollout_is_saved_as_it_is_and_asked_about_before_it_is_lost(editor, player, file, tmp_path):
    editor.request_quit()
    assert editor.should_quit  # it came from a file
    editor.should_quit = False
    own = replace(player.playing, path=None)
    player.opened, player.playing = [own], own
    editor.request_quit()
    question = editor.status.question
    assert own.title in question.text and not question.enter_answers
    editor.status.answer(question.answers[-1])
    assert not editor.should_quit
    (tmp_path / "copy.jsonl").write_bytes(b"of somebody")
    player.save_as(tmp_path / "copy")
    settled(editor)
    assert (tmp_path / "copy.jsonl").read_bytes() == b"of somebody"
    editor.status.answer(editor.status.question.answers[0])
    settled(editor)
    assert (tmp_path / "copy.jsonl").read_bytes() == file.read_bytes()
    assert (editor.status.problem, player.playing.path) == (None, tmp_path / "copy.jsonl")
    editor.request_quit()
    assert editor.should_quit and editor.status.question is None
    player.save_as(file / "copy.jsonl")  # a file is no folder
    settled(editor)
    assert str(file) in editor.status.problem


def test_a_rollout_of_another_scene_has_plots_but_no_picture(editor, player, tmp_path):
    rollout = driven()[1]
    strange = msgspec.structs.replace(rollout, scenario={**rollout.scenario, "road_users": []}, scene="elsewhere")
    write_rollout(tmp_path / "strange.jsonl", strange)
    player.open(tmp_path / "strange.jsonl")
    settled(editor)
    assert "elsewhere" in player.why_hidden and editor.status.problem == player.why_hidden
    assert player.displayed_scene is editor.document.scene
    assert player.playing.metrics.collided_with == "lead"


@pytest.mark.street
def test_the_edited_scene_is_driven_through_in_a_worker_and_the_drive_is_opened(editor):
    player, history = editor.rollouts, editor.document.history
    editor.document.change_rain("Rain", intensity_mm_h=4.0)
    editor.document.edit("Show or hide", set_visible, "layers/wall", False)
    player.setup.settings = msgspec.structs.replace(player.setup.settings, agent="constant-velocity")
    player.setup.change(msgspec.convert(CRASH | {"duration_s": 3.0}, Scenario))
    player.start()
    assert player.why_not is None  # another one would wait
    (job,), pictures, labels = editor.jobs.all, [], list(history.labels)
    while job.state == "running":
        editor.jobs.wait(60)
        editor.tick(0.0)
        if job.progress.preview is not None:
            pictures.append(job.progress.preview)
    settled(editor)
    assert (job.kind, job.state, job.error, editor.status.problem) == ("drive", "finished", None, None)
    assert player.opened == [player.playing]
    metrics = player.playing.metrics
    assert (player.playing.intensity_mm_h, player.playing.path) == (4.0, None)
    assert (metrics.collided_with, metrics.with_background) == ("lead", True)
    assert pictures[-1].shape[1] == 320 and np.ptp(pictures[-1]) > 50
    assert (history.labels, player.step_now.step) == (labels, 0)
