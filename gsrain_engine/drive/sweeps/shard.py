"""A share of a sweep, for machines that know nothing of each other, such as the tasks of a SLURM array."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from .job import Job

_FORM = re.compile(r"(\d+)/(\d+)")


class Shard(NamedTuple):
    """The i-th of n shares, counted from 1."""

    place: int
    shares: int

    @staticmethod
    def parse(text: str) -> "Shard":
        """Read "i/n"; raises ValueError where it is none, or i is not within 1..n."""
        match = _FORM.fullmatch(text.strip())
        if match is None:
            raise ValueError(
                f"shard {text}: expected i/n, such as 1/10 or $SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"
            )
        place, shares = int(match[1]), int(match[2])
        if not 1 <= place <= shares:
            raise ValueError(f"shard {text}: shares are counted from 1 to n, as by sbatch --array=1-{max(shares, 1)}")
        return Shard(place, shares)

    def of(self, jobs: Sequence[Job]) -> list[Job]:
        """Return this share of the jobs, in their order: every n-th by id, so that each share is a fair mixture."""
        ids = sorted(job.id for job in jobs)
        own = set(ids[self.place - 1 :: self.shares])
        return [job for job in jobs if job.id in own]

    def __str__(self) -> str:
        return f"{self.place}/{self.shares}"
