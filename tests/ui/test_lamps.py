"""Lamps of the Rain panel in the real window, by hand."""

import numpy as np
import pytest

from ui.commands.keys import chord
from window_driver import imgui

UNDO = chord(imgui.Key.mod_ctrl, imgui.Key.z)


def test_a_lamp_is_added_edited_and_removed(driver):
    editor = driver.editor

    document, options = editor.document, editor.viewport.options
    document.change_rain("Fog", visibility_m=60.0)
    driver.click("//Rain/Lamps")
    dark = driver.picture()
    driver.tap("//Rain/Add lamp")
    assert document.history.undo_label == "Add lamp" and options.show_lamps
    lamp = document.scene.lamps_at(0.0).positions_m[0]
    assert driver.on_screen(lamp - [0, 0, 0.3]) == pytest.approx(driver.at(0.5, 0.5), abs=12)
    lit = driver.picture()
    assert np.abs(lit - dark).max() > 4
    driver.ctx.scroll_to_item_y("//Rain/##intensity_m2")
    driver.type_in("//Rain/##intensity_m2", 400.0)
    driver.type_in("//Rain/##outer_deg", 40.0)
    steps = document.history.labels[-3:]
    assert steps == ["Add lamp", "lamp: intensity", "lamp: dark beyond"]
    assert (document.scene.lamps[0].intensity_m2, document.scene.lamps[0].inner_deg) == (400.0, 40.0)
    brighter = driver.picture()
    assert np.abs(brighter - lit).max() > 4
    driver.press(UNDO)
    driver.press(UNDO)
    assert np.array_equal(driver.picture(), lit)
    driver.ctx.scroll_to_item_y("//Rain/Remove lamp")
    driver.tap("//Rain/Remove lamp")
    assert not document.scene.lamps and options.lamp == -1
    assert np.array_equal(driver.picture(), dark)
    driver.press(UNDO)
    assert np.array_equal(driver.picture(), lit)
    driver.ctx.scroll_to_item_y("//Rain/Find lamps")
    driver.tap("//Rain/Find lamps")
    driver.until(lambda: not editor.jobs.is_running("lamps"))
    assert editor.jobs.newest("lamps").progress.message.startswith("No lamps were found")
    document.change_rain("No lamps", lamps="none")
    assert np.array_equal(driver.picture(), dark)
