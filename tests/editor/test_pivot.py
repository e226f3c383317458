"""The viewport camera near surfaces: pivot, framing from the selection to the scene, and obstacles."""

import threading
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.background import Background
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import with_members
from gsrain_engine.editor.viewport.camera import OrbitCamera
from gsrain_engine.editor.viewport.obstacles import ObstacleFinder, Obstacles
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.scene import Scene
from small_scene import small_scene


@pytest.fixture
def editor():
    with closing(Editor(small_scene())) as opened:
        yield opened


def test_an_orbit_around_a_pivot_keeps_it_at_its_place_in_the_view():
    navigation, pivot = OrbitCamera(heading=0.2, pitch=-0.1), np.array([8.0, 3.0, 0.5])
    before = navigation.camera(640, 480).world_to_camera
    navigation.set_pivot(pivot)
    assert np.array_equal(navigation.camera(640, 480).world_to_camera, before)  # the view stays
    in_camera = before[:3, :3] @ pivot + before[:3, 3]
    for turn in ((0.7, 0.0), (-0.2, 0.3), (1.5, -0.1)):
        navigation.orbit(*turn)
        after = navigation.camera(640, 480).world_to_camera
        np.testing.assert_allclose(after[:3, :3] @ pivot + after[:3, 3], in_camera, atol=1e-9)


def test_the_frame_goes_from_the_selection_to_the_member_to_the_scene(editor):
    viewport = editor.viewport

    def select(scene: Scene) -> Scene:
        road = scene.member("layers/road")
        chosen = np.asarray(road.gaussians.means[:, 0] < 3)
        return with_members(
            scene, [replace(road, marks=SelectionFlags(selected=BitMask.of(chosen))), *scene.members[1:]]
        )

    editor.document.edit("Select", select)
    viewport.options.member = "layers/road"
    found = []
    for _ in range(3):
        viewport.frame_scene()
        found.append(viewport.navigation.target)
    row, road, scene = found
    assert row == pytest.approx([1, 0, 0], abs=1.5) and road == pytest.approx([20, 0, 0], abs=2)
    assert scene == pytest.approx(viewport.core.middle)
    viewport.frame_scene()
    assert viewport.navigation.target == pytest.approx(row, abs=1e-6)  # and again


def test_obstacles_are_looked_for_while_the_window_goes_on(editor, monkeypatch):
    is_drawn, find = threading.Event(), Obstacles.of

    def slowly(*arguments):
        assert is_drawn.wait(20), "the caller waits"
        return find(*arguments)

    monkeypatch.setattr(Obstacles, "of", slowly)
    with closing(Background()) as background:
        finder = ObstacleFinder(background)
        scene, radius_m = editor.document.scene, editor.viewport.core.radius_m
        assert finder.of(scene, radius_m) is None
        is_drawn.set()
        found = finder.of(scene, radius_m, wait=True)
        assert found is not None and finder.of(scene, radius_m) is found


def test_an_orbit_stops_at_a_wall_and_a_camera_inside_one_gets_out(editor):
    viewport, scene = editor.viewport, editor.document.scene
    assert viewport.obstacles.of(scene, viewport.core.radius_m, wait=True) is not None
    viewport.navigation = OrbitCamera(position=np.array([27.0, 0.0, 4.5]), distance_m=9.0)  # around x = 36
    for _ in range(60):
        viewport.orbit(0.05, 0.0)
    assert 33 < viewport.navigation.position[0] < 40  # it came closer, and did not go through
    stopped = viewport.navigation.position[0]
    viewport.orbit(-0.3, 0.0)
    assert viewport.navigation.position[0] < stopped - 1  # and back
    wall = [part for each in scene.layers if each.name == "wall" and (part := scene.part(each)) is not None]
    obstacles = Obstacles.of(wall, 10.0)
    x = np.array([[39.0, 0, 4], [42.0, 0, 4], [40.0, 0, 4]])
    assert obstacles.stops(x[0], x[1]) and not obstacles.stops(x[2], x[0]) and not obstacles.stops(x[1], x[1] + 5)
