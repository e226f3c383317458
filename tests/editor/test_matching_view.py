"""Matching in the editor: what is matched with what, told in pictures, and again when a person looks elsewhere."""

import time

import numpy as np
import pytest

from gsrain_engine.appearance.correspondence import MatchOutcome
from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.editor.editor import Editor
from gsrain_engine.scene.camera import Camera, look_at
from small_scene import small_scene

UP = np.array([0.0, 0.0, 1.0])


def deep_capture(moments=3) -> Capture:
    """A striped wall 20 m ahead, from places 1 m apart; at each a second camera looks 20 degrees to the left."""
    views = []
    for k in range(moments):
        for sensor, angle in (("front", 0.0), ("left", 0.35)):
            eye = np.array([float(k), 0.0, 1.5])
            camera = Camera(96, 64, 80.0, 80.0, 48.0, 32.0, look_at(eye, eye + [np.cos(angle), np.sin(angle), 0], UP))
            v, u = np.mgrid[:64, :96] + 0.5
            rays = np.stack([(u - 48) / 80, (v - 32) / 80, np.ones_like(u)], axis=2) @ camera.world_to_camera[:3, :3]
            depth = (20.0 - k) / rays[..., 0]
            across = depth * rays[..., 1]
            image = np.repeat((120 + 80 * np.sin(across))[..., None], 3, axis=2).astype(np.uint8)
            views.append(
                CaptureFrame(
                    f"{sensor}_{k}", camera, image, 0.1 * k, sensor, depth_source=depth.astype(np.float32),
                    sky_source=np.zeros((64, 96), bool),
                )
            )  # fmt: skip
    return Capture("wall", tuple(views))


@pytest.fixture
def written(tmp_path):
    for _ in write_views(tmp_path / "wall", deep_capture().views):
        pass
    return tmp_path / "wall"


@pytest.fixture
def editor():
    editor = Editor(small_scene())
    editor.playback.clock.playing = False
    yield editor
    editor.close()


def _until(editor, condition):
    """Let frames go by as the window does."""
    last = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < last, "waited in vain"
        editor.tick(0.001)
        for work in [*editor.matching.pending, *editor.captures.pending]:
            work.exception()  # waits for it


def test_recorded_views_are_matched_with_the_one_that_is_asked_for(editor, written):
    captures, matching = editor.captures, editor.matching
    captures.open(written)
    _until(editor, lambda: captures.capture is not None)
    assert matching.shown is None
    matching.is_on = True
    captures.look_from(2)  # front_1
    _until(editor, lambda: matching.shown is not None)
    assert matching.shown.request[2:4] == (2, 4)
    assert matching.shown.matched.to.name == "front_2"
    np.testing.assert_array_equal(matching.shown.camera.position, captures.cameras(editor.document.scene)[2].position)
    assert 0.6 < matching.shown.shares[MatchOutcome.MATCHED] < 0.95
    picture = matching.picture
    assert picture is matching.picture
    matching.mode = "pixels"
    assert matching.picture is not picture

    matching.against = "beside"
    _until(editor, lambda: matching.shown is not None and matching.shown.request.to == 3)
    captures.look_from(4)
    matching.against = "next"
    editor.tick(0.001)
    assert matching.shown is None
    assert matching.why_none == "This is the last view of its camera."
    assert not captures.is_working
    matching.is_on = False
    editor.tick(0.001)
    assert matching.why_none is None


def test_the_live_view_is_matched_by_the_scenes_depth(editor, written):
    captures, matching = editor.captures, editor.matching
    captures.open(written)
    _until(editor, lambda: captures.capture is not None)
    captures.chosen, captures.in_scene_axes, matching.is_on = 0, True, True
    editor.viewport.navigation.look_like(captures.cameras(editor.document.scene)[2])
    _until(editor, lambda: matching.shown is not None)
    assert matching.shown.request.of is None
    assert matching.shown.matched.to.name == "front_0"
    assert matching.shown.matched.found.valid.any()
    captures.in_scene_axes = False
    _until(editor, lambda: matching.why_none is not None)
    assert "does not lie in the scene" in matching.why_none
    assert matching.shown is None
