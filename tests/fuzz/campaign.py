"""Tries readers with damaged files for minutes each, in processes of their own: they may be killed, hang, or die."""

import logging
import multiprocessing
import queue
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import psutil

from .found import write_finding
from .reader import Example, Finding, limited_memory
from .readers import READERS

_HANGS_S = 30.0
"""Of processor time: a process that spends so much on one file hangs where Python can't interrupt it."""


def campaign(name: str, minutes: float, seed: int, out: Path) -> tuple[int, int]:
    """Try a reader for so many minutes, and write one finding of each kind into a folder.

    Returns the numbers of files and of findings.
    """
    first, written, end = seed, set[Path](), time.monotonic() + minutes * 60
    while (left := end - time.monotonic()) > 0:
        at = multiprocessing.get_context("spawn").Value("q", seed - 1)  # one before the first: its example is made
        for finding in _explored(name, seed, left, at):
            file = write_finding(finding, out)
            if file not in written:
                print(f"{name}: {file}: {finding.what}", flush=True)
            written.add(file)
        seed = max(at.value, seed)
    return seed - first, len(written)


def _explored(name: str, seed: int, seconds: float, at: "Synchronized[int]") -> Iterator[Finding]:
    """Run one process to its end; the file at which it died is a finding, too, and is counted."""
    context = multiprocessing.get_context("spawn")
    found: Any = context.Queue()
    process = context.Process(target=_explore, args=(name, seconds, at, found))
    process.start()
    seen, spent_s = at.value, 0.0
    while process.is_alive():
        with suppress(queue.Empty):
            yield found.get(timeout=1)
        with suppress(psutil.NoSuchProcess):
            times = psutil.Process(process.pid).cpu_times()
            if at.value != seen or at.value < seed:
                seen, spent_s = at.value, times.user + times.system
            elif times.user + times.system - spent_s > _HANGS_S:
                process.kill()
    process.join()
    while not found.empty():
        yield found.get()
    if process.exitcode:
        at.value = max(at.value, seed)
        with tempfile.TemporaryDirectory(prefix="gsrain-fuzz-") as folder:
            file, content = Example(READERS[name], Path(folder)).damaged(at.value)
        at.value += 1
        yield Finding(name, file, content, f"the process died, exit code {process.exitcode}")


def _explore(name: str, seconds: float, at: "Synchronized[int]", found: Any) -> None:
    logging.disable()  # warnings of readers
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
