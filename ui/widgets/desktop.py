"""Programs of the desktop, in which files and folders are opened."""

import logging
import os
import subprocess
import sys
import threading
from pathlib import Path

logger = logging.getLogger("gsrain")


def open_in_desktop(path: Path) -> None:
    """Open a file or folder in the program that the desktop has for it, without waiting."""
    threading.Thread(target=_open, args=(path,), daemon=True).start()


def _open(path: Path) -> None:
    program = "open" if sys.platform == "darwin" else "xdg-open"
    try:
        if sys.platform == "win32":
            os.startfile(path)
        else:
            subprocess.run([program, str(path)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    except OSError as error:
        logger.warning("%s can't be opened: %s: %s", path, program, error.strerror)
