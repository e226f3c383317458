"""An editor in a process of its own that closes while a worker is at it; prints the worker's number."""

import threading
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import psutil

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import Job
from gsrain_engine.scene.progress import Progress


def silent() -> Iterator[Progress]:
    """Work that shows one picture, and then says nothing for hours."""
    yield Progress(0.5, "at it", np.zeros((8, 8, 3), np.uint8))
    threading.Event().wait(3600)


def main() -> None:
    """Do as the module says."""
    with closing(Editor()) as editor:
        job = editor.jobs.start(Job("recolor", "Recolor", silent), lambda *_: None)
        while job.state == "running" and job.progress.preview is None:
            editor.jobs.wait(60)
            editor.tick(0.0)
        workers = [each.pid for each in psutil.Process().children() if "--multiprocessing-fork" in each.cmdline()]
        print(job.error or workers[0], flush=True)


if __name__ == "__main__":
    main()
