"""Recording in the real window: the panel, the dialog, the job, and what is asked before something is replaced."""

import shlex

import av

from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene
from ui.commands.keys import chord
from window_driver import imgui


def test_a_clip_is_recorded_while_the_window_goes_on(driver, tmp_path):
    target = tmp_path / "clip.mp4"

    def script():
        editor = driver.editor
        driver.click("//Rain/8.5")
        editor.render_queue.change(size_px=(480, 320), last_s=3.0)
        driver.ctx.window_focus("//View")
        driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.r))
        driver.choose_file("Record the timeline", target)
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
        driver.choose_file("Record the timeline", target)
        assert editor.status.question.text == "clip.mp4 is there already."
        driver.ctx.item_click("//Replace?/Cancel")
        driver.frames()
        assert (editor.status.question, len(editor.jobs.all)) == (None, 1)

    driver.run(script)
    with av.open(str(target)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 90


def test_steps_and_recordings_are_copied(driver, tmp_path):
    source = str(tmp_path / "scene")
    write_scene(small_scene(), source, in_drawing_order=True)

    def copied(button):
        driver.click(button)
        return imgui.get_clipboard_text()

    def script():
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
        assert shlex.split(render) == [
            "gsrain",
            "render",
            "edited",
            "-o",
            "clip.mp4",
            "--size",
            "960x640",
            "--codec",
            "h264",
        ]
        recorded = copied("//Record/Copy as Python").splitlines()
        assert recorded[:-1] == edited.splitlines()[:-1]
        assert recorded[-1] == "gr.export(scene, 'clip.mp4', size_px=(960, 640), codec='h264')"

    driver.run(script)
