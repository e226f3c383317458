"""The camera path of an editor: keyframes, drags, files, and the ride that follows from them."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.camera_path_edit import ViewAngles
from small_scene import small_scene


@pytest.fixture
def editor():
    """An editor of a scene with y down, whose unit is 25 cm and whose file has its origin elsewhere."""
    scene = replace(small_scene(), metres_per_unit=0.25, up=(0.0, -1.0, 0.0), origin=(3000.0, -2000.0, 50.0))
    with closing(Editor(scene)) as opened:
        opened.playback.clock.playing = False
        yield opened


def look_from(editor, time_s, x):
    editor.playback.clock.seek(time_s)
    editor.viewport.navigation.position = np.array([x, 0.5 * x, 2.0])
    editor.viewport.navigation.heading = 0.1 * x


def four_keys(editor):
    for time_s, x in ((0.0, 0.0), (1.0, 2.0), (2.0, 5.0), (4.0, 9.0)):
        look_from(editor, time_s, x)
        editor.camera_path.add_keyframe()
    return editor.document.scene.path


def test_a_keyframe_has_the_view_whatever_the_axes_of_the_scene(editor):
    look_from(editor, 1.0, 3.0)
    view = editor.viewport.shot(96, 64).camera
    editor.camera_path.add_keyframe()
    look_from(editor, 1.0, 8.0)
    editor.camera_path.go_to_keyframe(0)
    again = editor.viewport.shot(96, 64).camera
    assert np.allclose(again.world_to_camera, view.world_to_camera, atol=1e-9)
    assert again.fy == pytest.approx(view.fy)
    assert np.linalg.norm(editor.document.scene.path.positions[0]) == pytest.approx(4 * np.linalg.norm(view.position))


def test_a_drag_in_time_is_one_step(editor):
    path = four_keys(editor)
    editor.camera_path.begin_drag(1)
    for seconds in (0.3, 3.7, 0.9):
        editor.camera_path.drag_in_time(seconds)
    editor.camera_path.end_drag()
    assert editor.document.scene.path.times_s == pytest.approx([0, 1.9, 2, 4])
    assert editor.document.history.labels[-2:] == ["Insert camera keyframe", "Move keyframe"]
    editor.document.undo()
    assert editor.document.scene.path is path
    editor.camera_path.begin_drag(0)
    editor.camera_path.drag_in_time(-5.0)  # not before 0
    assert editor.document.scene.path.times_s[0] == 0


def test_the_window_rides_as_a_recording_does(editor):
    four_keys(editor)
    editor.camera_path.change_path("Loop", loop=True, easing="in and out")
    editor.viewport.options.follow_path = True
    sequence = FrameSequence(
        editor.document.scene, editor.live_rain.simulation, editor.viewport.path, 96, 64, 30.0, in_scene_time=True
    )
    for number in (0, 31, 100, 250):
        editor.playback.clock.seek(sequence.time_s(number))
        ridden, recorded = editor.viewport.shot(96, 64), sequence.shot(number)
        assert ridden.time_s == recorded.time_s
        assert np.array_equal(ridden.camera.world_to_camera, recorded.camera.world_to_camera)
        assert np.array_equal(ridden.velocity_m_s, recorded.velocity_m_s)


def test_a_circle_starts_at_the_view_and_looks_at_its_target(editor):
    editor.viewport.navigation.distance_m = 6.0
    view, target = editor.viewport.shot(96, 64).camera, editor.viewport.navigation.target
    editor.camera_path.circle_target()
    path = editor.viewport.path
    assert np.allclose(path.camera(0.0, 96, 64).world_to_camera, view.world_to_camera, atol=1e-9)
    assert editor.playback.span_s == (0, 12)
    for t in (2.0, 7.5, 11.9):
        assert path.camera(t, 96, 64).world_to_camera @ [*target, 1] == pytest.approx([0, 0, 6, 1], abs=0.01)


def test_the_drive_becomes_a_path_and_keyframes_snap_to_it(editor):
    editor.camera_path.path_from_drive(every_s=1.0)
    drive = editor.viewport.path
    assert len(drive.times_s) == 6
    above = drive.positions[2] + np.array([0, 0, 3.0])
    editor.camera_path.place_keyframe(2, "Move", position_m=above, look=ViewAngles(90, 0, 0))
    editor.camera_path.snap_keyframe(2)
    assert editor.viewport.path.positions[2] == pytest.approx(drive.positions[2], abs=1e-6)
    assert abs(editor.viewport.path.quaternions_wxyz[2] @ drive.quaternions_wxyz[2]) == pytest.approx(1)


@pytest.mark.parametrize("name", ["drive.json", "drive"])
def test_the_path_of_the_drive_is_exported_in_axes_and_units_of_the_scene(editor, tmp_path, name):
    drive = editor.viewport.path
    editor.camera_path.export_path(tmp_path / name)
    assert [each.name for each in tmp_path.iterdir()] == ["drive.json"]
    editor.camera_path.import_path(tmp_path / "drive.json")
    moved = editor.document.scene.path.positions  # y down, 0.25 m
    np.testing.assert_allclose(moved[:, 1], -4 * drive.positions[:, 2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 4 * np.linalg.norm(drive.positions, axis=1), atol=1e-6)
    np.testing.assert_allclose(editor.viewport.path.positions, drive.positions, atol=1e-6)


@pytest.mark.parametrize("form", ["keyframes", "nerfstudio", "training cameras"])
def test_exports_read_back_or_are_reported(editor, tmp_path, form):
    path = four_keys(editor)
    editor.camera_path.export_path(tmp_path / "out", form)
    editor.camera_path.import_path(tmp_path / "out.json")
    again = editor.document.scene.path
    assert again is not path
    assert again.positions[[0, -1]] == pytest.approx(path.positions[[0, -1]], abs=1e-6)
    editor.camera_path.export_path(tmp_path / "out.json" / "out.json", form)  # a file is no folder
    assert str(tmp_path / "out.json") in editor.status.problem


@pytest.mark.parametrize("upright", [False, True])
def test_a_keyframe_follows_the_pointer_across_the_view(editor, upright):
    four_keys(editor)
    editor.viewport.navigation.position, editor.viewport.navigation.heading = np.array([1.0, -8.0, 2.5]), 0.3
    editor.viewport.navigation.pitch = 0.0
    shot, moved_px = editor.viewport.shot(96, 64), np.array([7.0, -5.0])
    before = editor.viewport.path.positions
    editor.camera_path.begin_drag(1, in_view=True)
    editor.camera_path.drag_in_view(shot, tuple(moved_px), upright=upright)
    editor.camera_path.end_drag()
    after = editor.viewport.path.positions
    (x0, y0, depth), (x1, y1, depth_after) = (
        shot.camera.world_to_camera[:3, :3] @ path[1] + shot.camera.world_to_camera[:3, 3] for path in (before, after)
    )
    assert depth > 1 and depth_after == pytest.approx(depth)
    pixels = shot.camera.fx * (x1 - x0) / depth, shot.camera.fy * (y1 - y0) / depth
    assert pixels == pytest.approx(moved_px * ([0, 1] if upright else [1, 1]), abs=1e-6)
    assert np.array_equal(np.delete(after, 1, axis=0), np.delete(before, 1, axis=0))
