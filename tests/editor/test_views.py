"""Named views of an editor: the way back to what was on the screen, their edits, and their files."""

from contextlib import closing
from dataclasses import replace

import cv2
import numpy as np
import pytest
from msgspec import structs

from editor.files.open_document import keep_now, settle
from gsrain_engine.editor.autosave import autosave_folder
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.actors import set_origin
from gsrain_engine.editor.edits.level import set_length
from gsrain_engine.editor.views import camera_of_view, picture_pixels, small_picture
from gsrain_engine.rain.keyframes import RainKeyframes
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.named_view import MAX_VIEWS, NamedView, view_named
from small_scene import small_scene


@pytest.fixture
def editor():
    """An editor of a scene with y down, whose unit is 25 cm."""
    with closing(Editor(replace(small_scene(), metres_per_unit=0.25, up=(0.0, -1.0, 0.0)))) as opened:
        opened.playback.clock.playing = False
        yield opened


def look_from(editor, time_s, x, rain_mm_h):
    editor.playback.clock.seek(time_s)
    editor.viewport.navigation.position = np.array([x, 0.5 * x, 2.0])
    editor.viewport.navigation.heading = 0.1 * x
    editor.document.change_rain("Intensity", intensity_mm_h=rain_mm_h)


def moment(editor):
    """Return the state of the screen: matrix and focal length of the camera, time, and rain."""
    shot = editor.viewport.shot(96, 64)
    return shot.camera.world_to_camera, shot.camera.fy, shot.time_s, editor.document.rain


