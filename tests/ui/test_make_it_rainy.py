"""The Wet look panel in the real window: preview, job, comparison, undo, and what it says where it can't."""

import tempfile

import msgspec
import numpy as np
import psutil
import pytest

from gsrain_engine.editor import make_rainy
from gsrain_engine.editor.jobs.make_rainy import MAKE_RAINY_TITLE
from ui.commands.base import chord
from window_driver import Driver, imgui

PANEL = "//Make it rainy/"
UNDO = chord(imgui.Key.mod_ctrl, imgui.Key.z)


@pytest.fixture
def driver(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    (tmp_path / "shots").mkdir()
    return Driver(tmp_path / "shots")


def test_a_view_is_previewed_then_the_scene_made_rainy_compared_and_undone(driver):
    def script():
        session, ctx = driver.session, driver.ctx
        rainy = session.rainy
        rainy.preview_width_px = 96
        rainy.choice = msgspec.structs.replace(rainy.choice, count=2, width_px=64)
        clear, before = driver.picture(), session.scene
        driver.click(f"{PANEL}###preview")
        assert rainy.why_not(session) == "Wait for Preview, or cancel it."
        driver.until(lambda: not session.jobs.running, 1_000_000)
        driver.frames()
        assert session.problem is None
        assert rainy.previewed.pixels.shape[1] == 96
        # It lies over what it is of, right of the line, and only while the view is that one.
        assert (session.view.split, rainy.fits(session)) == ("now | preview", True)
        assert ctx.item_exists("//View/divider")
        drag_the_view(driver)
        assert rainy.what_is_stale(session) == "The view has changed since."
        assert not ctx.item_exists("//View/divider")
        driver.click(f"{PANEL}Return to it")
        assert rainy.what_is_stale(session) is None
        ctx.item_input_value(f"{PANEL}##seed", 3)
        driver.frames()
        assert rainy.what_is_stale(session) == "The settings have changed since."

        driver.click(f"{PANEL}###make")
        driver.until(lambda: session.jobs.all[0].progress.message == "Starting", 1_000_000)
        assert not ctx.item_exists(f"{PANEL}###make")  # its progress stands there
        driver.click(f"{PANEL}Cancel##0")
        assert (session.jobs.all[0].state, session.scene) == ("cancelled", before)
        session.jobs.clear()

        blue_sky = session.sky
        driver.click(f"{PANEL}###make")
        (job,) = session.jobs.all
        driver.until(lambda: job in session.previews or job.state != "running", 1_000_000)
        driver.until(lambda: job.state != "running" and session.staged is None, 1_000_000)
        assert (job.state, job.error) == ("finished", None)
        assert job.report.is_file()
        assert session.history.labels == ["Open", MAKE_RAINY_TITLE]
        assert all(each.wet_sh is not None for each in session.scene.members)

        # Beside the clear scene, in rain that a step of its own brings.
        driver.click(f"{PANEL}###compare")
        assert session.view.split == "clear | rainy"
        assert session.rain.intensity_mm_h == make_rainy.COMPARED_MM_H
        compared = driver.picture()
        middle = compared.shape[1] // 2
        assert np.array_equal(compared[:, : middle - 1], clear[:, : middle - 1])
        assert np.abs(compared[:, middle:] - clear[:, middle:]).mean() > 3
        assert session.sky != blue_sky  # drops take the color of the wet one
        driver.click(f"{PANEL}###compare")
        assert session.view.split == "off"
        driver.press(UNDO)
        driver.press(UNDO)
        assert session.scene is before

    driver.run(script)


def test_closing_the_window_ends_the_worker(driver, tmp_path, monkeypatch):
    session, workers = driver.session, []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def script():
        session.rainy.choice = msgspec.structs.replace(session.rainy.choice, count=1000)
        driver.click(f"{PANEL}###make")
        (job,) = session.jobs.all
        driver.until(lambda: job.state != "running" or job.progress.message.startswith("Making"), 1_000_000)
        workers.extend(each for each in psutil.Process().children() if "--multiprocessing-fork" in each.cmdline())
        assert workers and list(tmp_path.glob("gsrain-job-*"))

    driver.run(script)
    assert not any(each.is_running() for each in workers)
    assert not list(tmp_path.glob("gsrain-job-*"))


def test_what_is_missing_is_said_where_it_is_chosen(driver, tmp_path, monkeypatch):
    (tmp_path / "weights.pkl").write_bytes(b"")

    def script():
        session, ctx = driver.session, driver.ctx
        rainy = session.rainy
        ctx.window_focus("//Make it rainy")
        ctx.set_ref("//Make it rainy")
        driver.frames()

        ctx.combo_click("##method/CycleGAN-Turbo")
        monkeypatch.setattr(make_rainy, "has_torch", lambda: False)
        assert "needs torch, which is not installed" in rainy.why_not(session)
        monkeypatch.setattr(make_rainy, "has_torch", lambda: True)
        assert rainy.why_not(session).startswith("CycleGAN-Turbo: no transfer weights")
        ctx.item_click("###make")
        assert session.jobs.all == []
        type_into(driver, "##weights", tmp_path / "nothing.pkl")
        assert "nothing.pkl: is not there" in rainy.why_not(session)
        type_into(driver, "##weights", tmp_path / "weights.pkl")
        assert rainy.why_not(session).startswith("CycleGAN-Turbo: no SD-Turbo")
        ctx.item_open("More settings")
        ctx.item_click("More settings/###mutual_attention")
        rainy.change(normals="dsine")
        driver.frames()
        assert (rainy.settings.normals, rainy.settings.mutual_attention) == ("dsine", False)
        assert ctx.item_exists("More settings/##normals_checkout")
        assert not ctx.item_exists("More settings/##neighbors")

        ctx.combo_click("##method/Pictures")
        assert rainy.why_not(session) == "Pictures: choose a folder of pictures first."
        assert "none from here" in rainy.why_no_preview(session)
        rainy.change(images=tmp_path)
        ctx.combo_click("##source/of the open capture")
        assert rainy.why_not(session).startswith("No capture is open")
        ctx.combo_click("##source/along the camera path")
        assert rainy.why_not(session).startswith("There is no camera path yet")
        ctx.combo_click("##source/of the rig, along the drive")
        assert rainy.why_not(session) is None

        ctx.combo_click("##method/Wet look")
        ctx.item_click("Train the transfer")
        driver.frames()
        assert session.studio.why_not(session) == "Choose a folder that the weights go into first."
        type_into(driver, "##output", tmp_path / "training")
        type_into(driver, "##clear", tmp_path / "no such folder")
        assert "no such folder: is not there" in session.studio.why_not(session)

    driver.run(script)


def drag_the_view(driver):
    """Look elsewhere, by a drag right of the line."""
    rect = driver.ctx.item_info("//View/view").rect_full
    x, y = 0.25 * rect.min.x + 0.75 * rect.max.x, (rect.min.y + rect.max.y) / 2
    driver.ctx.mouse_move_to_pos(imgui.ImVec2(x, y))
    driver.ctx.mouse_drag_with_delta((60, 0))
    driver.frames()


def type_into(driver, field, path):
    driver.ctx.item_click(field)
    driver.ctx.key_chars_replace_enter(str(path))
    driver.frames()
