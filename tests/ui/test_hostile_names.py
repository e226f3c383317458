"""Names out of files in the window: none hides a part of itself, is taken for another, or ends the window."""

from dataclasses import replace
from pathlib import Path

import pytest

from gsrain_engine.editor.edits.members import replace_scene
from small_scene import small_scene
from ui.widgets import text
from window_driver import Driver, imgui

NAMES = ("a##hidden", "b##hidden", "c###same", "d###same", "%s%n%d", "##", "[/x]\x1b[\u202e\nline", "\udcff no text")


def test_layers_cameras_steps_and_files(tmp_path, monkeypatch):
    scene = small_scene("scene \udcff\u202e")
    layers = tuple(replace(scene.layers[0], name=name) for name in NAMES)
    rigs = {f"rig {name}": tuple(replace(each, name=name) for each in scene.rigs["one"]) for name in NAMES}
    driver = Driver(tmp_path, replace(scene, layers=layers, rigs=rigs))
    chosen = []

    def script():
        editor = driver.editor
        editor.status.problem = f"{NAMES[-1]}: can't be opened"
        for name in NAMES:
            editor.document.edit(f"Rename {name}", replace_scene, replace(editor.document.scene, name=name))
        for window in ("Layers", "History", "Log", "Record"):
            driver.ctx.window_focus(f"//{window}")
            driver.frames(2)
        driver.ctx.window_focus("//Layers")
        for layer in editor.document.scene.layers[:4]:  # those that are in sight
            driver.ctx.item_click(f"//Layers/**/###{text.plain_identity(layer.key.replace('/', ' '))}")
            driver.frames(2)
            chosen.append(editor.viewport.options.member)

    driver.run(script)
    assert chosen == [f"layers/{name}" for name in NAMES[:4]]
    assert driver.window.failure is None


@pytest.mark.parametrize("name", NAMES)
def test_a_label_shows_all_of_a_name(name):
    drawn = text.label(name, str(Path("/home") / name))
    shown, _, identity = drawn.partition("##")
    assert "#" not in identity and shown.replace(" ", "") == text.escape_invisible(name).replace(" ", "")


def test_titles_and_choices_hide_nothing(monkeypatch):
    drawn = []

    def drawing(*arguments):
        drawn.append(arguments)

    for function in ("separator_text", "progress_bar", "combo", "button"):
        monkeypatch.setattr(imgui, function, drawing)
    text.escape_all_text()
    imgui.separator_text("Record a##b")
    imgui.progress_bar(0.5, None, "Record a##b: 50 %")
    imgui.combo("##cameras", 0, ["a##b", "c#"])
    imgui.button("Open##here")
    assert drawn == [
        ("Record a# #b",), (0.5, None, "Record a# #b: 50 %"), ("##cameras", 0, ["a# #b", "c# "]), ("Open##here",)
    ]  # fmt: skip


def test_identities_stay_different():
    found = {text.plain_identity(name) for name in ("a#b", "a%23b", "a##b", "a###b", "ab", "a\x1b", r"a\x1b")}
    assert len(found) == 7 and not any("#" in each for each in found)


def test_icons_line_breaks_and_letters_are_drawn_as_they_are():
    words = "\uf015 Zürich\n東京\t\U0001f697"
    assert text._visible(words) == words
    assert text._visible(["a\x1b", words]) == [r"a\x1b", words] and text._visible(3) == 3
