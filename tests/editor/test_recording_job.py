"""Recordings from a session, in the processes that a window would start; compared with those of the command line."""

import shlex
import shutil
from dataclasses import replace

import av
import numpy as np
import pytest
from PIL import Image

from app.main import run
from gsrain_engine.editor.autosave import saved_scene
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import JobError
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


@pytest.fixture
def session():
    session = Editor(small_scene(), RainSettings(intensity_mm_h=8.5))
    yield session
    session.close()


def open_now(session, path):
    """Open a scene and wait for it, without a window to wait in."""
    before = session.scene
    session.open(str(path))
    while session.scene is before:
        for future in session.pending_files:
            future.exception(timeout=60)
        session.update(0.01)
        session.swap_in()


def flown(scene):
    """The scene with a person's own path, in scene time."""
    times = np.array([0.5, 1.0, 2.0])
    facing = np.tile([0.5, -0.5, 0.5, -0.5], (3, 1))
    return CameraPath(times, np.array([[0.0, 0, 2], [1, 0.5, 2], [4, 0, 1]]), facing, np.full(3, 50.0))


def command_of(session):
    """Equivalent command line in the log."""
    line = next(line.text for line in session.log.lines if "The same from the command line" in line.text)
    return shlex.split(line.partition(": ")[2])[1:]


@pytest.mark.parametrize("codec", ["h264", "png"])
def test_the_window_s_recording_is_that_of_the_command_line(session, tmp_path, codec):
    session.set_scene("Fly", replace(session.scene, path=flown(session.scene)))
    session.recorder.change(
        codec=codec, size_px=(96, 64), first_s=0.5, last_s=0.7, motion_blur=2, passes=("color", "labels")
    )
    project, target = tmp_path / "project", tmp_path / ("clip.mp4" if codec == "h264" else "clip")
    write_scene(saved_scene(session), project, session.files.known, in_drawing_order=True)
    session.recorder.record_to(target)
    assert session.jobs.newest("export").wait(60) == str(target)
    mine = {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.glob("clip*/**/*") if path.is_file()}
    mine |= {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.glob("clip*") if path.is_file()}
    assert len(mine) == {"h264": 1 + 6 + 1, "png": 2 * 6 + 1}[codec]
    for path in mine:
        (tmp_path / path).unlink()
    command = command_of(session)
    assert run([str(project) if word == "PROJECT" else word for word in command]) == 0
    assert {path: (tmp_path / path).read_bytes() for path in mine} == mine


def test_so_is_that_of_a_project_that_was_opened_again(session, tmp_path):
    project = tmp_path / "project"
    write_scene(saved_scene(session), project, in_drawing_order=True)
    again = Editor()
    try:
        open_now(again, project)
        assert again.rain.intensity_mm_h == 8.5
        again.recorder.change(codec="png", size_px=(96, 64), last_s=0.1)
        again.recorder.record_to(tmp_path / "window")
        again.jobs.newest("export").wait(60)
    finally:
        again.close()
    assert run(["render", str(project), "-o", str(tmp_path / "typed"), "--size", "96x64", "--to", "0.1"]) == 0
    names = [path.name for path in sorted((tmp_path / "window").iterdir())]
    assert names == ["000000.png", "000001.png", "000002.png"]
    for name in names:
        assert (tmp_path / "window" / name).read_bytes() == (tmp_path / "typed" / name).read_bytes()


def test_a_cancelled_recording_can_be_played(session, tmp_path):
    session.recorder.change(size_px=(96, 64), last_s=600.0)
    session.recorder.record_to(tmp_path / "long")  # the format's ending is put behind the name
    job = session.jobs.newest("export")
    while job.state == "running" and (job.progress.preview is None or "left" not in job.progress.message):
        session.jobs.wait(60)
        session.update(0.01)
    assert job.progress.preview.shape == (64, 96, 3)
    write_scene(small_scene(), tmp_path / "other.ply")
    open_now(session, tmp_path / "other.ply")
    assert session.recorder.is_recording  # it has a copy of what it began with
    job.cancel()
    assert (job.state, session.recorder.is_recording) == ("cancelled", False)
    session.close()  # waits for the worker
    with av.open(str(tmp_path / "long.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) >= 2


def test_an_existing_file_is_only_replaced_after_a_question(session, tmp_path):
    target = tmp_path / "clip"
    target.mkdir()
    session.recorder.change(codec="png", size_px=(96, 64), last_s=0.03)
    for label, started in (("Cancel", 0), ("Replace", 1)):
        session.recorder.record_to(target)
        assert session.jobs.all == []
        question = session.questions.present
        assert "clip" in question.text
        session.questions.answer(next(each for each in question.answers if each.label == label))
        assert len(session.jobs.all) == started
    shutil.rmtree(target)
    session.jobs.all[0].cancel()
    assert "nothing of it was written" in session.log.lines[-1].text


def test_a_still_is_what_the_view_shows(session, tmp_path):
    session.recorder.change(size_px=(96, 64), supersampling=2)
    session.clock.time_s = 1.5
    session.navigation.position[:] = [10.0, 2.0, 3.0]
    shown = session.shot(96, 64).camera
    path = session.recorder.still_scene().path.moved(session.scene.scene_to_world)
    assert np.allclose(path.camera(1.5, 96, 64).world_to_camera, shown.world_to_camera, atol=1e-9)
    assert path.camera(1.5, 96, 64).fx == pytest.approx(shown.fx)
    session.recorder.record_still_to(tmp_path / "still")
    session.jobs.newest("export").wait(60)
    assert np.asarray(Image.open(tmp_path / "still.png")).shape == (64, 96, 3)
    assert not any("command line" in line.text for line in session.log.lines)
    session.view.follow_path = True
    assert session.recorder.still_scene().path is session.scene.path


@pytest.mark.parametrize(
    ("settings", "target", "named"),
    [
        ({"codec": "png"}, "file/clip", "file/clip"),
        ({"codec": "h264"}, "file/clip", "file/clip.mp4"),
        ({"size_px": (95, 64)}, "odd.mp4", "95x64"),
        ({"cameras": ("two",)}, "clip.mp4", "two"),
    ],
)
def test_a_recording_that_is_impossible_names_the_reason(session, tmp_path, settings, target, named):
    (tmp_path / "file").write_text("in the way")
    session.recorder.change(**{"size_px": (96, 64), "last_s": 0.03} | settings)
    session.recorder.record_to(tmp_path / target)
    for job in session.jobs.running:
        with pytest.raises(JobError, match=named):
            job.wait(60)
    assert named in session.problem


def test_settings_out_of_bounds_are_refused(session):
    session.recorder.change(motion_blur=1000)
    assert "$.motion_blur" in session.problem
    assert session.recorder.settings.motion_blur == 1


def test_extent_says_how_much_it_is(session):
    session.recorder.change(fps=10.0, size_px=(100, 100))
    extent = session.recorder.extent()
    assert (extent.frames, extent.cameras, extent.length_s, extent.rough_s) == (50, 1, 5.0, None)  # the ego's drive
    assert session.recorder.end_s == 5.0
    session.statistics = {"frame ms": 20.0, "megapixels": 0.04}
    assert session.recorder.extent().rough_s == pytest.approx(50 * 0.02 / 4)
    session.recorder.change(supersampling=2, motion_blur=3, twin=True)
    assert session.recorder.extent().rough_s == pytest.approx(50 * 0.02 / 4 * 4 * 3 * 2)
    session.recorder.change(cameras=("two",))
    assert "two" in session.recorder.extent()
