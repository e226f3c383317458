"""Recordings from an editor, in the processes that a window would start; compared with those of the command line."""

import os
import shlex
import shutil
from contextlib import closing
from dataclasses import replace

import av
import numpy as np
import pytest
from PIL import Image

from app.main import run
from editor.files.open_document import settle
from gsrain_engine.editor.autosave import saved_scene
from gsrain_engine.editor.drawing.frame import DrawnImage, DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene, set_path
from gsrain_engine.editor.jobs.job import JobError
from gsrain_engine.editor.viewport.options import FULL_QUALITY
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


@pytest.fixture
def editor():
    with closing(Editor(small_scene(), RainSettings(intensity_mm_h=8.5))) as opened:
        yield opened


FLIGHT = CameraPath(
    np.array([0.5, 1.0, 2.0]), np.array([[0.0, 0, 2], [1, 0.5, 2], [4, 0, 1]]),
    np.tile([0.5, -0.5, 0.5, -0.5], (3, 1)), np.full(3, 50.0),
)  # fmt: skip


def files_in(folder):
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(".provenance.json")]
    return {path.relative_to(folder): path.read_bytes() for path in files}


def test_the_estimate_is_of_the_last_picture_that_a_recording_would_draw_as_well(editor):
    """A substitute until the renderer is ready, the first picture with it, and coarse ones take another time."""

    def draw(frame_ms, backend, quality=FULL_QUALITY, is_settled=True):
        image = DrawnImage(quality, frame_ms, backend, "", {"megapixels": 0.5})
        editor.apply(DrawResult(editor.render_input(96, 64), drawn=image, is_settled=is_settled))
        return editor.viewport.full_ms_per_megapixel

    assert [draw(90_000, "opengl-quads", is_settled=False) for _ in range(2)] == [None, None]
    assert draw(60_000, "cpu") is None and editor.render_queue.extent().seconds is None
    assert draw(100, "cpu") == draw(9, "cpu", FULL_QUALITY._replace(scale=0.5)) == 200
    frames, seconds = editor.render_queue.extent().frames, editor.render_queue.extent().seconds
    assert seconds == pytest.approx(frames * 0.2 * 0.96 * 0.64)
    editor.viewport.reset()  # for another scene
    assert editor.render_queue.extent().seconds is None


def test_the_estimate_from_timed_frames_is_not_of_another_scene(editor, tmp_path):
    editor.render_queue.change(size_px=(96, 64), last_s=0.2)
    editor.render_queue.time_frames()
    editor.jobs.newest("timing").wait(60)
    assert editor.render_queue.extent().is_timed
    write_scene(small_scene("other"), tmp_path / "other")
    editor.files.open(str(tmp_path / "other"))
    settle(editor)
    assert editor.document.scene.name == "other" and not editor.render_queue.extent().is_timed


def test_the_ends_of_a_recording_are_those_of_the_timelines_range(editor):
    editor.document.edit("Fly", set_path, FLIGHT)
    queue, clock = editor.render_queue, editor.playback.clock

    def ends():
        return queue.settings.first_s, queue.settings.last_s

    queue.change(first_s=0.5, last_s=0.7)
    assert ends() == pytest.approx((0.5, 0.7))
    queue.follows_range, clock.span_s = True, (1.0, 1.8)
    assert ends() == pytest.approx((1.0, 1.8))


@pytest.mark.parametrize("flight", [None, FLIGHT])
@pytest.mark.parametrize("follows", [True, False])
@pytest.mark.parametrize("ego", [True, False])
def test_a_recording_ends_with_the_timeline_whatever_that_plays(editor, flight, follows, ego):
    scene = editor.document.scene if ego else replace(editor.document.scene, ego=None, actors=())
    editor.document.edit("Fly", replace_scene, replace(scene, path=flight))
    editor.render_queue.follows_range = follows
    extent, settings = editor.render_queue.extent(), editor.render_queue.settings
    assert settings.last_s == editor.playback.span_s[1]
    assert extent.length_s == pytest.approx(settings.last_s - settings.first_s, abs=1 / 30)


@pytest.mark.parametrize(("codec", "output", "count"), [("h264", "clip.mp4", 1 + 6 + 1), ("png", "clip", 2 * 6 + 1)])
def test_the_recording_of_the_window_is_that_of_the_command_line(editor, tmp_path, codec, output, count):
    editor.document.edit("Fly", set_path, FLIGHT)
    editor.render_queue.change(
        codec=codec, size_px=(96, 64), first_s=0.5, last_s=0.7, motion_blur=2, passes=("color", "labels")
    )
    project, folder = tmp_path / "project", tmp_path / "clips"
    write_scene(saved_scene(editor.viewport), project, editor.files.known, in_drawing_order=True)
    folder.mkdir()
    editor.render_queue.record_to(folder / output)
    assert editor.jobs.newest("export").wait(60) == str(folder / output)
    mine = files_in(folder)
    assert len(mine) == count
    shutil.rmtree(folder)
    folder.mkdir()
    line = next(line.text for line in editor.status.log.lines if "The same from the command line" in line.text)
    command = shlex.split(line.partition(": ")[2])[1:]
    assert run([str(project) if word == "PROJECT" else word for word in command]) == 0
    assert files_in(folder) == mine


@pytest.mark.parametrize("flight", [FLIGHT, None])
def test_the_page_of_the_window_is_that_of_the_command_line(editor, tmp_path, flight):
    editor.document.edit("Fly", set_path, flight)
    project, page, other = tmp_path / "project", tmp_path / "mine.html", tmp_path / "other.html"
    write_scene(saved_scene(editor.viewport), project, editor.files.known, in_drawing_order=True)
    editor.render_queue.publish_to(tmp_path / "mine")  # the ending is put behind the name
    assert editor.jobs.newest("export").wait(60) == page
    assert run(["publish", str(project), "-o", str(other)]) == 0
    assert page.read_bytes() == other.read_bytes()
    editor.render_queue.publish_to(page)
    assert editor.status.question.title == "Replace?"


