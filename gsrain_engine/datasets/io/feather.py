"""Tables of Arrow on disk (Feather 2); pyarrow is imported on first use.

Facts: arrow.apache.org/docs/format/Columnar.html.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64, Shaped

from ...optional_packages import MissingPackageError, import_package
from ..capture import CaptureError
from .arrays import read_bytes

_DAMAGES = (OSError, ValueError, KeyError, TypeError, IndexError, NotImplementedError, MemoryError)
"""Base classes of Arrow's errors."""

_MAX_BYTES = 1 << 30
_CODECS = {b"\x04\x22\x4d\x18": "lz4", b"\x28\xb5\x2f\xfd": "zstd"}
"""First bytes of compressed columns."""


def read_feather(file: Path, feature: str) -> Any:
    """Read a whole table as a `pyarrow.Table`; `feature` is the subject of the message without pyarrow.

    Raises `CaptureError` if it is missing, damaged or larger than 1 GB.
    """
    arrow, content = _arrow(feature), read_bytes(file, _MAX_BYTES)
    try:
        table = arrow.ipc.open_file(arrow.py_buffer(content)).read_all()
        table.validate(full=True)
        return table
    except _DAMAGES as error:
        raise CaptureError(f"{file}: not a Feather file that can be read ({_first_line(error)})") from None


def feather_column(table: Any, name: str, file: Path) -> Shaped[np.ndarray, " n"]:
    """Numbers of a column in its own type; raises `CaptureError`, also for missing numbers."""
    found = _found(table, name, file)
    if found.null_count or not _is_number(found.type):
        raise CaptureError(f"{file}: its column {name!r} has {found.null_count} gaps and the type {found.type}")
    return np.asarray(found.to_numpy())


def feather_words(table: Any, name: str, file: Path) -> list[str]:
    """Texts of a column; raises `CaptureError`."""
    return [str(each) for each in _found(table, name, file).to_pylist()]


def encoded_feather(
    table: Any, rows: Int64[np.ndarray, " m"], columns: Mapping[str, Shaped[np.ndarray, " m"]], recorded: bytes
) -> bytes:
    """Content of a file with some rows of a table, some columns of which are replaced.

    Types and compression are those of the file `recorded`, and so is the metadata but for the number of rows.
    """
    arrow = _arrow("")
    found = table.take(arrow.array(rows))
    for name, values in columns.items():
        place = found.schema.get_field_index(name)
        field = found.schema.field(place)
        found = found.set_column(place, field, arrow.array(values.astype(field.type.to_pandas_dtype()), field.type))
    metadata = dict(found.schema.metadata or {})
    if b"pandas" in metadata:
        metadata[b"pandas"] = _counted(metadata[b"pandas"], len(rows))
        found = found.replace_schema_metadata(metadata)
    sink = arrow.BufferOutputStream()
    first = {place: codec for start, codec in _CODECS.items() if (place := recorded.find(start)) >= 0}
    options = arrow.ipc.IpcWriteOptions(compression=first[min(first)] if first else None)
    with arrow.ipc.new_file(sink, found.schema, options=options) as writer:
        writer.write_table(found)
    return sink.getvalue().to_pybytes()


def _counted(content: bytes, count: int) -> bytes:
    """Metadata of pandas whose index, a range, has another number of rows."""
    try:
        values = json.loads(content)
        for each in values["index_columns"]:
            if isinstance(each, dict) and each.get("kind") == "range":
                each |= {"start": 0, "stop": count, "step": 1}
        return json.dumps(values).encode()
    except (KeyError, TypeError, ValueError):
        return content


def _found(table: Any, name: str, file: Path) -> Any:
    if table.column_names.count(name) != 1:
        raise CaptureError(f"{file}: has no column {name!r}")
    return table.column(name)


def _is_number(kind: Any) -> bool:
    types = _arrow("").types
    return types.is_floating(kind) or types.is_integer(kind)


def _arrow(feature: str) -> Any:
    try:
        import_package("pyarrow.ipc", feature, "recordings")
        import_package("pyarrow.types", feature, "recordings")
        return import_package("pyarrow", feature, "recordings")
    except MissingPackageError as error:
        raise CaptureError(str(error)) from None


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
