"""Finding, doing and undoing things: keys, command palette, layers, history."""

from ui.commands.keys import chord, chord_name, chords_of
from ui.commands.table import COMMANDS
from ui.panels.registry import BUILT_IN_PANELS
from ui.shell import MENUS
from ui.tools import TOOLS
from window_driver import imgui

_CTRL, _KEY = imgui.Key.mod_ctrl, imgui.Key


def test_keys_and_titles_mean_one_thing():
    keys = [keys for command in COMMANDS for keys in chords_of(command)]
    keys += [int(tool.key) for tool in TOOLS if tool.key is not None]
    keys += [int(key) for key in (_KEY.w, _KEY.a, _KEY.s, _KEY.d, _KEY.q, _KEY.e)]
    assert sorted(keys) == sorted(set(keys)), [chord_name(each) for each in keys if keys.count(each) > 1]
    names = [command.name for command in COMMANDS] + [tool.name for tool in TOOLS]
    assert len(names) == len(set(names))
    assert {command.menu for command in COMMANDS} <= {"", *MENUS}
    assert len({panel.title for panel in BUILT_IN_PANELS}) == len(BUILT_IN_PANELS)


def test_a_command_is_found_by_a_part_of_its_name_and_any_step_can_be_gone_to(driver):
    editor = driver.editor

    def script():
        driver.click("//Rain/8.5")
        driver.ctx.window_focus("//View")
        driver.press(chord(_CTRL, imgui.Key.p))
        driver.frames(3)
        assert editor.viewport.options.dialog == "commands"
        driver.ctx.key_chars("undo")
        driver.frames(3)
        driver.press(imgui.Key.enter)
        driver.until(lambda: editor.document.rain.intensity_mm_h == 0)
        driver.until(lambda: editor.viewport.options.dialog == "")
        assert editor.document.history.redo_label == "Preset 8.5"
        for name in ("1.2", "8.5", "12.0"):
            driver.click(f"//Rain/{name}")
        for item, intensity in (("Preset 1.2##1", 1.2), ("Preset 12.0##3", 12), ("Open##0", 0)):
            driver.click(f"//History/{item}")
            assert editor.document.rain.intensity_mm_h == intensity

    driver.run(script)


def test_layers_are_locked_copied_named_and_removed(driver):
    editor = driver.editor

    def names():
        return [each.name for each in editor.document.scene.layers]

    def script():
        driver.click("//Layers/members/###lock layers road")
        assert editor.document.scene.layers[0].locked
        driver.click("//Layers/members/###layers wall")
        assert editor.viewport.options.member == "layers/wall"
        driver.click("//Layers/Duplicate")
        assert names() == ["road", "wall", "wall 2", "sky"]
        assert editor.document.scene.layers[2].gaussians is editor.document.scene.layers[1].gaussians
        driver.ctx.item_double_click("//Layers/members/###layers wall 2")
        driver.frames(3)
        driver.ctx.key_chars_replace_enter("fence")
        driver.frames(3)
        assert (names()[2], editor.viewport.options.member) == ("fence", "layers/fence")
        driver.click("//Layers/Remove")
        assert names() == ["road", "wall", "sky"]
        driver.press(chord(_CTRL, imgui.Key.z))
        assert names() == ["road", "wall", "fence", "sky"]

    driver.run(script)
