"""Recording in the real window: the panel, the dialog, the job, and what is asked before something is replaced."""

import av
import pytest

from ui.commands.base import chord
from window_driver import Driver, imgui


@pytest.fixture
def driver(tmp_path):
    return Driver(tmp_path)


def name_it(driver, title, path):
    """Type a place into a save dialog, and save."""
    driver.frames(3)
    driver.ctx.item_click(f"//{title}/##file_input")
    driver.ctx.key_chars_replace(str(path))
    driver.ctx.item_click(f"//{title}/**/Save")
    driver.frames(3)


def test_a_clip_is_recorded_while_the_window_goes_on(driver, tmp_path):
    target = tmp_path / "clip.mp4"

    def script():
        editor = driver.editor
        driver.click("//Rain/8.5")
        editor.render_queue.change(size_px=(480, 320), last_s=3.0)
        driver.ctx.window_focus("//View")
        driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.r))
        name_it(driver, "Record the timeline", target)
        driver.until(lambda: len(editor.jobs.all) == 1)
        job = editor.jobs.all[0]
        driver.ctx.window_focus("//Jobs")
        driver.until(lambda: job in editor.viewport.job_previews or job.state != "running", 100_000)
        assert editor.viewport.job_previews[job][1:] == (240, 160)  # every second pixel
        driver.click("//Rain/12.0")  # the recording has the document as it was
        assert editor.document.rain.intensity_mm_h == 12.0
        driver.until(lambda: job.state != "running", 100_000)
        assert (job.state, job.error) == ("finished", None)
        driver.frames(2)
        assert editor.viewport.job_previews == {}
        driver.ctx.window_focus("//View")
        driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.r))
        name_it(driver, "Record the timeline", target)
        assert editor.status.question.text == "clip.mp4 is there already."
        driver.ctx.item_click("//Replace?/Cancel")
        driver.frames()
        assert (editor.status.question, len(editor.jobs.all)) == (None, 1)

    driver.run(script)
    with av.open(str(target)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 90


def test_the_panel_s_fields_say_what_is_recorded(driver, tmp_path):
    recorder = driver.editor.render_queue

    def script():
        driver.ctx.window_focus("//Record")
        driver.frames()
        driver.ctx.set_ref("//Record")
        driver.ctx.combo_click("##format/EXR frames")
        driver.ctx.combo_click("##size/1280 x 720")
        driver.frames()
        assert (recorder.settings.codec, recorder.settings.size_px) == ("exr", (1280, 720))
        driver.ctx.item_click("depth")
        driver.ctx.item_click("labels")
        driver.ctx.item_click("color")
        driver.frames()
        assert recorder.settings.passes == ("depth", "labels")
        driver.ctx.item_click("Also render without rain")
        driver.ctx.item_input_value("##supersampling", 3)
        driver.ctx.item_input_value("##motion_blur", 8)
        driver.ctx.item_input_value("##fps", 24.0)
        driver.frames()
        wanted = recorder.settings
        assert (wanted.twin, wanted.supersampling, wanted.motion_blur, wanted.fps) == (True, 3, 8, 24.0)
        assert driver.editor.playback.timeline.fps == 24.0
        assert recorder.end_s == 5.0
        driver.ctx.item_click("###its end")
        driver.frames()
        assert recorder.settings.last_s == 5.0
        driver.ctx.item_input_value("##first_s", 1.5)
        driver.ctx.item_input_value("##last_s", 2.0)
        driver.frames()
        assert (recorder.settings.first_s, recorder.settings.last_s, recorder.extent().frames) == (1.5, 2.0, 12)
        driver.ctx.item_input_value("##first_s", 3.0)  # after the end: not taken
        driver.frames()
        assert recorder.settings.first_s == 1.5
        driver.ctx.combo_click("##format/MP4 (H.264)")
        driver.ctx.item_click("###usual")
        driver.ctx.item_input_value("##quality", 30)
        driver.frames()
        assert (recorder.settings.codec, recorder.settings.quality) == ("h264", 30)
        driver.ctx.combo_click("##size/the rig's own")
        driver.ctx.item_click("##cameras")
        driver.frames()
        driver.ctx.item_click("//$FOCUSED/FRONT  (960 x 640)##one\\/FRONT")
        driver.frames()
        assert (recorder.settings.size_px, recorder.settings.cameras) == (None, ("one/FRONT",))
        assert recorder.extent().cameras == 1

    driver.run(script)
