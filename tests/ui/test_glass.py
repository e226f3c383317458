"""Water on glass in the real window: chosen in the Rain panel, drawn in the viewport and in the pictures of a rig."""

import numpy as np

from ui.widgets import fields


def test_glass_is_chosen_and_drawn_in_the_viewport(driver):
    editor = driver.editor

    document = editor.document
    document.change_rain("Wet before", glass_wet_s=5.0, streaks=False, intensity_mm_h=12.0)
    open_air = driver.picture()
    driver.panel("Rain")
    driver.ctx.set_ref("//Rain")
    driver.ctx.combo_click("##glass/windshield")
    assert document.rain.glass == "windshield" and document.history.undo_label == "Glass"
    behind = driver.picture()
    assert np.abs(behind - open_air).max() > 20
    assert np.array_equal(driver.picture(), behind)  # drops stay while time stands still
    editor.playback.clock.time_s = 1.0
    assert not np.array_equal(driver.picture(), behind)
    editor.playback.clock.time_s = 0.0
    assert np.array_equal(driver.picture(), behind)
    driver.ctx.combo_click("##glass/none")
    assert np.array_equal(driver.picture(), open_air)


def test_the_panel_says_what_keeps_a_lens_dry(driver, monkeypatch):
    said = []
    monkeypatch.setattr(fields, "faint", said.append)
    for kind in ("windshield", "lens"):
        driver.editor.document.change_rain("Glass", glass=kind)
        said.clear()
        driver.panel("Rain")
        driver.tap("//Rain/Glass")
        assert any("against it" in each for each in said) == (kind == "lens")
        driver.tap("//Rain/Glass")
