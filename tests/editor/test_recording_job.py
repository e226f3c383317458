"""Recordings from a editor, in the processes that a window would start; compared with those of the command line."""

import shlex
import shutil
from dataclasses import replace

import av
import numpy as np
import pytest
from PIL import Image

from app.main import run
from gsrain_engine.editor.autosave import saved_scene
from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.jobs.job import JobError
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


@pytest.fixture
def editor():
    editor = Editor(small_scene(), RainSettings(intensity_mm_h=8.5))
    yield editor
    editor.close()


def open_now(editor, path):
    """Open a scene and wait for it, without a window to wait in."""
    before = editor.document.scene
    editor.files.open(str(path))
    while editor.document.scene is before:
        for future in editor.pending_files:
            future.exception(timeout=60)
        editor.tick(0.01)
        editor.apply(DrawResult(is_pending_ready=True))


def flown(scene):
    """The scene with a person's own path, in scene time."""
    times = np.array([0.5, 1.0, 2.0])
    facing = np.tile([0.5, -0.5, 0.5, -0.5], (3, 1))
    return CameraPath(times, np.array([[0.0, 0, 2], [1, 0.5, 2], [4, 0, 1]]), facing, np.full(3, 50.0))


def command_of(editor):
    """Equivalent command line in the log."""
    line = next(line.text for line in editor.status.log.lines if "The same from the command line" in line.text)
    return shlex.split(line.partition(": ")[2])[1:]


@pytest.mark.parametrize("codec", ["h264", "png"])
def test_the_window_s_recording_is_that_of_the_command_line(editor, tmp_path, codec):
    editor.document.edit("Fly", replace_scene, replace(editor.document.scene, path=flown(editor.document.scene)))
    editor.render_queue.change(
        codec=codec, size_px=(96, 64), first_s=0.5, last_s=0.7, motion_blur=2, passes=("color", "labels")
    )
    project, target = tmp_path / "project", tmp_path / ("clip.mp4" if codec == "h264" else "clip")
    write_scene(saved_scene(editor.viewport), project, editor.files.known, in_drawing_order=True)
    editor.render_queue.record_to(target)
    assert editor.jobs.newest("export").wait(60) == str(target)
    mine = {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.glob("clip*/**/*") if path.is_file()}
    mine |= {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.glob("clip*") if path.is_file()}
    assert len(mine) == {"h264": 1 + 6 + 1, "png": 2 * 6 + 1}[codec]
    for path in mine:
        (tmp_path / path).unlink()
    command = command_of(editor)
    assert run([str(project) if word == "PROJECT" else word for word in command]) == 0
    assert {path: (tmp_path / path).read_bytes() for path in mine} == mine


def test_so_is_that_of_a_project_that_was_opened_again(editor, tmp_path):
    project = tmp_path / "project"
    write_scene(saved_scene(editor.viewport), project, in_drawing_order=True)
    again = Editor()
    try:
        open_now(again, project)
        assert again.document.rain.intensity_mm_h == 8.5
        again.render_queue.change(codec="png", size_px=(96, 64), last_s=0.1)
        again.render_queue.record_to(tmp_path / "window")
        again.jobs.newest("export").wait(60)
    finally:
        again.close()
    assert run(["render", str(project), "-o", str(tmp_path / "typed"), "--size", "96x64", "--to", "0.1"]) == 0
    names = [path.name for path in sorted((tmp_path / "window").iterdir())]
    assert names == ["000000.png", "000001.png", "000002.png"]
    for name in names:
        assert (tmp_path / "window" / name).read_bytes() == (tmp_path / "typed" / name).read_bytes()


