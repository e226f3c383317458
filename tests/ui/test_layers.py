"""Several layers at once in the real window: rows chosen by hand, and edits of them as one step."""

from ui.commands.keys import chord
from window_driver import imgui

KEY = imgui.Key
ROAD, WALL, SKY = (f"//Layers/members/###layers {each}" for each in ("road", "wall", "sky"))


def click_with(driver, held, item):
    driver.ctx.key_down(held)
    driver.frames()
    driver.tap(item)
    driver.ctx.key_up(held)
    driver.frames()


def test_two_rows_are_chosen_faded_and_come_back_by_one_undo(driver):
    document, viewport = driver.editor.document, driver.editor.viewport
    driver.panel("Layers")
    driver.tap(ROAD)
    click_with(driver, KEY.mod_ctrl, WALL)
    assert [each.name for each in viewport.chosen_members] == ["road", "wall"]
    before, steps = document.scene, document.history.cursor
    driver.type_in("//Layers/##opacity", 0.5)
    assert [each.opacity for each in document.scene.layers] == [0.5, 0.5, 1.0]
    assert document.history.labels[steps + 1 :] == ["Opacity of 2 layers: 0.50"]
    driver.press(chord(KEY.mod_ctrl, KEY.z))
    assert document.scene is before


def test_values_that_differ_become_one_by_a_drag_that_is_one_step(driver):
    document = driver.editor.document
    driver.panel("Layers")
    driver.tap(WALL)
    edit = driver.panel("Edit")
    driver.ctx.scroll_to_item_y(f"{edit}##exposure_ev")
    driver.type_in(f"{edit}##exposure_ev", 1.0)
    driver.type_in(f"{edit}##saturation", 2.0)
    driver.panel("Layers")
    click_with(driver, KEY.mod_ctrl, ROAD)
    driver.ctx.scroll_to_item_y(f"{edit}##exposure_ev")
    steps = document.history.cursor
    driver.type_in(f"{edit}##exposure_ev", 0.0)  # as the active one has it already
    assert [each.grading.exposure_ev for each in document.scene.layers] == [0.0, 0.0, 0.0]
    driver.drag(f"{edit}##exposure_ev", (-30, 0))
    values = {each.grading.exposure_ev for each in document.scene.layers[:2]}
    assert len(values) == 1 and values.pop() < 0.0 == document.scene.layers[2].grading.exposure_ev
    assert [each.grading.saturation for each in document.scene.layers] == [1.0, 2.0, 1.0]
    labels = document.history.labels[steps + 1 :]
    assert labels[0] == "Exposure of 2 layers: 0.00 EV" and len(labels) == 2
    value = document.scene.layers[0].grading.exposure_ev
    assert labels[1] == f"Exposure of 2 layers: {value:.2f} EV"


def test_an_eye_and_a_lock_act_on_all_rows_that_are_chosen(driver):
    document, viewport = driver.editor.document, driver.editor.viewport
    driver.panel("Layers")

    def flags(name):
        return [getattr(each, name) for each in document.scene.layers]

    driver.tap(ROAD)
    click_with(driver, KEY.mod_shift, SKY)
    assert [each.name for each in viewport.chosen_members] == ["road", "wall", "sky"]
    driver.tap("//Layers/members/###show layers wall")
    assert flags("visible") == [False] * 3 and document.history.undo_label == "Hide 3 layers"
    driver.press(chord(KEY.mod_ctrl, KEY.z))
    driver.tap("//Layers/members/###lock layers road")
    assert flags("locked") == [True] * 3 and document.history.undo_label == "Lock 3 layers"
    driver.press(chord(KEY.mod_ctrl, KEY.z))
    click_with(driver, KEY.mod_ctrl, ROAD)
    driver.tap("//Layers/members/###lock layers road")  # not one of those that are chosen
    assert flags("locked") == [True, False, False] and document.history.undo_label == "Lock road"


def test_all_rows_are_chosen_by_a_key_of_the_list_copied_and_removed(driver):
    document, viewport = driver.editor.document, driver.editor.viewport
    driver.panel("Layers")
    driver.tap(WALL)
    driver.press(chord(KEY.mod_ctrl, KEY.a))
    assert len(viewport.chosen_members) == 3 and viewport.active_member.name == "wall"
    assert driver.editor.selection.is_empty
    driver.tap("//Layers/Duplicate")
    assert document.history.undo_label == "Duplicate 3 layers"
    assert sorted(each.name for each in viewport.chosen_members) == ["road 2", "sky 2", "wall 2"]
    driver.tap("//Layers/Remove")
    assert [each.name for each in document.scene.layers] == ["road", "wall", "sky"]
    assert document.history.undo_label == "Remove 3 layers"
    driver.ctx.window_focus("//View")
    driver.frames()
    driver.press(chord(KEY.mod_ctrl, KEY.a))
    assert not driver.editor.selection.is_empty  # elsewhere it selects Gaussians


def test_locked_layers_that_are_chosen_too_stay_as_they_are(driver):
    document = driver.editor.document
    driver.panel("Layers")
    driver.tap("//Layers/members/###lock layers road")
    driver.tap(ROAD)
    click_with(driver, KEY.mod_ctrl, WALL)
    driver.type_in("//Layers/##opacity", 0.5)
    assert [each.opacity for each in document.scene.layers] == [1.0, 0.5, 1.0]
    assert document.history.undo_label == "Opacity of wall: 0.50"
    driver.tap("//Layers/Remove")
    assert [each.name for each in document.scene.layers] == ["road", "sky"]
