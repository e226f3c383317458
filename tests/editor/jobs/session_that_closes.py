"""A session in a process of its own: reconstructs a capture, and closes while that is under way.

Run as a program with a capture folder.
"""

import sys
from multiprocessing.connection import wait
from pathlib import Path

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.training import ReconstructionJobKind
from gsrain_engine.training.settings import TrainingSettings


def main(capture: str) -> None:
    """Do as the module says; prints the worker's number when it trains."""
    session = Editor()
    session.start_task(
        ReconstructionJobKind(Path(capture), TrainingSettings(steps=100_000, gaussians=1500, device="cpu"))
    )
    (job,) = session.jobs
    while job.state == "running" and not job.progress.message.startswith("Step"):
        session.update(0.0)
        if job._worker is not None:
            wait([job._worker.waitable], timeout=60)
    print(job.error or job._worker._process.pid, flush=True)
    session.close()


if __name__ == "__main__":
    main(sys.argv[1])
