"""Time of the editor, and what it lets go of."""

import gc
import weakref

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.editor.clock import PlaybackClock
from gsrain_engine.editor.edits.transform import pivot
from gsrain_engine.rain.shelter_map import shelter_map_of
from gsrain_engine.simulation.ground import road_surface_of
from gsrain_engine.simulation.obstacles import occupied_space_of


def test_at_the_end_of_its_span_time_begins_again_or_stops():
    clock = PlaybackClock(4.5)
    clock.advance(1.0, (1.0, 5.0))
    assert clock.time_s == pytest.approx(1.5)
    clock.loop, clock.time_s = False, 4.5
    clock.advance(1.0, (1.0, 5.0))
    assert (clock.time_s, clock.playing) == (5.0, False)
    clock.toggle()
    clock.advance(0.25, (1.0, 5.0))
    assert (clock.time_s, clock.playing) == (1.25, True)


@given(st.integers(0, 3000), st.sampled_from([24.0, 25.0, 30.0, 60.0]))
def test_steps_go_from_frame_to_frame_and_back(frame, fps):
    clock = PlaybackClock(frame / fps)
    clock.step(1, fps)
    assert clock.time_s == pytest.approx((frame + 1) / fps)
    clock.step(-1, fps)
    assert clock.time_s == pytest.approx(frame / fps)
    assert not clock.playing


def test_nothing_holds_on_to_a_closed_scene(editor):
    scene = editor.document.scene
    occupied_space_of(scene, road_surface_of(scene))
    shelter_map_of(scene)
    pivot(scene, scene.members[0].key)
    means = [weakref.ref(each.gaussians.means) for each in scene.members]
    del scene
    editor.files.close_scene()
    editor.tick(0.1)
    editor.background.wait(60)
    gc.collect()
    assert [each() for each in means] == 3 * [None]
