"""`gsrain info FILE` of a disdrometer's measurements, and the option that says which of a table's columns is what."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from gsrain_engine.rain.disdrometer.reading import UnknownKindError
from gsrain_engine.rain.disdrometer.tables import TableColumns, load_columns
from gsrain_engine.rain.fitting.measured_file import open_measured
from gsrain_engine.scene.formats.gaussian_files import unknown_format

from ..console import print_lines

Columns = Annotated[
    Path | None,
    Parameter(help="YAML file that says which column is what, for tables of disdrometers that no reader knows."),
]


def columns_of(file: Path | None) -> TableColumns | None:
    """Read what `--columns` names. Raises `ValueError` with the file and the field, `OSError`."""
    return None if file is None else load_columns(file)


def disdrometer_info(file: Path, columns: Path | None) -> dict[str, Any]:
    """Print what a disdrometer file holds; returns the numbers. Raises `ValueError`."""
    try:
        measured = open_measured(file, columns_of(columns)).measured()
    except UnknownKindError as error:
        if error.kind is not None:
            told = f"neither a scene, nor a capture, nor a disdrometer file; it is {error.kind}"
            raise ValueError(f"{file}: {told}") from None
        raise ValueError(f"{file}: {unknown_format(file)}; nor measured rain: {error.problem}") from None
    print_lines("\n".join(measured.lines))
    return measured.numbers()
