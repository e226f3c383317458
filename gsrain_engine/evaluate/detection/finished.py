"""What detectors made of pictures in an earlier run, kept line by line: a sweep that was stopped goes on from there."""

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import msgspec
import numpy as np

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.limits import read_file

from .frames import JudgedFrame
from .pictures import Trial
from .sweep import Judgement

FINISHED_FILE = "finished.jsonl"
_FORM = b"2"
"""Goes up where the same inputs are judged otherwise than in an earlier program."""
_DIGITS = 16

_Picture = tuple[str, str, float, int]
"""Key of detector and view, kind of picture, intensity, first seed."""


class _Line(msgspec.Struct, frozen=True, kw_only=True):
    """A line of the file: a judgement, and a hash of all that it follows from."""

    key: str
    judgement: Judgement


class Finished:
    """Judgements in a file, one to a line, each written whole as soon as it is made. A torn last line is not read.

    A judgement is known again where its detector, its view and all that its picture is made of are the same: more
    seeds, intensities, views or detectors only add to the file, and what was made of anything else is left out of it.
    """

    def __init__(self, file: Path, inputs: Mapping[str, Any], detectors: Mapping[str, str]) -> None:
        """Read what is there.

        Args:
            file: Need not be there yet; its folder must.
            inputs: All that pictures follow from but the view: hashes of files, settings, versions.
            detectors: By name, a hash of its file and of how it is used.
        """
        told = msgspec.json.encode(inputs, order="sorted")
        self._bases = {name: _hash(_FORM, told, name.encode(), each.encode()) for name, each in detectors.items()}
        self._file = file
        self._known: dict[_Picture, Judgement] = {}
        self._stream: BinaryIO | None = None

    def __enter__(self) -> "Finished":
        self._stream = self._file.open("ab")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is not None:
            self._stream.close()

    def read(self, frames: list[JudgedFrame]) -> int:
        """Take over what still holds for these views, and drop the rest from the file; returns how many judgements."""
        if not self._file.is_file():
            return 0
        keys = {self._key(name, frame) for name in self._bases for frame in frames}
        lines = read_file(self._file).splitlines(keepends=True)
        kept: list[bytes] = []
        for line in lines:
            try:
                read = msgspec.json.decode(line, type=_Line)
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):  # torn when a run was killed
                continue
            if read.key in keys and line.endswith(b"\n"):
                kept.append(line)
                self._known[_picture(read.key, read.judgement.trial)] = read.judgement
        if len(kept) < len(lines):
            with whole_file(self._file) as beside:
                beside.write_bytes(b"".join(kept))
        return len(self._known)

    def known(self, detector: str, frame: JudgedFrame, trial: Trial) -> Judgement | None:
        found = self._known.get(_picture(self._key(detector, frame), trial))
        return None if found is None else replace(found, trial=trial)

    def keep(self, judgement: Judgement, frame: JudgedFrame) -> None:
        assert self._stream is not None
        line = _Line(key=self._key(judgement.detector, frame), judgement=judgement)
        self._stream.write(msgspec.json.encode(line, enc_hook=_plain) + b"\n")
        self._stream.flush()

    def _key(self, detector: str, frame: JudgedFrame) -> str:
        return _hash(self._bases[detector].encode(), *_told((frame.name, frame.shot, frame.truths)))


def _picture(key: str, trial: Trial) -> _Picture:
    return key, trial.kind, trial.intensity_mm_h, trial.seeds[0]


def _told(value: Any) -> list[bytes]:
    """The bytes of a value: arrays whole, dataclasses field by field."""
    if isinstance(value, np.ndarray):
        return [value.tobytes()]
    if isinstance(value, tuple):
        return [part for each in value for part in _told(each)]
    if is_dataclass(value):
        return [part for each in fields(value) for part in (each.name.encode(), *_told(getattr(value, each.name)))]
    return [repr(value).encode()]


def _hash(*parts: bytes) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(len(part).to_bytes(8, "little") + part)
    return found.hexdigest()[:_DIGITS]


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(type(value).__name__)
