"""Named views in the real window, by hand: save one, move on, come back, rename, reorder, delete, undo."""

import numpy as np
import pytest
from msgspec import structs

from gsrain_engine.editor.edits.views import save_view
from gsrain_engine.editor.views import picture_pixels, small_picture
from gsrain_engine.scene.named_view import NamedView
from ui.commands.keys import chord
from window_driver import imgui

KEY = imgui.Key
CTRL, SHIFT = KEY.mod_ctrl, KEY.mod_shift
UNDO = chord(CTRL, KEY.z)


def names(driver):
    return [view.name for view in driver.editor.document.scene.views]


def place(driver):
    return driver.editor.viewport.shot(96, 64).camera.world_to_camera


def look_elsewhere(driver):
    driver.stroke(driver.at(0.5, 0.5), driver.at(0.7, 0.55), button=1)
    driver.editor.playback.clock.seek(3.0)


def test_a_view_is_saved_and_come_back_to_in_two_actions(driver):
    editor = driver.editor
    editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    before, first = place(driver), driver.picture()
    driver.press(chord(CTRL, SHIFT, KEY.v))
    assert driver.is_open("Save view")
    driver.enter("Gate")
    assert not driver.is_open("Save view") and names(driver) == ["Gate"]
    assert editor.document.history.undo_label == "Save view: Gate"
    found, of_screen = (
        picture_pixels(each).astype(float)
        for each in (editor.document.scene.views[0].picture, small_picture(first.astype(np.uint8)))
    )
    assert np.abs(found - of_screen).mean() < 4  # the window's picture has a quarter of the pixels along each side

    look_elsewhere(driver)
    assert not np.allclose(place(driver), before, atol=1e-3)
    with driver.journey(2):
        driver.menu("View/Go to view 1 (Gate)")
    np.testing.assert_array_equal(driver.picture(), first)

    look_elsewhere(driver)
    editor.document.change_rain("Intensity", intensity_mm_h=0.0)
    with driver.journey(1):
        driver.press(chord(CTRL, KEY._1))
    np.testing.assert_allclose(place(driver), before, atol=1e-9)
    assert (editor.playback.clock.time_s, editor.document.rain.intensity_mm_h) == (0.0, 8.5)
    driver.press(UNDO)
    assert editor.document.rain.intensity_mm_h == 0.0

    look_elsewhere(driver)
    with driver.journey(2):
        driver.tap(driver.panel("Views") + "**/###view Gate")
    np.testing.assert_allclose(place(driver), before, atol=1e-9)


def test_views_are_renamed_set_moved_and_deleted_in_the_panel(driver):
    panel = driver.panel("Views")
    for _ in range(2):
        driver.tap(panel + "Save")
    driver.click(panel + "rain")
    driver.ctx.item_click(panel + "##view name")
    driver.enter("Bridge")
    assert names(driver) == ["View 1", "View 2", "Bridge"]
    assert [view.rain is None for view in driver.editor.views.views] == [False, False, True]
    assert set(driver.editor.views.textures) == {"View 1", "View 2", "Bridge"}

    driver.double_click(panel + "**/###view View 2")
    driver.enter("Gate")
    driver.tap(panel + "**/###view View 1")
    driver.press(KEY.f2)
    driver.enter("Gate")  # is in use
    assert names(driver) == ["View 1", "Gate", "Bridge"] and "Gate" in driver.editor.status.problem
    driver.editor.status.problem = None
    driver.press(KEY.f2)
    driver.enter("Door")
    assert names(driver) == ["Door", "Gate", "Bridge"]

    def choose(view, item):
        driver.ctx.item_click(f"{panel}**/###view {view}", 1)
        driver.frames()
        driver.ctx.item_click(f"//$FOCUSED/{item}")
        driver.frames()

    look_elsewhere(driver)
    choose("Bridge", "Move up")
    choose("Door", "Move down")
    choose("Gate", "Set to current view")
    choose("Door", "###delete")
    assert names(driver) == ["Bridge", "Gate"] and driver.editor.views.views[1].time_s == 3.0
    labels = ["Rename view: View 1 to Door", "Move view up: Bridge", "Move view down: Door",
              "Set view to current: Gate", "Delete view: Door"]  # fmt: skip
    assert driver.editor.document.history.labels[-5:] == labels
    for _ in labels:
        driver.press(UNDO)
    assert names(driver) == ["View 1", "Gate", "Bridge"]


def test_the_palette_finds_views_by_name(driver):
    view = NamedView(name="0", position=(1.0, 0.0, 1.5), quaternion_wxyz=(0.5, -0.5, 0.5, -0.5))
    for name in ("1", "2", "3", "4", "5", "6", "7", "8", "9", "Roof##of 10"):
        driver.editor.document.edit("Save", save_view, structs.replace(view, name=name))
    there = structs.replace(view, name="Tower", position=(2.0, 1.0, 5.0))
    driver.editor.document.edit("Save", save_view, there)
    driver.frames()
    driver.press(chord(CTRL, KEY.p))
    driver.enter("go to view tower")
    assert driver.editor.viewport.navigation.position == pytest.approx([2.0, 1.0, 5.0])
    driver.press(chord(CTRL, KEY.p))
    driver.enter("view (3)")
    assert driver.editor.views.chosen == "3"
    driver.menu("View/More views/Tower##Tower")
    assert driver.editor.views.chosen == "Tower"
    driver.panel("Views")
    driver.frames(3)
    assert driver.window.failure is None


def test_a_small_window_has_the_views_in_its_strip(unopened):
    unopened.size_px, unopened.dpi_scale = (800, 560), 2.0

    def script():
        driver, before = unopened, place(unopened)
        panel = driver.panel("Views")
        driver.tap(panel + "Save")
        driver.tap("//**/###fold Views")
        look_elsewhere(driver)
        assert not np.allclose(place(driver), before, atol=1e-3)
        with driver.journey(2):
            driver.tap(driver.panel("Views") + "**/###view View 1")
        np.testing.assert_allclose(place(driver), before, atol=1e-9)

    unopened.run(script)
