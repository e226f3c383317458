"""The losses of a fine-tuning, iteration by iteration: as a CSV file, and for TensorBoard where it is installed."""

import csv
import logging
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.limits import open_file

logger = logging.getLogger("gsrain")

FILE = "losses.csv"
_STEP = "step"


class LossLog:
    """Appends to a folder's files; use it as a context, so that everything is on the disk in the end."""

    def __init__(self, folder: Path, begins_at: int = 0) -> None:
        """Begin, or go on after so many iterations: what was noted later is forgotten, it comes again."""
        self._file = folder / FILE
        self.kept = [row for row in read_losses(self._file) if row[_STEP] <= begins_at] if begins_at else []
        """What was noted before."""
        if self.kept:
            with whole_file(self._file) as beside, beside.open("w", newline="", encoding="utf-8") as stream:
                _write_rows(stream, self.kept)
        self._stream = self._file.open("a" if self.kept else "w", newline="", encoding="utf-8")
        self._rows = csv.DictWriter(self._stream, list(self.kept[0])) if self.kept else None
        self._board: Any = None
        if find_spec("tensorboard") is None:
            logger.info("TensorBoard is not installed: losses go to %s only", self._file)
        else:
            writer: Any = import_module("torch.utils.tensorboard").SummaryWriter
            self._board = writer(str(folder / "tensorboard"), purge_step=begins_at + 1 if begins_at else None)

    def __enter__(self) -> "LossLog":
        return self

    def __exit__(self, *error: object) -> None:
        self._stream.close()
        if self._board is not None:
            self._board.close()

    def add(self, step: int, losses: Mapping[str, float]) -> None:
        """Note the losses of an iteration; the first one is number 1."""
        self._write({_STEP: float(step), **losses})
        if self._board is not None:
            for name, value in losses.items():
                self._board.add_scalar(name.replace("_", "/", 1), value, step)

    def show(self, step: int, grid: UInt8[np.ndarray, "h w 3"]) -> None:
        if self._board is not None:
            self._board.add_image("samples", grid, step, dataformats="HWC")

    def flush(self) -> None:
        """Bring what was noted to the disk, for others to read."""
        self._stream.flush()
        if self._board is not None:
            self._board.flush()

    def _write(self, row: Mapping[str, float]) -> None:
        if self._rows is None:
            self._rows = _write_rows(self._stream, [row])
        else:
            self._rows.writerow(_in_words(row))


def _write_rows(stream: TextIO, rows: Sequence[Mapping[str, float]]) -> "csv.DictWriter[str]":
    writer = csv.DictWriter(stream, list(rows[0]))
    writer.writeheader()
    writer.writerows(_in_words(row) for row in rows)
    return writer


def _in_words(row: Mapping[str, float]) -> dict[str, str]:
    return {name: f"{value:.9g}" for name, value in row.items()}


def read_losses(file: Path) -> list[dict[str, float]]:
    """Read all whole rows of a CSV file of losses, which may still be growing; none where it is missing."""
    if not file.is_file():
        return []
    rows: list[dict[str, float]] = []
    with TextIOWrapper(open_file(file), newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            try:
                rows.append({name: float(value) for name, value in row.items()})
            except (TypeError, ValueError):
                break
    return rows
