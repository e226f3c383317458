"""Background jobs in the real window: the wet look, reconstruction and recoloring, recordings."""

import os
import shlex

import av
import msgspec
import numpy as np
import pytest
from PIL import Image

from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.editor.jobs import make_rainy as make_rainy_job
from gsrain_engine.editor.jobs.make_rainy import MAKE_RAINY_TITLE
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.formats.scene_folder import write_scene_folder
from gsrain_engine.training.settings import load_settings
from small_scene import small_scene
from training.drive_capture import drive_capture, world_depth
from ui.commands.keys import chord
from ui.panels import jobs as jobs_panels
from window_driver import imgui

PANEL = "//Wet look/"
UNDO = chord(imgui.Key.mod_ctrl, imgui.Key.z)


def test_a_view_is_previewed_then_the_scene_made_rainy_compared_and_undone(driver, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))

    editor, ctx = driver.editor, driver.ctx
    rainy = editor.wet_look
    rainy.preview_width_px = 96
    rainy.choice = msgspec.structs.replace(rainy.choice, count=2, width_px=64)
    clear, before = driver.picture(), editor.document.scene
    with driver.journey(2):  # a view in rain
        driver.tap(f"{driver.panel('Wet look')}###preview")
    assert rainy.why_not is None  # the job would wait for the preview
    driver.until_worked(lambda: not editor.jobs.running)
    driver.frames()
    assert editor.status.problem is None
    assert rainy.previewed.images.pictures["rainy"].shape[1] == 96
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

    small = rainy.choice
    rainy.choice = msgspec.structs.replace(small, count=100)  # work that does not end before it is cancelled
    driver.click(f"{PANEL}###make")
    driver.until_worked(lambda: editor.jobs.running)
    assert ctx.item_exists(f"{PANEL}###make")  # another one would wait
    for plays in (True, False):
        faint_words = []
        with monkeypatch.context() as patched:
            patched.setattr(jobs_panels, "faint", faint_words.append)
            editor.playback.clock.playing = plays
            driver.frames()
            editor.playback.clock.playing = False
        assert any("pause that (Space)" in (each or "") for each in faint_words) == plays
    driver.click(f"{PANEL}Cancel##0")
    assert (editor.jobs.all[0].state, editor.document.scene) == ("cancelled", before)
    editor.jobs.clear()
    rainy.choice = small

    blue_sky = editor.live_rain.sky
    driver.panel("Rain")
    with driver.journey(2):  # a wet scene
        driver.tap(f"{driver.panel('Wet look')}###make")
    (job,) = editor.jobs.all
    driver.until_worked(lambda: job in editor.viewport.job_previews or job.state != "running")
    driver.until_worked(lambda: job.state != "running" and editor.viewport.staged is None)
    assert (job.state, job.error) == ("finished", None)
    assert job.report.is_file()
    assert editor.document.history.labels == ["Opened", MAKE_RAINY_TITLE]
    assert all(each.wet_sh is not None for each in editor.document.scene.members)

    # Beside the clear scene, once it rains: without rain there is nothing to compare, and none is added.
    driver.click(f"{PANEL}###compare")
    assert editor.viewport.options.split != "clear | rainy" and editor.document.rain.intensity_mm_h == 0
    editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    with driver.journey(1):
        driver.tap(f"{PANEL}###compare")
    assert editor.viewport.options.split == "clear | rainy"
    compared = driver.picture()
    middle = compared.shape[1] // 2
    assert np.array_equal(compared[:, : middle - 1], clear[:, : middle - 1])
    assert np.abs(compared[:, middle:] - clear[:, middle:]).mean() > 3
    driver.until(lambda: editor.live_rain.sky != blue_sky)  # drops take the color of the wet one
    driver.click(f"{PANEL}###compare")
    assert editor.viewport.options.split == "off"
    driver.press(UNDO)
    driver.press(UNDO)
    assert editor.document.scene is before


REDO = chord(imgui.Key.mod_ctrl, imgui.Key.y)
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


