"""Tries readers with damaged files for minutes each, in processes of their own: they may be killed, hang, or die."""

import logging
import multiprocessing
import queue
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import psutil

from .found import kind_of, write_finding
from .reader import Example, Finding, limited_memory
from .readers import READERS

_HANGS_S = 30.0
"""Of processor time: a process that spends so much on one file hangs where Python can't interrupt it."""


@dataclass
class Trials:
    """Number of trials of a reader, and its findings, one of each kind."""

    reader: str
    executions: int = 0
    seconds: float = 0.0
    findings: dict[str, Finding] = field(default_factory=dict[str, Finding])

    def add(self, finding: Finding) -> bool:
        """Take a finding down; whether it is of a new kind."""
        return self.findings.setdefault(kind_of(finding), finding) is finding


def campaign(names: list[str], minutes: float, first_seed: int, out: Path) -> Iterator[Trials]:
    """Try each reader for so many minutes; files that it does not come to terms with are written into a folder."""
    for name in names:
        trials, began = Trials(name), time.monotonic()
        seed = first_seed
        while (left := minutes * 60 - (time.monotonic() - began)) > 0:
            for finding in _explored(trials, seed, left):
                if trials.add(finding):
                    print(f"{name}: {write_finding(finding, out)}: {finding.what}", flush=True)
            seed = first_seed + trials.executions
        trials.seconds = time.monotonic() - began
        yield trials


def _explored(trials: Trials, seed: int, seconds: float) -> Iterator[Finding]:
    """Run one process to its end; what it was at when it died is a finding, too."""
    context = multiprocessing.get_context("spawn")
    at, found = context.Value("q", seed - 1), context.Queue()  # one before the first: its example is still being made
    process = context.Process(target=_explore, args=(trials.reader, seconds, at, found))
    process.start()
    seen, spent_s = at.value, 0.0
    while process.is_alive():
        with suppress(queue.Empty):
            yield found.get(timeout=1)
        now_s = _processor_time(process.pid)
        if at.value != seen or at.value < seed:
            seen, spent_s = at.value, now_s
        elif now_s - spent_s > _HANGS_S:
            process.kill()
    process.join()
    while not found.empty():
        yield found.get()
    trials.executions += max(at.value - seed, 0)
    if process.exitcode:
        trials.executions += 1
        with tempfile.TemporaryDirectory(prefix="gsrain-fuzz-") as folder:
            file, content = Example(READERS[trials.reader], Path(folder)).damaged(max(at.value, seed))
        yield Finding(trials.reader, file, content, f"the process died, exit code {process.exitcode}")


def _processor_time(pid: int | None) -> float:
    try:
        spent = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return spent.user + spent.system


def _explore(name: str, seconds: float, at: "Synchronized[int]", found: "multiprocessing.Queue[Any]") -> None:
    logging.disable()  # what readers tell by the way
    with tempfile.TemporaryDirectory(prefix="gsrain-fuzz-") as folder:
        example = Example(READERS[name], Path(folder))
        at.value += 1
        end = time.monotonic() + seconds
        with limited_memory():
            while time.monotonic() < end:
                finding = example.tried(at.value)
                if finding is not None:
                    found.put(finding)
                at.value += 1