def test_a_cancelled_recording_can_be_played(editor, tmp_path):
    editor.render_queue.change(size_px=(96, 64), last_s=600.0)
    editor.render_queue.record_to(tmp_path / "long")  # the format's ending is put behind the name
    job = editor.jobs.newest("export")
    while job.state == "running" and (job.progress.preview is None or "left" not in job.progress.message):
        editor.jobs.wait(60)
        editor.tick(0.01)
    assert job.progress.preview.shape == (64, 96, 3)
    write_scene(small_scene(), tmp_path / "other.ply")
    open_now(editor, tmp_path / "other.ply")
    assert editor.render_queue.is_recording  # it has a copy of what it began with
    job.cancel()
    assert (job.state, editor.render_queue.is_recording) == ("cancelled", False)
    editor.close()  # waits for the worker
    with av.open(str(tmp_path / "long.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) >= 2


def test_an_existing_file_is_only_replaced_after_a_question(editor, tmp_path):
    target = tmp_path / "clip"
    target.mkdir()
    editor.render_queue.change(codec="png", size_px=(96, 64), last_s=0.03)
    for label, started in (("Cancel", 0), ("Replace", 1)):
        editor.render_queue.record_to(target)
        assert editor.jobs.all == []
        question = editor.status.question
        assert "clip" in question.text
        editor.status.answer(next(each for each in question.answers if each.label == label))
        assert len(editor.jobs.all) == started
    shutil.rmtree(target)
    editor.jobs.all[0].cancel()
    assert "nothing of it was written" in editor.status.log.lines[-1].text


def test_a_still_is_what_the_view_shows(editor, tmp_path):
    editor.render_queue.change(size_px=(96, 64), supersampling=2)
    editor.playback.clock.time_s = 1.5
    editor.viewport.navigation.position[:] = [10.0, 2.0, 3.0]
    shown = editor.viewport.shot(96, 64).camera
    path = editor.render_queue.still_scene().path.moved(editor.document.scene.scene_to_world)
    assert np.allclose(path.camera(1.5, 96, 64).world_to_camera, shown.world_to_camera, atol=1e-9)
    assert path.camera(1.5, 96, 64).fx == pytest.approx(shown.fx)
    editor.render_queue.record_still_to(tmp_path / "still")
    editor.jobs.newest("export").wait(60)
    assert np.asarray(Image.open(tmp_path / "still.png")).shape == (64, 96, 3)
    assert not any("command line" in line.text for line in editor.status.log.lines)
    editor.viewport.options.follow_path = True
    assert editor.render_queue.still_scene().path is editor.document.scene.path


@pytest.mark.parametrize(
    ("settings", "target", "named"),
    [
        ({"codec": "png"}, "file/clip", "file/clip"),
        ({"codec": "h264"}, "file/clip", "file/clip.mp4"),
        ({"size_px": (95, 64)}, "odd.mp4", "95x64"),
        ({"cameras": ("two",)}, "clip.mp4", "two"),
    ],
)
def test_a_recording_that_is_impossible_names_the_reason(editor, tmp_path, settings, target, named):
    (tmp_path / "file").write_text("in the way")
    editor.render_queue.change(**{"size_px": (96, 64), "last_s": 0.03} | settings)
    editor.render_queue.record_to(tmp_path / target)
    for job in editor.jobs.running:
        with pytest.raises(JobError, match=named):
            job.wait(60)
    assert named in editor.status.problem


def test_copied_recordings_make_the_same_frames(editor, tmp_path):
    """Command and program of a recording, run on the file of the scene, write the frames that the job writes."""
    write_scene(editor.document.scene, tmp_path / "scene", in_drawing_order=True)
    open_now(editor, tmp_path / "scene")
    editor.document.change_rain("Intensity", intensity_mm_h=5.0)
    editor.camera_path.add_keyframe(0.0)
    editor.camera_path.add_keyframe(0.2)
    editor.render_queue.change(codec="png", size_px=(48, 32), fps=10.0, last_s=0.2, supersampling=2, twin=True)
    command, program = editor.render_queue.command, editor.render_queue.program
    editor.render_queue.record_to(tmp_path / "job")
    editor.jobs.all[-1].wait(120)
    command = command.replace("edited", str(tmp_path / "edited")).replace("-o clip", f"-o {tmp_path / 'command'}")
    for line in command.split(" && "):
        assert run(shlex.split(line)[1:]) == 0
    exec(program.replace("'clip'", repr(str(tmp_path / "python"))), {})
    frames = {each.name: each.read_bytes() for each in sorted((tmp_path / "job").iterdir())}
    assert len(frames) == 2
    for form in ("command", "python"):
        assert {each.name: each.read_bytes() for each in sorted((tmp_path / form).iterdir())} == frames
        assert (tmp_path / f"{form}.clear").is_dir()
