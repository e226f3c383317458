"""Jobs run real processes; `wait` polls them as a window does, and yields the processor between polls."""

import os
import signal
import time
from multiprocessing.shared_memory import SharedMemory

import numpy as np
import psutil
import pytest

from gsrain_engine.editor.jobs import process
from gsrain_engine.editor.jobs.process import SharedImage, WorkerProcess
from gsrain_engine.scene.progress import Progress


def counting(path, steps):
    for k in range(steps):
        yield Progress(k / steps, f"step {k}")
    path.write_text("result")


def failing(kind):
    yield Progress(0.5, "about to fail")
    raise kind("the third wheel is missing")


def dying():
    yield Progress(0.25, "about to die")
    os.kill(os.getpid(), signal.SIGKILL)


def endless():
    while True:
        yield Progress(0.5, "still at it")


def hungry():
    yield Progress(0.1, "about to ask for more than there is")
    np.ones(1 << 62, np.uint8)


def deaf():
    """Work without a yield, in compiled code that never looks at signals."""
    yield Progress(0.5, "multiplying")
    matrix = np.ones((20_000, 2_000), np.float32)
    while True:
        matrix @ matrix.T


def showing():
    for k in range(3):
        yield Progress(k / 3, "painting", np.full((40, 30, 3), 10 * (k + 1), np.uint8))
    yield Progress(0.9, "thinking")


def painting_large():
    yield Progress(0.5, "painting", np.full((3000, 4000, 3), 7, np.uint8))


def telling_its_niceness(path):
    yield Progress(0.5, "looking")
    path.write_text(str(psutil.Process().nice()))


def finish(job):
    while job.state == "running":
        job.wait(30)
        job.poll()


def test_a_job_reports_and_leaves_its_result(tmp_path):
    job = WorkerProcess(counting, tmp_path / "result", 3)
    finish(job)
    assert job.state == "finished"
    assert job.progress.fraction == 1
    assert (tmp_path / "result").read_text() == "result"
    job.close()


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (ValueError, "the third wheel is missing"),  # foreseen, and said in a sentence
        (RuntimeError, "RuntimeError: the third wheel is missing"),
    ],
)
def test_a_failing_job_has_one_line_and_a_traceback(kind, told):
    job = WorkerProcess(failing, kind)
    finish(job)
    assert (job.state, job.error) == ("failed", told)
    assert "in failing" in job.details
    job.close()


def test_what_can_t_be_started_leaves_no_shared_memory(monkeypatch):
    made = []

    class Recorded(SharedImage):
        def __init__(self):
            super().__init__()
            made.append(self.name)

    monkeypatch.setattr(process, "SharedImage", Recorded)
    with pytest.raises(AttributeError, match="pickle"):
        WorkerProcess(counting, lambda: None)
    with pytest.raises(FileNotFoundError):
        SharedMemory(made[0])


def test_a_dead_worker_is_a_failed_job():
    job = WorkerProcess(dying)
    finish(job)
    assert job.state == "failed"
    assert "the worker was killed" in job.error
    assert "memory" in job.error
    job.close()


def test_missing_memory_is_told_in_a_sentence():
    job = WorkerProcess(hungry)
    finish(job)
    assert job.state == "failed"
    assert job.error.startswith("the machine ran out of memory: close other programs")
    assert "in hungry" in job.details
    job.close()


def test_the_newest_picture_arrives_and_stays():
    job = WorkerProcess(showing)
    finish(job)
    assert job.progress.preview.shape == (40, 30, 3)
    assert (job.progress.preview == 30).all()
    job.close()


def test_a_large_picture_arrives_smaller():
    job = WorkerProcess(painting_large)
    finish(job)
    height, width = job.progress.preview.shape[:2]
    assert width * height <= 1024 * 768
    assert abs(width / height - 4 / 3) < 0.01
    assert (job.progress.preview == 7).all()
    job.close()


def test_two_slots_never_show_half_a_picture():
    ours = SharedImage()
    theirs = SharedImage(ours.name)
    assert ours.take() is None
    for value in (1, 2, 3):
        theirs.write(np.full((8, 6, 3), value, np.uint8))
    assert (ours.take() == 3).all()
    assert ours.take() is None  # it was taken already
    theirs.write(np.full((4, 4, 3), 9, np.uint8))
    theirs._numbers()[1 + 3 * (4 % 2)] = 0  # as while it is being written
    assert ours.take() is None
    theirs.close()
    ours.close()
    ours.close()


@pytest.mark.skipif(not psutil.POSIX, reason="niceness is POSIX's")
def test_workers_come_after_the_window(tmp_path):
    job = WorkerProcess(telling_its_niceness, tmp_path / "nice")
    finish(job)
    assert int((tmp_path / "nice").read_text()) > psutil.Process().nice()
    job.close()


def test_cancel_ends_the_process_within_a_second_wherever_it_is():
    job = WorkerProcess(deaf)
    while job.progress.message != "multiplying":
        job.wait(30)
        job.poll()
    started = time.perf_counter()
    job.cancel()
    assert not job._process.join(timeout=1.0)
    assert job._process.exitcode is not None
    assert time.perf_counter() - started < 1
    job.close()


def test_cancel_stops_a_job_that_would_go_on_for_ever():
    job = WorkerProcess(endless)
    job.wait(30)
    job.poll()
    job.cancel()
    assert job.state == "cancelled"
    job.poll()
    assert job.state == "cancelled"
    job.close()


@pytest.mark.parametrize("times", [1, 2])
def test_cancel_may_come_at_once_and_twice(times):
    job = WorkerProcess(endless)
    for _ in range(times):
        job.cancel()
    assert job.state == "cancelled"
    job.close()
