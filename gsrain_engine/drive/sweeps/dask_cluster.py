"""Workers of a Dask cluster: on this machine, in a lab, or behind a batch system."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast
from uuid import uuid4

from .engine import MOST_RETRIES, Work
from .job import Job
from .outcome import Outcome

if TYPE_CHECKING:
    from distributed import Client

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

    def outcomes(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
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
                    yield Outcome(id=futures[future], error="the workers that had this job died one after the other")
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
                retries=MOST_RETRIES,
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
