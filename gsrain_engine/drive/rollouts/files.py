"""Roll-out files of every form that can be read back, by the ending of their names."""

from pathlib import Path

from .json_lines import read_rollout
from .parquet import read_rollout_parquet
from .rollout import Rollout

ROLLOUT_SUFFIXES = (".jsonl", ".parquet")


def read_any_rollout(path: Path) -> Rollout:
    """Read a roll-out from JSON lines, or from Parquet where the name ends so.

    Raises ValueError, with the file, for what is none, and where a library is missing that reads it.
    """
    if path.suffix.lower() != ".parquet":
        return read_rollout(path)
    try:
        return read_rollout_parquet(path)
    except ImportError as error:
        raise ValueError(f"{path}: {error}") from None
