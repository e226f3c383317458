"""Weather, rain regions and the drop color in the window, driven by hand."""

import numpy as np
import pytest
from imgui_bundle import implot

from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.editor.rain_regions import face_handles, inset_view
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.render.draw import rain_anchor
from ui.panels import rain_keyframes
from window_driver import Driver, imgui


@pytest.fixture
def driver(tmp_path):
    return Driver(tmp_path)


def hill():
    keys = ((0.0, 0.0), (10.0, 8.0), (20.0, 0.0))
    return RainKeyframes(keys=tuple(RainKeyframe(time_s=at, intensity_mm_h=rate) for at, rate in keys))


@pytest.fixture
def pixel_of(monkeypatch):
    """Screen position of a point of the plot, as last drawn."""
    last = {}
    drawn = rain_keyframes.now_line

    def spy(editor):
        drawn(editor)
        last["zero"], last["one"] = implot.plot_to_pixels(0.0, 0.0), implot.plot_to_pixels(1.0, 1.0)

    monkeypatch.setattr(rain_keyframes, "now_line", spy)

    def pixel(seconds, rate):
        zero, one = last["zero"], last["one"]
        return imgui.ImVec2(zero.x + seconds * (one.x - zero.x), zero.y + rate * (one.y - zero.y))

    return pixel


def at(driver, place, *, press=None):
    driver.ctx.mouse_move_to_pos(place)
    driver.frames()
    if press is not None:
        driver.ctx.mouse_click(press)
        driver.frames()


def test_keys_are_dragged_added_and_removed_in_the_plot(driver, pixel_of):
    def script():
        editor = driver.editor
        editor.document.edit_keyframes("Hill", replace_keyframes, hill())
        driver.ctx.window_focus("//Shower")
        driver.frames(4)
        at(driver, pixel_of(10.0, 8.0))
        driver.ctx.mouse_down(0)
        driver.frames()
        for rate in (8.5, 9.5, 11.0):
            driver.ctx.mouse_move_to_pos(pixel_of(11.0, rate))
            driver.frames()
        driver.ctx.mouse_up(0)
        driver.frames()
        moved = editor.document.keyframes.keys[1]
        assert (moved.time_s, moved.intensity_mm_h) == (pytest.approx(11.0, abs=0.3), pytest.approx(11.0, abs=0.3))
        assert editor.document.history.undo_label == "Move rain keyframe"
        editor.document.undo()
        assert editor.document.keyframes == hill()
        at(driver, pixel_of(15.0, 7.0))
        driver.ctx.mouse_double_click(0)
        driver.frames(3)
        assert len(editor.document.keyframes.keys) == 4
        added = editor.document.keyframes.keys[2]
        assert (added.time_s, added.intensity_mm_h) == (pytest.approx(15.0, abs=0.3), pytest.approx(7.0, abs=0.3))
        at(driver, pixel_of(10.0, 8.0), press=1)
        assert editor.document.keyframes.key_times["intensity_mm_h"].tolist() == [0.0, added.time_s, 20.0]

    driver.run(script)


def view_corner(driver):
    driver.ctx.window_focus("//View")
    driver.frames(3)
    info = driver.ctx.item_info("//View/view")
    return info.rect_full.min, info.rect_full.get_width(), info.rect_full.get_height()


def test_a_face_of_the_region_is_dragged_from_outside(driver):
    """The upper face in the inset: the region gets higher, the floor stays, and it is one step."""

    def script():
        editor = driver.editor
        editor.viewport.options.tool = "Rain regions"
        driver.frames(4)
        corner, width, height = view_corner(driver)
        em = font_size()
        wide, high = int(min(15 * em, 0.5 * width)), int(min(11 * em, 0.5 * height))
        shot = editor.viewport.shot(int(width), int(height))
        anchor = rain_anchor(editor.document.scene, editor.live_rain.simulation, shot)
        box = editor.document.rain.streak_region
        camera = inset_view(box, anchor, wide, high).camera
        (top,) = [each for each in face_handles(box, anchor, camera, inset=0.0) if each.face == (2, True)]
        x, y, z = camera.world_to_camera[:3, :3] @ top.point_m + camera.world_to_camera[:3, 3]
        at_x = corner.x + width - wide - 0.6 * em + camera.fx * x / z + camera.cx
        at_y = corner.y + height - high - 0.6 * em + camera.fy * y / z + camera.cy
        driver.ctx.mouse_move_to_pos(imgui.ImVec2(at_x, at_y))
        driver.frames()
        driver.ctx.mouse_down(0)
        driver.frames()
        steps = editor.document.history.cursor
        for up in (4, 8, 12):
            driver.ctx.mouse_move_to_pos(imgui.ImVec2(at_x, at_y - up))
            driver.frames()
        driver.ctx.mouse_up(0)
        driver.frames()
        changed = editor.document.rain.streak_region
        assert changed.maximum_m[2] > box.maximum_m[2] + 0.3
        assert (changed.minimum_m, changed.maximum_m[:2]) == (box.minimum_m, box.maximum_m[:2])
        assert editor.document.history.cursor == steps + 1
        editor.document.undo()
        assert editor.document.rain.streak_region == box

    driver.run(script)


def font_size():
    return imgui.get_style().font_size_base * imgui.get_style().font_scale_main * imgui.get_style().font_scale_dpi


def test_the_drop_colour_is_picked_from_the_view(driver):
    """A pixel of the wall, which is reddish, then a rectangle of the sky; back to the scene's sky."""

    def script():
        editor = driver.editor
        editor.document.change_rain("Intensity", intensity_mm_h=8.5)
        driver.frames(3)
        driver.click("//Rain/###pick sky")
        corner, width, height = view_corner(driver)
        shown = driver.picture()
        reddish = shown[..., 0] - shown[..., 2]
        row, column = np.unravel_index(np.argmax(reddish), reddish.shape)
        at(driver, imgui.ImVec2(corner.x + column + 0.5, corner.y + row + 0.5), press=0)
        driver.until(lambda: editor.document.rain.drop_color is not None)
        red, _, blue = editor.document.rain.drop_color
        assert red > blue + 0.1
        driver.ctx.mouse_move_to_pos(imgui.ImVec2(corner.x + 0.4 * width, corner.y + 0.14 * height))
        driver.ctx.mouse_down(0)
        driver.frames()
        driver.ctx.mouse_move_to_pos(imgui.ImVec2(corner.x + 0.6 * width, corner.y + 0.2 * height))
        driver.frames()
        driver.ctx.mouse_up(0)
        driver.until(
            lambda: editor.viewport.sky_pick is None and editor.document.rain.drop_color != (red, _, blue), 200
        )
        driver.frames()
        assert editor.document.rain.drop_color[2] > editor.document.rain.drop_color[0] + 0.05
        driver.click("//Rain/from the sky")
        assert editor.document.rain.drop_color is None

    driver.run(script)
