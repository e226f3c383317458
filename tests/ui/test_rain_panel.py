"""The Rain panel on the screen of a small laptop: what is used most needs no scrolling."""

import pytest

from window_driver import imgui

USED_MOST = (
    *("0", "1.2", "5", "8.5", "12", "paper", "##intensity_mm_h", "##exposure_s", "Streaks", "Splashes and rings"),
    *("Spray", "##haze", "##visibility_m given", "##wetness", "##wind_speed_m_s", "##wind_from_deg", "##glass"),
    *("##lamps", "###pick sky"),
)


@pytest.fixture
def driver(unopened):
    unopened.size_px = (1366, 768)
    return unopened


def part_in_sight(driver, name):
    """The part of a panel between its tabs and its lower edge, without its scroll bar."""
    window = driver.ctx.window_info(f"//{name}").window
    assert window.active and not window.hidden and window.scroll.y == 0
    return window.inner_clip_rect


def test_common_controls_are_in_sight_and_others_are_folded(driver):
    driver.editor.document.change_rain("Rain", intensity_mm_h=8.5)
    driver.panel("Rain")
    sight = part_in_sight(driver, "Rain")
    for item in USED_MOST:
        rect = driver.ctx.item_info(f"//Rain/{item}").rect_full
        assert sight.min.y <= rect.min.y < rect.max.y <= sight.max.y, item
        assert sight.min.x <= rect.min.x < rect.max.x <= sight.max.x, item
    absent = imgui.test_engine.TestOpFlags_.no_error
    for item in ("##diameter_scale", "##streak_gain", "wind"):
        assert driver.ctx.item_info(f"//Rain/{item}", absent).id_ == 0, item


def test_four_figures_of_the_rain_come_first_and_all_others_unfold(driver):
    driver.editor.document.change_rain("Rain", intensity_mm_h=8.5)
    driver.panel("Rain properties")
    sight = part_in_sight(driver, "Rain properties")
    assert sight.get_height() < driver.ctx.window_info("//Rain").window.inner_clip_rect.get_height() / 2
    more = "//Rain properties/More quantities"
    folded = driver.ctx.item_info(more).rect_full
    assert folded.max.y <= sight.max.y and folded.min.y - sight.min.y < 7 * imgui.get_text_line_height_with_spacing()
    window = driver.ctx.window_info("//Rain properties").window
    assert window.scroll_max.y == 0
    driver.tap(more)
    assert window.scroll_max.y > 0
