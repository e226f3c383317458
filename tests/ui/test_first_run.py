"""First steps: from a file of Gaussians to rain in five clicks, and a hint that ends for good."""

from dataclasses import replace as with_fields

import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.editor.preferences import load_preferences
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


def test_a_file_of_gaussians_becomes_a_rainy_scene_in_five_clicks(driver, tmp_path):
    file = tmp_path / "own.ply"
    write_scene(with_fields(small_scene(), ego=None, rigs={}), file)
    clicks = []

    def click(item):
        clicks.append(item)
        driver.tap(item)

    def script():
        editor = driver.editor
        editor.files.close_scene()
        driver.until(lambda: not editor.document.scene.members and editor.busy is None)
        driver.frames(3)
        click("//**/###Open...")
        driver.ctx.item_click("//Open a scene/##name")
        driver.ctx.key_chars_replace(str(file))
        click("//Open a scene/Open")
        driver.until(lambda: editor.document.scene.members and editor.busy is None)
        driver.frames(3)
        assert editor.scene_setup.is_open and editor.scene_setup.axis == "-y"
        click("//**/###guess")
        assert editor.status.problem is None
        scene = editor.document.scene
        assert editor.document.history.labels == ["Open", "Guess the orientation"]
        road = scene.part(scene.layers[0])
        assert scene.ground_m is not None and np.linalg.norm(scene.up) == pytest.approx(1)
        assert road is not None
        click("//**/###rain")
        assert editor.document.rain.intensity_mm_h == 5.0 and not editor.scene_setup.is_open
        assert len(clicks) <= 5

        # What was guessed is corrected: another axis, a known length.
        editor.scene_setup.is_open = True
        editor.scene_setup.turn("z")
        assert (editor.scene_setup.axis, editor.document.scene.ground_m) == ("z", None)
        driver.frames(3)
        driver.tap("//**/###measure")
        assert editor.viewport.options.tool == "Measure"
        driver.tap("//**/###close set-up")
        assert not editor.scene_setup.is_open

    driver.run(script)


def test_the_hint_of_three_steps_ends_for_good(driver, tmp_path):
    def script():
        editor = driver.editor
        editor.preferences.value = replace(editor.preferences.value, hint=True)
        driver.frames(3)
        driver.tap("//**/###step 2")
        assert editor.document.rain.intensity_mm_h == 5.0 and editor.preferences.value.hint
        editor.files.source = str(tmp_path / "own.ply")
        editor.render_queue.change(size_px=(64, 48), last_s=0.1)
        editor.render_queue.record_to(tmp_path / "clip.mp4")
        driver.until(lambda: not editor.preferences.value.hint)
        driver.until(lambda: not load_preferences()[0].hint)
        editor.preferences.set(hint=True)
        editor.jobs.close()
        editor.jobs.clear()
        driver.frames(3)
        driver.tap("//**/###end hint")
        driver.until(lambda: not load_preferences()[0].hint)

    driver.run(script)
