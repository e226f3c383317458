"""The scenes that were opened or saved last, in a file that several windows share."""

import logging
from pathlib import Path

import msgspec

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.file_lock import locked
from gsrain_engine.untrusted.limits import read_file
from gsrain_engine.untrusted.plain_values import MOST_BYTES

from ..preferences.places import state_folder

logger = logging.getLogger("gsrain")

MOST = 12


class _Recent(msgspec.Struct):
    paths: list[str] = []


def recent_files() -> list[Path]:
    """The scenes that were used last, the latest first."""
    try:
        return [Path(each) for each in msgspec.json.decode(read_file(_file(), MOST_BYTES), type=_Recent).paths[:MOST]]
    except FileNotFoundError:
        return []
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        logger.warning("%s: the list of recent scenes can't be read: %s", _file(), error)
        return []


def add_recent_file(path: Path) -> list[Path]:
    """Put a scene to the head of the list, whatever other windows have put there meanwhile; returns the list.

    Raises:
        OSError: When the list can't be written.
    """
    return _rewritten(path.absolute(), at_head=True)


def forget_recent_file(path: Path) -> list[Path]:
    """Take a scene off the list; returns the list.

    Raises:
        OSError: When the list can't be written.
    """
    return _rewritten(path.absolute(), at_head=False)


def _rewritten(path: Path, *, at_head: bool) -> list[Path]:
    folder = state_folder()
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        others = [each for each in recent_files() if each != path]
        paths = [path, *others][:MOST] if at_head else others
        with whole_file(_file()) as beside:
            names = [str(each).encode(errors="replace").decode() for each in paths]
            beside.write_bytes(msgspec.json.encode(_Recent(names)))
    return paths


def _file() -> Path:
    return state_folder() / "recent.json"
