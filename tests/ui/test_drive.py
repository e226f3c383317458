"""Driving in the real window: from the panel, a roll-out that plays, plots that are clicked, the rig's cameras."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.simulation.agents.registry import open_agent
from gsrain_engine.simulation.rollout_io import read_rollout, write_rollout
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation, drive
from small_scene import small_scene
from window_driver import imgui

LEAD = {"id": "lead", "ahead_m": 9.0, "behaviour": {"kind": "constant-velocity"}}
CRASH = {"name": "crash", "speed_m_s": 2.0, "duration_s": 4.0, "road_users": [LEAD]}


@pytest.fixture(scope="module")
def rollout(tmp_path_factory):
    scenario = msgspec.convert(CRASH | {"rain": {"intensity_mm_h": 8.5}}, Scenario)
    simulation, agent = Simulation(scenario, small_scene()), open_agent("constant-velocity")
    for _ in drive(simulation, agent):
        pass
    path = tmp_path_factory.mktemp("drive") / "crash.jsonl"
    write_rollout(path, simulation.rollout(agent.name))
    return path


def test_a_scenario_is_changed_saved_and_driven_from_the_panel(driver, tmp_path):
    editor = driver.editor
    drives = editor.rollouts
    driver.ctx.window_focus("//Drive")
    driver.frames()
    driver.ctx.set_ref("//Drive")
    driver.tap("Change scenario")
    driver.ctx.item_input_value("**/##duration_s", 1.0)
    driver.type_in("**/##speed_m_s", 2.5)
    assert drives.setup.is_changed
    driver.ctx.item_click("**/###save scenario")
    driver.choose_file("Save scenario", tmp_path / "short.yaml")
    saved = load_scenario(tmp_path / "short.yaml")
    assert (saved.duration_s, saved.speed_m_s) == (1.0, 2.5)
    driver.ctx.set_ref("//Drive")
    driver.ctx.item_click("Change scenario")
    driver.ctx.combo_click("##agent/constant-velocity")
    driver.ctx.combo_click("##rain/one intensity")
    driver.frames()
    driver.type_in("##intensity_mm_h", 5.0)
    driver.ctx.set_ref("")
    driver.panel("Rain")
    with driver.journey(2):
        driver.tap(f"{driver.panel('Drive')}###drive")
    driver.until(lambda: len(editor.jobs.all) == 1)
    job = editor.jobs.all[0]
    driver.until_worked(lambda: job.state != "running" and not drives.is_working)
    assert (job.state, job.error, editor.status.problem) == ("finished", None, None)
    assert (drives.playing.intensity_mm_h, drives.playing.metrics.end) == (5.0, "time")
    assert job.progress.message == "no collision in 1.00 s (time)"
    driver.frames()
    driver.ctx.item_click("//Drive/###save roll-out")
    driver.choose_file("Save roll-out", tmp_path / "mine.jsonl")
    driver.until(lambda: not drives.is_working)
    assert read_rollout(tmp_path / "mine.jsonl") == drives.playing.rollout


def test_a_click_on_an_image_of_the_rig_looks_from_its_camera(driver):
    viewport, playback = driver.editor.viewport, driver.editor.playback
    viewport.ride(True)
    playback.clock.seek(2.0)
    driver.tap(f"{driver.panel('Camera rig')}###look from FRONT")
    scene = driver.editor.document.scene
    (front,) = scene.rigs["one"]
    expected, shown = front.camera(scene.ego_to_world(2.0)), viewport.shot(960, 640).camera
    assert np.allclose(shown.world_to_camera, expected.world_to_camera, atol=1e-6)
    assert shown.vertical_fov_deg == pytest.approx(expected.vertical_fov_deg)
    playback.clock.seek(3.0)
    assert np.array_equal(viewport.shot(960, 640).camera.world_to_camera, shown.world_to_camera)


def test_the_boxes_of_a_plan_are_those_of_the_rollout(driver, rollout):
    drives, viewport = driver.editor.rollouts, driver.editor.viewport
    driver.window.drop([str(rollout)])
    driver.until(lambda: drives.playing is not None and not drives.is_working)
    drives.show_boxes = drives.show_plan = False
    viewport.look_from_above()

    def yellow():
        return np.all(np.abs(driver.screen() - [255, 205, 60]) < 40, axis=-1).sum()

    before = yellow()
    viewport.options.marks = frozenset({"boxes"})
    assert yellow() > before + 30  # the lead and the ego vehicle; the scene has no road users


def test_a_rollout_that_was_dropped_plays_and_goes_away_again(driver, rollout):
    editor = driver.editor
    drives = editor.rollouts

    before = driver.picture()
    home = editor.viewport.navigation.camera(90, 60).world_to_camera
    driver.window.drop([str(rollout)])
    driver.until(lambda: drives.playing is not None and not drives.is_working)
    driver.ctx.window_focus("//Drive")
    driver.frames(3)
    first = driver.picture()
    assert np.abs(first - before).mean() > 2  # a car, another place, rain
    driver.tap("//Drive/###collision")
    assert drives.step_now.collision == "lead"
    driver.ctx.window_focus("//Drive plots")
    driver.frames(3)
    corner, size = driver.area("//Drive plots/##Speed")
    driver.click_at(corner + size / 2)
    assert 0.3 < editor.playback.clock.time_s / drives.playing.duration_s < 0.7
    driver.tap("//Drive/front camera")
    front = editor.viewport.navigation.camera(90, 60).world_to_camera
    driver.tap("//Drive/Ego car")
    assert [each.id for each in editor.rollouts.displayed_scene.actors] == ["lead"]
    driver.ctx.mouse_move("//View/view")
    driver.ctx.mouse_drag_with_delta(imgui.ImVec2(40, 0), 1)  # a person looks elsewhere
    driver.frames()
    assert driver.editor.viewport.chase.mode == "free"
    assert not np.allclose(editor.viewport.navigation.camera(90, 60).world_to_camera, front)
    # Its own rain is not the panel's, which says so; what was not saved is not closed without a question.
    driver.tap(f"{driver.panel('Rain')}Show this rain")
    assert not drives.shows_rain and not driver.ctx.item_exists("//Rain/Show this rain")
    saved = drives.playing
    drives.opened = [drives.playing, replace(saved, path=None)]
    drives.play(drives.opened[-1])
    driver.until(lambda: drives.playing is drives.opened[-1] and not drives.is_working)
    editor.viewport.chase.begin("front camera")
    for answer in ("Cancel", "Lose it"):
        editor.rollouts.close_all()
        assert editor.status.question.text.count("crash") == 1
        driver.frames(3)
        driver.tap(f"//{editor.status.question.title}/{answer}")
        assert len(drives.opened) == (2 if answer == "Cancel" else 0)
    assert drives.playing is None
    drives.opened = [saved, replace(saved)]
    drives.play(saved)
    driver.until(lambda: drives.playing is saved and not drives.is_working)
    editor.viewport.chase.begin("front camera")
    drives.close(saved)
    driver.until(lambda: drives.playing in drives.opened and not drives.is_working)
    assert editor.viewport.chase.mode == "front camera"
    driver.panel("Drive")
    driver.tap("//Drive/**/###close")
    assert (drives.playing, editor.document.history.cursor, editor.files.has_changes) == (None, 0, False)
    editor.playback.clock.seek(0.0)
    editor.viewport.go_home()
    assert np.allclose(editor.viewport.navigation.camera(90, 60).world_to_camera, home)
    assert np.abs(driver.picture() - before).max() <= 2
