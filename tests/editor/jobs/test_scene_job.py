"""Jobs whose result is a scene: real workers, and the session that polls them as a window does."""

import os
import signal
from concurrent.futures import wait
from dataclasses import replace
from multiprocessing.connection import wait as wait_for
from multiprocessing.shared_memory import SharedMemory

import numpy as np
import psutil
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import SceneJob, WorkerCall
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.formats.scene_folder import write_scene_folder
from gsrain_engine.scene.progress import Progress
from small_scene import small_scene


def growing(folder, steps):
    """Write a scene of more and more layers; each is a snapshot of the work, the last is the result."""
    scene = small_scene("grown")
    for k in range(1, steps + 1):
        write_scene_folder(replace(scene, layers=scene.layers[:k]), folder / f"{k}")
        yield Progress(k / (steps + 1), f"{k} layers")
        while not (folder / f"seen {k}").exists() and k < steps:
            pass  # the test lets it go on


def dying(folder, steps):
    yield Progress(0.5, "about to die")
    os.kill(os.getpid(), signal.SIGKILL)


def failing(folder, steps):
    yield Progress(0.5, "about to fail")
    raise ValueError(f"{folder.name} has no {steps}rd wheel")


class Growing:
    title, preparing, report = "Grow", "Getting ready", None

    def __init__(self, work=growing, is_whole=True):
        self.work, self.is_whole, self.folder, self.newest = work, is_whole, None, 0

    def prepare(self, folder):
        self.folder = folder
        return WorkerCall(self.work, (folder, 3))

    def snapshot(self, folder):
        newest = max((int(each.name) for each in folder.iterdir() if each.name.isdigit()), default=0)
        if newest == self.newest or not (folder / f"{newest}" / "scene.json").exists():
            return None
        self.newest = newest
        return read_scene(folder / f"{newest}")

    def load(self, folder):
        return read_scene(folder / "3")

    def staged(self, scene):
        return PendingScene("Grow", scene, is_whole=self.is_whole)


@pytest.fixture
def session():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def follow(session, job, until=lambda: False):
    """Poll until the job has ended, or something is so, and take in what it stages; wait where there is nothing new."""
    while job.state == "running" and not until():
        pending = [each for each in (job._preparing, job._snapshot, job._loading) if each is not None]
        if pending:
            wait(pending, timeout=60)
        elif job._worker is not None:
            wait_for([job._worker.waitable], timeout=60)
        session.update(0.0)
        session.swap_in()


def test_snapshots_and_result_are_one_step_that_is_undone_at_once(session):
    before = session.scene
    task = Growing()
    job = SceneJob(task, session._files)
    session.start(job)
    for layers in (1, 2):
        follow(session, job, until=lambda n=layers: len(session.scene.layers) == n and session.scene is not before)
        assert len(session.scene.layers) == layers
        assert session.history.labels == ["Open", "Grow"]
        (task.folder / f"seen {layers}").touch()
    follow(session, job)
    assert job.state == "finished"
    assert len(session.scene.layers) == 3
    assert session.history.labels == ["Open", "Grow"]
    session.undo()
    assert session.scene is before
    session.redo()
    assert len(session.scene.layers) == 3


def test_who_goes_on_with_something_else_gets_the_result_as_a_step_of_its_own(session):
    task = Growing()
    job = SceneJob(task, session._files)
    session.start(job)
    follow(session, job, until=lambda: "Grow" in session.history.labels)
    session.undo()
    session.change_rain("Intensity", intensity_mm_h=5.0)
    (task.folder / "seen 1").touch()
    follow(session, job, until=lambda: task.newest >= 2)
    (task.folder / "seen 2").touch()
    follow(session, job)
    assert session.history.labels == ["Open", "Intensity", "Grow"]
    assert len(session.scene.layers) == 3
    assert session.rain.intensity_mm_h == 5


def test_a_killed_worker_is_a_failed_job_and_leaves_the_scene_and_no_file(session):
    before, task = session.scene, Growing(dying)
    job = SceneJob(task, session._files)
    session.start(job)
    follow(session, job)
    assert job.state == "failed"
    assert "the worker was killed" in job.error
    assert session.scene is before
    wait([session._files.submit(lambda: None)])
    assert not task.folder.exists()


def test_cancelling_leaves_the_scene_and_no_file(session):
    before, task = session.scene, Growing()
    job = SceneJob(task, session._files)
    session.start(job)
    follow(session, job, until=lambda: session.scene is not before)
    shown = session.scene
    job.cancel()
    follow(session, job)
    assert job.state == "cancelled"
    assert session.scene is shown  # the last snapshot stays, and can be undone
    wait([session._files.submit(lambda: None)])
    assert not task.folder.exists()


def test_a_failed_worker_says_why_and_leaves_no_file(session):
    task = Growing(failing)
    job = SceneJob(task, session._files)
    session.start(job)
    follow(session, job)
    assert (job.state, job.error) == ("failed", f"{task.folder.name} has no 3rd wheel")
    assert session.problem == f"Grow failed: {job.error}"
    wait([session._files.submit(lambda: None)])
    assert not task.folder.exists()


def test_closing_the_session_ends_the_worker_and_leaves_nothing_behind():
    session, task = Editor(small_scene()), Growing()
    job = SceneJob(task, session._files)
    session.start(job)
    follow(session, job, until=lambda: "Grow" in session.history.labels)
    process, picture = psutil.Process(job._worker._process.pid), job._worker._image.name
    session.close()
    assert job.state == "cancelled"
    assert not process.is_running()
    assert not task.folder.exists()
    with pytest.raises(FileNotFoundError):
        SharedMemory(picture)


def test_closing_the_session_before_the_worker_starts_leaves_no_file():
    session, task = Editor(small_scene()), Growing()
    job = SceneJob(task, session._files)
    session.start(job)
    session.close()
    assert (job.state, job._worker) == ("cancelled", None)
    assert task.folder is None or not task.folder.exists()


def test_a_disk_that_fails_is_a_failed_job(session, monkeypatch):
    task = Growing()

    def full(folder):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(task, "prepare", full)
    job = SceneJob(task, session._files)
    session.start(job)
    wait([session._files.submit(lambda: None)])
    follow(session, job)
    assert (job.state, job.error) == ("failed", "No space left on device")
    assert np.array_equal(session.scene.layers[0].gaussians.means, small_scene().layers[0].gaussians.means)
