"""Moving, measuring, cropping and cleaning in the real window, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.scene.flags import BitMask
from ui.commands.keys import chord
from window_driver import imgui

WALL = "layers/wall"


def use(driver, name):
    driver.ctx.window_focus("//View")
    driver.editor.viewport.options.tool = name
    driver.frames(3)


def change_wall(editor, **changes):
    editor.document.edit("Change", replace_scene, editor.document.scene.with_member(WALL, **changes))


def arrow_at(driver, middle_m):
    """Middle of the upward arrow of the gizmo at a world point."""
    start = driver.on_screen(middle_m)
    up = driver.on_screen(middle_m + [0, 0, 3.0]) - start
    return start + 28 * up / np.linalg.norm(up)


def drag_up(driver, handle, pixels, **options):
    driver.stroke(handle, *(handle - [0, part] for part in np.linspace(0, pixels, 7)[1:]), **options)


def release(driver):
    driver.ctx.mouse_up(0)
    driver.frames()


def test_dragging_an_arrow_moves_the_layer_as_one_step(driver):
    editor = driver.editor

    editor.viewport.options.member = WALL
    before, steps = driver.picture(), editor.document.history.cursor
    driver.press(imgui.Key.t)
    assert editor.viewport.options.tool == "Transform"
    driver.frames(3)
    drag_up(driver, arrow_at(driver, np.array([40, 0, 4.5])), 40, lets_go=False)
    assert editor.document.history.cursor == steps
    dragged = driver.picture()
    assert np.abs(dragged - before).max() > 20
    release(driver)
    assert editor.document.history.labels[steps + 1 :] == ["Move wall"]
    move = editor.document.scene.member(WALL).to_scene
    assert move[2, 3] > 1
    assert move[:2, 3] == pytest.approx(np.zeros(2), abs=1e-3)
    assert np.array_equal(driver.picture(), dragged)
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.z))
    assert np.array_equal(driver.picture(), before)


def test_the_selection_is_dragged_and_escape_takes_it_back(driver):
    editor = driver.editor

    editor.viewport.options.show_selection = False
    wall = editor.document.scene.member(WALL)
    means = wall.gaussians.means
    upper = means[:, 2] > 4.5
    change_wall(editor, marks=replace(wall.marks, selected=BitMask.of(upper)))
    before, steps = driver.picture(), editor.document.history.cursor
    use(driver, "Transform")
    handle = arrow_at(driver, np.median(means[upper], axis=0).astype(float))
    drag_up(driver, handle, 30, lets_go=False)
    assert np.abs(driver.picture() - before).max() > 20
    driver.press(imgui.Key.escape)
    release(driver)
    assert editor.document.history.cursor == steps
    use(driver, "Transform")
    assert np.array_equal(driver.picture(), before)
    drag_up(driver, handle, 30)
    assert editor.document.history.undo_label == "Move the selection"
    moved = editor.document.scene.member(WALL).gaussians.means - means
    assert np.all(moved[upper][:, 2] > 0.5) and not moved[~upper].any()


def test_a_face_of_the_crop_box_is_dragged_and_applied(driver):
    editor = driver.editor
    use(driver, "Crop")
    editor.viewport.frame_scene()
    editor.viewport.navigation.orbit(0.5, -0.4)
    driver.tool("Crop").box = None
    driver.frames(3)
    box, eye = driver.tool("Crop").box, editor.viewport.navigation.position.copy()
    top = box.face_m(2, True)
    driver.stroke(*(driver.on_screen(top - [0, 0, depth]) for depth in np.linspace(0, 4, 7)))
    smaller = driver.tool("Crop").box
    assert smaller.size_m[2] == pytest.approx(box.size_m[2] - 4, abs=0.2)
    assert smaller.face_m(2, False) == pytest.approx(box.face_m(2, False))
    assert np.array_equal(editor.viewport.navigation.position, eye)
    driver.tap("**/Apply##crop")
    wall = editor.document.scene.member(WALL)
    assert np.all(wall.marks.deleted.flags[wall.gaussians.means[:, 2] > smaller.face_m(2, True)[2]])
    assert editor.document.scene.member("layers/sky").marks.deleted is None
    driver.ctx.mouse_move(f"{driver.panel('Edit')}###purge")
    driver.frames(4)  # with its tooltip, which lists the steps
    driver.tap("//Edit/###purge")
    assert editor.document.history.labels[-1] == "Purge deleted"
    assert editor.document.scene.member(WALL).marks.deleted is None


def test_the_view_next_to_the_options_of_a_tool_can_be_dragged(driver):
    use(driver, "Crop")
    driver.frames(3)
    heading = driver.editor.viewport.navigation.heading
    driver.stroke(driver.at(0.97, 0.05), driver.at(0.87, 0.05))
    assert driver.editor.viewport.navigation.heading != heading


def test_floaters_that_are_found_are_marked_counted_and_deleted(driver):
    editor = driver.editor
    wall = editor.document.scene.member(WALL)
    opacities = wall.gaussians.opacities.copy()
    opacities[[22, 210, 377]] = 0.004  # hardly anything to be tinted
    change_wall(editor, gaussians=replace(wall.gaussians, opacities=opacities))
    driver.panel("Edit")
    driver.ctx.set_ref("")

    def are_marked():
        """Tell for each of the centers whether there is a dot of the selection's color."""
        screen, found = driver.screen(), []
        for center in wall.gaussians.means[[22, 210, 377]]:
            x, y = driver.on_screen(center).round().astype(int)
            there = screen[y - 2 : y + 3, x - 2 : x + 3]
            found.append(bool(np.abs(there - (255, 209, 38)).max(axis=2).min() < 40))
        return found

    assert are_marked() == [False] * 3
    driver.tap("//Edit/Find floaters")
    driver.until(lambda: editor.floaters.count is not None)
    driver.frames(3)
    assert editor.floaters.count == 3 and are_marked() == [True] * 3
    editor.viewport.options.show_selection = False
    assert are_marked() == [False] * 3
    driver.tap("//Edit/Delete 3 floaters")
    assert editor.document.scene.member(WALL).marks.deleted.indices.tolist() == [22, 210, 377]
