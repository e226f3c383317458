"""Workers that are stopped, think for minutes, have too little memory, or crash: the job panel says what it is."""

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


def finished(job):
    while job.state == "running":
        job.wait(30)
        job.poll()
    return job


def heard(job, message, warning=None):
    """Poll until a job has a message and a warning."""
    until = time.monotonic() + 30
    while (job.progress.message, job.progress.warning) != (message, warning):
        assert time.monotonic() < until, job.progress
        job.wait(0.05)
        job.poll()


def test_a_stopped_worker_is_told_of_goes_on_and_ends_at_once_when_it_is_cancelled():
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
    assert time.monotonic() - began < 4  # SIGTERM by itself waits for who lets it go on
    assert not psutil.pid_exists(pid)


def test_silence_is_told_by_the_minute():
    now = [0.0]
    silence = WorkerWatchdog(os.getpid(), lambda: now[0])
    told = []
    for now[0] in (30.0, 59.0, 61.0, 119.0, 125.0):
        told.append(silence.warning)
    assert told == [None, None, "no news for 1 min", "no news for 1 min", "no news for 2 min"]
    silence.heard()
    assert silence.warning is None


def test_a_process_that_is_gone_is_not_stopped():
    now = [0.0]
    silence = WorkerWatchdog(2**22 + 1, lambda: now[0])
    now[0] = 10.0
    assert silence.warning is None


def test_too_little_memory_is_a_sentence():
    job = finished(WorkerProcess(with_little_memory))
    assert job.state == "failed"
    assert job.error.startswith("the machine ran out of memory: close other programs")
    job.close()


def test_a_crash_is_told_by_its_name():
    job = finished(WorkerProcess(crashing))
    assert (job.state, job.error) == ("failed", "the worker died of SIGSEGV")
    job.close()
