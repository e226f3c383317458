"""Workers that are stopped, silent, out of memory, or crash: the job panel has the reason."""

import os
import signal
import threading
import time

import numpy as np
import psutil
import pytest

from gsrain_engine.editor.jobs.process import WorkerProcess, WorkerWatchdog
from gsrain_engine.scene.progress import Progress

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals and limits as POSIX has them")


def endless():
    yield Progress(0.5, "at it")
    while True:
        threading.Event().wait(0.01)
        yield Progress(0.5, "still at it")


def with_little_memory():
    import resource

    used = psutil.Process().memory_info().vms
    resource.setrlimit(resource.RLIMIT_AS, (used + (64 << 20), resource.RLIM_INFINITY))
    yield Progress(0.1, "about to ask for more")
    np.ones(1 << 28, np.uint8)


def crashing():
    yield Progress(0.1, "about to crash")
    os.kill(os.getpid(), signal.SIGSEGV)


def heard(job, message, warning=None):
    """Poll until a job has a message and a warning."""
    until = time.monotonic() + 30
    while (job.progress.message, job.progress.warning) != (message, warning):
        assert time.monotonic() < until, job.progress
        job.wait(0.05)
        job.poll()


def test_stopped_workers_are_reported_and_can_be_canceled():
    job = WorkerProcess(endless)
    heard(job, "still at it")
    pid = job.pid
    os.kill(pid, signal.SIGSTOP)
    heard(job, "still at it", f"process {pid} is stopped: kill -CONT {pid} lets it go on")
    os.kill(pid, signal.SIGCONT)
    heard(job, "still at it")
    os.kill(pid, signal.SIGSTOP)
    job.cancel()
    began = time.monotonic()
    job.close()
    assert time.monotonic() - began < 4  # SIGTERM alone waits until the process is resumed
    assert not psutil.pid_exists(pid)


def test_silence_is_reported_by_the_minute():
    now = [0.0]
    watchdog, gone = (WorkerWatchdog(pid, lambda: now[0]) for pid in (os.getpid(), 2**22 + 1))
    warnings = []
    for now[0] in (30.0, 59.0, 61.0, 119.0, 125.0):
        warnings.append(watchdog.warning)
        assert now[0] > 60 or gone.warning is None  # a process that has ended is not stopped
    assert warnings == [None, None, "no news for 1 min", "no news for 1 min", "no news for 2 min"]
    watchdog.heard()
    assert watchdog.warning is None


@pytest.mark.parametrize(
    ("work", "error"),
    [
        (with_little_memory, "the machine ran out of memory: close other programs"),
        (crashing, "the worker died of SIGSEGV"),
    ],
)
def test_failures_are_explained(work, error):
    job = WorkerProcess(work)
    while job.state == "running":
        job.wait(30)
        job.poll()
    assert job.state == "failed" and job.error.startswith(error)
    job.close()
