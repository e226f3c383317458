"""The folder of a sweep: a row and a roll-out a job, each whole or not there; any number of sweeps may write to it."""

import errno
import os
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.limits import read_file

from ..rollouts.json_lines import write_rollout
from .job import Job
from .outcome import Outcome
from .row import FINISHED, Row, encoded, parquet, parquet_modules, row_of, rows_in
from .sweep import Sweep

_SUFFIX = ".parquet"


class SweepFolder:
    """Rows by the ids of their jobs. A row is written last: where it stands, everything else of its job does."""

    def __init__(self, path: Path) -> None:
        """Use a folder, which is made when something is written."""
        self.path = path
        self.rows = path / "rows"
        self.rollouts = path / "rollouts"
        self.clips = path / "clips"
        self.log = path / "log.jsonl"

    def describe(self, sweep: Sweep, jobs: Iterable[Job]) -> None:
        """Write down what is run: sweep.json, and jobs.jsonl with all that each id stands for.

        Raises ValueError where rows can't be written later: no job is to be done in vain.
        """
        parquet_modules()
        self.path.mkdir(parents=True, exist_ok=True)
        lines = sorted((job.id, msgspec.json.encode({"id": job.id, "job": job}, order="sorted")) for job in jobs)
        with whole_file(self.path / "sweep.json") as beside:
            beside.write_bytes(encoded(sweep))
        with whole_file(self.path / "jobs.jsonl") as beside:
            beside.write_bytes(b"".join(line + b"\n" for _, line in lines))

    def keep(self, job: Job, outcome: Outcome) -> Row:
        """Write what came of a job, and say so in the log; raises OSError, and then nothing half stands there."""
        row = row_of(job, outcome)
        if outcome.rollout is not None:
            self.rollouts.mkdir(parents=True, exist_ok=True)
            write_rollout(self.rollouts / f"{job.id}.jsonl", outcome.rollout)
        self.rows.mkdir(parents=True, exist_ok=True)
        with whole_file(self.rows / f"{job.id}{_SUFFIX}") as beside:
            beside.write_bytes(parquet([row], str(row["kind"])))
        self._note(job, outcome)
        return row

    def read(self, jobs: Iterable[Job]) -> dict[str, Row]:
        """Return the rows that stand there, by the ids of their jobs. A damaged one counts as missing."""
        found: dict[str, Row] = {}
        for job in jobs:
            row = self._row(job.id)
            if row is not None:
                found[job.id] = row
        return found

    def to_do(self, jobs: Sequence[Job], *, retry_failed: bool = False) -> list[Job]:
        """Return the jobs without a row, in their order; those whose row tells of a failure too, if asked for."""
        rows = self.read(jobs)
        return [
            job for job in jobs if job.id not in rows or (retry_failed and rows[job.id]["status"] != FINISHED)
        ]  # fmt: skip

    def others(self, jobs: Sequence[Job]) -> int:
        """Count rows of other jobs: of other settings, scenes or versions."""
        own = {f"{job.id}{_SUFFIX}" for job in jobs}
        return sum(file.name not in own for file in self.rows.glob(f"[!.]*{_SUFFIX}"))

    def _row(self, id: str) -> Row | None:
        try:
            rows = rows_in(read_file(self.rows / f"{id}{_SUFFIX}"))
        except (FileNotFoundError, ValueError):
            return None
        row = rows[0] if len(rows) == 1 else {}
        return row if row.get("id") == id and "status" in row else None

    def _note(self, job: Job, outcome: Outcome) -> None:
        """Add a line to the log: everything about the job that differs from machine to machine."""
        line = {
            "at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "id": job.id,
            "job": job.title,
            "seconds": round(outcome.seconds, 3),
            "worker": outcome.worker,
            "error": outcome.error,
        }
        with self.log.open("ab+", buffering=0) as file:  # one write a line: those of several sweeps don't mix
            told = msgspec.json.encode(line) + b"\n"
            if file.seek(0, os.SEEK_END) and (file.seek(-1, os.SEEK_END), file.read(1))[1] != b"\n":
                told = b"\n" + told  # behind a line that a full disk has torn
            if file.write(told) != len(told):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.log))
