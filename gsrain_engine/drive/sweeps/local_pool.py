"""Workers on this machine: processes that get jobs one by one. One that dies is replaced, and its job done again."""

import os
import signal
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from multiprocessing.connection import Connection, wait

from .engine import MOST_RETRIES, Work
from .job import Job
from .outcome import Outcome
from .pool_worker import PoolWorker


class LocalPool:
    """A pool of processes. It holds none between sweeps."""

    def __init__(self, workers: int | None = None, retries: int = MOST_RETRIES) -> None:
        """Use so many workers; none takes half of the cores, at least one. Raises ValueError below one."""
        if workers is not None and workers < 1:
            raise ValueError(f"a pool has at least one worker, got {workers}")
        self.workers = workers or max(1, _cores() // 2)
        self._retries = retries

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Do jobs; each worker stays with a scene for as long as there are jobs of it."""
        threads = max(1, _cores() // self.workers)
        with closing(_Crew(work, jobs, threads, self._retries)) as crew:
            for _ in range(min(self.workers, len(jobs))):
                crew.employ()
            while crew.is_busy:
                yield from crew.finished()


class _Crew:
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

    def finished(self) -> Iterator[Outcome]:
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

    def _buried(self, worker: PoolWorker) -> Outcome | None:
        """Put the job of a worker that died back in front; its outcome where that has happened too often."""
        job = worker.job
        self._deaths[job.id] += 1
        if self._deaths[job.id] <= self._retries:
            self._waiting.insert(0, job)
            return None
        return Outcome(id=job.id, error=_death(self._deaths[job.id], worker.exit_code))


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
