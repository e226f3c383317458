"""The appearance follows the rain: wet colors, the intensity, wetness by hand, undo and redo."""

import numpy as np
import pytest

from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.scene.transforms import with_wet_colors_of
from ui.commands.base import chord
from window_driver import Driver, imgui

UNDO, REDO = chord(imgui.Key.mod_ctrl, imgui.Key.z), chord(imgui.Key.mod_ctrl, imgui.Key.y)


def darker(scene):
    for each in scene.members:
        scene = scene.with_member(each.key, wet_sh=each.gaussians.sh - np.float32(0.6))
    return scene


@pytest.fixture
def driver(tmp_path):
    return Driver(tmp_path)


def test_the_intensity_blends_wet_colours_in_and_every_step_is_undone(driver):
    def script():
        editor = driver.editor
        driver.click("//Rain/Streaks")  # so that the pictures show the scene alone
        driver.click("//Rain/Haze")
        clear, before = driver.picture(), editor.document.scene
        editor.viewport.staged = PendingScene("Make it rainy", darker(before), change=with_wet_colors_of)
        driver.until(lambda: editor.document.scene is not before)
        assert [new.gaussians for new in editor.document.scene.members] == [old.gaussians for old in before.members]
        assert np.array_equal(driver.picture(), clear)  # it does not rain
        driver.ctx.item_input_value("//Rain/##intensity_mm_h", 12.0)
        driver.frames()
        wet = driver.picture()
        assert np.abs(wet - clear).mean() > 3
        driver.press(UNDO)
        assert np.array_equal(driver.picture(), clear)
        driver.press(UNDO)
        assert editor.document.scene is before
        driver.press(REDO)
        driver.press(REDO)
        assert np.array_equal(driver.picture(), wet)

    driver.run(script)
