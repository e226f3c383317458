"""First steps: from a file of Gaussians to rain in four actions, a hint that ends, and news after an update."""

from dataclasses import replace as with_fields
from importlib.metadata import version

import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.compile_cache import kernel_names
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.gaussians import box_around
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.news import news_in, read_news
from gsrain_engine.editor.preferences import load_preferences
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from small_scene import small_scene
from window_driver import imgui


def test_a_file_of_gaussians_becomes_a_rainy_scene_in_four_actions(driver, tmp_path):
    file = tmp_path / "own.ply"
    write_scene(with_fields(small_scene(), ego=None, rigs={}), file)

    editor = driver.editor
    editor.files.close_scene()
    driver.until(lambda: not editor.document.scene.members and editor.busy is None)
    driver.frames(3)
    for offered in ("Open built-in street", "Open capture folder...", "What's new"):
        assert driver.ctx.item_exists(f"//**/###{offered}")
    with driver.journey(4):
        driver.tap("//**/###Open...")
        driver.choose_file("Open a scene", file)
        driver.until(lambda: editor.document.scene.members and editor.busy is None)
        driver.frames(3)
        assert editor.scene_setup.is_open and editor.scene_setup.axis == "-y"
        driver.tap("//**/###guess")
        assert editor.status.problem is None
        assert editor.document.history.labels == ["Opened", "Guess the orientation"]
        scene = editor.document.scene
        assert scene.ground_m is not None and np.linalg.norm(scene.up) == pytest.approx(1)
        driver.tap("//**/###rain")
    document = editor.document
    by_bar = document.rain
    assert by_bar.intensity_mm_h == 5.0 and not editor.scene_setup.is_open
    document.undo()
    assert replace(document.rain, intensity_mm_h=5.0) == by_bar
    driver.tap(f"{driver.panel('Rain')}5")  # means the same there, whatever else the rain has
    assert document.rain == by_bar
    document.change_rain("Fog", visibility_m=200.0, glass="windshield")
    driver.tap(f"{driver.panel('Rain')}8.5")
    assert document.rain == replace(by_bar, intensity_mm_h=8.5, visibility_m=200.0, glass="windshield")

    # What was guessed is corrected: another axis, a known length.
    editor.scene_setup.is_open = True
    editor.viewport.options.tool, editor.selection.box = "Box", box_around(scene)  # with options in two rows
    driver.frames(3)
    row_start, row_size = driver.area("//**/Apply##box")
    assert driver.area("//**/###guess")[0][1] >= row_start[1] + row_size[1]
    editor.scene_setup.turn("z")
    assert (editor.scene_setup.axis, editor.document.scene.ground_m) == ("z", None)
    driver.frames(3)
    driver.tap("//**/###measure")
    assert editor.viewport.options.tool == "Measure"
    driver.tap("//**/###close set-up")
    assert not editor.scene_setup.is_open

    # What was saved then opens without it, whatever is still assumed.
    saved = tmp_path / "saved"
    editor.files.save_to(saved)
    driver.until(lambda: editor.busy is None)
    folder = tmp_path / "by a command"
    write_scene(with_fields(read_scene(file), unit_is_assumed=True), folder)
    for path, is_open in ((file, True), (saved, False), (folder, False)):
        editor.files.open_now(str(path))
        driver.until(lambda: editor.busy is None)
        driver.frames(3)
        assert editor.document.scene.unit_is_assumed and editor.scene_setup.is_open == is_open


def test_the_hint_of_three_steps_ends_for_good(driver, tmp_path):
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

    # After an update, what is new is offered in its place, once.
    editor.preferences.set(known_version="0.0.1")
    driver.frames(3)
    driver.tap("//**/###read news")
    assert driver.is_open("What's new")
    driver.tap("//What's new/###close news")
    driver.until(lambda: load_preferences()[0].known_version == version("gsrain"))
    assert not driver.is_open("What's new") and not driver.ctx.item_exists("//**/###read news")


def test_the_news_are_the_short_group_of_the_newest_changes():
    changes = (
        "# Changes\n\n## 1.2\n\nIn short\n* Rain at\n  `night`.\n* *Record* is faster.\n\nFiles\n* More.\n\n## 1.1\n"
    )
    assert news_in(changes) == ("1.2", ("Rain at night.", "Record is faster."))
    assert news_in("# Changes\n\n## 1.2\n\nFiles\n* More.\n\n## 1.1\n\nIn short\n* Old.\n").lines == ()
    assert len(read_news().lines) > 3


COUNT = len(kernel_names())


def test_the_kernels_that_are_compiled_are_counted_while_a_file_opens(driver, monkeypatch):
    apply, bar, drawn = Editor.apply, imgui.progress_bar, []

    def apply_preparing(editor, result):
        apply(editor, result)
        editor.viewport.is_preparing, editor.viewport.kernels = True, COUNT // 2

    def draw_bar(fraction, *others):
        drawn.append(fraction)
        bar(fraction, *others)

    monkeypatch.setattr(Editor, "apply", apply_preparing)
    monkeypatch.setattr(imgui, "progress_bar", draw_bar)
    monkeypatch.setattr(Files, "busy", "Opening crossing")
    driver.editor.viewport.is_preparing, driver.editor.viewport.kernels = True, COUNT // 2
    driver.ctx.yield_(3)
    monkeypatch.undo()
    driver.frames(3)
    assert (COUNT // 2) / COUNT in drawn and any(each < 0 for each in drawn)
