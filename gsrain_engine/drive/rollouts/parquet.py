"""Roll-outs as Parquet, one row a moment: for pandas, polars and DuckDB, and back without loss."""

from pathlib import Path
from typing import Any

import msgspec

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.explained_errors import converted
from gsrain_engine.untrusted.limits import check_file
from gsrain_engine.untrusted.printable import printable

from .json_lines import check_users
from .rollout import EgoRecord, Rollout, RolloutStep, UserRecord

_HEADER = b"gsrain.rollout"
"""Key of the file's metadata: what is the same for the whole drive, as JSON."""
_VERSION = 1
_MOST_ROWS, _MOST_BYTES = 1_000_000, 1 << 30
_MISSING = "Parquet files of roll-outs need pyarrow: pip install 'gsrain[drive]'"
_OF_EGO = tuple(EgoRecord.__struct_fields__)


def write_rollout_parquet(path: Path, rollout: Rollout) -> None:
    """Write a roll-out; the file is whole or not there at all. The same roll-out gives the same bytes.

    Columns: step, time_s, ego_* (one each of `EgoRecord`), route_left_m, route_completion, collision, plan (list of x
    and y), road_users (list of records), notes (JSON). Raises ImportError, with what to install, where pyarrow is
    missing.
    """
    arrow, parquet = _pyarrow()
    header = msgspec.structs.asdict(rollout)
    del header["steps"]
    schema = _schema(arrow).with_metadata({_HEADER: msgspec.json.encode(header, order="sorted")})
    table = arrow.Table.from_pylist([_row(step) for step in rollout.steps], schema=schema)
    with whole_file(path) as beside:
        parquet.write_table(table, beside, compression="zstd")


def read_rollout_parquet(path: Path) -> Rollout:
    """Read a roll-out that `write_rollout_parquet` has written.

    Raises ValueError, with the file, for what is none, and for one of a newer version; ImportError where pyarrow is
    missing.
    """
    _pyarrow()
    header, rows = _header_and_rows(path)
    try:
        plain = msgspec.json.decode(header)
        version = plain["version"]
        is_newer = version > _VERSION
        if not rows and not is_newer:
            raise ValueError("a roll-out of no moment")
        rollout = None if is_newer else converted({**plain, "steps": [_step(row) for row in rows]}, Rollout)
    except (ValueError, AttributeError, KeyError, RecursionError, TypeError) as error:
        raise ValueError(f"{path}: a roll-out that can't be read: {printable(error)}") from None
    if rollout is None:
        raise ValueError(f"{path}: a roll-out of version {printable(version)}; this program reads up to {_VERSION}")
    check_users(path, rollout)
    return rollout


def _header_and_rows(path: Path) -> tuple[bytes, list[dict[str, Any]]]:
    arrow, parquet = _pyarrow()
    check_file(path)  # what keeps it from being opened is no damage
    try:
        with parquet.ParquetFile(path) as file:
            _check_size(file.metadata)
            header = (file.metadata.metadata or {}).get(_HEADER)
            rows = [] if header is None else file.read().to_pylist()
    except (arrow.ArrowException, OSError, OverflowError, ValueError) as error:  # damage comes as any of them
        raise ValueError(f"{path}: not a Parquet file of a roll-out: {printable(error)}") from None
    if header is None:
        raise ValueError(f"{path}: a Parquet file, but not of a roll-out: its metadata has no {_HEADER.decode()}")
    return header, rows


def _check_size(metadata: Any) -> None:
    """Raise ValueError before columns are unpacked that are larger than a roll-out's, however small the file.

    Nothing is asked of single columns: Arrow ends the whole process over damage there.
    """
    size = sum(metadata.row_group(i).total_byte_size for i in range(metadata.num_row_groups))
    if metadata.num_rows > _MOST_ROWS or size > _MOST_BYTES:
        raise ValueError(f"{metadata.num_rows} rows of {size / 1e9:.1f} GB: too large")


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError:
        raise ImportError(_MISSING) from None
    return pyarrow, parquet


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


def _row(step: RolloutStep) -> dict[str, Any]:
    return {
        "step": step.step,
        "time_s": step.time_s,
        **{f"ego_{name}": getattr(step.ego, name) for name in _OF_EGO},
        "route_left_m": step.route_left_m,
        "route_completion": step.route_completion,
        "collision": step.collision,
        "plan": [{"x_m": x, "y_m": y} for x, y in step.plan],
        "road_users": [msgspec.structs.asdict(user) for user in step.road_users],
        "notes": msgspec.json.encode(step.notes, order="sorted").decode(),
    }


def _step(row: dict[str, Any]) -> dict[str, Any]:
    ego = {name: row.pop(f"ego_{name}") for name in _OF_EGO}
    plan = [(point["x_m"], point["y_m"]) for point in row.pop("plan")]
    return {**row, "ego": ego, "plan": plan, "notes": msgspec.json.decode(row["notes"])}
