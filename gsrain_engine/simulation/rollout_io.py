"""Roll-out files: JSON lines and Parquet."""

from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from ..optional_packages import import_package
from ..safe_io.errors import convert_checked
from ..safe_io.files import whole_file
from ..safe_io.limits import check_file
from ..safe_io.text_files import printable_line, read_whole
from .rollout import EgoRecord, Rollout, RolloutStep, UserRecord

ROLLOUT_SUFFIXES = (".jsonl", ".parquet")


def read_any_rollout(path: Path) -> Rollout:
    """Read a roll-out from Parquet or JSON lines, by suffix. Raises ValueError, also for a missing library."""
    try:
        return read_rollout_parquet(path) if path.suffix.lower() == ".parquet" else read_rollout(path)
    except ImportError as error:
        raise ValueError(f"{path}: {error}") from None


# JSON lines: a header, followed by one line per step

_MAX_BYTES = 1 << 30
_VERSION = 1
_MOMENTS = "moments"  # number of step lines, to detect files truncated between two lines


def write_rollout(path: Path | str, rollout: Rollout) -> None:
    """Write a roll-out atomically. The same roll-out gives the same bytes."""
    header = msgspec.structs.asdict(rollout)
    header[_MOMENTS] = len(header.pop("steps"))
    with whole_file(Path(path)) as partial, partial.open("wb") as file:
        for line in (header, *rollout.steps):
            file.write(msgspec.json.encode(line, order="sorted") + b"\n")


def read_rollout(path: Path | str) -> Rollout:
    """Read a roll-out. Raises ValueError, naming file and line, if it is invalid, truncated or of a newer version."""
    path = Path(path)
    first, *rest = read_whole(path, _MAX_BYTES).splitlines() or [b""]
    header = _header(path, first, "first line")
    count = header.pop(_MOMENTS, None)
    steps: list[RolloutStep] = []
    for number, line in enumerate(rest, start=2):
        try:
            steps.append(msgspec.json.decode(line, type=RolloutStep))
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise ValueError(f"{path}: line {number}: {printable_line(error)}") from None
    if not steps:
        raise ValueError(f"{path}: a roll-out of no moment: it has been torn off after its first line")
    if count not in (None, len(steps)):
        raise ValueError(
            f"{path}: a torn roll-out: its first line says {printable_line(count, 60)} moments, {len(steps)} follow"
        )
    try:
        rollout = msgspec.convert({**header, "steps": tuple(steps)}, Rollout)
    except msgspec.ValidationError as error:
        raise ValueError(f"{path}: line 1: {printable_line(error)}") from None
    check_rollout(path, rollout)
    return rollout


def check_rollout(path: Path, rollout: Rollout) -> None:
    """Raise ValueError if the rain is no number, or a step has a road user that `users` does not list."""
    try:
        _ = rollout.intensity_mm_h
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    for step in rollout.steps:
        for user in step.road_users:
            if user.id not in rollout.users:
                raise ValueError(
                    f"{path}: step {step.step}: road user {printable_line(repr(user.id))} is not among its `users`"
                )


def _header(path: Path, data: bytes, where: str) -> dict[str, Any]:
    try:
        header = msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise ValueError(f"{path}: not a roll-out: its {where} is no JSON object") from None
    version = header.get("version")
    if not isinstance(version, int) or version < 1:
        raise ValueError(f"{path}: not a roll-out: its {where} has no `version`")
    if version > _VERSION:
        raise ValueError(f"{path}: a roll-out of version {version}; this program reads up to {_VERSION}")
    return header


# Parquet: one row per step, for pandas, polars and DuckDB; lossless

_HEADER = b"gsrain.rollout"  # metadata key of the header as JSON
_MAX_ROWS = 1_000_000
_OF_EGO = tuple(EgoRecord.__struct_fields__)


