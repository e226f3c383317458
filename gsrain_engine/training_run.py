"""Runs of trainings: steps, clock, progress, periodic actions, and the checkpoints from which they resume.

Reconstruction and fine-tuning share them. Needs no torch: the format of a checkpoint reads and writes its arrays.
"""

import logging
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
import numpy as np
from jaxtyping import UInt8

from .safe_io.files import whole_file
from .safe_io.text_files import printable_line
from .scene.progress import Progress

logger = logging.getLogger("gsrain")

_PREVIEW_INTERVAL_S = 2.0
_FIGURES_INTERVAL_S = 0.25


class PeriodicAction(NamedTuple):
    """Something that a training does between its steps, such as saving."""

    every: int
    """Steps from one time to the next; 0: never."""
    run: Callable[[int], Progress]
    """Takes the number of steps done."""
    at_end: bool = False
    """True if it is also done after the last step, whatever the interval."""

    def is_due(self, done: int, steps: int) -> bool:
        return self.at_end if done == steps else self.every > 0 and done % self.every == 0


class TrainingRun:
    """One training from its first step, or that of a checkpoint, to its last, with its clock and its progress."""

    def __init__(self, steps: int, shares: tuple[float, float]) -> None:
        """Start the clock; `shares` are the total progress (0..1) at the first and the last step."""
        self.first = 0
        self.warning: str | None = None
        self._steps, self._shares = steps, shares
        self._began = time.perf_counter()
        self._made_at: dict[str, float] = {}

    @property
    def seconds(self) -> float:
        """Time since the start; over all runs if resumed."""
        return time.perf_counter() - self._began

    def continue_from(self, checkpoint: "CheckpointHeader") -> None:
        self.first = checkpoint.step
        self._began -= checkpoint.seconds

    def train(self, step: Callable[[int], Progress], actions: Sequence[PeriodicAction]) -> Generator[Progress]:
        """Do the steps, counted from 0, and after each one the actions that are due."""
        for number in range(self.first, self._steps):
            yield step(number)
            for action in actions:
                if action.is_due(number + 1, self._steps):
                    yield action.run(number + 1)

    def progress(
        self,
        done: int,
        message: str,
        preview: UInt8[np.ndarray, "h w 3"] | None = None,
        metrics: Mapping[str, float] | None = None,
    ) -> Progress:
        """Progress after a number of steps, with the current warning; metrics are those after this "step"."""
        first, last = self._shares
        fraction = first + (last - first) * (done / self._steps)
        return Progress(fraction, message, preview, {"step": done, **(metrics or {})}, self.warning)

    def preview_is_due(self) -> bool:
        """True once every two seconds."""
        return self._is_due("preview", _PREVIEW_INTERVAL_S)

    def figures_are_due(self) -> bool:
        """True four times a second; reading figures of a GPU more often would only keep it waiting."""
        return self._is_due("figures", _FIGURES_INTERVAL_S)

    def _is_due(self, name: str, interval_s: float) -> bool:
        now = time.perf_counter()
        if now - self._made_at.get(name, -np.inf) <= interval_s:
            return False
        self._made_at[name] = now
        return True

    def warn(self, warning: str | None) -> None:
        """Set the warning that further progress carries, or clear it; one that follows none is logged."""
        if warning is not None and self.warning is None:
            logger.warning("%s", warning)
        self.warning = warning


# Checkpoints


class CheckpointError(ValueError):
    """Error for a checkpoint that can't be resumed; the message names the file and the reason."""


class CheckpointHeader(msgspec.Struct, frozen=True, kw_only=True):
    """State of a training besides its arrays; a subclass adds `settings`, and what identifies the data."""

    version: int = 1
    step: int = 0
    seconds: float = 0.0


_Header = TypeVar("_Header", bound=CheckpointHeader)
_PROGRESS = frozenset({"step", "seconds", "settings"})
_DAMAGE = (AttributeError, KeyError, OSError, RecursionError, RuntimeError, TypeError, ValueError, msgspec.MsgspecError)


@dataclass(frozen=True, slots=True)
class CheckpointFormat(Generic[_Header]):
    """Files with the full state of an unfinished training: a JSON header and arrays, written atomically."""

    save: Callable[[Path, bytes, Mapping[str, Any]], None]
    """Writes the header and the arrays by name to a file."""
    load: Callable[[Path], tuple[bytes, dict[str, Any]]]
    """Reads them; may raise any of Python's errors about values, keys, types and files."""
    free: frozenset[str]
    """Settings that may change on resume, since they don't affect what is learned."""

    def write(self, file: Path, header: _Header, arrays: Mapping[str, Any]) -> None:
        with whole_file(file) as temporary:
            self.save(temporary, msgspec.json.encode(header), arrays)

    def resume(self, file: Path, expected: _Header, restore: Callable[[Mapping[str, Any]], None]) -> _Header:
        """Read a checkpoint and restore its arrays; return its header.

        Raises `CheckpointError` if the file is missing or damaged, differs from the expected header in more than the
        progress, or lacks an array.
        """
        if not file.is_file():
            raise CheckpointError(f"{file}: there is no checkpoint to resume from; begin anew without --resume")
        try:
            encoded, arrays = self.load(file)
            header = msgspec.json.decode(encoded, type=type(expected))
        except _DAMAGE as error:
            reason = printable_line(error)
            raise CheckpointError(f"{file}: not a checkpoint of a training, or damaged: {reason}") from None
        for (name, before), (_, now) in zip(self._conditions(header), self._conditions(expected), strict=True):
            if before != now:
                raise CheckpointError(f"{file}: made with {name} {printable_line(before)}, now it is {now}")
        try:
            restore(arrays)
        except (KeyError, RuntimeError) as error:
            raise CheckpointError(f"{file}: doesn't fit this training: {error}") from None
        return header

    def _conditions(self, header: CheckpointHeader) -> list[tuple[str, Any]]:
        """Everything in a header that must not change on resume, with its name."""
        fields = msgspec.structs.asdict(header)
        settings = msgspec.structs.asdict(fields["settings"])
        return [(name, value) for name, value in fields.items() if name not in _PROGRESS] + [
            (name, value) for name, value in settings.items() if name not in self.free
        ]


def arrays_of(state: Mapping[str, Any], part: str) -> dict[str, Any]:
    """Arrays of one part of a state, whose names start with the part and a colon; without that prefix."""
    prefix = f"{part}:"
    return {name.removeprefix(prefix): array for name, array in state.items() if name.startswith(prefix)}
