"""Finding, doing and undoing things: menus, command palette, keyboard page, layers, history, notices."""

import pytest

from ui.commands.base import chord, chord_name
from ui.commands.registry import ACTIONS
from ui.panels.registry import BUILT_IN_PANELS
from ui.shell import MENUS
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
