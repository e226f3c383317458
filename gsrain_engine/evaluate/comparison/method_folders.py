"""The transferred pictures of each method, a folder each; one that stands and was made the same way is kept."""

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.cyclegan_turbo.places import find_base, find_weights
from gsrain_engine.appearance.methods import method_of, open_transfer
from gsrain_engine.appearance.normals.estimators import WEIGHTS
from gsrain_engine.appearance.transfer import RainyView, Transfer
from gsrain_engine.appearance.transfer_record import TransferRecord, read_record
from gsrain_engine.appearance.transferred_folder import (
    check_transferred_folder,
    is_transferred_folder,
    write_transferred,
)
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.limits import read_file

from .settings import CLEAR, ComparedMethod, Comparison
from .source import ComparedSource
from .stamp import stamp

_SECONDS = "seconds.json"
_FILES = ("weights", "base", "images", "normals_weights", "normals_checkout")


@dataclass(frozen=True, slots=True)
class MethodFolder:
    """Where the pictures of a method lie."""

    method: ComparedMethod
    folder: Path
    seconds: float | None
    """That its transfer took when it ran, model loading included; None where it was stopped before that was written."""
    was_kept: bool
    """Whether it stood there from an earlier run."""
    notes: tuple[str, ...] = ()
    """What its transfer could not do, a sentence each."""


class Untouched:
    """A `Transfer` that leaves views as they are."""

    name = CLEAR

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        for view in views:
            yield RainyView(view, view.image)


def check_methods(comparison: Comparison, output: Path) -> None:
    """Raise ValueError, with the method's row, for what a transfer would miss only later. Learned ones need torch."""
    for each in comparison.methods:
        row = f"method {each.name!r}"
        check_transferred_folder(output / each.name)
        if each.method == CLEAR:
            continue
        needs = method_of(each.method).needs
        if needs is not None and getattr(each, needs) is None:
            raise ValueError(f"{row}: needs {needs}")
        for field in _FILES:
            path: Path | None = getattr(each, field)
            if path is not None and not path.exists():
                raise ValueError(f"{row}: {field} {path}: no such file or folder")
        if each.method == "cyclegan-turbo":
            try:
                _check_learned(each)
            except (ValueError, FileNotFoundError) as error:
                raise ValueError(f"{row}: {error}") from None


def _check_learned(method: ComparedMethod) -> None:
    """Raise for files that are found missing only when the model is opened."""
    weights = method.weights or find_weights()
    if method.normals in WEIGHTS and method.normals_weights is None:
        raise ValueError(f"normals {method.normals} need normals_weights: {WEIGHTS[method.normals]}")
    if method.normals == "dsine" and method.normals_checkout is None:
        raise ValueError("normals dsine need normals_checkout: git clone https://github.com/baegwangbin/DSINE")
    try:
        find_base(method.base)
    except FileNotFoundError:
        from gsrain_engine.appearance.cyclegan_turbo.weights import open_weights  # torch is an extra

        if open_weights(weights).random_base_seed is None:  # a test's need no SD-Turbo
            raise


def record_of(method: ComparedMethod, source: ComparedSource, comparison: Comparison) -> TransferRecord:
    """Return how a method's folder is made: the same record, the same pictures."""
    told: dict[str, Any] = msgspec.to_builtins(method.settings, enc_hook=str)
    whole = msgspec.to_builtins(comparison, enc_hook=str)
    told |= {part: whole[part] for part in ("source", "capture", "pictures", "views")} | {"stamp": source.stamp}
    files: dict[str, Path | None] = {field: getattr(method, field) for field in _FILES}
    if method.method == "cyclegan-turbo" and method.weights is None:
        files["weights"] = find_weights()
    told["files"] = {field: stamp(path) for field, path in files.items() if path is not None}
    return TransferRecord(method.method, source.name, json.loads(json.dumps(told)), source.to_world)


def method_folder(
    method: ComparedMethod, source: ComparedSource, comparison: Comparison, output: Path
) -> Iterator[MethodFolder | int]:
    """Make a method's folder, or find it made: yields numbers of views done, and in the end the folder.

    Raises what the transfer raises, with the method's row before it.
    """
    folder, record = output / method.name, record_of(method, source, comparison)
    if _stands(folder, record):
        yield MethodFolder(method, folder, _read_seconds(folder), True, read_record(folder).notes)
        return
    started = time.perf_counter()
    try:
        transfer = _opened(method, source)
        for done, _ in enumerate(write_transferred(folder, transfer.transferred(source.views), record, source.mask)):
            yield done + 1
    except (ValueError, OSError) as error:
        raise ValueError(f"method {method.name!r}: {error}") from error
    seconds = round(time.perf_counter() - started, 3)
    with whole_file(folder / _SECONDS) as beside:
        beside.write_text(json.dumps({"seconds": seconds}) + "\n", encoding="utf-8")
    yield MethodFolder(method, folder, seconds, False, read_record(folder).notes)


def _opened(method: ComparedMethod, source: ComparedSource) -> Transfer:
    return Untouched() if method.method == CLEAR else open_transfer(method.method, method.settings, source.surroundings)


def _stands(folder: Path, record: TransferRecord) -> bool:
    if not is_transferred_folder(folder):
        return False
    try:
        there = read_record(folder)
    except CaptureError:
        return False
    return (there.method, there.made_of, dict(there.settings)) == (record.method, record.made_of, dict(record.settings))


def _read_seconds(folder: Path) -> float | None:
    try:
        return float(json.loads(read_file(folder / _SECONDS))["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
