"""Roll-outs as files: JSON lines, what is the same for the whole drive first, then one line a moment."""

from pathlib import Path
from typing import Any

import msgspec

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.plain_values import read_whole
from gsrain_engine.untrusted.printable import printable

from .rollout import Rollout, RolloutStep

_MOST_BYTES = 1 << 30
_VERSION = 1
_MOMENTS = "moments"
"""How many lines follow the first: a file that is torn between two lines shows it by nothing else."""


def write_rollout(path: Path | str, rollout: Rollout) -> None:
    """Write a roll-out; the file is whole or not there at all. The same roll-out gives the same bytes."""
    header = msgspec.structs.asdict(rollout)
    header[_MOMENTS] = len(header.pop("steps"))
    with whole_file(Path(path)) as beside, beside.open("wb") as file:
        for line in (header, *rollout.steps):
            file.write(msgspec.json.encode(line, order="sorted") + b"\n")


def read_rollout(path: Path | str) -> Rollout:
    """Read a roll-out.

    Raises ValueError, with the file and the line, for what is none, for a torn file, and for one of a newer version.
    """
    path = Path(path)
    first, *rest = read_whole(path, _MOST_BYTES).splitlines() or [b""]
    header = _header(path, first)
    count = header.pop(_MOMENTS, None)
    steps = [_step(path, number, line) for number, line in enumerate(rest, start=2)]
    if not steps:
        raise ValueError(f"{path}: a roll-out of no moment: it has been torn off after its first line")
    if count not in (None, len(steps)):
        raise ValueError(f"{path}: a torn roll-out: its first line says {count} moments, {len(steps)} follow")
    try:
        rollout = msgspec.convert({**header, "steps": tuple(steps)}, Rollout)
    except msgspec.ValidationError as error:
        raise ValueError(f"{path}: line 1: {printable(error)}") from None
    check_users(path, rollout)
    return rollout


def check_users(path: Path, rollout: Rollout) -> None:
    """Raise ValueError where a moment has somebody in it whom the roll-out does not describe."""
    for step in rollout.steps:
        for user in step.road_users:
            if user.id not in rollout.users:
                raise ValueError(
                    f"{path}: step {step.step}: road user {printable(repr(user.id))} is not among its `users`"
                )


def _header(path: Path, line: bytes) -> dict[str, Any]:
    try:
        header = msgspec.json.decode(line, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise ValueError(f"{path}: not a roll-out: its first line is no JSON object") from None
    version = header.get("version")
    if not isinstance(version, int) or version < 1:
        raise ValueError(f"{path}: not a roll-out: its first line has no `version`")
    if version > _VERSION:
        raise ValueError(f"{path}: a roll-out of version {printable(version)}; this program reads up to {_VERSION}")
    return header


def _step(path: Path, number: int, line: bytes) -> RolloutStep:
    try:
        return msgspec.json.decode(line, type=RolloutStep)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: line {number}: {printable(error)}") from None
