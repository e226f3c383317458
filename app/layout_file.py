"""The window's layout: each window keeps a copy of its own; the next one gets what the last to close has left."""

import os
import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.session.preferences.places import config_folder, state_folder


@contextmanager
def own_layout() -> Generator[Path | None]:
    """Give a file to keep the layout in while the window is open; it becomes the next window's when the block ends.

    Several windows never write to the same file, and what one of them leaves behind is whole. A disk that refuses
    costs the layout, nothing else: where it takes no file there is none.
    """
    shared, folder = config_folder() / "window.ini", state_folder() / "layouts"
    own = folder / f"{os.getpid()}.ini"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        own.touch()  # the window itself would end over a folder that can't be made
        own.unlink()
    except OSError:
        yield None
        return
    with suppress(OSError):
        _remove_abandoned(folder)
        shutil.copyfile(shared, own)
    yield own
    with suppress(OSError):
        shared.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(shared) as beside:
            shutil.copyfile(own, beside)
        own.unlink(missing_ok=True)


def _remove_abandoned(folder: Path) -> None:
    """Remove the copies of windows that were killed."""
    for file in folder.glob("*.ini"):
        if file.stem.isdigit() and not psutil.pid_exists(int(file.stem)):
            file.unlink(missing_ok=True)
