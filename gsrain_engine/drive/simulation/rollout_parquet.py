"""Roll-outs as Parquet, one row a moment: for pandas, polars and DuckDB, and back without loss."""

from pathlib import Path
from typing import Any

import msgspec

from gsrain_engine.scene.atomic_files import whole_file

from .rollout import EgoRecord, Rollout, RolloutStep, UserRecord
from .rollout_files import check_users

_HEADER = b"gsrain.rollout"
"""Key of the file's metadata: what is the same for the whole drive, as JSON."""
_VERSION = 1
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
    arrow, parquet = _pyarrow()
    try:
        table = parquet.read_table(path)
    except arrow.ArrowInvalid as error:
        raise ValueError(f"{path}: not a Parquet file: {str(error).splitlines()[0]}") from None
    header = (table.schema.metadata or {}).get(_HEADER)
    if header is None:
        raise ValueError(f"{path}: a Parquet file, but not of a roll-out: its metadata has no {_HEADER.decode()}")
    try:
        plain = msgspec.json.decode(header)
        if plain["version"] > _VERSION:
            raise ValueError(f"{path}: a roll-out of version {plain['version']}; this program reads up to {_VERSION}")
        rollout = msgspec.convert({**plain, "steps": [_step(row) for row in table.to_pylist()]}, Rollout)
    except (msgspec.MsgspecError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: a roll-out that can't be read: {error}") from None
    check_users(path, rollout)
    return rollout


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
