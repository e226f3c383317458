"""A process of the local pool, which does one job after the other."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait

from gsrain_engine.untrusted.limits import receive_message

from .engine import Work
from .job import Job
from .outcome import Outcome

_MAX_OUTCOME_BYTES = 1 << 28
_THREADS = "NUMBA_NUM_THREADS"


class PoolWorker:
    """A process, and the job that it has."""

    def __init__(self, work: Work, threads: int) -> None:
        """Start it; compiled kernels use so many threads in it. It is given jobs before it is up."""
        context = multiprocessing.get_context("spawn")
        self.messages, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        try:
            with _without_interrupts(), _threads(threads):
                self._process.start()
        except BaseException:
            self.messages.close()
            raise
        finally:
            theirs.close()
        self._job: Job | None = None

    @property
    def job(self) -> Job:
        """What it was given last."""
        assert self._job is not None
        return self._job

    @property
    def scene(self) -> str | None:
        return None if self._job is None else self._job.scene

    @property
    def exit_code(self) -> int | None:
        return self._process.exitcode

    def begin(self, job: Job) -> None:
        """Give it a job. That it died meanwhile shows when the outcome is asked for."""
        self._job = job
        with suppress(OSError):
            self.messages.send(job)

    def outcome(self) -> Outcome | None:
        """Return what came of its job; None when it died over it."""
        try:
            return receive_message(self.messages, _MAX_OUTCOME_BYTES)
        except (EOFError, OSError) as error:
            if not isinstance(error, EOFError | ConnectionError):
                self._process.kill()  # it has more to say than an outcome has, and would wait to be heard
            self._process.join()
            return None

    def close(self) -> None:
        self.messages.close()
        self._process.kill()
        self._process.join()


def _serve(messages: Connection, work: Work) -> None:
    """Do jobs in the new process, for as long as there is somebody who gives some."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            messages.send(work(messages.recv()))


def _end_with_parent() -> None:
    """Leave at once when the sweep is gone, killed perhaps: nobody would take what comes out."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _without_interrupts() -> Generator[None]:
    """Start processes that pass Ctrl-C by: it means this one, which ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _threads(count: int) -> Generator[None]:
    """Start processes in which compiled kernels use so many threads, where nothing else was set."""
    if _THREADS in os.environ:
        yield
        return
    os.environ[_THREADS] = str(count)
    try:
        yield
    finally:
        del os.environ[_THREADS]
