"""Small and large windows on screens of any scale: docks fold to a strip, and the viewport stays usable."""

import pytest
from msgspec.structs import replace

from window_driver import hello_imgui, imgui

OPEN = "//###open panel"


@pytest.fixture
def driver(unopened):
    unopened.size_px, unopened.dpi_scale = (800, 560), 2.0
    return unopened


def test_in_a_small_window_panels_fold_to_names_and_one_opens_over_the_view(driver):
    dpi_scale = driver.dpi_scale

    def is_docked():
        return driver.ctx.window_info("//Rain", imgui.test_engine.TestOpFlags_.no_error).window is not None

    def sizes():
        style = imgui.get_style()
        names = ("docking_separator_size", "indent_spacing", "window_min_size", "cell_padding", "scrollbar_size")
        return [str(getattr(style, name)) for name in names]

    folded, editor = driver.window.workspace.folded, driver.editor
    before = sizes()
    names = ["Layers", "Rain", "Wet look", "Timeline", "Log"]
    assert [each for each in folded.hidden if each in names] == names and folded.open == ""
    _, size = driver.area()
    assert size[0] > 0.75 * 800 * dpi_scale and size[1] > 0.65 * 560 * dpi_scale  # px

    # 5 mm/h in two actions; the panel closes where it was opened.
    driver.tap("//**/###fold Rain")
    driver.tap(f"{OPEN}/Rain/5")
    assert editor.document.rain.intensity_mm_h == 5.0
    rect = driver.ctx.window_info(OPEN).window.rect()
    corner, size = driver.area()
    assert rect.max.x <= corner[0] + size[0] + 1 and rect.min.x >= corner[0]
    driver.tap("//**/###fold Rain")
    assert folded.open == ""

    # The timeline has room for all of its buttons, below the picture.
    driver.tap("//**/###fold Timeline")
    rect = driver.ctx.window_info(OPEN).window.rect()
    assert rect.min.y > corner[1] + 100 * dpi_scale
    for each in ("add key", "path", "record"):
        start, size = driver.area(f"{OPEN}/Timeline/###{each}")
        assert size[0] > 0 and rect.min.x < start[0] and start[0] + size[0] <= rect.max.x
    driver.tap("//**/###fold Timeline")

    # What asks for a panel opens it there.
    driver.ctx.set_ref("//##MainMenuBar")
    driver.ctx.menu_click("View/Panels/Jobs")
    driver.ctx.set_ref("")
    driver.frames()
    assert folded.open == "Jobs"

    # A smaller text makes room for all docks, and a larger one folds them again.
    editor.preferences.value = replace(editor.preferences.value, font_scale=0.6)
    driver.frames(4)
    assert (folded.hidden, folded.width, is_docked()) == ([], 0.0, True)
    driver.frames(8)
    assert {"Layers", "Rain", "Timeline"} <= set(editor.preferences.value.front_panels)
    editor.preferences.value = replace(editor.preferences.value, font_scale=1.0)
    driver.frames(4)
    assert folded.open == "" and [each for each in folded.hidden if each in names] == names
    assert sizes() == before  # however often preferences change
    padding = imgui.get_style().frame_padding.x
    assert padding == pytest.approx(6 * dpi_scale, abs=1)  # sizes keep to the screen's scale
    folded.unfold()
    windows = hello_imgui.get_runner_params().docking_params.dockable_windows
    assert all(each.is_visible for each in windows)  # as they are saved
