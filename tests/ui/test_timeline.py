"""The timeline and the camera path in the real window, driven as a person drives them."""

import numpy as np
import pytest

from gsrain_engine.editor.overlays import path_overlay_of
from ui.commands.base import chord
from window_driver import Driver, imgui

KEY = imgui.Key
UNDO = chord(KEY.mod_ctrl, KEY.z)


@pytest.fixture
def driver(tmp_path):
    made = Driver(tmp_path)
    made.editor.viewport.options.shrink = 3  # a coarse picture: none of these tests looks at it
    return made


def place(driver, item):
    """Screen position of an item."""
    rect = driver.ctx.item_info(item).rect_full
    return np.array([rect.min.x, rect.min.y]), np.array([rect.max.x, rect.max.y])


def hand(driver, start, end, modifier=None):
    """Drag with the left button from one place of the screen to another."""
    driver.ctx.mouse_move_to_pos(imgui.ImVec2(*map(float, start)))
    driver.frames()
    if modifier is not None:
        driver.ctx.key_down(modifier)
        driver.frames()
    driver.ctx.mouse_down(0)
    driver.frames()
    for share in (0.3, 0.7, 1.0):
        driver.ctx.mouse_move_to_pos(imgui.ImVec2(*map(float, np.asarray(start) + share * np.subtract(end, start))))
        driver.frames()
    driver.ctx.mouse_up(0)
    driver.frames()
    if modifier is not None:
        driver.ctx.key_up(modifier)
        driver.frames()


def four_keys(driver):
    """Look around, and keep four views at 0, 1, 2 and 4 s, by the keyboard alone."""
    editor = driver.editor
    driver.ctx.mouse_move("//View/view")
    for time_s, step in ((0.0, (0, 0, 0)), (1.0, (3, 0.5, 0.5)), (2.0, (3, -1, 0.5)), (4.0, (4, 0.5, 0))):
        editor.playback.clock.seek(time_s)
        editor.viewport.navigation.position = editor.viewport.navigation.position + np.array(step, float)
        driver.frames()
        driver.press(KEY.k)
    return editor.document.scene.path


def on_ruler(driver, time_s):
    """Screen position of a moment on the ruler."""
    low, high = place(driver, "//Timeline/ruler")
    return low[0] + driver.editor.playback.timeline.ruler.x(time_s), (low[1] + high[1]) / 2 - 4


def test_keys_are_added_scrubbed_moved_copied_deleted_and_undone(driver):
    def script():
        editor = driver.editor
        path = four_keys(driver)
        assert path.times_s.tolist() == [0, 1, 2, 4]
        assert editor.document.history.labels[1:] == ["Insert keyframe"] * 4
        by_hand = editor.viewport.navigation.position.copy()

        # a click on a key looks through it
        driver.click("//Timeline/**/key 1")
        assert editor.viewport.options.follow_path
        assert editor.playback.clock.time_s == 1.0
        assert editor.viewport.shot(96, 64).camera.position == pytest.approx(path.positions[1])

        # dragging the ruler scrubs, and everything follows
        hand(driver, on_ruler(driver, 0.5), on_ruler(driver, 3.0))
        assert editor.playback.clock.time_s == pytest.approx(3.0, abs=0.05)
        assert editor.viewport.shot(96, 64).camera.position == pytest.approx(
            editor.viewport.path.camera(editor.playback.clock.time_s, 96, 64).position
        )

        # a drag in time is one step
        (x, y), _ = place(driver, "//Timeline/**/key 1")
        pixels = editor.playback.timeline.ruler.x(1.5) - editor.playback.timeline.ruler.x(0.0)
        steps = len(editor.document.history.labels)
        hand(driver, (x + 6, y + 6), (x + 6 + pixels, y + 6))
        assert editor.document.scene.path.times_s == pytest.approx([0, 2, 2.5, 4], abs=0.05)  # past the third one
        assert editor.playback.timeline.key == 2
        assert editor.document.scene.path.positions[2] == pytest.approx(path.positions[1])
        assert editor.document.history.labels[steps:] == ["Move keyframe"]
        driver.press(UNDO)
        assert editor.document.scene.path is path

        # with Ctrl it copies
        hand(driver, (x + 6, y + 6), (x + 6 + 2 * pixels, y + 6), KEY.mod_ctrl)
        copied = editor.document.scene.path
        assert len(copied.times_s) == 5
        assert np.delete(copied.times_s, editor.playback.timeline.key) == pytest.approx(path.times_s)
        assert copied.times_s[editor.playback.timeline.key] == pytest.approx(4.0, abs=0.1)
        assert copied.positions[editor.playback.timeline.key] == pytest.approx(path.positions[1])
        assert editor.document.history.undo_label == "Copy keyframe"
        driver.press(UNDO)
        assert editor.document.scene.path is path

        # Delete takes the chosen one away
        driver.click("//Timeline/**/key 2")
        driver.press(KEY.delete)
        assert editor.document.scene.path.times_s.tolist() == [0, 1, 4]
        driver.press(UNDO)
        assert editor.document.scene.path is path

        # a drag of the picture leaves the ride where the camera is
        driver.click("//Timeline/**/key 3")
        driver.ctx.mouse_move("//View/view")
        driver.ctx.mouse_down(1)
        driver.ctx.mouse_move_to_pos(imgui.ImVec2(*(np.mean(place(driver, "//View/view"), axis=0) + [4, 0]).tolist()))
        driver.ctx.mouse_up(1)
        driver.frames()
        assert not editor.viewport.options.follow_path
        assert editor.viewport.navigation.position == pytest.approx(path.positions[3])
        assert editor.viewport.navigation.position == pytest.approx(by_hand)

    driver.run(script)


def test_a_key_is_dragged_in_the_picture(driver):
    def script():
        editor = driver.editor
        path = four_keys(driver)
        editor.viewport.navigation.position = np.array([-4.0, -3.0, 4.0])
        editor.viewport.navigation.heading, editor.viewport.navigation.pitch = 0.3, -0.2
        driver.frames(3)
        corner, end = place(driver, "//View/view")
        width, height = (end - corner).astype(int)
        camera = editor.viewport.shot(int(width), int(height)).camera

        def handle(key):
            return corner + next(
                each.handle_px for each in path_overlay_of(editor.viewport, camera).keys if each.key == key
            )

        steps = len(editor.document.history.labels)
        start = handle(2)
        hand(driver, start, start + [40, -30])
        moved = editor.document.scene.path
        assert handle(2) == pytest.approx(start + [40, -30], abs=2)
        depth = [camera.world_to_camera[2, :3] @ each.positions[2] for each in (path, moved)]
        assert depth[0] == pytest.approx(depth[1])  # in the plane that faces the view
        assert np.array_equal(np.delete(moved.positions, 2, axis=0), np.delete(path.positions, 2, axis=0))
        assert editor.document.history.labels[steps:] == ["Move keyframe"]
        assert np.array_equal(editor.viewport.navigation.position, [-4.0, -3.0, 4.0])  # the view stays

        driver.press(UNDO)
        assert editor.document.scene.path is path
        hand(driver, start, start + [30, -40], KEY.mod_shift)
        risen = editor.document.scene.path.positions[2] - path.positions[2]
        assert risen[:2] == pytest.approx([0, 0], abs=1e-9)
        assert risen[2] > 0.1

        driver.click("//Timeline/show path")
        hand(driver, start, start + [30, 0])  # nothing is there to take hold of: the view orbits
        assert not np.array_equal(editor.viewport.navigation.position, [-4.0, -3.0, 4.0])

    driver.run(script)
