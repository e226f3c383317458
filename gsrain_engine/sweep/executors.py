"""Executors that run the jobs of a sweep: serial, local process pool, Dask cluster.

All executors produce the same results, in different orders.
"""

import multiprocessing
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, cast, runtime_checkable
from uuid import uuid4

from ..optional_packages import require_package
from ..safe_io.limits import receive_message
from ..threads import thread_limit, usable_cores
from .expansion import Job
from .worker import JobResult, worker_cache

Work = Callable[[Job], JobResult]
"""Runs a job and never raises; must be picklable. Sweeps use `worker.run_job`."""

MAX_RETRIES = 2
"""Maximum number of retries of a job whose worker died."""


@runtime_checkable
class Executor(Protocol):
    """Runs the jobs of a sweep on workers."""

    @property
    def workers(self) -> int:
        """Number of jobs that run at the same time."""
        ...

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        """Run jobs and yield each result as it arrives. Closing the iterator stops all running jobs."""
        ...


class SerialExecutor:
    """Runs jobs one by one in this process, for debugging and as a reference."""

    workers = 1

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        with closing(worker_cache()):
            for job in jobs:
                yield work(job)


# Local process pool: workers get jobs one by one; one that dies is replaced, and its job is retried


class LocalPool:
    """A pool of processes that live only as long as a sweep."""

    def __init__(self, workers: int | None = None, retries: int = MAX_RETRIES) -> None:
        """Use `workers` processes; None means half of the cores, at least one. Raises ValueError below one."""
        if workers is not None and workers < 1:
            raise ValueError(f"a pool has at least one worker, got {workers}")
        self.workers = workers or max(1, usable_cores() // 2)
        self._retries = retries

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        """Run jobs; a worker prefers jobs of the scene that it has open."""
        threads = max(1, usable_cores() // self.workers)
        with closing(_PoolWorkers(work, jobs, threads, self._retries)) as crew:
            for _ in range(min(self.workers, len(jobs))):
                crew.employ()
            while crew.busy:
                yield from crew.finished()


class PoolWorker:
    """A process and its current job."""

    def __init__(self, work: Work, threads: int) -> None:
        """Start the process with `threads` threads for compiled kernels. It accepts jobs before it is ready."""
        context = multiprocessing.get_context("spawn")
        self.messages, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        try:
            with _without_interrupts(), thread_limit(threads):
                self.process.start()
        except BaseException:
            self.messages.close()
            raise
        finally:
            theirs.close()
        self.job: Job | None = None  # the most recent one

    def begin(self, job: Job) -> None:
        """Send a job. If the process has died, `outcome` reports it."""
        self.job = job
        with suppress(OSError):
            self.messages.send(job)

    def outcome(self) -> JobResult | None:
        """Return the result of the job, or None if the process died."""
        try:
            return receive_message(self.messages, _MAX_OUTCOME_BYTES)
        except (EOFError, OSError) as error:
            if not isinstance(error, EOFError | ConnectionError):
                self.process.kill()  # the result exceeds the limit, and the process would block on sending
            self.process.join()
            return None

    def close(self) -> None:
        self.messages.close()
        self.process.kill()
        self.process.join()


class _PoolWorkers:
    """The workers of one sweep and the queue of jobs."""

    def __init__(self, work: Work, jobs: Sequence[Job], threads: int, retries: int) -> None:
        self._work, self._threads, self._retries = work, threads, retries
        self._waiting = list(jobs)
        self._deaths = Counter[str]()
        self.busy: dict[object, PoolWorker] = {}

    def employ(self, worker: PoolWorker | None = None) -> None:
        """Assign the next job to a worker or to a new one; closes the worker if no job is left."""
        if not self._waiting:
            if worker is not None:
                worker.close()
            return
        worker = worker or PoolWorker(self._work, self._threads)
        open_scenes = {each.job and each.job.scene for each in self.busy.values()}
        self.busy[worker.messages] = worker
        worker.begin(next_job(self._waiting, worker.job and worker.job.scene, open_scenes))

    def finished(self) -> Iterator[JobResult]:
        """Wait for results; yields each after its worker got the next job."""
        ready: list[Connection] = wait([each.messages for each in self.busy.values()])  # pyright: ignore
        for messages in ready:
            worker = self.busy.pop(messages)
            outcome = worker.outcome()
            if outcome is None:
                worker.close()
                outcome = self._bury(worker)
                self.employ()
            else:
                self.employ(worker)
            if outcome is not None:
                yield outcome

    def close(self) -> None:
        for worker in self.busy.values():
            worker.close()

    def _bury(self, worker: PoolWorker) -> JobResult | None:
        """Requeue the job of a dead worker first; return a failed result once the retries are used up."""
        job, exit_code = worker.job, worker.process.exitcode
        assert job is not None
        self._deaths[job.id] += 1
        times = self._deaths[job.id]
        if times <= self._retries:
            self._waiting.insert(0, job)
            return None
        how = "was killed" if exit_code == -getattr(signal, "SIGKILL", 9) else f"died (exit code {exit_code})"
        reason = f"each of {times} workers that had this job {how}; was there too little memory?"
        return JobResult(id=job.id, error=reason)


def next_job(waiting: list[Job], own: str | None, open_scenes: set[str | None]) -> Job:
    """Remove and return the first job of a worker's own scene, else of a scene no worker has, else the first."""
    mine = (place for place, job in enumerate(waiting) if job.scene == own)
    free = (place for place, job in enumerate(waiting) if job.scene not in open_scenes)
    return waiting.pop(next(mine, next(free, 0)))


_MAX_OUTCOME_BYTES = 1 << 28


def _serve(messages: Connection, work: Work) -> None:
    """Run jobs in the worker process until the pipe closes."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            messages.send(work(messages.recv()))


def _end_with_parent() -> None:
    """Exit when the parent process ends, also if it was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _without_interrupts() -> Generator[None]:
    """Start processes that ignore Ctrl-C; the parent handles it and ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# Dask cluster

ANSWERS_WITHIN_S = 20


class DaskCluster:
    """The workers of a Dask scheduler. Each needs the same program version and the same scene paths."""

    def __init__(self, address: str, resources: Mapping[str, float] | None = None) -> None:
        """Connect to a scheduler, such as tcp://host:8786; `resources` is what a job needs, such as {"GPU": 1}.

        Raises ValueError if no scheduler answers or Dask is missing.
        """
        require_package("distributed", "a Dask cluster")
        from distributed import Client

        try:
            self._client = Client(address, timeout=ANSWERS_WITHIN_S, set_as_default=False)
        except (OSError, TimeoutError) as error:
            raise ValueError(f"no Dask scheduler answers at {address}: {' '.join(str(error).split())}") from None
        self._resources = dict(resources or {})
        self.address = address

    @property
    def workers(self) -> int:
        return len(cast(dict[str, int], self._client.nthreads()))

    def close(self) -> None:
        self._client.close()

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        """Run jobs by scene; the scheduler reassigns those of dead workers. Raises ConnectionError if it is gone."""
        from distributed import CancelledError, KilledWorker, as_completed

        sweep = uuid4().hex[:8]  # the scheduler caches results by key, across sweeps
        futures: dict[Any, str] = {
            self._client.submit(
                work,
                job,
                key=f"gsrain-{sweep}-{job.id}",
                retries=MAX_RETRIES,
                priority=-place,
                resources=self._resources or None,
                pure=False,
            ): job.id
            for place, job in enumerate(jobs)
        }
        try:
            for future in as_completed(futures, loop=self._client.loop):
                try:
                    yield future.result()
                except KilledWorker:
                    yield JobResult(id=futures[future], error="the workers that had this job died one after the other")
                except CancelledError:
                    raise ConnectionError(f"the Dask scheduler at {self.address} is gone") from None
                future.release()
        finally:
            self._client.cancel(list(futures))
