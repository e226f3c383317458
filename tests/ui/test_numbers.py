"""Numbers by hand: typed after a double click, refused beyond their bounds, and the compass of the wind."""

import pytest

from ui.commands.keys import chord
from ui.widgets import numbers
from window_driver import imgui

KEY = imgui.Key
FIELD = "//Rain/##intensity_mm_h"


def test_a_number_is_typed_after_a_double_click_and_limited_with_its_bound_on_the_screen(driver, monkeypatch):
    monkeypatch.setattr(numbers, "_FLASH_S", 60.0)  # the machine may be busy
    document = driver.editor.document
    driver.drag(FIELD, (40, 0))
    dragged = document.rain.intensity_mm_h
    assert dragged > 1 and document.history.labels == ["Opened", "Intensity"]
    driver.click(FIELD)
    assert document.rain.intensity_mm_h == dragged  # a click is none of a drag: the value stays
    driver.ctx.item_double_click(FIELD)
    driver.frames(3)
    driver.ctx.key_chars_replace_enter("40")  # beyond the slider's 13, within the bounds
    driver.frames(3)
    assert document.rain.intensity_mm_h == 40
    before, (low, size) = driver.screen(), driver.area(FIELD)
    driver.ctx.item_double_click(FIELD)
    driver.frames(3)
    driver.ctx.key_chars_replace_enter("200")
    driver.frames(2)
    assert document.rain.intensity_mm_h == 149
    x, y = (low + [0, size[1]]).astype(int)
    red = (driver.screen() - before)[y + 3 : y + 12, x + 2 : x + 5].mean(axis=(0, 1))
    assert red[0] > 100 > red[2]  # the card with "max 149 mm/h"
    assert document.history.labels == ["Opened", "Intensity", "Intensity", "Intensity"]
    steps = document.history.steps
    assert steps[2].document.rain_change(steps[3].document) == "40 -> 149 mm/h"
    driver.ctx.item_click(FIELD, 1)
    driver.frames()
    assert document.rain.intensity_mm_h == 0


def test_the_needle_of_the_compass_is_dragged_and_turned_by_keys(driver):
    document, clock = driver.editor.document, driver.editor.playback.clock

    def wind():
        return document.rain.wind_from_deg, document.rain.wind_speed_m_s

    driver.click("//Rain/Wind and seed")
    driver.ctx.scroll_to_item_y("//Rain/wind")
    driver.frames(3)
    corner, size = driver.area("//Rain/wind")
    center, reach = corner + size / 2, size[0] / 2
    driver.stroke(center + [0, -0.3 * reach], center + [0.3 * reach, 0], center + [0.4 * reach, 0])
    from_deg, speed_m_s = wind()
    assert from_deg == pytest.approx(90, abs=2) and 8 < speed_m_s < 13
    assert document.history.labels == ["Opened", "Wind"]
    driver.press(KEY.right_arrow)
    driver.press(KEY.up_arrow)
    assert wind() == (from_deg + 5, pytest.approx(speed_m_s + 0.5)) and clock.time_s == 0
    driver.press(chord(KEY.mod_ctrl, KEY.z))
    assert wind() == (from_deg + 5, speed_m_s)
    driver.ctx.window_focus("//View")
    driver.press(KEY.right_arrow)
    assert clock.time_s > 0  # a frame forward, since the compass has the focus no more
