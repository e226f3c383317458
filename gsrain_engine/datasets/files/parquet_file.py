"""Parquet files, read by the row: pyarrow is imported when one is opened, and said to be missing where it is."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.untrusted.limits import check_file

from ..capture import CaptureError

_ROWS_AT_ONCE = 8
_DAMAGES = (OSError, ValueError, KeyError, TypeError, IndexError, NotImplementedError, MemoryError)
"""What Arrow's errors are kinds of."""


@dataclass(frozen=True, slots=True)
class ParquetFile:
    """A table on the disk. Every method raises `CaptureError`, which names the file."""

    path: Path

    def rows(self, columns: Sequence[str], optional: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
        """Yield rows in their order, lists as NumPy arrays, other values as Python's; absent optional ones are None."""
        opened = self._opened()
        there = set(self._column_names(opened))
        missing = [name for name in columns if name not in there]
        if missing:
            raise CaptureError(f"{self.path}: has no column {missing[0]!r}")
        read = [*columns, *(name for name in optional if name in there)]
        absent = {name: None for name in optional if name not in there}
        try:
            for batch in opened.iter_batches(batch_size=_ROWS_AT_ONCE, columns=read):
                arrays = [(name, batch.column(name)) for name in read]
                for k in range(batch.num_rows):
                    yield {**absent, **{name: _plain(array[k]) for name, array in arrays}}
        except _DAMAGES as error:
            raise CaptureError(f"{self.path}: can't be read ({error})") from None

    def row_groups(self, columns: Sequence[str]) -> list[tuple[int, int, dict[str, Any]]]:
        """Each row's group, its place there, and some columns: what `cell` needs to find it again."""
        opened = self._opened()
        try:
            return [
                (group, place, row)
                for group in range(opened.num_row_groups)
                for place, row in enumerate(opened.read_row_group(group, columns=list(columns)).to_pylist())
            ]
        except _DAMAGES as error:
            raise CaptureError(f"{self.path}: can't be read ({error})") from None

    def cell(self, column: str, group: int, place: int) -> Any:
        """One value, such as a picture; neighbours are kept for a while, for they are asked for next."""
        return _group(self.path, column, group)[place].as_py()

    def _opened(self) -> Any:
        try:
            check_file(self.path)
            return _parquet().ParquetFile(self.path)
        except _DAMAGES as error:
            raise CaptureError(f"{self.path}: not a Parquet file that can be read ({error})") from None

    @staticmethod
    def _column_names(opened: Any) -> list[str]:
        return list(opened.schema_arrow.names)


@lru_cache(maxsize=2)
def _group(path: Path, column: str, group: int) -> Any:
    try:
        check_file(path)
        return _parquet().ParquetFile(path).read_row_group(group, columns=[column]).column(column)
    except _DAMAGES as error:
        raise CaptureError(f"{path}: can't be read ({error})") from None


def _plain(value: Any) -> Any:
    """Python's value of a scalar of pyarrow; lists of numbers become arrays without a detour."""
    values = getattr(value, "values", None)
    if values is not None and value.is_valid:
        return np.asarray(values.to_numpy(zero_copy_only=False))
    return value.as_py()


@cache
def _parquet() -> Any:
    try:
        return import_module("pyarrow.parquet")
    except ImportError:
        raise CaptureError("Waymo's Parquet files need the package pyarrow: pip install 'gsrain[waymo]'") from None
