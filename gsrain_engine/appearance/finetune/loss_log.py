"""Training losses: a CSV and TensorBoard log, and early warnings of failed trainings."""

import csv
import logging
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from jaxtyping import Float32, UInt8

from ...safe_io.files import whole_file
from ...safe_io.limits import open_file

logger = logging.getLogger("gsrain")
FILE = "losses.csv"
_STEP = "step"
_FLUSHED_EVERY_S = 1.0


class LossLog:
    """Log of losses in a folder's files; a context manager that closes them."""

    def __init__(self, folder: Path, begins_at: int = 0) -> None:
        """Start a log, or continue one after `begins_at` iterations; later rows are dropped and will be repeated."""
        file = folder / FILE
        self.earlier_rows = [row for row in read_losses(file) if row[_STEP] <= begins_at] if begins_at else []
        if self.earlier_rows:
            with whole_file(file) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
                _write_rows(stream, self.earlier_rows)
        self._stream = file.open("a" if self.earlier_rows else "w", newline="", encoding="utf-8")
        self._writer = csv.DictWriter(self._stream, list(self.earlier_rows[0])) if self.earlier_rows else None
        self._flushed_at = -np.inf
        self._board: Any = None
        if find_spec("tensorboard") is None:
            logger.info("TensorBoard is not installed: losses go to %s only", file)
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
        """Append the losses of an iteration, counted from 1."""
        row = {_STEP: float(step), **losses}
        if self._writer is None:
            self._writer = _write_rows(self._stream, [row])
        else:
            self._writer.writerow(_texts(row))
        if self._board is not None:
            for name, value in losses.items():
                self._board.add_scalar(name.replace("_", "/", 1), value, step)
        if time.perf_counter() - self._flushed_at > _FLUSHED_EVERY_S:
            self.flush()

    def show(self, step: int, grid: UInt8[np.ndarray, "h w 3"]) -> None:
        if self._board is not None:
            self._board.add_image("samples", grid, step, dataformats="HWC")

    def flush(self) -> None:
        """Write everything to the files; also done once a second, so that they can be followed."""
        self._flushed_at = time.perf_counter()
        self._stream.flush()
        if self._board is not None:
            self._board.flush()


def _write_rows(stream: TextIO, rows: Sequence[Mapping[str, float]]) -> "csv.DictWriter[str]":
    writer = csv.DictWriter(stream, list(rows[0]))
    writer.writeheader()
    writer.writerows(_texts(row) for row in rows)
    return writer


def _texts(row: Mapping[str, float]) -> dict[str, str]:
    return {name: f"{value:.9g}" for name, value in row.items()}


def read_losses(file: Path) -> list[dict[str, float]]:
    """Read all complete rows of a loss log, which may still be growing; empty if it is missing."""
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


# Collapse monitor: warns if the model only reconstructs, or if a discriminator has won

CHANCE = float(3 * np.log(2))
"""Adversarial loss of three levels if generated and real images are indistinguishable."""
_RANKS = 256
_STUCK = 0.25  # share of the distance below which a model only reconstructs
_WON = 0.1  # share of the chance loss below which a discriminator has won, so that nothing is learned from it
_WINDOW = 100


def color_distance(
    source: Iterable[Float32[np.ndarray, "_ _ 3"]], target: Iterable[Float32[np.ndarray, "_ _ 3"]]
) -> float:
    """Mean color distance of two sets of images in 0..1, over red, green and blue.

    The Wasserstein distance of each channel's values (Villani 2003): a lower bound of the mean change of any
    translation of one look into the other.
    """
    return float(np.abs(_ranked(source) - _ranked(target)).mean())


class CollapseMonitor:
    """Monitor of the last losses of a training."""

    def __init__(self, distance: float, gan_weight: float, warned_after: int) -> None:
        """Take the distance between the looks, the adversarial weight, and the first step with warnings."""
        self.distance = max(distance, 1 / 255)
        self._gan_weight, self._warned_after = gan_weight, warned_after
        self._recent: deque[Mapping[str, float]] = deque(maxlen=_WINDOW)

    def add(self, losses: Mapping[str, float]) -> None:
        self._recent.append(losses)

    @property
    def share(self) -> float:
        """Mean change as a share of the distance between the looks: 1 or more for a complete translation."""
        return self._mean("change") / self.distance

    def warning(self, step: int) -> str | None:
        """Problem in a sentence or two; None if there is none or it is too early to tell."""
        if step < self._warned_after or not self._recent:
            return None
        # Each of the two losses has half the weight, so chance level is the weight times `CHANCE`.
        sums = [self._mean(f"judge_{look}_made") + self._mean(f"judge_{look}_real") for look in ("rainy", "clear")]
        judged = [each / (self._gan_weight * CHANCE) for each in sums] if self._gan_weight else []
        won = bool(judged) and min(judged) < _WON
        if self.share < _STUCK:
            why = "raise losses.gan or the rate, lower the losses of LPIPS, and train in float32"
            if won:
                why = "the discriminators tell everything apart and teach nothing: lower their rate"
            elif not judged:
                why = "there is no adversarial loss: set losses.gan"
            return (
                f"after {step:,} steps the model only reconstructs: it changes pictures by "
                f"{self._mean('change'):.1%} of the range, {self.share:.0%} of what lies between the two looks; {why}"
            )
        if won:
            return f"after {step:,} steps a discriminator's loss is {min(judged):.0%} of chance: lower its rate"
        return None

    def _mean(self, name: str) -> float:
        """Mean of one loss over the last iterations; 0 before the first."""
        return sum(each[name] for each in self._recent) / max(len(self._recent), 1)


def distance_sample(pictures: Sequence[object], limit: int = 64) -> list[int]:
    """Indices of the images used to measure the distance: evenly spread, at most `limit`."""
    return np.unique(np.linspace(0, len(pictures) - 1, min(len(pictures), limit)).round().astype(int)).tolist()


def _ranked(pictures: Iterable[Float32[np.ndarray, "_ _ 3"]]) -> Float32[np.ndarray, "_ 3"]:
    """Values of all images, weighted equally, at evenly spaced quantiles per channel."""
    ranks = (np.arange(_RANKS) + 0.5) / _RANKS
    pooled = np.concatenate([np.quantile(each.reshape(-1, 3), ranks, axis=0) for each in pictures])
    return np.quantile(pooled, ranks, axis=0).astype(np.float32)
