"""Saving, leaving and recovering in the real window, with what it asks on the way."""

import json

import numpy as np
import pytest

from editor.files.open_document import HeldJob
from gsrain_engine.editor.autosave import fingerprint_of
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.files import LoadedDocument
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache
from small_scene import small_scene
from ui.commands.keys import chord
from window_driver import Driver, imgui

CTRL, SHIFT = imgui.Key.mod_ctrl, imgui.Key.mod_shift


@pytest.fixture(autouse=True)
def own_folders(tmp_path_factory, monkeypatch):
    for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path_factory.mktemp(name)))


def key(driver, *keys):
    driver.ctx.window_focus("//View")
    driver.press(chord(*keys))


def test_leaving_with_changes_asks_and_nothing_else_goes_on_meanwhile(unopened):
    screens = []

    def script():
        editor = unopened.editor
        unopened.click("//Rain/8.5")
        key(unopened, CTRL, imgui.Key.q)
        unopened.frames(3)
        assert unopened.ctx.item_exists("//Unsaved changes/Don't save")
        unopened.press(chord(CTRL, imgui.Key.z))  # keys do nothing while something is asked
        assert editor.document.rain.intensity_mm_h == 8.5
        screens.append(unopened.screen())
        unopened.press(imgui.Key.escape)
        assert editor.status.question is None and not editor.should_quit
        unopened.frames(3)
        screens.append(unopened.screen())
        unopened.window.ask_to_close()  # the cross of the window
        unopened.frames(3)
        unopened.tap("//Unsaved changes/Cancel")
        assert editor.status.question is None and not editor.should_quit
        unopened.press(chord(CTRL, imgui.Key.z))
        assert not editor.files.has_changes
        unopened.window.ask_to_close()
        unopened.frames(1000)  # the window is gone long before

    with pytest.raises(RuntimeError, match="the app exited before the test finished"):
        unopened.run(script)
    assert unopened.editor.should_quit
    asked, not_asked = screens
    assert np.abs(asked - not_asked).mean() > 5


def test_the_cross_of_the_window_asks_about_a_job_and_waits_for_it(unopened):
    job = HeldJob()
    job.start(unopened.editor)

    def script():
        editor = unopened.editor
        unopened.window.ask_to_close()
        unopened.frames(3)
        unopened.tap("//Work goes on/Cancel")
        assert job.state == "running" and editor.status.question is None
        unopened.window.ask_to_close()
        unopened.frames(3)
        unopened.tap("//Work goes on/Wait")
        unopened.press(imgui.Key.enter)  # stops nothing
        assert job.state == "running" and unopened.ctx.item_exists("//Waiting/Stop it")
        road = editor.document.scene.layers[0]
        job.let_end(
            editor.document.scene.with_member(road.key, gaussians=road.gaussians.with_sh(road.gaussians.sh + 1))
        )
        unopened.until(
            lambda: editor.document.history.undo_label == "Make it rainy" and editor.status.question is not None
        )
        unopened.frames(3)
        assert not editor.should_quit
        unopened.ctx.item_click("//Unsaved changes/Don't save")
        unopened.frames(1000)  # the window is gone long before

    with pytest.raises(RuntimeError, match="the app exited before the test finished"):
        unopened.run(script)
    assert unopened.editor.should_quit and job.state == "finished"


def test_what_was_kept_is_recovered_and_a_change_on_the_disk_is_asked_about(tmp_path):
    home = tmp_path / "crossing"
    write_scene(small_scene("crossing"), home)
    before = Driver(tmp_path)
    died = before.editor
    opened = LoadedDocument(died.document.scene, str(home), home, fingerprint_of(home), FileCache())
    died.files.enter(opened, died.document.state)
    member = died.document.scene.members[0]
    marks = SelectionFlags(deleted=BitMask.of(np.arange(len(member.gaussians)) < 100))
    died.document.edit("Delete", replace_scene, died.document.scene.with_member(member.key, marks=marks))
    died.tick(0.0)
    late = died.files.recovery.now() + 20.0
    died.files.recovery.now = lambda: late
    died.tick(0.0)
    died.close()  # without an answer to what becomes of the changes
    driver = Driver(tmp_path)
    driver.editor = Editor()
    driver.editor.playback.clock.playing = False
    driver.editor.files.open(str(home))

    def script():
        editor = driver.editor
        driver.until(lambda: editor.status.question is not None)
        driver.frames(3)
        with driver.journey(1):
            driver.tap("//Recover unsaved changes/Recover")
        driver.until(lambda: editor.files.has_changes and editor.busy is None)
        assert editor.document.scene.layers[0].marks.deleted.size == 100
        values = json.loads((home / "scene.json").read_text())
        (home / "scene.json").write_text(json.dumps(values | {"name": "theirs"}))
        key(driver, CTRL, imgui.Key.s)
        driver.frames(3)
        assert read_scene(home).name == "theirs"
        driver.ctx.item_click("//Changed on disk/Overwrite")
        driver.until(lambda: not editor.files.has_changes)
        assert read_scene(home).layers[0].marks.deleted.size == 100

    driver.run(script)