def write_rollout_parquet(path: Path, rollout: Rollout) -> None:
    """Write a roll-out to Parquet atomically. The same roll-out gives the same bytes.

    Columns: step, time_s, ego_* (one each of `EgoRecord`), route_left_m, route_completion, collision, plan (list of x
    and y), road_users (list of records), notes (JSON). Raises ImportError with install
    instructions if pyarrow is missing.
    """
    arrow, parquet = _pyarrow()
    header = msgspec.structs.asdict(rollout)
    del header["steps"]
    schema = _schema(arrow).with_metadata({_HEADER: msgspec.json.encode(header, order="sorted")})
    rows: list[dict[str, Any]] = []
    for step in rollout.steps:
        row = msgspec.structs.asdict(step)
        row |= {f"ego_{name}": value for name, value in msgspec.structs.asdict(row.pop("ego")).items()}
        row["plan"] = [{"x_m": x, "y_m": y} for x, y in step.plan]
        row["road_users"] = [msgspec.structs.asdict(user) for user in step.road_users]
        row["notes"] = msgspec.json.encode(step.notes, order="sorted").decode()
        rows.append(row)
    table = arrow.Table.from_pylist(rows, schema=schema)
    with whole_file(path) as partial:
        parquet.write_table(table, partial, compression="zstd")


def read_rollout_parquet(path: Path) -> Rollout:
    """Read a roll-out written by `write_rollout_parquet`.

    Raises ValueError, naming the file, for an invalid file or a newer version, and ImportError if pyarrow is missing.
    """
    data, rows = _header_and_rows(path)
    header = _header(path, data, "metadata")
    try:
        if not rows:
            raise ValueError("a roll-out of no moment")
        for row in rows:
            row["ego"] = {name: row.pop(f"ego_{name}") for name in _OF_EGO}
            row["plan"] = [(point["x_m"], point["y_m"]) for point in row["plan"]]
            row["notes"] = msgspec.json.decode(row["notes"])
        rollout = convert_checked({**header, "steps": rows}, Rollout)
    except (ValueError, AttributeError, KeyError, RecursionError, TypeError) as error:
        raise ValueError(f"{path}: a roll-out that can't be read: {printable_line(error)}") from None
    check_rollout(path, rollout)
    return rollout


def _header_and_rows(path: Path) -> tuple[bytes, list[dict[str, Any]]]:
    arrow, parquet = _pyarrow()
    check_file(path)  # an unreadable path is not reported as damage
    try:
        with parquet.ParquetFile(path) as file:
            # Access no single columns: Arrow aborts the process on damage there.
            about = file.metadata
            size = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
            if about.num_rows > _MAX_ROWS or size > _MAX_BYTES:
                raise ValueError(f"{about.num_rows} rows of {size / 1e9:.1f} GB: too large")
            header = (about.metadata or {}).get(_HEADER)
            rows = [] if header is None else file.read().to_pylist()
    except (arrow.ArrowException, OSError, OverflowError, ValueError) as error:  # any of these for damaged files
        raise ValueError(f"{path}: not a Parquet file of a roll-out: {printable_line(error)}") from None
    if header is None:
        raise ValueError(f"{path}: a Parquet file, but not of a roll-out: its metadata has no {_HEADER.decode()}")
    return header, rows


def _pyarrow() -> tuple[Any, Any]:
    return import_package("pyarrow", "a Parquet file"), import_module("pyarrow.parquet")


def _schema(arrow: Any) -> Any:
    number = arrow.float64()
    point = arrow.struct([("x_m", number), ("y_m", number)])
    user = [("id", arrow.string()), *((name, number) for name in UserRecord.__struct_fields__ if name != "id")]
    return arrow.schema(
        [
            ("step", arrow.int64()),
            ("time_s", number),
            *((f"ego_{name}", number) for name in _OF_EGO),
            ("route_left_m", number),
            ("route_completion", number),
            ("collision", arrow.string()),
            ("plan", arrow.list_(point)),
            ("road_users", arrow.list_(arrow.struct(user))),
            ("notes", arrow.string()),
        ]
    )