def test_the_input_of_a_network_appears_with_the_preview_and_the_job(driver, tmp_path, monkeypatch):
    pytest.importorskip("diffusers")
    from appearance.cyclegan_turbo.published_checkpoints import trained_model
    from gsrain_engine.appearance.base import TrainingRecord
    from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights

    data = tmp_path / "data" / "gsrain"
    monkeypatch.setenv("XDG_DATA_HOME", str(data.parent))
    for part in ("unet", "vae"):  # the weights lie upon random ones, but the panel looks for a base
        (data / "sd-turbo" / part).mkdir(parents=True)
        (data / "sd-turbo" / part / "config.json").write_text("{}")
    (data / "transfer").mkdir()
    record = TrainingRecord(
        conditioning="luma", normals="depth", framing="stretch", width_px=64, height_px=64, steps=200
    )
    save_weights(trained_model(normals=True), data / "transfer" / "mine.safetensors", record)
    words = "The network saw 64x64 px (stretch), normals from depth as luma."

    editor, rainy = driver.editor, driver.editor.wet_look
    rainy.method, rainy.preview_width_px = "cyclegan-turbo", 96
    rainy.choice = msgspec.structs.replace(rainy.choice, count=1, width_px=96)
    assert rainy.training == f"mine.safetensors: trained with {record.words}."
    driver.click(f"{PANEL}More settings")
    for chosen in ("up", "as trained"):  # the settings that may follow the training can be set, and unset again
        driver.ctx.set_ref(f"{PANEL}More settings")
        driver.ctx.combo_click(f"##guide/{chosen}")
        driver.frames()
        assert rainy.settings.guide == (None if chosen == "as trained" else chosen)
    driver.ctx.set_ref("")
    driver.click(f"{PANEL}More settings")
    driver.click(f"{PANEL}###preview")
    driver.until_worked(lambda: not editor.jobs.running)
    driver.frames()
    assert editor.status.problem is None
    images = rainy.previewed.images
    assert images.note == words
    assert list(images.pictures) == list(rainy.textures) == ["clear", "framed", "guide", "rainy"]
    height, width = images.pictures["clear"].shape[:2]
    assert width == 96 and height < width
    sizes = [(each.width, each.height) for each in rainy.textures.values()]
    assert sizes == [(width, height), (64, 64), (64, 64), (width, height)]
    with_pictures, previewed = driver.screen(), rainy.previewed
    rainy.previewed = None
    corner, size = driver.area()
    differing = np.argwhere((driver.screen() != with_pictures).any(axis=2))  # rows, columns
    rainy.previewed = previewed
    beside = (differing[:, 1] < corner[0]) | (differing[:, 1] > corner[0] + size[0])
    assert np.ptp(differing[beside], axis=0).min() > 40  # the pictures in the panel
    scene, report = tmp_path / "scene", tmp_path / "report.html"
    write_scene_folder(small_scene(), scene)
    order = make_rainy_job.TransferRequest(rainy.method, rainy.settings, rainy.choice)
    steps = list(make_rainy_job.make_rainy(scene, order, tmp_path / "colors.npz", report))  # what its worker runs
    assert steps[-1].note == words and "64x64 px (stretch)" in report.read_text()


