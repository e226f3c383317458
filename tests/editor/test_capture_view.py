"""An open capture beside a scene: read in the background, looked from, listed by camera."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets.capture import Capture, CaptureError
from gsrain_engine.editor import capture_view
from gsrain_engine.editor.capture_view import THUMBNAIL_PX, CaptureImageLoader, sample_points
from gsrain_engine.editor.editor import Editor
from gsrain_engine.scene.scene import Scene
from small_scene import small_scene

from .small_capture import COLORS, small_capture, written_capture


@pytest.fixture
def editor():
    editor = Editor(small_scene())
    yield editor
    editor.close()


def _wait(editor: Editor) -> None:
    (reading,) = editor.captures.pending
    reading.exception(timeout=60)
    editor.captures.poll()


def _opened(editor: Editor, capture: Capture) -> None:
    editor.captures.display(Path("small"), capture, sample_points(capture))


def test_files_outside_of_the_folder_are_read_when_a_person_says_so(editor: Editor, tmp_path: Path):
    folder = written_capture(tmp_path / "drive")
    picture = next(folder.glob("*[0-9a-z].png"))
    picture.rename(tmp_path / "elsewhere.png")
    picture.symlink_to(tmp_path / "elsewhere.png")
    editor.captures.open(folder)
    _wait(editor)
    assert editor.captures.capture is None and editor.status.problem is None
    editor.tick(0.01)
    question = editor.status.question
    assert question is not None and picture.name in question.text and "--" not in question.text
    editor.status.answer(question.answers[0])
    _wait(editor)
    assert editor.captures.capture is not None and editor.captures.allows_outside
    editor.captures.open(written_capture(tmp_path / "another"))
    _wait(editor)
    assert not editor.captures.allows_outside


def test_a_folder_is_opened_in_the_background(editor: Editor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    may_go_on, threads = threading.Event(), []
    read = capture_view.read_capture

    def slowly(path: Path, allow_outside: bool):
        may_go_on.wait(60)
        threads.append(threading.current_thread())
        return read(path, allow_outside)

    monkeypatch.setattr(capture_view, "read_capture", slowly)
    editor.captures.open(written_capture(tmp_path / "drive"))
    editor.captures.poll()
    assert editor.captures.capture is None
    assert editor.captures.busy == "Reading drive"
    assert editor.is_working
    may_go_on.set()
    _wait(editor)
    assert editor.captures.busy is None
    assert editor.captures.capture is not None and len(editor.captures.capture) == 4
    assert threads[0] is not threading.main_thread()


def test_looking_from_a_view_takes_its_place_and_moment(editor: Editor):
    _opened(editor, small_capture())
    captures = editor.captures
    editor.viewport.options.follow_path = True
    captures.look_from(2)
    camera = captures.cameras(editor.document.scene)[2]
    eye = editor.viewport.navigation.camera(300, 200)
    assert eye.position == pytest.approx(camera.position)
    assert eye.world_to_camera[2, :3] == pytest.approx(camera.world_to_camera[2, :3])
    assert not editor.viewport.options.follow_path
    assert captures.view_at_camera == 2
    editor.viewport.navigation.turn(0.01, 0.0)
    assert captures.view_at_camera is None


def test_a_capture_lies_as_the_scene_that_was_made_from_it_does(editor: Editor):
    capture = replace(small_capture(), up=(0.0, -1.0, 0.0))
    made = replace(small_scene(), up=(0.05, -1.0, 0.0), metres_per_unit=3.0)
    _opened(editor, capture)
    captures = editor.captures
    assert captures.to_world(made) == pytest.approx(made.scene_to_world)
    assert captures.cameras(made)[1].position == pytest.approx(
        made.scene_to_world[:3, :3] @ capture[1].camera.position, abs=1e-9
    )
    # Beside a scene of other axes its own up is turned up, at its own scale; a person may overrule that.
    other = small_scene()
    assert captures.to_world(other)[:3, :3] @ [0.0, -1.0, 0.0] == pytest.approx([0, 0, 1])
    captures.in_scene_axes = True
    assert captures.to_world(other) == pytest.approx(other.scene_to_world)
    captures.in_scene_axes = None
    assert captures.to_world(Scene("none"))[2, :3] == pytest.approx([0, -1, 0])


def test_pictures_come_when_they_are_asked_for_and_broken_ones_are_named(editor: Editor):
    capture = small_capture()

    def broken() -> np.ndarray:
        raise CaptureError("001.png: cut off")

    views = (capture[0], replace(capture[1], image_source=broken), *capture.views[2:])
    _opened(editor, replace(capture, views=views, problems=("a frame is missing",)))
    pictures = editor.captures.pictures
    assert pictures is not None
    for view in (0, 1):
        assert pictures.want(view, THUMBNAIL_PX) is None
        _read_one(pictures)
    shown = pictures.want(0, THUMBNAIL_PX)
    assert shown is not None and tuple(shown[10, 10]) == COLORS[0]
    assert editor.captures.problems == ["a frame is missing", "001.png: cut off"]
    assert pictures.want(1, THUMBNAIL_PX) is None
    pictures.poll()
    assert not pictures.is_reading  # what is broken is not tried again


def _read_one(pictures: CaptureImageLoader) -> None:
    pictures.poll()
    (reading,) = pictures.pending
    reading.exception(timeout=60)
    pictures.poll()
