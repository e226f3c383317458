"""A session in a process of its own that begins a job which never ends by itself, and waits to be killed.

Prints the worker's process, its temporary folder and its shared memory.
"""

import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from gsrain_engine.editor.jobs.folder import temporary_folder
from gsrain_engine.editor.jobs.process import WorkerProcess
from gsrain_engine.scene.progress import Progress


def silent(place: Path) -> Iterator[Progress]:
    """Work that says something once, and then nothing for hours."""
    (place / "big").write_bytes(bytes(100_000))
    yield Progress(0.5, "at it")
    threading.Event().wait(3600)
    yield Progress(1.0, "done")


def main() -> None:
    """Do as the module says."""
    with temporary_folder() as place:
        job = WorkerProcess(silent, place)
        while job.progress.message != "at it":
            job.wait(60)
            job.poll()
        print(job.pid, place, job.preview.name, flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