def test_a_capture_becomes_a_scene_that_takes_on_the_look_of_pictures(drive, driver, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setenv("XDG_DATA_HOME", str(drive / "data"))
    settings = load_settings("draft", steps=40, width_px=96, gaussians=3000, measured_every=20)
    editor = driver.editor
    editor.training.settings = settings

    def ended(job):
        return job.state != "running" and editor.viewport.staged is None

    before = editor.document.scene
    editor.captures.open(drive / "drive")
    driver.until(lambda: editor.captures.capture is not None)
    driver.frames(3)
    with driver.journey(2):  # a scene from an open capture
        driver.tap(f"{driver.panel('Capture')}Reconstruct")
        driver.tap("//Capture/Reconstruct/Reconstruct")
    (job,) = editor.jobs.all
    # Where it was started there is how far it is, and what is started next waits.
    assert driver.ctx.item_exists("//Capture/Reconstruct/Cancel##0")
    assert driver.ctx.item_exists("//Capture/Reconstruct/Reconstruct")
    driver.until_worked(lambda: ended(job))
    assert (job.state, job.error) == ("finished", None)
    assert editor.document.history.labels == ["Opened", "Reconstruct drive"]
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
    editor.document.change_rain("Haze", haze="none")
    editor.training.recolor(drive / "dim")
    driver.until_worked(lambda: ended(editor.jobs.all[-1]))
    assert (editor.jobs.all[-1].state, editor.jobs.all[-1].error) == ("finished", None)
    assert np.array_equal(driver.picture(), trained)  # it does not rain
    driver.type_in("//Rain/##intensity_mm_h", 12.0)
    wet = driver.picture()
    assert 0.35 < wet.mean() / trained.mean() < 0.65
    driver.press(UNDO)
    driver.press(UNDO)
    assert all(member.wet_sh is None for member in editor.document.scene.members)
    driver.press(REDO)
    driver.press(REDO)
    assert np.array_equal(driver.picture(), wet)


def test_a_clip_is_recorded_while_the_window_goes_on(driver, tmp_path, monkeypatch):
    target, opened = tmp_path / "clip.mp4", tmp_path / "opened"
    (tmp_path / "bin").mkdir()
    opener = tmp_path / "bin" / "xdg-open"
    opener.write_text(f'#!/bin/sh\necho "$1" >> {opened}\n')
    opener.chmod(0o755)
    monkeypatch.setenv("PATH", f"{opener.parent}{os.pathsep}{os.environ['PATH']}")

    editor = driver.editor
    driver.click("//Rain/8.5")
    editor.render_queue.change(size_px=(480, 320), fps=2.0)
    timeline = driver.panel("Timeline")
    driver.ctx.window_focus("//View")
    with driver.journey(6):  # a flight of 10 s as a video
        driver.press(imgui.Key.k)
        driver.type_in(f"{timeline}**/##time", 10.0)
        driver.stroke(driver.at(0.5, 0.4), driver.at(0.54, 0.4), driver.at(0.56, 0.42), button=1)
        driver.press(imgui.Key.k)
        driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.r))
        driver.choose_file("Record timeline", target)
    driver.until(lambda: len(editor.jobs.all) == 1)
    job = editor.jobs.all[0]
    driver.ctx.window_focus("//Jobs")
    driver.until_worked(lambda: job in editor.viewport.job_previews or job.state != "running")
    assert editor.viewport.job_previews[job][1:] == (240, 160)  # every second pixel
    driver.click("//Rain/12")  # the recording has the document as it was
    assert editor.document.rain.intensity_mm_h == 12.0
    driver.until_worked(lambda: job.state != "running")
    assert (job.state, job.error) == ("finished", None)
    driver.frames(2)
    driver.tap("//**/###open output")
    driver.tap("//**/###show output")
    driver.tap("//**/###dismiss")
    driver.until(lambda: opened.exists() and len(opened.read_text().splitlines()) == 2)
    assert set(opened.read_text().splitlines()) == {str(target), str(target.parent)} and job.is_noticed
    assert editor.viewport.job_previews == {}
    driver.ctx.window_focus("//View")
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.r))
    driver.choose_file("Record timeline", target)
    assert editor.status.question.text == "clip.mp4 is there already."
    driver.tap("//Replace?/Cancel")
    assert (editor.status.question, len(editor.jobs.all)) == (None, 1)
    editor.render_queue.change(fps=30.0)  # these do not end before they are canceled
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.r))
    driver.choose_file("Record timeline", tmp_path / "other.mp4")
    driver.until_worked(lambda: "left" in editor.jobs.all[1].progress.message)

    # Others wait: in the same place they are refused, else they run next, or not at all.
    editor.render_queue.record_to(tmp_path / "other.mp4")
    assert "is being recorded already" in editor.status.problem
    editor.status.dismiss()
    for name in ("third.mp4", "fourth.mp4"):
        editor.render_queue.record_to(tmp_path / name)
    other, third, fourth = editor.jobs.all[1:]
    assert editor.jobs.waiting == [third, fourth]
    driver.ctx.window_focus("//Log")  # in front of *Jobs*, which has the same buttons
    driver.tap("//**/###list jobs")
    run_next, cancel = (driver.area(f"//**/{button}")[0] for button in ("Run next##3", "Cancel##1"))
    monkeypatch.setattr(jobs_panels, "_metrics", lambda _job: imgui.dummy(imgui.ImVec2(1, 100)))
    driver.frames(2)  # what the running one reports grows, and moves no button
    assert np.array_equal(driver.area("//**/Run next##3")[0], run_next)
    assert np.array_equal(driver.area("//**/Cancel##1")[0], cancel)
    assert driver.ctx.item_exists("//**/Run now##3")
    driver.tap("//**/Run next##3")
    assert editor.jobs.waiting == [fourth, third]
    driver.tap("//**/Cancel##2")
    assert (third.state, editor.jobs.waiting) == ("cancelled", [fourth])
    driver.press(imgui.Key.escape)
    place = driver.area("//**/###cancel job")[0]
    driver.tap("//**/###cancel job")  # of the status bar
    driver.until(lambda: fourth.state == "running")
    assert other.state == "cancelled" and np.array_equal(driver.area("//**/###cancel job")[0], place)
    driver.tap("//**/###cancel job")
    assert (fourth.state, editor.jobs.pending) == ("cancelled", [])
    driver.frames(3)
    driver.tap("//View/**/###open output")  # what was recorded of the canceled one
    driver.until(lambda: opened.read_text().splitlines()[-1] == str(other.output))
    with av.open(str(target)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 20


def test_steps_and_recordings_are_copied(driver, tmp_path):
    source = str(tmp_path / "scene")
    write_scene(small_scene(), source, in_drawing_order=True)

    def copied(button):
        driver.click(button)
        return imgui.get_clipboard_text()

    driver.editor.files.open(source)
    driver.until(lambda: driver.editor.files.source == source)
    driver.click("//Rain/8.5")
    words = shlex.split(copied("//History/Copy as command"))
    assert words[:3] == ["gsrain", "edit", source]
    assert "intensity_mm_h=8.5" in words[3]
    assert words[4:] == ["-o", "edited"]
    edited = copied("//History/Copy as Python")
    assert edited.splitlines()[2] == f"scene = gr.load({source!r})"
    render = copied("//Record/Copy as command").partition(" && ")[2]
    assert render == "gsrain render edited -o clip.mp4 --size 960x640 --to 5.0 --codec h264"  # as the timeline plays it
    recorded = copied("//Record/Copy as Python").splitlines()
    assert recorded[:-1] == edited.splitlines()[:-1]
    assert recorded[-1] == "gr.export(scene, 'clip.mp4', size_px=(960, 640), last_s=5.0, codec='h264')"
