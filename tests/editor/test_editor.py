import gc
import weakref
from concurrent.futures import wait

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import set_visible
from gsrain_engine.editor.edits.transform import pivot
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.shelter_map import shelter_map_of
from gsrain_engine.simulation.ground import road_surface_of
from gsrain_engine.simulation.obstacles import occupied_space_of
from oracles.drop_phases import displacement
from small_scene import small_scene


@pytest.fixture
def editor():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def test_moving_the_slider_moves_no_drop(editor):
    editor.document.change_rain("Intensity", intensity_mm_h=4.0)
    editor.tick(10.0)
    before = displacement(editor.live_rain.simulation.motion, editor.playback.clock.time_s)
    editor.document.change_rain("Intensity", intensity_mm_h=4.5)
    assert np.allclose(displacement(editor.live_rain.simulation.motion, editor.playback.clock.time_s), before)


def test_riding_along_follows_the_ego(editor):
    editor.viewport.options.follow_path = True
    editor.tick(2.0)
    shot = editor.viewport.shot(96, 64)
    assert shot.camera.position == pytest.approx([4.0, 0, 1.5])
    assert shot.velocity_m_s == pytest.approx([2.0, 0, 0])


def test_roofs_are_found_behind_the_window_and_rain_falls_through_them_until_then():
    editor = Editor(small_scene(), RainSettings(intensity_mm_h=8.5, roofs=True))
    assert editor.busy == "Finding roofs"
    assert not editor.split_panes[0].rainfall.rain.roofs
    editor.tick(0.0)
    wait(editor.pending_files, timeout=60)
    assert editor.busy is None
    assert editor.split_panes[0].rainfall is editor.live_rain.simulation
    editor.document.edit(
        "Show or hide", set_visible, editor.document.scene.layers[0].key, False
    )  # another scene, as seen from above
    assert editor.busy == "Finding roofs"
    editor.close()


def test_nothing_holds_on_to_a_closed_scene():
    editor = Editor(small_scene())
    occupied_space_of(editor.document.scene, road_surface_of(editor.document.scene))
    shelter_map_of(editor.document.scene)
    pivot(editor.document.scene, editor.document.scene.members[0].key)
    means = [weakref.ref(each.gaussians.means) for each in editor.document.scene.members]
    editor.files.close_scene()
    editor.tick(0.1)
    wait(editor.pending_files, timeout=60)
    gc.collect()
    assert means
    assert [each() for each in means] == [None] * len(means)
    editor.close()
