"""Where the jobs of a sweep are done: the same outcomes come from every engine, in another order."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Protocol, runtime_checkable

from .job import Job
from .outcome import Outcome
from .workbench import workbench

Work = Callable[[Job], Outcome]
"""Does a job and never raises; it survives pickling. `work.do` is the one that sweeps use."""

MOST_RETRIES = 2
"""Of a job whose worker died."""


@runtime_checkable
class Engine(Protocol):
    """Something with workers."""

    @property
    def workers(self) -> int:
        """How many jobs are done at a time."""
        ...

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Do jobs; yields what came of each, once, as it comes. Closing the iterator stops all that is under way."""
        ...


class HereEngine:
    """Does one job after the other in this process: for debuggers, and to compare with."""

    workers = 1

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Do jobs in their order."""
        with closing(workbench()):
            for job in jobs:
                yield work(job)
