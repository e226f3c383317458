"""A scene that came without a drive gets one along its camera path, by the menu, and the Drive panel takes it."""

from dataclasses import replace

import numpy as np

from gsrain_engine.scene.camera_path import CameraPath
from small_scene import small_scene
from ui.commands.base import chord
from window_driver import Driver, imgui

_AHEAD = np.array([[0.5, -0.5, 0.5, -0.5]])
"""Camera axes to a world in which it looks along x."""


def test_the_ego_drives_along_the_path_and_undo_takes_it_back(tmp_path):
    places = np.column_stack([np.linspace(0, 20, 5), np.zeros(5), np.full(5, 1.5)])
    path = CameraPath(np.arange(5.0), places, _AHEAD.repeat(5, axis=0), np.full(5, 45.0))
    driver = Driver(tmp_path, replace(small_scene(), ego=None, rigs={}, path=path))
    editor = driver.editor

    def script():
        assert "camera path" in (editor.rollouts.why_not or "")
        driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.p))
        driver.until(lambda: editor.viewport.options.dialog == "commands")
        driver.frames(3)
        driver.ctx.key_chars("drive ego along")
        driver.frames(3)
        driver.press(imgui.Key.enter)
        driver.until(lambda: editor.document.scene.ego is not None)
        assert editor.status.problem is None and editor.document.scene.ego is not None
        assert editor.rollouts.why_not is None
        pose = editor.document.scene.ego_to_world(4.0)
        assert pose is not None and np.allclose(pose[:3, 3], [20, 0, 1.5], atol=1e-6)
        assert editor.document.history.undo_label == "Ego drive"
        editor.document.undo()
        driver.frames()
        assert editor.document.scene.ego is None

    driver.run(script)
