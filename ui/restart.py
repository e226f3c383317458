"""Restart of the window after its graphics context was lost, with recovered changes."""

import logging
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple, NoReturn

logger = logging.getLogger("gsrain")
_AUTOSAVE, _SCENE, _TIMES = "GSRAIN_KEPT", "GSRAIN_SCENE", "GSRAIN_RESTARTS"
_MAX_IN_A_ROW = 3
_A_WHILE_S = 300.0  # uptime after which a window's driver counts as working


class RestartState(NamedTuple):
    """State left by the previous window."""

    kept: Path | None = None
    """Path of its unsaved changes."""
    scene: str | None = None
    """Scene that was open."""


def restart_state() -> RestartState | None:
    """Return the state to continue with, or None if the user started this window. Call it only once."""
    kept, scene = os.environ.pop(_AUTOSAVE, ""), os.environ.pop(_SCENE, "")
    return RestartState(Path(kept) if kept else None, scene or None) if _TIMES in os.environ else None


def restart_program(left: RestartState, lived_s: float) -> NoReturn:
    """Replace this process by a new one, after a window that was open for `lived_s` seconds.

    Raises `OSError` after several restarts in a row.
    """
    times = 1 + (int(os.environ.get(_TIMES, "0")) if lived_s < _A_WHILE_S else 0)
    if times > _MAX_IN_A_ROW:
        raise OSError(f"the graphics card was lost {times} times in a row: its driver does not come back")
    os.environ |= {_TIMES: str(times), _AUTOSAVE: str(left.kept or ""), _SCENE: left.scene or ""}
    command = [sys.executable, *sys.orig_argv[1:]]
    logger.error("The graphics card was lost; the window begins again.")
    sys.stderr.flush()
    if os.name == "nt":  # on Windows, execv would return control to the parent, which waits for this process
        sys.exit(subprocess.call(command))
    os.execv(command[0], command)
