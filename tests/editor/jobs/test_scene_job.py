"""Jobs whose result is a scene: real workers, and the session that polls them as a window does."""

import os
import signal
from concurrent.futures import wait
from dataclasses import replace
from multiprocessing.shared_memory import SharedMemory

import numpy as np
import psutil
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import scene_job
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
    """Snapshots and result of a job, and the folder in which it works."""

    def __init__(self, work=growing):
        self.work, self.folder, self.newest = work, None, 0

    def start(self, session):
        job = scene_job(
            session, "reconstruct", "Grow", self.work, self.inputs, lambda folder: read_scene(folder / "3"),
            is_whole=True, snapshot=self.snapshot,
        )  # fmt: skip
        session.start(job)
        return job

    def inputs(self, folder):
        self.folder = folder
        return folder, 3

    def snapshot(self, folder):
        newest = max((int(each.name) for each in folder.iterdir() if each.name.isdigit()), default=0)
        if newest == self.newest or not (folder / f"{newest}" / "scene.json").exists():
            return None
        self.newest = newest
        return read_scene(folder / f"{newest}")


@pytest.fixture
def session():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def follow(session, job, until=lambda: False):
    """Poll until the job has ended, or something is so, and take in what it stages; wait where there is nothing new."""
    while job.state == "running" and not until():
        job.wait(60)
        session.update(0.0)
        session.swap_in()


def test_snapshots_and_result_are_one_step_that_is_undone_at_once(session):
    before = session.scene
    task = Growing()
    job = task.start(session)
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
    job = task.start(session)
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
    job = task.start(session)
    follow(session, job)
    assert job.state == "failed"
    assert "the worker was killed" in job.error
    assert session.scene is before
    wait([session._files.submit(lambda: None)])
    assert not task.folder.exists()


def test_cancelling_leaves_the_scene_and_no_file(session):
    before, task = session.scene, Growing()
    job = task.start(session)
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
    job = task.start(session)
    follow(session, job)
    assert (job.state, job.error) == ("failed", f"{task.folder.name} has no 3rd wheel")
    assert session.problem == f"Grow failed: {job.error}"
    wait([session._files.submit(lambda: None)])
    assert not task.folder.exists()


def test_closing_the_session_ends_the_worker_and_leaves_nothing_behind():
    session, task = Editor(small_scene()), Growing()
    job = task.start(session)
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
    job = task.start(session)
    session.close()
    assert (job.state, job._worker) == ("cancelled", None)
    assert task.folder is None or not task.folder.exists()


def test_a_disk_that_fails_is_a_failed_job(session, monkeypatch):
    task = Growing()

    def full(folder):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(task, "inputs", full)
    job = task.start(session)
    wait([session._files.submit(lambda: None)])
    follow(session, job)
    assert (job.state, job.error) == ("failed", "No space left on device")
    assert np.array_equal(session.scene.layers[0].gaussians.means, small_scene().layers[0].gaussians.means)
