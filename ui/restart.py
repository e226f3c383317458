"""A window that begins again by itself: its graphics context was lost, and what was open in it was kept."""

import logging
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple, NoReturn

logger = logging.getLogger("gsrain")

_RESTART_VARIABLES, _SCENE, _TIMES = "GSRAIN_KEPT", "GSRAIN_SCENE", "GSRAIN_RESTARTS"

_MAX_IN_A_ROW = 3

_A_WHILE_S = 300.0
"""A window that has lived so long had a driver that works."""


class RestartState(NamedTuple):
    """What the window before this one has left."""

    kept: Path | None = None
    """Where its unsaved changes are kept."""
    scene: str | None = None
    """What was open in it."""


def restart_state() -> RestartState | None:
    """What to go on with; None where a person has started this window. To be asked once."""
    kept, scene = os.environ.pop(_RESTART_VARIABLES, ""), os.environ.pop(_SCENE, "")
    return RestartState(Path(kept) if kept else None, scene or None) if _TIMES in os.environ else None


def restart_program(left: RestartState, lived_s: float) -> NoReturn:
    """Start the program anew in the place of this process, whose window has lived so long.

    Raises `OSError` where that has not helped several times in a row.
    """
    times = 1 + (int(os.environ.get(_TIMES, "0")) if lived_s < _A_WHILE_S else 0)
    if times > _MAX_IN_A_ROW:
        raise OSError(f"the graphics card was lost {times} times in a row: its driver does not come back")
    os.environ |= {_TIMES: str(times), _RESTART_VARIABLES: str(left.kept or ""), _SCENE: left.scene or ""}
    command = [sys.executable, *sys.orig_argv[1:]]
    logger.error("The graphics card was lost; the window begins again.")
    sys.stderr.flush()
    if os.name == "nt":  # there, who waits for this process would not wait for one that takes its place
        sys.exit(subprocess.call(command))
    os.execv(command[0], command)