def test_a_cancelled_recording_can_be_played(editor, tmp_path):
    editor.render_queue.change(size_px=(96, 64), last_s=600.0)
    editor.render_queue.record_to(tmp_path / "long")  # the format's ending is put behind the name
    job = editor.jobs.newest("export")
    while job.state == "running" and (job.progress.preview is None or "left" not in job.progress.message):
        editor.jobs.wait(60)
        editor.tick(0.01)
    assert job.progress.preview.shape == (64, 96, 3)
    write_scene(small_scene("other"), tmp_path / "other")
    editor.files.give_up()
    editor.files.open(str(tmp_path / "other"))
    settle(editor)
    assert editor.document.scene.name == "other"
    assert job.is_pending  # it has a copy of what it began with
    job.cancel()
    assert (job.state, job.is_pending) == ("cancelled", False)
    assert job.has_output and editor.jobs.notices == [job]
    os.utime(job.output, (1e9, 1e9))
    assert not job.has_output and editor.jobs.notices == []  # it would be the file of another one
    editor.close()  # waits for the worker
    with av.open(str(tmp_path / "long.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) >= 2


def test_a_still_has_the_view_of_the_viewport(editor, tmp_path):
    editor.render_queue.change(size_px=(96, 64), supersampling=2)
    editor.playback.clock.time_s = 1.5
    editor.viewport.navigation.position[:] = [10.0, 2.0, 3.0]
    view = editor.viewport.shot(96, 64).camera
    camera = editor.render_queue.still_scene().path.moved(editor.document.scene.scene_to_world).camera(1.5, 96, 64)
    assert np.allclose(camera.world_to_camera, view.world_to_camera, atol=1e-9)
    assert camera.fx == pytest.approx(view.fx)
    editor.render_queue.record_still_to(tmp_path / "still")
    editor.jobs.newest("export").wait(60)
    assert np.asarray(Image.open(tmp_path / "still.png")).shape == (64, 96, 3)
    assert not any("command line" in line.text for line in editor.status.log.lines)
    editor.viewport.options.follow_path = True
    assert editor.render_queue.still_scene().path is editor.document.scene.path


def test_a_still_of_a_view_from_above_is_to_scale_and_has_its_marks(editor, tmp_path):
    editor.render_queue.change(size_px=(96, 64))
    editor.viewport.look_from_above()
    camera = editor.viewport.shot(96, 64).camera
    shown = []
    for name, marks in (("plain", ()), ("marked", ("grid",))):
        editor.viewport.options.marks = frozenset(marks)
        editor.render_queue.record_still_to(tmp_path / name)
        editor.jobs.newest("export").wait(60)
        shown.append(np.asarray(Image.open(tmp_path / f"{name}.png")))
    sequence = FrameSequence(editor.document.scene, RainSimulation.start(editor.document.rain), camera, 96, 64)
    expected = sequence.image(CpuRenderer(), 0, sequence.sky(CpuRenderer()))
    assert np.abs(shown[0].astype(int) - expected).mean() < 0.5
    assert 0.005 < (shown[0] != shown[1]).any(axis=-1).mean() < 0.5


def test_a_sheet_has_five_intensities_and_is_that_of_the_command_line(editor, tmp_path):
    editor.document.edit("Fly", set_path, FLIGHT)
    editor.viewport.options.follow_path = True
    editor.playback.clock.time_s = 1.5
    editor.render_queue.change(codec="png", size_px=(96, 64), passes=("color", "depth"), fps=24.0, transparent=True)
    project, file = tmp_path / "project", tmp_path / "sheet.png"
    write_scene(saved_scene(editor.viewport), project, editor.files.known, in_drawing_order=True)
    editor.render_queue.draw_sheet_to(file)
    editor.jobs.newest("export").wait(60)
    with Image.open(file) as sheet:
        assert sheet.width >= 96 and 5 * 64 < sheet.height < 5 * 200  # captions are wrapped
    drawn = file.read_bytes()
    line = next(line.text for line in editor.status.log.lines if "The same from the command line" in line.text)
    command = shlex.split(line.partition(": ")[2])[1:]
    assert run([str(project) if word == "PROJECT" else word for word in command]) == 0
    assert file.read_bytes() == drawn


@pytest.mark.parametrize(
    ("settings", "target", "named"),
    [
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
    editor.files.open(str(tmp_path / "scene"))
    settle(editor)
    editor.document.change_rain("Intensity", intensity_mm_h=5.0)
    editor.camera_path.add_keyframe(0.0)
    editor.camera_path.add_keyframe(0.2)
    editor.render_queue.change(codec="png", size_px=(48, 32), fps=10.0, last_s=0.2, supersampling=2, twin="sunny")
    command, program = editor.render_queue.command, editor.render_queue.program
    editor.render_queue.record_to(tmp_path / "job")
    editor.jobs.all[-1].wait(120)
    command = command.replace("edited", str(tmp_path / "edited")).replace("-o clip", f"-o {tmp_path / 'command'}")
    for line in command.split(" && "):
        assert run(shlex.split(line)[1:]) == 0
    exec(program.replace("'clip'", repr(str(tmp_path / "python"))), {})
    for clear in ("", ".clear"):
        frames = files_in(tmp_path / f"job{clear}")
        assert len(frames) == 2
        assert files_in(tmp_path / f"command{clear}") == files_in(tmp_path / f"python{clear}") == frames
