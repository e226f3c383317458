"""An editor in a process of its own: reconstructs a capture, and closes while that is under way.

Run as a program with a capture folder.
"""

import sys
from pathlib import Path

import psutil

from gsrain_engine.editor.background_edits import reconstruct
from gsrain_engine.editor.document import Recipe
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.job_results import scene_results
from gsrain_engine.editor.jobs.training import reconstruction_job
from gsrain_engine.training.settings import TrainingSettings


def main(capture: str) -> None:
    """Do as the module says; prints the worker's number while it trains."""
    editor = Editor()
    settings = TrainingSettings(steps=100_000, gaussians=1500, device="cpu")
    take = scene_results(editor.viewport, "Reconstruct", Recipe(reconstruct, {}))
    job = editor.jobs.start(reconstruction_job(Path(capture), settings), take)
    while job.state == "running" and "loss" not in job.progress.metrics:
        editor.jobs.wait(60)
        editor.tick(0.0)
    workers = [each.pid for each in psutil.Process().children() if "--multiprocessing-fork" in each.cmdline()]
    print(job.error or workers[0], flush=True)
    editor.close()


if __name__ == "__main__":
    main(sys.argv[1])
