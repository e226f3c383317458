"""The timeline and the camera path in the real window, driven as a person drives them."""

import numpy as np
import pytest

from gsrain_engine.editor.overlays import path_overlay_of
from ui.commands.keys import chord
from window_driver import imgui

KEY = imgui.Key
UNDO = chord(KEY.mod_ctrl, KEY.z)


@pytest.fixture
def flight(driver):
    """Begin a flight: look around, and store four views at 0, 1, 2 and 4 s, by the keyboard alone."""
    editor = driver.editor
    editor.viewport.options.shrink = 3  # a coarse picture: none of these tests looks at it

    def begin():
        driver.ctx.mouse_move("//View/view")
        for time_s, step in ((0.0, (0, 0, 0)), (1.0, (3, 0.5, 0.5)), (2.0, (3, -1, 0.5)), (4.0, (4, 0.5, 0))):
            editor.playback.clock.seek(time_s)
            editor.viewport.navigation.position = editor.viewport.navigation.position + np.array(step, float)
            driver.frames()
            driver.press(KEY.k)
        return editor.document.scene.path

    return begin


def drag(driver, start, end, held=()):
    driver.stroke(*(start + share * np.subtract(end, start) for share in (0, 0.3, 0.7, 1.0)), held=held)


def test_keys_are_added_scrubbed_moved_copied_deleted_and_undone(driver, flight):
    editor = driver.editor
    document, clock, timeline = editor.document, editor.playback.clock, editor.playback.timeline

    def on_ruler(time_s):
        (left, top), (_, height) = driver.area("//Timeline/ruler")
        return np.array([left + timeline.ruler.x(time_s), top + height / 2 - 4])

    def script():
        path = flight()
        assert path.times_s.tolist() == [0, 1, 2, 4]
        assert document.history.labels[1:] == ["Insert keyframe"] * 4
        by_hand = editor.viewport.navigation.position.copy()

        # A click on a key looks through it.
        driver.click("//Timeline/**/key 1")
        assert editor.viewport.options.follow_path and clock.time_s == 1.0
        assert editor.viewport.shot(96, 64).camera.position == pytest.approx(path.positions[1])

        # Dragging the ruler scrubs, and everything follows.
        drag(driver, on_ruler(0.5), on_ruler(3.0))
        assert clock.time_s == pytest.approx(3.0, abs=0.05)
        expected = editor.viewport.path.camera(clock.time_s, 96, 64).position
        assert editor.viewport.shot(96, 64).camera.position == pytest.approx(expected)

        # A drag in time is one step; with Ctrl it copies.
        place = driver.area("//Timeline/**/key 1")[0] + 6
        moved = np.array([timeline.ruler.x(1.5) - timeline.ruler.x(0.0), 0.0])
        steps = len(document.history.labels)
        drag(driver, place, place + moved)
        assert document.scene.path.times_s == pytest.approx([0, 2, 2.5, 4], abs=0.05)  # past the third one
        assert timeline.key == 2
        assert document.scene.path.positions[2] == pytest.approx(path.positions[1])
        assert document.history.labels[steps:] == ["Move keyframe"]
        driver.press(UNDO)
        assert document.scene.path is path
        drag(driver, place, place + 2 * moved, held=(KEY.mod_ctrl,))
        copied = document.scene.path
        assert len(copied.times_s) == 5
        assert np.delete(copied.times_s, timeline.key) == pytest.approx(path.times_s)
        assert copied.times_s[timeline.key] == pytest.approx(4.0, abs=0.1)
        assert copied.positions[timeline.key] == pytest.approx(path.positions[1])
        assert document.history.undo_label == "Copy keyframe"
        driver.press(UNDO)
        assert document.scene.path is path

        # Delete removes the active one.
        driver.click("//Timeline/**/key 2")
        driver.press(KEY.delete)
        assert document.scene.path.times_s.tolist() == [0, 1, 4]
        driver.press(UNDO)
        assert document.scene.path is path

        # A drag of the picture leaves the ride where the camera is.
        driver.click("//Timeline/**/key 3")
        driver.stroke(driver.at(0.5, 0.5), driver.at(0.5, 0.5) + [4, 0], button=1)
        assert not editor.viewport.options.follow_path
        assert editor.viewport.navigation.position == pytest.approx(path.positions[3]) == pytest.approx(by_hand)

    driver.run(script)


def test_a_key_is_dragged_in_the_picture(driver, flight):
    document, viewport = driver.editor.document, driver.editor.viewport
    here = np.array([-4.0, -3.0, 4.0])

    def script():
        path = flight()
        viewport.navigation.position = here
        viewport.navigation.heading, viewport.navigation.pitch = 0.3, -0.2
        driver.frames(3)
        corner, size = driver.area()
        camera = viewport.shot(*map(int, size)).camera

        def handle(key):
            return corner + next(each.handle_px for each in path_overlay_of(viewport, camera).keys if each.key == key)

        steps, start = len(document.history.labels), handle(2)
        drag(driver, start, start + [40, -30])
        moved = document.scene.path
        assert handle(2) == pytest.approx(start + [40, -30], abs=2)
        depth = [camera.world_to_camera[2, :3] @ each.positions[2] for each in (path, moved)]
        assert depth[0] == pytest.approx(depth[1])  # in the plane that faces the view
        assert np.array_equal(np.delete(moved.positions, 2, axis=0), np.delete(path.positions, 2, axis=0))
        assert document.history.labels[steps:] == ["Move keyframe"]
        assert np.array_equal(viewport.navigation.position, here)  # the view stays

        driver.press(UNDO)
        assert document.scene.path is path
        drag(driver, start, start + [30, -40], held=(KEY.mod_shift,))
        risen = document.scene.path.positions[2] - path.positions[2]
        assert risen[:2] == pytest.approx([0, 0], abs=1e-9) and risen[2] > 0.1

        driver.click("//Timeline/show path")
        drag(driver, start, start + [30, 0])  # nothing is there to take hold of: the view orbits
        assert not np.array_equal(viewport.navigation.position, here)

    driver.run(script)
