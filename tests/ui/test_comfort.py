"""Finding, doing and undoing things: menus, command palette, keyboard page, layers, history, notices."""

import numpy as np
import pytest

from gsrain_engine.editor.status import Answer, Question, do_nothing
from gsrain_engine.scene.scene import Scene
from ui.commands.base import chord, chord_name
from ui.commands.registry import ACTIONS
from ui.dialogs import matches
from ui.panels.registry import BUILT_IN_PANELS
from ui.shell import MENUS, panel_windows
from ui.tools import TOOLS
from window_driver import Driver, imgui

_CTRL, _SHIFT = imgui.Key.mod_ctrl, imgui.Key.mod_shift


@pytest.fixture
def driver(tmp_path):
    return Driver(tmp_path)


def test_every_key_means_one_thing():
    keys = [keys for action in ACTIONS for keys in action.chords]
    keys += [int(tool.key) for tool in TOOLS if tool.key is not None]
    keys += [int(key) for key in (imgui.Key.w, imgui.Key.a, imgui.Key.s, imgui.Key.d, imgui.Key.q, imgui.Key.e)]
    assert sorted(keys) == sorted(set(keys)), [chord_name(each) for each in keys if keys.count(each) > 1]


def test_names_are_unique_and_menus_known_and_all_explained():
    names = [action.name for action in ACTIONS] + [tool.name for tool in TOOLS]
    assert len(names) == len(set(names))
    assert {action.menu for action in ACTIONS} <= {"", *MENUS}
    assert [action.name for action in ACTIONS if not action.help] == []
    assert len({panel.title for panel in BUILT_IN_PANELS}) == len(BUILT_IN_PANELS)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_fields_have_edges_and_questions_darken_the_rest(driver, tmp_path, monkeypatch, theme):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    editor, screens = driver.editor, []

    def script():
        editor.preferences.set(theme=theme)
        driver.ctx.window_focus("//Rain")
        driver.frames(3)
        item = driver.ctx.item_info("//Rain/Shelter under roofs").rect_full
        screens.append(driver.screen())
        low, middle = (int(item.min.x), int(item.min.y)), int(item.min.y + imgui.get_font_size() / 2)
        box = screens[0][middle, low[0] - 3 : low[0] + 12]
        assert np.abs(np.diff(box.sum(axis=1))).max() > 60  # not white on white
        editor.status.ask(Question("Well?", "Well?", (Answer("OK", do_nothing),)))
        driver.frames(30)  # it fades in
        screens.append(driver.screen())
        assert screens[1][:60].mean() < 0.8 * screens[0][:60].mean()

    driver.run(script)


def test_chords_read_as_people_write_them():
    assert chord_name(chord(_CTRL, _SHIFT, imgui.Key.z)) == "Ctrl+Shift+Z"
    assert chord_name(chord(imgui.Key.left_bracket)) == "["
    for action in ACTIONS:
        assert " or ".join(map(chord_name, action.chords)) == action.key_names
    assert matches("Show the selection", "sel sh")
    assert not matches("Show the selection", "hide")


def test_a_command_is_found_by_a_part_of_its_name(driver):
    def script():
        driver.click("//Rain/8.5")
        driver.ctx.window_focus("//View")
        driver.press(chord(_CTRL, imgui.Key.p))
        driver.frames(3)
        assert driver.editor.viewport.options.dialog == "commands"
        driver.ctx.key_chars("undo")
        driver.frames(3)
        driver.press(imgui.Key.enter)
        driver.until(lambda: driver.editor.document.rain.intensity_mm_h == 0)
        driver.until(lambda: driver.editor.viewport.options.dialog == "")
        assert driver.editor.document.history.redo_label == "Preset 8.5"

    driver.run(script)


