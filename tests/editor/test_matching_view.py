"""Matching in the editor: of recorded views, and of the live view."""

import time

import numpy as np
import pytest

from gsrain_engine.appearance.correspondence import MatchOutcome
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.camera import Camera, look_at

UP = np.array([0.0, 0.0, 1.0])


def deep_view(number, sensor, turn_rad):
    """A striped wall at x = 20 m, from a place on the x axis."""
    eye, ahead = np.array([float(number), 0.0, 1.5]), np.array([np.cos(turn_rad), np.sin(turn_rad), 0])
    camera = Camera(96, 64, 80.0, 80.0, 48.0, 32.0, look_at(eye, eye + ahead, UP))
    v, u = np.mgrid[:64, :96] + 0.5
    rays = np.stack([(u - 48) / 80, (v - 32) / 80, np.ones_like(u)], axis=2) @ camera.world_to_camera[:3, :3]
    depth = (20.0 - number) / rays[..., 0]
    image = np.repeat((120 + 80 * np.sin(depth * rays[..., 1]))[..., None], 3, axis=2).astype(np.uint8)
    return CaptureFrame(
        f"{sensor}_{number}", camera, image, 0.1 * number, sensor, depth_source=depth.astype(np.float32),
        sky_source=np.zeros((64, 96), bool),
    )  # fmt: skip


@pytest.fixture
def editor(editor, tmp_path):
    """An editor with a capture from three places 1 m apart; at each a second camera looks 20 degrees to the left."""
    views = [deep_view(number, *sensor) for number in range(3) for sensor in (("front", 0.0), ("left", 0.35))]
    for _ in write_views(tmp_path / "wall", views):
        pass
    editor.captures.open(tmp_path / "wall")
    until(editor, lambda: editor.captures.capture is not None)
    assert editor.matching.shown is None
    editor.matching.is_on = True
    return editor


def until(editor, condition):
    """Let frames go by as the window does."""
    last = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < last, "waited in vain"
        editor.tick(0.001)
        editor.background.wait()


def test_recorded_views_are_matched_with_the_chosen_neighbor(editor):
    captures, matching = editor.captures, editor.matching
    captures.look_from(2)  # front_1
    until(editor, lambda: matching.shown is not None)
    assert (matching.shown.request[2:4], matching.shown.matched.to.name) == ((2, 4), "front_2")
    np.testing.assert_array_equal(matching.shown.camera.position, captures.cameras(editor.document.scene)[2].position)
    assert 0.6 < matching.shown.shares[MatchOutcome.MATCHED] < 0.95
    picture = matching.picture
    assert picture is matching.picture
    matching.mode = "pixels"
    assert not np.array_equal(matching.picture, picture)
    matching.against = "beside"
    until(editor, lambda: matching.shown is not None and matching.shown.request.to == 3)
    captures.look_from(4)
    matching.against = "next"
    editor.tick(0.001)
    assert matching.shown is None and "last view" in matching.why_none
    matching.is_on = False
    editor.tick(0.001)
    assert matching.why_none is None


def test_the_live_view_is_matched_by_the_depth_of_the_scene(editor):
    captures, matching = editor.captures, editor.matching
    captures.chosen, captures.in_scene_axes = 0, True
    editor.viewport.navigation.look_like(captures.cameras(editor.document.scene)[2])
    until(editor, lambda: matching.shown is not None)
    assert (matching.shown.request.of, matching.shown.matched.to.name) == (None, "front_0")
    assert matching.shown.matched.found.valid.any()
    captures.in_scene_axes = False
    until(editor, lambda: matching.why_none is not None)
    assert matching.shown is None
