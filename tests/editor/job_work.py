"""Work of jobs in tests: in a module that imports little, since each worker process imports it anew."""

import os
import signal

import numpy as np
import psutil

from gsrain_engine.editor.jobs.process import install_sigterm_handler
from gsrain_engine.scene.progress import Progress


def painting(folder):
    """Report three steps with snapshots, the last with a warning, a large picture and the settings of its process."""
    for step in (1, 2, 3):
        (folder / "snapshot").write_text(f"snapshot {step}")
        image, metrics = np.full((30, 40, 3), step, np.uint8), {"step": 10 * step, "loss": 1 / step}
        yield Progress(step / 4, "painting", image, metrics)
        (folder / "go on").read_text()  # ends when the snapshot was read
    threads = os.environ["OMP_NUM_THREADS"], os.environ["NUMBA_NUM_THREADS"]
    (folder / "result").write_text(f"{psutil.Process().nice()} {threads}")
    yield Progress(0.9, "thinking", np.full((3000, 4000, 3), 7, np.uint8), warning="nothing is learned")


def failing(_):
    yield Progress(0.5, "about to fail")
    raise ValueError("the third wheel is missing")


def killed(_):
    yield Progress(0.25, "about to die")
    os.kill(os.getpid(), signal.SIGKILL)


def leaving(_):
    yield Progress(0.25, "about to leave")
    os._exit(3)


def ended(_):
    """Work that unwinds when it is ended, as recordings do."""
    install_sigterm_handler()
    yield Progress(0.25, "about to be ended")
    os.kill(os.getpid(), signal.SIGTERM)
    yield Progress(0.5, "never reached")


def hungry(_):
    yield Progress(0.1, "about to ask for more than there is")
    np.ones(1 << 62, np.uint8)


def succeeding(_):
    yield Progress(1.0, "done")


def deaf(_):
    """Work without a yield, in compiled code that never looks at signals."""
    yield Progress(0.5, "multiplying")
    matrix = np.ones((20_000, 2_000), np.float32)
    while True:
        matrix @ matrix.T


def endless(*_):
    while True:
        yield Progress(0.5, "still at it")
