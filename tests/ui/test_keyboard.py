"""The keyboard in menus and lists, panels that come back, and the pivot of a double click."""

import numpy as np
import pytest

from gsrain_engine.editor.preferences import load_preferences
from ui.widgets.type_ahead import has_keys, install_type_ahead
from ui.window import interface_scale
from window_driver import Driver, hello_imgui, imgui

KEY = imgui.Key


def test_panels_in_front_and_hidden_ones_come_back(unopened, tmp_path, monkeypatch):
    monkeypatch.setattr("gsrain_engine.editor.preferences.config_folder", lambda: tmp_path / "config")

    def panels():
        return {each.label: each for each in hello_imgui.get_runner_params().docking_params.dockable_windows}

    def arrange():
        for name in ("Drive", "History"):
            unopened.ctx.window_focus(f"//{name}")
            unopened.frames(3)
        panels()["Jobs"].is_visible = False
        unopened.frames(3)

    unopened.run(arrange)
    unopened.editor.close()  # writes the preferences
    assert load_preferences()[0].hidden_panels == ("Jobs",)
    (tmp_path / "next").mkdir()
    following = Driver(tmp_path / "next")

    def look():
        assert not panels()["Jobs"].is_visible and panels()["Log"].is_visible
        front = following.editor.preferences.value.front_panels
        assert {"Drive", "History"} <= set(front) and not {"Rain", "Layers"} & set(front)
        following.frames(5)
        assert following.editor.preferences.value.front_panels == front

    following.run(look)
    following.editor.close()


def test_a_double_click_sets_the_pivot_that_an_orbit_turns_around(driver):
    viewport = driver.editor.viewport

    place = driver.at(0.62, 0.42)  # on the wall, off the line of sight
    driver.point_at(place)
    driver.ctx.mouse_double_click(0)
    driver.frames(3)
    pivot = viewport.navigation.pivot
    assert pivot == pytest.approx([40, pivot[1], pivot[2]], abs=0.6) and pivot[1] < -2
    assert np.abs(driver.on_screen(pivot) - place).max() < 2
    driver.stroke(driver.at(0.5, 0.5), driver.at(0.56, 0.5), driver.at(0.6, 0.5))
    assert np.abs(driver.on_screen(pivot) - place).max() < 2  # it stays where it was on the screen
    driver.press(KEY.r)
    assert viewport.navigation.pivot is None


def test_menus_and_lists_are_used_by_the_keyboard(driver):
    document, options = driver.editor.document, driver.editor.viewport.options
    driver.click("//Rain/##haze")  # a list
    driver.press(KEY.g)
    driver.press(KEY.enter)
    driver.frames(3)
    assert document.rain.haze == "gaussians"
    driver.click("//Rain/##haze")
    driver.press(KEY.down_arrow)
    driver.press(KEY.enter)
    driver.frames(3)
    assert document.rain.haze == "none"
    driver.click("//Rain/##haze")
    driver.press(KEY.m)
    driver.press(KEY.escape)
    driver.frames(3)
    assert document.rain.haze == "none"  # closed, not chosen
    view_menu = np.array([352, 11])
    driver.click_at(view_menu)
    was_on = options.show_selection
    for key in (KEY.h, KEY.i):
        driver.press(key)
    driver.press(KEY.enter)
    driver.frames(3)
    assert options.show_selection != was_on and document.history.labels == ["Opened", "Haze model", "Haze model"]
    driver.click_at(view_menu)
    driver.press(KEY.k)  # alone, it inserts a keyframe
    driver.press(KEY.escape)
    assert document.scene.path is None


def test_alt_and_a_letter_opens_a_menu(driver):
    for chord, command in ((KEY.f10, "Open..."), (int(KEY.mod_alt) | int(KEY.v), "Frame selection or scene")):
        driver.press(chord)
        driver.frames(3)
        assert driver.ctx.item_exists(f"//$FOCUSED/{command}")
        before = driver.editor.playback.clock.time_s
        for key in (KEY.down_arrow, KEY.right_arrow, KEY.escape, KEY.escape):
            driver.press(key)
        assert driver.editor.playback.clock.time_s == before  # the arrows move in the menu
        assert not driver.ctx.item_exists(f"//$FOCUSED/{command}")


def test_a_menu_that_was_open_in_an_earlier_window_takes_no_keys():
    def frames_with_keys_for_menus(*, is_menu_open):
        install_type_ahead()
        imgui.create_context()
        io, found = imgui.get_io(), []
        io.set_ini_filename("")
        io.display_size, io.backend_flags = imgui.ImVec2(200, 100), imgui.BackendFlags_.renderer_has_textures
        for frame in range(5):
            imgui.new_frame()
            if frame == 2 and is_menu_open:
                imgui.open_popup("menu")
                if imgui.begin_popup("menu"):
                    imgui.end_popup()
            if has_keys():
                found.append(frame)
            imgui.end_frame()
        imgui.destroy_context()
        return found

    assert frames_with_keys_for_menus(is_menu_open=True) == [2, 3, 4]
    assert frames_with_keys_for_menus(is_menu_open=False) == []


def test_text_has_the_size_of_the_monitor_unless_the_system_enlarges_the_window():
    assert interface_scale(2.0, 1440, 1440) == 2.0  # X11 and Windows
    assert interface_scale(2.0, 2880, 1440) == 1.0  # macOS
    assert interface_scale(1.5, 1100, 733) == 1.0  # Wayland
    assert interface_scale(1.0, 0, 0) == 1.0  # minimized