def test_a_panel_that_is_hidden_is_brought_back_by_its_name(driver):
    def script():
        (log,) = (each for each in panel_windows() if each.label == "Log")
        log.is_visible = False
        driver.frames(3)
        assert not imgui.internal.find_window_by_name("Log").active
        assert not imgui.internal.find_window_by_name("Timeline").hidden
        driver.ctx.window_focus("//View")
        driver.press(chord(_CTRL, imgui.Key.p))
        driver.frames(3)
        driver.ctx.key_chars("panel log")
        driver.frames(3)
        driver.press(imgui.Key.enter)
        driver.until(lambda: log.is_visible and not imgui.internal.find_window_by_name("Log").hidden)
        assert imgui.internal.find_window_by_name("Timeline").hidden  # it is in front of it
        assert len(panel_windows()) == len(BUILT_IN_PANELS)

    driver.run(script)


def test_the_keyboard_page_opens_and_closes_and_holds_keys_back(driver):
    def script():
        driver.ctx.window_focus("//View")
        driver.press(imgui.Key.f1)
        driver.until(lambda: driver.editor.viewport.options.dialog == "keys")
        driver.press(imgui.Key.space)
        assert not driver.editor.playback.clock.playing
        driver.press(imgui.Key.escape)
        driver.until(lambda: driver.editor.viewport.options.dialog == "")
        driver.press(imgui.Key.space)
        assert driver.editor.playback.clock.playing
        driver.editor.playback.clock.playing = False

    driver.run(script)


def test_layers_are_locked_copied_named_and_removed(driver):
    def script():
        editor = driver.editor
        driver.click("//Layers/members/###lock layers road")
        assert editor.document.scene.layers[0].locked
        driver.click("//Layers/members/###layers wall")
        assert editor.viewport.options.member == "layers/wall"
        driver.click("//Layers/Duplicate")
        assert [each.name for each in editor.document.scene.layers] == ["road", "wall", "wall 2", "sky"]
        assert editor.document.scene.layers[2].gaussians is editor.document.scene.layers[1].gaussians
        driver.ctx.item_double_click("//Layers/members/###layers wall 2")
        driver.frames(3)
        driver.ctx.key_chars_replace_enter("fence")
        driver.frames(3)
        assert editor.document.scene.layers[2].name == "fence"
        assert editor.viewport.options.member == "layers/fence"
        driver.click("//Layers/Remove")
        assert [each.name for each in editor.document.scene.layers] == ["road", "wall", "sky"]
        driver.press(chord(_CTRL, imgui.Key.z))
        assert [each.name for each in editor.document.scene.layers] == ["road", "wall", "fence", "sky"]

    driver.run(script)


def test_a_layer_fades_by_its_opacity_in_one_step(driver):
    def script():
        driver.click("//Layers/members/###layers wall")
        before, steps = driver.picture(), len(driver.editor.document.history.labels)
        driver.drag("//Layers/##opacity", (-60, 0))
        assert driver.editor.document.scene.layers[1].opacity < 0.8
        assert len(driver.editor.document.history.labels) == steps + 1
        assert abs(driver.picture() - before).max() > 10

    driver.run(script)


def test_any_step_of_the_history_can_be_gone_to(driver):
    def script():
        for name in ("1.2", "8.5", "12.0"):
            driver.click(f"//Rain/{name}")
        driver.click("//History/Preset 1.2##1")
        assert driver.editor.document.rain.intensity_mm_h == 1.2
        driver.click("//History/Preset 12.0##3")
        assert driver.editor.document.rain.intensity_mm_h == 12
        driver.click("//History/Open##0")
        assert driver.editor.document.rain.intensity_mm_h == 0

    driver.run(script)


def test_an_empty_window_offers_the_street(tmp_path):
    driver = Driver(tmp_path, Scene("no scene"))

    def script():
        driver.ctx.set_ref("//View")
        driver.ctx.item_click("//View/**/Open the built-in street")
        driver.until(lambda: driver.editor.document.scene.name == "street", 100_000)
        assert driver.editor.document.scene.gaussian_count > 300_000

    driver.run(script)


def test_a_problem_is_told_in_the_corner_until_it_is_closed(driver):
    def script():
        driver.editor.status.problem = "The disk is full."
        driver.frames(3)
        driver.ctx.item_click("//View/**/Details")
        driver.frames(2)
        driver.ctx.item_click("//View/**/Close")
        driver.frames(2)
        assert driver.editor.status.problem is None

    driver.run(script)
