"""Jobs run real processes; `wait` polls them as a window does, and yields the processor between polls."""

import os
import signal
from multiprocessing.connection import wait as wait_for

import pytest

from gsrain_engine.scene.progress import Progress
from gsrain_engine.session.jobs.worker import Job


def counting(path, steps):
    for k in range(steps):
        yield Progress(k / steps, f"step {k}")
    path.write_text("result")


def failing():
    yield Progress(0.5, "about to fail")
    raise ValueError("the third wheel is missing")


def dying():
    yield Progress(0.25, "about to die")
    os.kill(os.getpid(), signal.SIGKILL)


def endless():
    while True:
        yield Progress(0.5, "still at it")


def finish(job):
    while job.state == "running":
        wait_for([job.waitable], timeout=30)
        job.poll()


def test_a_job_reports_and_leaves_its_result(tmp_path):
    job = Job("Count", counting, tmp_path / "result", 3)
    finish(job)
    assert job.state == "finished"
    assert job.progress.fraction == 1
    assert (tmp_path / "result").read_text() == "result"
    job.close()


def test_a_failing_job_has_one_line_and_a_traceback():
    job = Job("Fail", failing)
    finish(job)
    assert (job.state, job.error) == ("failed", "ValueError: the third wheel is missing")
    assert "in failing" in job.details
    job.close()


def test_a_dead_worker_is_a_failed_job():
    job = Job("Die", dying)
    finish(job)
    assert job.state == "failed"
    assert "the worker died" in job.error
    job.close()


def test_cancel_stops_a_job_that_would_go_on_for_ever():
    job = Job("Endless", endless)
    wait_for([job.waitable], timeout=30)
    job.poll()
    job.cancel()
    assert job.state == "cancelled"
    job.poll()
    assert job.state == "cancelled"


@pytest.mark.parametrize("times", [1, 2])
def test_cancel_may_come_at_once_and_twice(times):
    job = Job("Endless", endless)
    for _ in range(times):
        job.cancel()
    assert job.state == "cancelled"
