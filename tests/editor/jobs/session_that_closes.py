"""A session in a process of its own: reconstructs a capture, and closes while that is under way.

Run as a program with a capture folder.
"""

import sys
from pathlib import Path

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.training import reconstruction_job
from gsrain_engine.training.settings import TrainingSettings


def main(capture: str) -> None:
    """Do as the module says; prints the worker's number when it trains."""
    session = Editor()
    settings = TrainingSettings(steps=100_000, gaussians=1500, device="cpu")
    job = reconstruction_job(session, Path(capture), settings)
    session.start(job)
    while job.state == "running" and not job.progress.message.startswith("Step"):
        job.wait(60)
        session.update(0.0)
    print(job.error or job._worker._process.pid, flush=True)
    session.close()


if __name__ == "__main__":
    main(sys.argv[1])
