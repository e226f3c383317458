"""From a capture to Gaussians, and from pictures to their colors, in the real window."""

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.training.settings import load_settings
from training.drive_capture import drive_capture, world_depth
from ui.commands.keys import chord
from window_driver import imgui

pytest.importorskip("torch")

UNDO, REDO = chord(imgui.Key.mod_ctrl, imgui.Key.z), chord(imgui.Key.mod_ctrl, imgui.Key.y)
DIM = 0.45


@pytest.fixture
def drive(tmp_path):
    """Views of a road and a wall, with depth; and the same pictures as they look in bad light."""
    capture = drive_capture()
    views = [
        # The sky has no depth, the rest has.
        type(view)(
            f"view{view.name}", view.camera, view.image, view.time_s, "FRONT",
            depth_source=np.where(np.isfinite(depth := world_depth(view.camera)), depth, 0).astype(np.float32),
        )
        for view in capture
    ]  # fmt: skip
    for _ in write_views(tmp_path / "drive", views):
        pass
    (tmp_path / "dim").mkdir()
    for view in views:
        Image.fromarray((DIM * view.image).astype(np.uint8)).save(tmp_path / "dim" / f"{view.name}.png")
    return tmp_path


def test_a_capture_becomes_a_scene_that_takes_on_the_look_of_pictures(drive, driver, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(drive / "data"))
    settings = load_settings("draft", steps=40, width_px=96, gaussians=3000, measured_every=20)
    editor = driver.editor
    editor.training.settings = settings

    def ended(job):
        return job.state != "running" and editor.viewport.staged is None

    def script():
        before = editor.document.scene
        editor.captures.open(drive / "drive")
        driver.until(lambda: editor.captures.capture is not None)
        driver.ctx.window_focus("//Capture")
        driver.ctx.item_open("//Capture/Reconstruct")
        driver.frames()
        driver.ctx.item_click("//Capture/Reconstruct/Reconstruct")
        driver.frames()
        (job,) = editor.jobs.all
        # Where it was started there is how far it is, and nothing else can be started.
        assert driver.ctx.item_exists("//Capture/Reconstruct/Cancel##0")
        assert not driver.ctx.item_exists("//Capture/Reconstruct/Reconstruct")
        driver.until(lambda: ended(job), 1_000_000)
        assert (job.state, job.error) == ("finished", None)
        assert editor.document.history.labels == ["Open", "Reconstruct drive"]
        assert {layer.kind for layer in editor.document.scene.layers} == {"background", "sky"}
        assert job.report.is_file()

        # The picture from a recorded camera is like the photograph, and undo brings the earlier scene back.
        captures = editor.captures
        captures.show_picture = captures.show_points = captures.show_frustums = False
        captures.look_from(2)
        trained = driver.picture()
        height, width = trained.shape[:2]
        road = trained[3 * height // 4 :, width // 3 : 2 * width // 3].mean(axis=(0, 1))
        assert np.abs(road - captures.view.image[48:, 32:64].mean(axis=(0, 1))).max() < 25
        driver.press(UNDO)
        assert editor.document.scene is before
        driver.press(REDO)
        assert editor.document.scene is not before

        # Dim pictures of the same views give it wet colors, which come with the rain.
        driver.click("//Rain/Streaks")
        driver.click("//Rain/Haze")
        editor.training.recolor(drive / "dim")
        driver.until(lambda: ended(editor.jobs.all[-1]), 1_000_000)
        assert (editor.jobs.all[-1].state, editor.jobs.all[-1].error) == ("finished", None)
        assert np.array_equal(driver.picture(), trained)  # it does not rain
        driver.ctx.item_input_value("//Rain/##intensity_mm_h", 12.0)
        driver.frames()
        wet = driver.picture()
        assert 0.35 < wet.mean() / trained.mean() < 0.65
        driver.press(UNDO)
        driver.press(UNDO)
        assert all(member.wet_sh is None for member in editor.document.scene.members)
        driver.press(REDO)
        driver.press(REDO)
        assert np.array_equal(driver.picture(), wet)

    driver.run(script)
