"""An open capture next to a scene: read in the background, looked from, and its images."""

from dataclasses import replace
from pathlib import Path

import pytest

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.editor.capture_view import THUMBNAIL_PX, sample_points
from gsrain_engine.scene.scene import Scene
from small_scene import small_scene

from .small_capture import COLORS, small_capture, written_capture


def wait_for(background):
    background.wait(60)
    background.poll()


def displayed(editor, capture):
    editor.captures.display(Path("small"), capture, sample_points(capture))
    return editor.captures


def test_files_outside_of_the_folder_are_read_after_a_question(editor, tmp_path):
    folder = written_capture(tmp_path / "drive")
    picture = next(folder.glob("*[0-9a-z].png"))
    picture.rename(tmp_path / "elsewhere.png")
    picture.symlink_to(tmp_path / "elsewhere.png")
    editor.captures.open(folder)
    wait_for(editor.background)
    assert editor.captures.capture is None and editor.status.problem is None
    question = editor.status.question
    assert picture.name in question.text and "--" not in question.text
    editor.status.answer(question.answers[0])
    wait_for(editor.background)
    assert editor.captures.capture is not None and editor.captures.allows_outside
    editor.captures.open(written_capture(tmp_path / "another"))
    wait_for(editor.background)
    assert not editor.captures.allows_outside


def test_looking_from_a_view_takes_its_place_until_the_camera_turns(editor):
    captures = displayed(editor, small_capture())
    editor.viewport.options.follow_path = True
    captures.look_from(2)
    camera, eye = captures.cameras(editor.document.scene)[2], editor.viewport.navigation.camera(300, 200)
    assert eye.position == pytest.approx(camera.position)
    assert eye.world_to_camera[2, :3] == pytest.approx(camera.world_to_camera[2, :3])
    assert not editor.viewport.options.follow_path
    assert captures.view_at_camera == 2
    editor.viewport.navigation.turn(0.01, 0.0)
    assert captures.view_at_camera is None


def test_a_capture_lies_as_the_scene_that_was_made_from_it(editor):
    captures = displayed(editor, replace(small_capture(), up=(0.0, -1.0, 0.0)))
    made, other = replace(small_scene(), up=(0.05, -1.0, 0.0), metres_per_unit=3.0), small_scene()
    assert captures.to_world(made) == pytest.approx(made.scene_to_world)
    position = made.scene_to_world[:3, :3] @ captures.capture[1].camera.position
    assert captures.cameras(made)[1].position == pytest.approx(position, abs=1e-9)
    # In a scene of other axes its own up is turned up, at its own scale; a person may overrule that.
    assert captures.to_world(other)[:3, :3] @ [0.0, -1.0, 0.0] == pytest.approx([0, 0, 1])
    captures.in_scene_axes = True
    assert captures.to_world(other) == pytest.approx(other.scene_to_world)
    captures.in_scene_axes = None
    assert captures.to_world(Scene("none"))[2, :3] == pytest.approx([0, -1, 0])


def test_images_are_read_on_demand_and_broken_ones_are_named(editor):
    capture = small_capture()

    def broken():
        raise CaptureError("001.png: cut off")

    views = (capture[0], replace(capture[1], image_source=broken), *capture.views[2:])
    captures = displayed(editor, replace(capture, views=views, problems=("a frame is missing",)))
    for view in (0, 1):
        assert captures.pictures.want(view, THUMBNAIL_PX) is None
        captures.pictures.poll()
        wait_for(editor.background)
    assert tuple(captures.pictures.want(0, THUMBNAIL_PX)[10, 10]) == COLORS[0]
    assert captures.problems == ["a frame is missing", "001.png: cut off"]
    assert captures.pictures.want(1, THUMBNAIL_PX) is None
    captures.pictures.poll()
    assert not captures.pictures.is_reading  # what is broken is not tried again
