"""Names out of files in the window: none hides a part of itself, is taken for another, or ends the window."""

from dataclasses import replace

import pytest

from gsrain_engine.editor.edits.members import replace_scene
from small_scene import small_scene
from ui.widgets import text
from window_driver import Driver

NAMES = ("a##hidden", "b##hidden", "c###same", "d###same", "%s%n%d", "##", "[/x]\x1b[\u202e\nline", "\udcff no text")


@pytest.fixture
def driver(tmp_path):
    scene = small_scene("scene \udcff\u202e")
    layers = tuple(replace(scene.layers[0], name=name) for name in NAMES)
    rigs = {f"rig {name}": tuple(replace(each, name=name) for each in scene.rigs["one"]) for name in NAMES}
    return Driver(tmp_path, replace(scene, layers=layers, rigs=rigs))


def test_layers_cameras_steps_and_files(driver):
    chosen = []
    editor = driver.editor
    editor.status.problem = f"{NAMES[-1]}: can't be opened"
    for name in NAMES:
        editor.document.edit(f"Rename {name}", replace_scene, replace(editor.document.scene, name=name))
    for window in ("Layers", "History", "Log", "Record"):
        driver.ctx.window_focus(f"//{window}")
        driver.frames(2)
    driver.ctx.window_focus("//Layers")
    for layer in editor.document.scene.layers[:4]:  # those that are in sight
        driver.tap(f"//Layers/**/###{text.plain_identity(layer.key.replace('/', ' '))}")
        chosen.append(editor.viewport.options.member)
    assert chosen == [f"layers/{name}" for name in NAMES[:4]]
    assert driver.window.failure is None
