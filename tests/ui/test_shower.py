"""Weather, rain regions and the drop color in the window, driven by hand."""

import numpy as np
import pytest
from imgui_bundle import implot

from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.editor.rain_regions import face_handles, inset_view
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.render.draw import rain_anchor
from ui.panels import rain_keyframes
from window_driver import imgui


@pytest.fixture
def pixel_of(monkeypatch):
    """Screen position of a point of the plot, as last drawn."""
    last = {}
    drawn = rain_keyframes.now_line

    def spy(editor):
        drawn(editor)
        for name, at in (("zero", 0.0), ("one", 1.0)):
            pixel = implot.plot_to_pixels(at, at)
            last[name] = np.array([pixel.x, pixel.y])

    monkeypatch.setattr(rain_keyframes, "now_line", spy)
    return lambda seconds, rate: last["zero"] + [seconds, rate] * (last["one"] - last["zero"])


def test_keys_are_dragged_added_and_removed_in_the_plot(driver, pixel_of):
    document = driver.editor.document
    keys = ((0.0, 0.0), (10.0, 8.0), (20.0, 0.0))
    hill = RainKeyframes(keys=tuple(RainKeyframe(time_s=at, intensity_mm_h=rate) for at, rate in keys))

    def place(key):
        return key.time_s, key.intensity_mm_h

    def script():
        document.edit_keyframes("Hill", replace_keyframes, hill)
        driver.ctx.window_focus("//Shower")
        driver.frames(4)
        driver.stroke(pixel_of(10.0, 8.0), *(pixel_of(11.0, rate) for rate in (8.5, 9.5, 11.0)))
        assert place(document.keyframes.keys[1]) == pytest.approx((11.0, 11.0), abs=0.3)
        assert document.history.undo_label == "Move rain keyframe"
        document.undo()
        assert document.keyframes == hill
        driver.point_at(pixel_of(15.0, 7.0))
        driver.ctx.mouse_double_click(0)
        driver.frames(3)
        added = document.keyframes.keys[2]
        assert len(document.keyframes.keys) == 4 and place(added) == pytest.approx((15.0, 7.0), abs=0.3)
        driver.click_at(pixel_of(10.0, 8.0), button=1)
        assert document.keyframes.key_times["intensity_mm_h"].tolist() == [0.0, added.time_s, 20.0]

    driver.run(script)


def test_a_face_of_the_region_is_dragged_from_outside(driver):
    """The upper face in the inset: the region gets higher, the floor stays, and it is one step."""
    editor = driver.editor

    def script():
        editor.viewport.options.tool = "Rain regions"
        driver.ctx.window_focus("//View")
        driver.frames(4)
        corner, size = driver.area()
        style = imgui.get_style()
        em = style.font_size_base * style.font_scale_main * style.font_scale_dpi
        inset = np.minimum([15 * em, 11 * em], 0.5 * size).astype(int)
        shot, box = editor.viewport.shot(*map(int, size)), editor.document.rain.streak_region
        anchor = rain_anchor(editor.document.scene, editor.live_rain.simulation, shot)
        camera = inset_view(box, anchor, *inset.tolist()).camera
        (top,) = [each for each in face_handles(box, anchor, camera, inset=0.0) if each.face == (2, True)]
        x, y, z = camera.world_to_camera[:3] @ np.append(top.point_m, 1.0)
        place = corner + size - inset - 0.6 * em + [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
        steps = editor.document.history.cursor
        driver.stroke(place, *(place - [0, up] for up in (4, 8, 12)))
        changed = editor.document.rain.streak_region
        assert changed.maximum_m[2] > box.maximum_m[2] + 0.3
        assert (changed.minimum_m, changed.maximum_m[:2]) == (box.minimum_m, box.maximum_m[:2])
        assert editor.document.history.cursor == steps + 1
        editor.document.undo()
        assert editor.document.rain.streak_region == box

    driver.run(script)


def test_the_drop_color_is_picked_from_the_view(driver):
    """A pixel of the wall, which is reddish, then a rectangle of the sky; back to the scene's sky."""
    editor = driver.editor

    def script():
        editor.document.change_rain("Intensity", intensity_mm_h=8.5)
        driver.frames(3)
        driver.click("//Rain/###pick sky")
        driver.ctx.window_focus("//View")
        driver.frames(3)
        picture = driver.picture()
        row, column = np.unravel_index(np.argmax(picture[..., 0] - picture[..., 2]), picture.shape[:2])
        driver.click_at(driver.area()[0] + [column + 0.5, row + 0.5])
        driver.until(lambda: editor.document.rain.drop_color is not None)
        picked = editor.document.rain.drop_color
        assert picked[0] > picked[2] + 0.1
        driver.stroke(driver.at(0.4, 0.14), driver.at(0.6, 0.2))
        driver.until(lambda: editor.viewport.sky_pick is None and editor.document.rain.drop_color != picked, 200)
        driver.frames()
        assert editor.document.rain.drop_color[2] > editor.document.rain.drop_color[0] + 0.05
        driver.click("//Rain/from the sky")
        assert editor.document.rain.drop_color is None

    driver.run(script)
