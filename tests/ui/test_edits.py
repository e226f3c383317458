"""Moving, measuring, cropping, levelling and grading in the real window, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.scene.flags import BitMask
from ui.commands.base import chord
from window_driver import Driver, imgui


@pytest.fixture
def driver(tmp_path):
    return Driver(tmp_path)


def on_screen(driver, point_m):
    """Screen position of a world point."""
    info = driver.ctx.item_info("//View/view")
    low, high = info.rect_full.min, info.rect_full.max
    camera = driver.editor.viewport.shot(int(high.x - low.x), int(high.y - low.y)).camera
    x, y, z = camera.world_to_camera[:3, :3] @ point_m + camera.world_to_camera[:3, 3]
    return np.array([low.x + camera.fx * x / z + camera.cx, low.y + camera.fy * y / z + camera.cy])


def drag(driver, start, end, steps=6):
    driver.ctx.mouse_move_to_pos(tuple(start))
    driver.frames()
    driver.ctx.mouse_down(0)
    driver.frames()
    for part in np.linspace(0, 1, steps + 1)[1:]:
        driver.ctx.mouse_move_to_pos(tuple(start + part * (end - start)))
        driver.frames(1)
    driver.frames()


def release(driver):
    driver.ctx.mouse_up(0)
    driver.frames()


def click_on(driver, point_m):
    driver.ctx.mouse_move_to_pos(tuple(on_screen(driver, np.array(point_m, float))))
    driver.frames()
    driver.ctx.mouse_click(0)
    driver.frames()


def select(editor, key, flags):
    marks = replace(editor.document.scene.member(key).marks, selected=BitMask.of(flags))
    editor.document.edit("Select", replace_scene, editor.document.scene.with_member(key, marks=marks))


def use(driver, name):
    driver.ctx.window_focus("//View")
    driver.editor.viewport.options.tool = name
    driver.frames(3)


def test_dragging_an_arrow_moves_the_layer_as_one_step(driver):
    def script():
        editor = driver.editor
        editor.viewport.options.member = "layers/wall"
        before, steps = driver.picture(), editor.document.history.cursor
        driver.press(imgui.Key.t)
        assert editor.viewport.options.tool == "Move"
        driver.frames(3)
        start = on_screen(driver, np.array([40, 0, 4.5]))
        up = on_screen(driver, np.array([40, 0, 8.0])) - start
        handle = start + 28 * up / np.linalg.norm(up)  # in the middle of the arrow
        drag(driver, handle, handle + [0, -40])
        assert editor.document.history.cursor == steps
        dragged = driver.picture()
        assert np.abs(dragged - before).max() > 20
        release(driver)
        assert editor.document.history.labels[steps + 1 :] == ["Move wall"]
        move = editor.document.scene.member("layers/wall").to_scene
        assert move[2, 3] > 1
        assert move[:2, 3] == pytest.approx(np.zeros(2), abs=1e-3)
        assert np.array_equal(driver.picture(), dragged)
        driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.z))
        assert np.array_equal(driver.picture(), before)

    driver.run(script)


def test_the_selection_is_dragged_and_escape_takes_it_back(driver):
    def script():
        editor = driver.editor
        editor.viewport.options.show_selection = False
        wall = editor.document.scene.member("layers/wall").gaussians
        select(editor, "layers/wall", wall.means[:, 2] > 4.5)
        before, steps = driver.picture(), editor.document.history.cursor
        use(driver, "Move")
        middle = np.median(wall.means[wall.means[:, 2] > 4.5], axis=0).astype(float)
        start = on_screen(driver, middle)
        up = on_screen(driver, middle + [0, 0, 3]) - start
        handle = start + 28 * up / np.linalg.norm(up)
        drag(driver, handle, handle + [0, -30])
        dragged = driver.picture()
        assert np.abs(dragged - before).max() > 20
        driver.ctx.key_down(imgui.Key.escape)
        driver.frames()
        driver.ctx.key_up(imgui.Key.escape)
        release(driver)
        assert editor.document.history.cursor == steps
        use(driver, "Move")
        assert np.array_equal(driver.picture(), before)
        drag(driver, handle, handle + [0, -30])
        release(driver)
        assert editor.document.history.undo_label == "Move the selection"
        there = editor.document.scene.member("layers/wall").gaussians
        assert np.all((there.means - wall.means)[wall.means[:, 2] > 4.5][:, 2] > 0.5)
        assert np.array_equal(there.means[wall.means[:, 2] <= 4.5], wall.means[wall.means[:, 2] <= 4.5])

    driver.run(script)


def test_two_clicks_measure_and_a_true_length_sets_the_metre(driver):
    def script():
        editor = driver.editor
        use(driver, "Measure")
        here = editor.viewport.navigation.position.copy()
        click_on(driver, (12, -2, 0))
        click_on(driver, (12, 2, 0))
        first, second = driver.tool("Measure").points_m
        assert np.linalg.norm(second - first) == pytest.approx(4, abs=0.3)
        assert np.array_equal(editor.viewport.navigation.position, here)
        driver.ctx.item_input_value("**/##true length", 8.0)
        driver.frames()
        driver.ctx.item_click("**/Set scale")
        driver.frames()
        assert editor.document.scene.metres_per_unit == pytest.approx(8 / np.linalg.norm(second - first))
        assert editor.document.history.undo_label == "Set the scale"
        assert editor.viewport.navigation.position == pytest.approx(editor.document.scene.metres_per_unit * here)

    driver.run(script)


def test_a_face_of_the_crop_box_is_dragged_and_applied(driver):
    def script():
        editor = driver.editor
        use(driver, "Crop")
        editor.viewport.frame_scene()
        editor.viewport.navigation.orbit(0.5, -0.4)
        driver.tool("Crop").box = None
        driver.frames(3)
        box = driver.tool("Crop").box
        start = on_screen(driver, box.face_m(2, True))
        eye = editor.viewport.navigation.position.copy()
        drag(driver, start, on_screen(driver, box.face_m(2, True) - [0, 0, 4]))
        release(driver)
        smaller = driver.tool("Crop").box
        assert smaller.size_m[2] == pytest.approx(box.size_m[2] - 4, abs=0.2)
        assert smaller.face_m(2, False) == pytest.approx(box.face_m(2, False))
        assert np.array_equal(editor.viewport.navigation.position, eye)
        driver.ctx.item_click("**/Apply##crop")
        driver.frames()
        top = smaller.face_m(2, True)[2]
        wall = editor.document.scene.member("layers/wall")
        assert np.all(wall.marks.deleted.flags[wall.gaussians.means[:, 2] > top])
        assert editor.document.scene.member("layers/sky").marks.deleted is None

    driver.run(script)


def test_floaters_are_found_shown_and_deleted(driver):
    def script():
        editor = driver.editor
        faint = editor.document.scene.member("layers/wall").gaussians
        opacities = faint.opacities.copy()
        opacities[:9] = 0.01
        editor.document.edit(
            "Faint",
            replace_scene,
            editor.document.scene.with_member("layers/wall", gaussians=replace(faint, opacities=opacities)),
        )
        driver.click("//Edit/Find floaters")
        driver.until(lambda: editor.document.history.undo_label == "Find floaters", 100_000)
        driver.frames()
        driver.click("//Edit/Delete 9 floaters")
        assert editor.document.scene.member("layers/wall").marks.deleted.size == 9
        assert editor.document.history.undo_label == "Delete floaters"

    driver.run(script)
