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
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


@pytest.fixture
def session():
    session = Editor(small_scene(), RainSettings(intensity_mm_h=8.5))
    yield session
    session.close()


def follow(session, until=lambda job: False):
    """Look after the last job as the window does, until it ends or something is true of it; return it."""
    job = session.jobs.all[-1]
    while job.state == "running" and not until(job):
        session.jobs.wait(60)
        session.update(0.01)
    return job


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
    job = follow(session)
    assert (job.state, job.error) == ("finished", None)
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
        assert follow(again).state == "finished"
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
    job = follow(session, until=lambda job: job.progress.preview is not None and "left" in job.progress.message)
    assert job.progress.preview.shape == (64, 96, 3)
    write_scene(small_scene(), tmp_path / "other.ply")
    open_now(session, tmp_path / "other.ply")
    assert session.recorder.is_recording  # it has a copy of what it began with
    job.cancel()
    assert (job.state, session.recorder.is_recording) == ("cancelled", False)
    session._files.submit(lambda: None).result()  # behind the cleaning up
    with av.open(str(tmp_path / "long.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) >= 2


def test_what_is_there_is_only_replaced_when_a_person_says_so(session, tmp_path):
    target = tmp_path / "clip"
    target.mkdir()
    session.recorder.change(codec="png", size_px=(96, 64), last_s=0.03)
    session.recorder.record_to(target)
    assert session.jobs.all == []
    assert session.questions.present.text == "clip is there already."
    replace_it, leave_it = session.questions.present.answers
    session.questions.answer(leave_it)
    assert session.jobs.all == []
    session.recorder.record_to(target)
    session.questions.answer(replace_it)
    assert len(session.jobs.all) == 1
    shutil.rmtree(target)
    session.jobs.all[0].cancel()
    assert session.log.lines[-1].text == f"Stopped recording {target}: nothing of it was written yet"


def test_a_still_is_what_the_view_shows(session, tmp_path):
    session.recorder.change(size_px=(96, 64), supersampling=2)
    session.clock.time_s = 1.5
    session.navigation.position[:] = [10.0, 2.0, 3.0]
    path = session.recorder._standing().moved(session.scene.scene_to_world)
    shot = session.shot(96, 64)
    assert np.allclose(path.camera(1.5, 96, 64).world_to_camera, shot.camera.world_to_camera, atol=1e-9)
    assert path.camera(1.5, 96, 64).fx == pytest.approx(shot.camera.fx)
    session.recorder.record_still_to(tmp_path / "still")
    assert follow(session).state == "finished"
    assert np.asarray(Image.open(tmp_path / "still.png")).shape == (64, 96, 3)
    assert not any("command line" in line.text for line in session.log.lines)


def test_what_goes_wrong_is_one_sentence(session, tmp_path):
    (tmp_path / "file").write_text("in the way")
    session.recorder.change(codec="png", size_px=(96, 64), last_s=0.03)
    session.recorder.record_to(tmp_path / "file" / "clip")
    job = follow(session)
    assert job.state == "failed"
    assert session.problem == f"Record clip failed: {job.error}"
    assert "clip can't be written on after 0 frames: " in session.problem
    session.recorder.change(codec="h264")
    session.recorder.record_to(tmp_path / "file" / "clip")
    assert follow(session).error == f"{tmp_path / 'file' / 'clip.mp4'} can't be written: File exists"
    session.recorder.change(size_px=(95, 64))
    session.recorder.record_to(tmp_path / "odd.mp4")
    assert "even width and height, got 95x64" in session.problem
    session.recorder.change(motion_blur=1000)
    assert "<= 64 - at `$.motion_blur`" in session.problem
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
    assert "no camera 'two'" in session.recorder.extent()
