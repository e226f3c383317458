"""The camera path of a session: keys, drags, files, and the ride that follows from them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.editor import camera_path
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.overlays import drag_in_view, path_overlay_of
from gsrain_engine.editor.timeline import content_span
from gsrain_engine.editor.viewport.picking import project_lines
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.camera_path_edit import ViewAngles, shift_path_time
from gsrain_engine.scene.camera_path_io import write_camera_path
from gsrain_engine.scene.scene import Scene
from small_scene import small_scene

AXES = {"metres_per_unit": 0.25, "up": (0.0, -1.0, 0.0)}


@pytest.fixture
def session():
    opened = Editor(replace(small_scene(), **AXES))
    opened.clock.playing = False
    yield opened
    opened.close()


def look_from(session, time_s, x):
    session.clock.seek(time_s)
    session.navigation.position = np.array([x, 0.5 * x, 2.0])
    session.navigation.heading = 0.1 * x


def four_keys(session):
    for time_s, x in ((0.0, 0.0), (1.0, 2.0), (2.0, 5.0), (4.0, 9.0)):
        look_from(session, time_s, x)
        camera_path.add_keyframe(session)
    return session.scene.path


def test_a_key_shows_what_the_view_showed_whatever_the_scene_s_axes(session):
    look_from(session, 1.0, 3.0)
    seen = session.shot(96, 64).camera
    camera_path.add_keyframe(session)
    assert session.timeline.key == 0
    look_from(session, 1.0, 8.0)
    camera_path.go_to_keyframe(session, 0)
    again = session.shot(96, 64).camera
    assert np.allclose(again.world_to_camera, seen.world_to_camera, atol=1e-9)
    assert again.fy == pytest.approx(seen.fy)
    assert np.linalg.norm(session.scene.path.positions[0]) == pytest.approx(4 * np.linalg.norm(seen.position))


def test_the_same_moment_updates_and_every_step_is_undone(session):
    bare = session.scene
    four_keys(session)
    look_from(session, 2.0, 20.0)
    camera_path.add_keyframe(session)
    assert len(session.scene.path.times_s) == 4
    assert session.history.undo_label == "Update keyframe"
    assert session.path.positions[2] == pytest.approx([20, 10, 2])
    for _ in range(5):
        session.undo()
    assert session.scene is bare
    assert camera_path.active_keyframe(session) is None


def test_keys_are_appended_at_the_usual_distance(session):
    camera_path.append_keyframe(session)
    assert session.scene.path.times_s.tolist() == [0]
    camera_path.append_keyframe(session)
    assert session.scene.path.times_s.tolist() == [0, 2]
    camera_path.retime_keyframe(session, 1, 0.5)
    camera_path.append_keyframe(session)
    assert session.scene.path.times_s.tolist() == [0, 0.5, 1.0]
    assert session.clock.time_s == 1.0


def test_roll_is_kept_by_a_ride_and_lost_by_the_hand(session):
    four_keys(session)
    camera_path.place_keyframe(session, 1, "Turn", look=ViewAngles(10.0, -5.0, 25.0))
    assert camera_path.key_angles(session, 1) == pytest.approx((10, -5, 25), abs=1e-6)
    camera_path.go_to_keyframe(session, 1)
    assert session.shot(96, 64).camera.world_to_camera[1, 2] == pytest.approx(
        -np.cos(np.radians(25)) * np.cos(np.radians(5)), abs=1e-6
    )
    session.stop_riding()
    assert session.navigation.position == pytest.approx(session.path.positions[1])
    assert np.degrees(session.navigation.pitch) == pytest.approx(-5)
    assert session.shot(96, 64).camera.world_to_camera[0, 2] == pytest.approx(0)  # level again


def test_a_drag_is_one_step_whichever_way_it_went(session):
    path = four_keys(session)
    camera_path.begin_drag(session, 1)
    for seconds in (0.3, 3.7, 0.9):
        camera_path.drag_in_time(session, seconds)
    camera_path.end_drag(session)
    assert session.scene.path.times_s == pytest.approx([0, 1.9, 2, 4])
    assert session.history.labels[-2:] == ["Insert keyframe", "Move keyframe"]
    session.undo()
    assert session.scene.path is path
    camera_path.begin_drag(session, 0)
    camera_path.drag_in_time(session, -5.0)  # not before 0
    camera_path.end_drag(session)
    assert session.scene.path.times_s[0] == 0


def test_a_drag_in_the_picture_follows_the_hand(session):
    four_keys(session)
    look_from(session, 0.0, -6.0)
    session.navigation.heading = 0.4
    shot = session.shot(600, 400)
    before = {mark.key: np.array(mark.handle_px) for mark in path_overlay_of(session, shot.camera).keys}
    camera_path.begin_drag(session, 3, in_view=True)
    for moved in ((5.0, 5.0), (31.0, -12.0)):
        drag_in_view(session, shot, moved, upright=False)
    camera_path.end_drag(session)
    after = {mark.key: np.array(mark.handle_px) for mark in path_overlay_of(session, shot.camera).keys}
    assert after[3] == pytest.approx(before[3] + [31, -12], abs=1e-6)
    assert after[2] == pytest.approx(before[2])
    camera_path.begin_drag(session, 3, in_view=True)
    place = session.path.positions[3]
    drag_in_view(session, shot, (9.0, -20.0), upright=True)
    assert session.path.positions[3][:2] == pytest.approx(place[:2])
    assert session.path.positions[3][2] > place[2]


def test_lines_are_cut_off_at_the_eye(session):
    camera = session.shot(96, 64).camera
    eye, forward = camera.position, camera.world_to_camera[2, :3]
    ahead = eye + 5 * forward
    lines = np.array(
        [[ahead, eye - 5 * forward], [eye - forward, eye - 2 * forward], [ahead, ahead + camera.world_to_camera[0, :3]]]
    )
    seen = project_lines(lines, camera)
    assert len(seen) == 2
    assert seen[0] == pytest.approx(np.tile([48.0, 32.0], (2, 1)), abs=1e-6)
    assert seen[1, 1] == pytest.approx([48 + camera.fx / 5, 32])


def test_what_the_window_rides_is_what_a_recording_shows(session):
    four_keys(session)
    camera_path.change_path(session, "Loop", loop=True, easing="in and out")
    session.view.follow_path = True
    sequence = FrameSequence(session.scene, session.rainfall, session.path, 96, 64, 30.0, in_scene_time=True)
    for number in (0, 31, 100, 250):
        session.clock.seek(sequence.time_s(number))
        ridden, recorded = session.shot(96, 64), sequence.shot(number)
        assert ridden.time_s == recorded.time_s
        assert np.array_equal(ridden.camera.world_to_camera, recorded.camera.world_to_camera)
        assert np.array_equal(ridden.velocity_m_s, recorded.velocity_m_s)


def test_the_path_is_the_same_value_until_something_changes(session):
    default = session.path
    assert session.path is default
    session.change_rain("Rain", intensity_mm_h=3.0)
    assert session.path is default
    four_keys(session)
    own = session.path
    assert session.path is own is not default
    session.set_scene("Scale", replace(session.scene, metres_per_unit=0.5))
    assert session.path.positions == pytest.approx(2 * own.positions)
    camera_path.delete_path(session)
    assert session.path.positions == pytest.approx(2 * default.positions)


def test_a_path_changes_no_picture(session):
    session.sky_is_stale, looks = False, session.scene.appearance
    four_keys(session)
    assert session.scene.appearance == looks
    assert hash(session.scene.appearance) == hash(looks)
    assert not session.sky_is_stale
    session.show_member("layers/wall", False)
    assert session.scene.appearance != looks
    assert session.sky_is_stale


def test_whole_paths_are_stretched_and_reversed(session):
    path = four_keys(session)
    camera_path.stretch_path(session, 8.0)
    assert session.scene.path.times_s.tolist() == [0, 2, 4, 8]
    camera_path.reverse_path(session)
    assert session.scene.path.times_s.tolist() == [0, 4, 6, 8]
    assert session.scene.path.positions[0] == pytest.approx(path.positions[3])
    steps = len(session.history.labels)
    camera_path.stretch_path(session, 0.0)
    assert "fall together" in session.problem
    assert len(session.history.labels) == steps


def test_a_circle_starts_at_the_view_and_looks_at_its_target(session):
    session.navigation.distance_m = 6.0
    seen, target = session.shot(96, 64).camera, session.navigation.target
    camera_path.circle_target(session)
    assert np.allclose(session.path.camera(0.0, 96, 64).world_to_camera, seen.world_to_camera, atol=1e-9)
    assert session.span_s == (0, 12)
    for t in (2.0, 7.5, 11.9):
        camera = session.path.camera(t, 96, 64)
        assert camera.world_to_camera[:3, :3] @ target + camera.world_to_camera[:3, 3] == pytest.approx(
            [0, 0, 6], abs=0.01
        )
    session.undo()
    assert session.scene.path is None


def test_next_and_previous_keys(session):
    four_keys(session)
    session.clock.seek(0.5)
    for steps, time_s in ((1, 1.0), (1, 2.0), (1, 4.0), (1, 4.0), (-1, 2.0)):
        camera_path.go_to_next_keyframe(session, steps)
        assert session.clock.time_s == time_s
    assert session.view.follow_path


def test_what_has_no_path_is_left_alone(session):
    bare = session.scene
    for change in (
        lambda: camera_path.update_keyframe(session, 0), lambda: camera_path.delete_keyframe(session, 0),
        lambda: camera_path.delete_path(session),
        lambda: camera_path.retime_keyframe(session, 0, 1.0), lambda: camera_path.reverse_path(session),
        lambda: camera_path.stretch_path(session, 3.0), lambda: camera_path.go_to_next_keyframe(session, 1),
        lambda: camera_path.begin_drag(session, 0), lambda: camera_path.drag_in_time(session, 1.0),
        lambda: camera_path.end_drag(session),
    ):  # fmt: skip
        change()
    assert session.scene is bare
    assert path_overlay_of(session, session.shot(96, 64).camera) is None


def test_the_drive_becomes_a_path_and_keys_snap_to_it(session):
    camera_path.path_from_drive(session, every_s=1.0)
    assert len(session.scene.path.times_s) == 6
    drive = session.path
    camera_path.place_keyframe(
        session, 2, "Move", position_m=drive.positions[2] + np.array([0, 0, 3.0]), look=ViewAngles(90, 0, 0)
    )
    camera_path.snap_keyframe(session, 2)
    assert session.path.positions[2] == pytest.approx(drive.positions[2], abs=1e-6)
    assert abs(session.path.quaternions_wxyz[2] @ drive.quaternions_wxyz[2]) == pytest.approx(1)


def test_without_a_drive_it_is_told():
    session = Editor(Scene("empty"))
    camera_path.path_from_drive(session)
    assert "no ego vehicle" in session.problem
    assert session.scene.path is None
    session.close()


@pytest.mark.parametrize("form", ["keyframes", "nerfstudio", "training cameras"])
def test_exports_read_back_or_are_reported(session, tmp_path, form):
    path = four_keys(session)
    camera_path.export_path(session, tmp_path / "out", form)
    camera_path.import_path(session, tmp_path / "out.json")
    assert session.scene.path is not path
    assert session.scene.path.positions[0] == pytest.approx(path.positions[0], abs=1e-9)
    assert session.scene.path.positions[-1] == pytest.approx(path.positions[-1], abs=1e-6)
    camera_path.export_path(session, tmp_path / "out.json" / "out.json", form)  # a file is no folder
    assert "can't be written" in session.problem


def test_a_path_from_before_time_began_is_imported_later(session, tmp_path):
    write_camera_path(tmp_path / "early.json", shift_path_time(four_keys(session), -3.0))
    camera_path.import_path(session, tmp_path / "early.json")
    assert session.scene.path.times_s.tolist() == [0, 1, 2, 4]


def test_the_span_is_that_of_the_flight_else_of_what_happens(session):
    assert session.span_s == (0, 5)  # the ego's drive
    camera_path.add_keyframe(session)
    assert session.span_s == (0, 5)  # one key is no flight
    four_keys(session)
    assert session.span_s == (0, 4)
    camera_path.set_span(session, True, 1.0)
    camera_path.set_span(session, False, 0.2)
    assert session.span_s == pytest.approx((1.0, 1.0 + 1 / 30))
    session.clock.span_s = None
    assert content_span(Scene("empty")) == (0, 8)
    shower = RainKeyframes(
        keys=(RainKeyframe(time_s=0.0, intensity_mm_h=1.0), RainKeyframe(time_s=60.0, intensity_mm_h=0.0))
    )
    assert content_span(Scene("empty"), shower) == (0, 60)


WORDS = st.sampled_from(["add", "delete", "retime", "copy", "reverse", "stretch"])
CHANGES = st.lists(st.tuples(WORDS, st.integers(0, 5), st.floats(0, 9)), max_size=12)


@settings(max_examples=20, deadline=None)
@given(CHANGES)
def test_any_edits_are_undone_to_the_very_values(changes):
    session = Editor(small_scene())
    session.clock.playing = False
    try:
        documents = [session.history.present]
        for word, key, number in changes:
            path = session.scene.path
            key = key % len(path.times_s) if path is not None else 0
            session.clock.seek(number)
            {
                "add": lambda: camera_path.add_keyframe(session),
                "delete": lambda key=key: camera_path.delete_keyframe(session, key),
                "retime": lambda key=key, number=number: camera_path.retime_keyframe(session, key, number),
                "copy": lambda key=key, number=number: camera_path.copy_keyframe(session, key, number),
                "reverse": lambda: camera_path.reverse_path(session),
                "stretch": lambda number=number: camera_path.stretch_path(session, 0.5 + number),
            }[word]()
            if session.scene.path is not None:
                assert np.all(np.diff(session.scene.path.times_s) > 0)
            if session.history.present is not documents[-1]:
                documents.append(session.history.present)
        for document in reversed(documents):
            assert session.history.present is document
            session.undo()
    finally:
        session.close()
