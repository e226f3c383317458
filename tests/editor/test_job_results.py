"""Scenes of jobs as undo steps, handed over as a runner does."""

from dataclasses import replace

import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.job_results import scene_results
from small_scene import small_scene


@pytest.fixture
def session():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def grown(layers):
    scene = small_scene("grown")
    return replace(scene, layers=scene.layers[:layers])


def test_snapshots_and_result_are_one_step_that_is_undone_at_once(session):
    before, take = session.scene, scene_results(session, "Grow", is_whole=True)
    for layers, is_final in ((1, False), (2, False), (3, True)):
        take(grown(layers), is_final)
        session.swap_in()
        assert len(session.scene.layers) == layers
        assert session.history.labels == ["Open", "Grow"]
    session.undo()
    assert session.scene is before
    session.redo()
    assert len(session.scene.layers) == 3


def test_a_snapshot_waits_for_the_one_before_but_the_result_replaces_it(session):
    take = scene_results(session, "Grow", is_whole=True)
    for layers, is_final, staged in ((1, False, 1), (2, False, 1), (3, True, 3)):
        take(grown(layers), is_final)
        assert len(session.staged.scene.layers) == staged


def test_a_result_is_a_step_of_its_own_after_another_edit(session):
    take = scene_results(session, "Grow", is_whole=True)
    take(grown(1), False)
    session.swap_in()
    session.undo()
    session.change_rain("Intensity", intensity_mm_h=5.0)
    take(grown(2), False)
    session.swap_in()
    assert session.history.labels == ["Open", "Intensity"]
    take(grown(3), True)
    session.swap_in()
    assert session.history.labels == ["Open", "Intensity", "Grow"]
    assert len(session.scene.layers) == 3
    assert session.rain.intensity_mm_h == 5


def test_wet_colors_are_added_to_the_scene_as_it_is_by_then(session):
    road = session.scene.member("layers/road")
    colored = session.scene.with_member(road.key, wet_sh=road.gaussians.sh * 0.5)
    session.show_member("layers/wall", False)
    scene_results(session, "Recolor")(colored, True)
    session.swap_in()
    assert session.scene.member(road.key).wet_sh is colored.member(road.key).wet_sh
    assert not session.scene.member("layers/wall").visible
    assert session.history.undo_label == "Recolor"


def test_a_scene_that_is_being_opened_is_not_replaced(session, tmp_path):
    before, take = session.scene, scene_results(session, "Grow", is_whole=True)
    session.open("street")
    take(grown(3), True)
    session.swap_in()
    assert session.scene is before and session.is_opening
