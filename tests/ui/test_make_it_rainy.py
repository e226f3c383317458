"""The Wet look panel in the real window: preview, job, comparison, undo, and what it says where it can't."""

import msgspec
import numpy as np

from gsrain_engine.editor import make_rainy
from gsrain_engine.editor.jobs.make_rainy import MAKE_RAINY_TITLE
from ui.commands.keys import chord
from window_driver import imgui

PANEL = "//Make it rainy/"
UNDO = chord(imgui.Key.mod_ctrl, imgui.Key.z)


def test_a_view_is_previewed_then_the_scene_made_rainy_compared_and_undone(driver, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))

    def script():
        editor, ctx = driver.editor, driver.ctx
        rainy = editor.wet_look
        rainy.preview_width_px = 96
        rainy.choice = msgspec.structs.replace(rainy.choice, count=2, width_px=64)
        clear, before = driver.picture(), editor.document.scene
        driver.click(f"{PANEL}###preview")
        assert rainy.why_not == "Wait for Preview, or cancel it."
        driver.until(lambda: not editor.jobs.running, 1_000_000)
        driver.frames()
        assert editor.status.problem is None
        assert rainy.previewed.pixels.shape[1] == 96
        # It lies over what it is of, right of the line, and only while the view is that one.
        assert (editor.viewport.options.split, rainy.fits) == ("now | preview", True)
        assert ctx.item_exists("//View/divider")
        driver.stroke(driver.at(0.75, 0.5), driver.at(0.75, 0.5) + [60, 0])  # right of the line
        assert rainy.what_is_stale == "The view has changed since."
        assert not ctx.item_exists("//View/divider")
        driver.click(f"{PANEL}Return to it")
        assert rainy.what_is_stale is None
        ctx.item_input_value(f"{PANEL}##seed", 3)
        driver.frames()
        assert rainy.what_is_stale == "The settings have changed since."

        driver.click(f"{PANEL}###make")
        driver.until(lambda: editor.jobs.all[0].progress.message == "Starting", 1_000_000)
        assert not ctx.item_exists(f"{PANEL}###make")  # its progress stands there
        driver.click(f"{PANEL}Cancel##0")
        assert (editor.jobs.all[0].state, editor.document.scene) == ("cancelled", before)
        editor.jobs.clear()

        blue_sky = editor.live_rain.sky
        driver.click(f"{PANEL}###make")
        (job,) = editor.jobs.all
        driver.until(lambda: job in editor.viewport.job_previews or job.state != "running", 1_000_000)
        driver.until(lambda: job.state != "running" and editor.viewport.staged is None, 1_000_000)
        assert (job.state, job.error) == ("finished", None)
        assert job.report.is_file()
        assert editor.document.history.labels == ["Open", MAKE_RAINY_TITLE]
        assert all(each.wet_sh is not None for each in editor.document.scene.members)

        # Beside the clear scene, in rain that a step of its own brings.
        driver.click(f"{PANEL}###compare")
        assert editor.viewport.options.split == "clear | rainy"
        assert editor.document.rain.intensity_mm_h == make_rainy.COMPARED_MM_H
        compared = driver.picture()
        middle = compared.shape[1] // 2
        assert np.array_equal(compared[:, : middle - 1], clear[:, : middle - 1])
        assert np.abs(compared[:, middle:] - clear[:, middle:]).mean() > 3
        assert editor.live_rain.sky != blue_sky  # drops take the color of the wet one
        driver.click(f"{PANEL}###compare")
        assert editor.viewport.options.split == "off"
        driver.press(UNDO)
        driver.press(UNDO)
        assert editor.document.scene is before

    driver.run(script)
