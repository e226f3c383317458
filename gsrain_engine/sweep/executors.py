"""Where the jobs of a sweep are done: the same outcomes come from every engine, in another order."""

import multiprocessing
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable
from uuid import uuid4

from ..safe_io.limits import receive_message
from .expansion import Job
from .worker import JobResult, worker_cache

if TYPE_CHECKING:
    from distributed import Client

Work = Callable[[Job], JobResult]
"""Does a job and never raises; it survives pickling. `work.do` is the one that sweeps use."""

MAX_RETRIES = 2
"""Of a job whose worker died."""


@runtime_checkable
class Executor(Protocol):
    """Something with workers."""

    @property
    def workers(self) -> int:
        """How many jobs are done at a time."""
        ...

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        """Do jobs; yields what came of each, once, as it comes. Closing the iterator stops all that is under way."""
        ...


class SerialExecutor:
    """Does one job after the other in this process: for debuggers, and to compare with."""

    workers = 1

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        """Do jobs in their order."""
        with closing(worker_cache()):
            for job in jobs:
                yield work(job)


# § Workers on this machine: processes that get jobs one by one. One that dies is replaced, and its job done again.


class LocalPool:
    """A pool of processes. It holds none between sweeps."""

    def __init__(self, workers: int | None = None, retries: int = MAX_RETRIES) -> None:
        """Use so many workers; none takes half of the cores, at least one. Raises ValueError below one."""
        if workers is not None and workers < 1:
            raise ValueError(f"a pool has at least one worker, got {workers}")
        self.workers = workers or max(1, _cores() // 2)
        self._retries = retries

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        """Do jobs; each worker stays with a scene for as long as there are jobs of it."""
        threads = max(1, _cores() // self.workers)
        with closing(_PoolWorkers(work, jobs, threads, self._retries)) as crew:
            for _ in range(min(self.workers, len(jobs))):
                crew.employ()
            while crew.is_busy:
                yield from crew.finished()


# § A process of the local pool, which does one job after the other.


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

    def outcome(self) -> JobResult | None:
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


class _PoolWorkers:
    """The workers of one sweep, and the jobs that wait for them."""

    def __init__(self, work: Work, jobs: Sequence[Job], threads: int, retries: int) -> None:
        self._work, self._threads, self._retries = work, threads, retries
        self._waiting = list(jobs)
        self._deaths = Counter[str]()
        self._busy: dict[object, PoolWorker] = {}

    @property
    def is_busy(self) -> bool:
        """Whether any job is under way."""
        return bool(self._busy)

    def employ(self, worker: PoolWorker | None = None) -> None:
        """Give a worker, or a new one, its next job; without a job there is no worker."""
        if not self._waiting:
            if worker is not None:
                worker.close()
            return
        worker = worker or PoolWorker(self._work, self._threads)
        taken = {each.scene for each in self._busy.values()}
        self._busy[worker.messages] = worker
        worker.begin(next_job(self._waiting, worker.scene, taken))

    def finished(self) -> Iterator[JobResult]:
        """Wait until something comes in; yields it once its worker has its next job."""
        ready: list[Connection] = wait([each.messages for each in self._busy.values()])  # pyright: ignore
        for messages in ready:
            worker = self._busy.pop(messages)
            outcome = worker.outcome()
            if outcome is None:
                worker.close()
                outcome = self._buried(worker)
                self.employ()
            else:
                self.employ(worker)
            if outcome is not None:
                yield outcome

    def close(self) -> None:
        for worker in self._busy.values():
            worker.close()

    def _buried(self, worker: PoolWorker) -> JobResult | None:
        """Put the job of a worker that died back in front; its outcome where that has happened too often."""
        job = worker.job
        self._deaths[job.id] += 1
        if self._deaths[job.id] <= self._retries:
            self._waiting.insert(0, job)
            return None
        return JobResult(id=job.id, error=_death(self._deaths[job.id], worker.exit_code))


def next_job(waiting: list[Job], own: str | None, taken: set[str | None]) -> Job:
    """Take out the first job of a worker's own scene, else of a scene that nobody works on, else the first."""
    mine = (place for place, job in enumerate(waiting) if job.scene == own)
    free = (place for place, job in enumerate(waiting) if job.scene not in taken)
    return waiting.pop(next(mine, next(free, 0)))


def _death(times: int, exit_code: int | None) -> str:
    how = "was killed" if exit_code == -getattr(signal, "SIGKILL", 9) else f"died (exit code {exit_code})"
    return f"each of {times} workers that had this job {how}; was there too little memory?"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_MAX_OUTCOME_BYTES = 1 << 28

_THREADS = "NUMBA_NUM_THREADS"


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


# § Workers of a Dask cluster: on this machine, in a lab, or behind a batch system.

_ANSWERS_WITHIN_S = 20


class DaskCluster:
    """The workers behind a scheduler. Each needs this program in this version, and sees scenes under the same names."""

    def __init__(self, address: str, resources: Mapping[str, float] | None = None) -> None:
        """Connect to a scheduler, such as tcp://host:8786; `resources` is what a job takes, such as {"GPU": 1}.

        Raises ValueError where none answers, or Dask is missing.
        """
        self._client = _client(address)
        self._resources = dict(resources or {})
        self.address = address

    @property
    def workers(self) -> int:
        return len(cast(dict[str, int], self._client.nthreads()))

    def close(self) -> None:
        self._client.close()

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[JobResult]:
        """Do jobs, those of a scene before those of the next. The scheduler gives a dead worker's jobs to others.

        Raises ConnectionError when the scheduler is gone.
        """
        from distributed import CancelledError, KilledWorker, as_completed

        futures = self._submitted(work, jobs)
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

    def _submitted(self, work: Work, jobs: Sequence[Job]) -> dict[Any, str]:
        """Hand all jobs over; returns the id of each future's job."""
        sweep = uuid4().hex[:8]  # the scheduler remembers results by key, those of other sweeps too
        return {
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


def _client(address: str) -> "Client":
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise ValueError("a Dask cluster takes the package distributed: pip install 'gsrain[drive]'") from None
    try:
        return Client(address, timeout=_ANSWERS_WITHIN_S, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise ValueError(f"no Dask scheduler answers at {address}: {' '.join(str(error).split())}") from None