def assert_same(found, expected):
    for one, other in zip(found[:3], expected[:3], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
    assert found[3] == expected[3]


def test_a_view_from_above_is_come_back_to_and_rendered_to_scale(editor):
    editor.viewport.look_from_above()
    editor.viewport.dolly(2)
    before = editor.viewport.shot(96, 64).camera
    editor.views.save("Plan")
    (view,) = editor.document.scene.views
    editor.viewport.go_home()
    assert not editor.viewport.shot(96, 64).camera.is_orthographic
    editor.views.go_to("Plan")
    for camera in (editor.viewport.shot(96, 64).camera, camera_of_view(editor.document.scene, view, 96, 64)):
        assert camera.pixels_per_m == pytest.approx(before.pixels_per_m)
        np.testing.assert_allclose(camera.world_to_camera, before.world_to_camera, rtol=1e-9, atol=1e-6)
    again = NamedView.of("again", before)  # as from Python, of the camera alone
    camera = camera_of_view(replace(editor.document.scene, metres_per_unit=1.0, up=(0.0, 0.0, 1.0)), again, 96, 64)
    assert camera.pixels_per_m == pytest.approx(before.pixels_per_m)
    middle = before.position + before.plane_m * before.world_to_camera[2, :3]
    np.testing.assert_allclose(
        (camera.world_to_camera[:3, :3] @ middle + camera.world_to_camera[:3, 3])[:2], 0, atol=1e-6
    )
    with pytest.raises(ValueError, match="orthographic view needs a target"):
        structs.replace(view, target=None)


def names(editor):
    return [view.name for view in editor.document.scene.views]


def test_a_view_is_come_back_to_whatever_the_axes_of_the_scene(editor):
    look_from(editor, 1.5, 3.0, 12.0)
    editor.viewport.navigation.set_pivot(np.array([9.0, 1.0, 0.5]))
    before, pivot_m = moment(editor), editor.viewport.navigation.pivot
    editor.views.save("Gate")
    look_from(editor, 4.0, 8.0, 0.0)
    editor.viewport.navigation.vertical_fov_deg = 30.0
    editor.viewport.orbit(0.5, 0.1)
    editor.views.go_to("Gate")
    assert_same(moment(editor), before)
    np.testing.assert_allclose(editor.viewport.navigation.pivot, pivot_m, atol=1e-9)
    assert editor.document.history.undo_label == "Rain of view: Gate"
    editor.document.undo()
    assert editor.document.rain.intensity_mm_h == 0.0
    editor.document.edit("Scale", set_length, 1.0, 2.0)
    editor.document.edit("Origin", set_origin, np.array([1.0, 2.0, 0.0]))
    editor.views.go_to("Gate")  # the same part of the scene, which is twice as large and elsewhere
    np.testing.assert_allclose(editor.viewport.navigation.position, [6.0 - 1.0, 3.0 - 2.0, 4.0], atol=1e-9)
    np.testing.assert_allclose(editor.viewport.navigation.pivot, [18.0 - 1.0, 2.0 - 2.0, 1.0], atol=1e-9)


def test_an_orbit_after_a_view_is_that_of_before(editor):
    look_from(editor, 0.0, 3.0, 0.0)
    editor.views.save("Gate")
    editor.viewport.orbit(0.4, 0.1)
    before = moment(editor)
    editor.viewport.dolly(2.0)
    editor.views.go_to("Gate")
    assert editor.viewport.navigation.pivot is None
    editor.viewport.orbit(0.4, 0.1)
    assert_same(moment(editor), before)


def test_a_view_without_time_and_rain_is_a_camera_alone(editor):
    look_from(editor, 1.5, 3.0, 12.0)
    editor.views.with_time = editor.views.with_rain = False
    editor.views.save("Gate")
    assert (editor.views.views[0].time_s, editor.views.views[0].rain) == (None, None)
    look_from(editor, 4.0, 8.0, 2.0)
    steps = editor.document.history.cursor
    editor.views.go_to("Gate")
    assert editor.viewport.navigation.position[0] == pytest.approx(3.0)
    assert editor.playback.clock.time_s == 4.0 and editor.document.rain.intensity_mm_h == 2.0
    assert editor.document.history.cursor == steps


def test_rain_that_follows_keyframes_goes_on_to_follow_them(editor):
    editor.document.edit_keyframes("Insert", RainKeyframes.with_key, 0.0, intensity_mm_h=3.0, wind_m_s=(1.0, 2.0))
    editor.views.save("Gate")
    keys = editor.document.keyframes.keys
    editor.document.change_rain("Exposure", exposure_s=0.01)
    editor.playback.clock.seek(5.0)
    editor.views.go_to("Gate")
    assert editor.document.keyframes.keys == keys and editor.document.rain.exposure_s is None


def test_views_are_edited_in_steps_with_names(editor):
    for _ in range(3):
        editor.views.save()
    look_from(editor, 2.0, 5.0, 4.0)
    editor.views.save("View 2")
    editor.views.rename("View 3", "  Bridge ")
    editor.views.move("Bridge", -1)
    editor.views.move("Bridge", -1)
    editor.views.move("Bridge", -1)  # is the first one
    editor.views.remove("View 1")
    assert names(editor) == ["Bridge", "View 2"] and editor.views.views[1].time_s == 2.0
    assert editor.document.history.labels[-6:] == [
        "Intensity", "Set view to current: View 2", "Rename view: View 3 to Bridge", "Move view up: Bridge",
        "Move view up: Bridge", "Delete view: View 1",
    ]  # fmt: skip
    for expected in (
        ["Bridge", "View 1", "View 2"], ["View 1", "Bridge", "View 2"], ["View 1", "View 2", "Bridge"],
        ["View 1", "View 2", "View 3"],
    ):  # fmt: skip
        editor.document.undo()
        assert names(editor) == expected
    editor.document.undo()
    assert editor.views.views[1].time_s == 0.0
    editor.document.go_to_step(0)
    assert names(editor) == []


@pytest.mark.parametrize("name", ["View 2", "a\nb", "x" * 201])
def test_names_are_unique_and_can_be_printed(name, editor):
    editor.views.save()
    editor.views.save()
    before = editor.document.state
    editor.views.rename("View 1", name)
    assert editor.document.state is before and "view" in editor.status.problem
    if name != "View 2":
        assert not editor.views.save(name) and editor.document.state is before


def test_a_view_with_damaged_rain_changes_nothing_and_is_reported(editor):
    editor.views.save("Gate")
    damaged = structs.replace(editor.views.views[0], rain={"intensity_mm_h": -3.0})
    editor.document.edit("Damage", lambda scene: replace(scene, views=(damaged,)))
    look_from(editor, 4.0, 8.0, 2.0)
    before = moment(editor)
    editor.views.go_to("Gate")
    assert_same(moment(editor), before)
    assert "view 'Gate'" in editor.status.problem and "intensity_mm_h" in editor.status.problem


def test_views_are_saved_and_autosaved_with_their_pictures(editor, tmp_path):
    editor.files.save_as(tmp_path / "saved")
    settle(editor)
    editor.views.save("Gate")
    green = np.zeros((300, 600, 3), np.uint8)
    green[:, 75:525, 1] = 200
    editor.views.take_picture(green)
    assert editor.document.history.labels == ["Opened", "Save view: Gate"]
    keep_now(editor)
    assert read_scene(autosave_folder(tmp_path / "saved") / "scene").views == editor.document.scene.views
    editor.files.save()
    settle(editor)
    assert read_scene(tmp_path / "saved").views == editor.document.scene.views
    with closing(Editor()) as other:
        other.files.open(str(tmp_path / "saved"))
        settle(other)
        pixels = picture_pixels(other.views.views[0].picture)
    assert pixels.shape == (96, 144, 3)
    np.testing.assert_allclose(pixels.reshape(-1, 3).mean(axis=0), [0, 200, 0], atol=3)  # the sides are cut off


def test_a_picture_that_comes_after_another_edit_is_dropped(editor):
    editor.views.save("Gate")
    editor.document.change_rain("Intensity", intensity_mm_h=4.0)
    before = editor.document.state
    editor.views.take_picture(np.zeros((30, 60, 3), np.uint8))
    assert editor.document.state is before


def test_pictures_are_small_and_damaged_ones_are_left_out():
    noise = np.random.default_rng(0).integers(0, 256, (720, 1280, 3), np.uint8)
    assert len(small_picture(noise)) < 1 << 16
    assert picture_pixels(small_picture(np.zeros((1, 1, 3), np.uint8))).shape == (96, 144, 3)
    assert picture_pixels(b"\xff\xd8\xff") is None
    assert picture_pixels(small_picture(noise)[:400]) is None
    assert picture_pixels(cv2.imencode(".png", np.zeros((4000, 4000), np.uint8))[1].tobytes()) is None


def test_errors_name_the_view_and_a_similar_one():
    views = tuple(NamedView(name=name, position=(0, 0, 0), quaternion_wxyz=(1, 0, 0, 0)) for name in ("Gate", "Roof"))
    with pytest.raises(ValueError, match="view 'gat': scene 's' has no view of this name; did you mean 'Gate'"):
        view_named(views, "gat", "s")
    with pytest.raises(ValueError, match="it has 'Gate', 'Roof'"):
        view_named(views, "xyz", "s")
    with pytest.raises(ValueError, match="scene 's' has no named views"):
        view_named((), "Gate", "s")


def test_more_views_than_a_scene_can_have_are_refused(editor, tmp_path):
    view = NamedView(name="first", position=(0, 0, 0), quaternion_wxyz=(1, 0, 0, 0))
    many = tuple(structs.replace(view, name=str(number)) for number in range(MAX_VIEWS))
    editor.document.edit("Many", lambda scene: replace(scene, views=many))
    assert not editor.views.can_save and not editor.views.save() and "views" in editor.status.problem
    with pytest.raises(ValueError, match="1,001 views"):
        write_scene(replace(small_scene(), views=(*many, view)), tmp_path / "saved")
