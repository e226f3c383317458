"""Table of results: one value that becomes text for terminals, Markdown, CSV, HTML and JSON."""

import csv
import io
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from ..safe_io.files import whole_file
from ..safe_io.text_files import escape_invisible
from .interval import Interval

Cell = str | int | float | Interval | None

_NARROWEST = 80  # minimum width of a line below the table, characters
_TITLE = 12  # width from which a title that is wider than its cells breaks, characters


@dataclass(frozen=True, slots=True)
class Column:
    """Name of a column, and how its cells become text."""

    name: str
    format: str = "g"
    """Format of fractions and intervals, as of `format`; whole numbers have commas if it has one."""
    unit: str = ""
    missing: str = "-"
    """Text of None and NaN."""
    definition: str = ""
    """Sentence below the table."""

    @property
    def title(self) -> str:
        return f"{self.name} ({self.unit})" if self.unit else self.name


def columns(formats: Mapping[str, str] | Iterable[str]) -> tuple[Column, ...]:
    """Return columns by their formats, or by names alone."""
    if isinstance(formats, Mapping):
        return tuple(Column(name, form) for name, form in formats.items())
    return tuple(map(Column, formats))


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of values below columns. Intervals state below the table over what they were taken."""

    title: str
    columns: tuple[Column, ...]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    foot: Sequence[Sequence[Cell]] = ()
    """Rows below the others, such as means, which stay there when a page sorts; not in CSV and JSON."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences below the table: over what intervals were taken, and definitions of columns."""
        taken: dict[str, list[str]] = {}
        for place, column in enumerate(self.columns):
            for words in _interval_sentences([row[place] for row in (*self.rows, *self.foot)]):
                taken.setdefault(words, []).append(column.name)
        if len(taken) == 1 and len(named := next(iter(taken.values()))) > 1:
            named[:] = ["Intervals"]
        intervals = (f"{', '.join(names)}: {words}." for words, names in taken.items())
        return *intervals, *(f"{each.name}: {each.definition}" for each in self.columns if each.definition)

    @property
    def text(self) -> str:
        """Aligned lines, then caption and notes; invisible characters are escaped."""
        cells = [[*map(escape_invisible, row)] for row in self._texts()]
        widest = [max((len(row[k]) for row in cells), default=0) for k in range(len(self.columns))]
        titles = [
            textwrap.wrap(escape_invisible(column.title), max(width, _TITLE), break_long_words=False) or [""]
            for column, width in zip(self.columns, widest, strict=True)
        ]
        widths = [max(width, *map(len, title)) for width, title in zip(widest, titles, strict=True)]
        height = max(map(len, titles))
        above = zip(*([""] * (height - len(title)) + title for title in titles), strict=True)
        forms = [f"{'<' if words else '>'}{width}" for words, width in zip(self._are_words(), widths, strict=True)]
        rule = ["-" * width for width in widths]
        lines = ["  ".join(map(format, line, forms)).rstrip() for line in (*above, rule, *cells)]
        width = max(_NARROWEST, len(lines[height]))
        below = [textwrap.fill(escape_invisible(each), width, subsequent_indent="  ") for each in self._below()]
        return "\n".join([*lines, *([""] if below else []), *below]) + "\n"

    @property
    def markdown(self) -> str:
        """A table of Markdown, then caption and notes; nothing in a name is markup."""
        rule = ["---" if words else "---:" for words in self._are_words()]
        titles = [_plain_markdown(each.title) for each in self.columns]
        lines = [titles, rule, *([*map(_plain_markdown, row)] for row in self._texts())]
        drawn = "".join(f"| {' | '.join(line)} |\n" for line in lines)
        below = "".join(f"* {_plain_markdown(each)}\n" for each in self._below())
        return f"{drawn}\n{below}" if below else drawn

    @property
    def csv(self) -> str:
        """All values unrounded; None and NaN are empty, and a column of intervals is followed by their ends and n."""
        wide = [any(isinstance(row[k], Interval) for row in self.rows) for k in range(len(self.columns))]
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        titles = [
            [f"{column.title}{end}" for end in ("", " low", " high", " n")[: 4 if is_wide else 1]]
            for column, is_wide in zip(self.columns, wide, strict=True)
        ]
        writer.writerow(chain.from_iterable(titles))
        for row in self.rows:
            writer.writerow(chain.from_iterable(map(_csv_values, row, wide)))
        return stream.getvalue()

    def write_csv(self, path: Path) -> None:
        """Write the values as a CSV file, atomically."""
        with whole_file(path) as partial:
            partial.write_bytes(self.csv.encode())

    @property
    def html(self) -> Markup:
        """A table element whose titles sort it, without caption and notes; all text is escaped."""
        from .charts import rendered  # loads OpenCV, which few commands need

        kinds = ["word" if words else "number" for words in self._are_words()]
        rows = [
            list(zip(kinds, map(_sort_key, values), texts, strict=True))
            for values, texts in zip((*self.rows, *self.foot), self._texts(), strict=True)
        ]
        titles = [(kind, each.title) for kind, each in zip(kinds, self.columns, strict=True)]
        count = len(self.rows)
        return rendered("table.html", titles=titles, body=rows[:count], foot=rows[count:])

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        below = "".join(f"<p>{escape(each)}</p>" for each in self._below())
        return f"{self.html}{below}"

    def __str__(self) -> str:
        return self.text

    @property
    def json(self) -> list[dict[str, Any]]:
        """Rows as plain values by title; NaN as None."""
        titles = [each.title for each in self.columns]
        return [dict(zip(titles, map(_json_value, row), strict=True)) for row in self.rows]

    def _below(self) -> tuple[str, ...]:
        return *([self.caption] if self.caption else []), *self.notes

    def _are_words(self) -> list[bool]:
        """True for each column with text, which is aligned left."""
        rows = (*self.rows, *self.foot)
        return [any(isinstance(row[k], str | bool) for row in rows) for k in range(len(self.columns))]

    def _texts(self) -> list[list[str]]:
        """Texts of all cells; an interval states its n where those of its column differ."""
        rows = (*self.rows, *self.foot)
        differ = [
            len({cell.n for row in rows if isinstance(cell := row[place], Interval)}) > 1
            for place in range(len(self.columns))
        ]
        return [
            [_text(*each) for each in zip(row, self.columns, differ, strict=True)] for row in rows
        ]  # fmt: skip


def table_of(title: str, titled: Iterable[Column | str], rows: Iterable[Mapping[str, Any]], caption: str = "") -> Table:
    """Return a table of rows that have values by column name; a value that a row lacks is missing."""
    found = tuple(each if isinstance(each, Column) else Column(each) for each in titled)
    return Table(title, found, [[row.get(each.name) for each in found] for row in rows], caption)


def _interval_sentences(cells: Iterable[Cell]) -> list[str]:
    """Return kinds of intervals with what they were taken over, and their smallest and largest n."""
    counts: dict[tuple[str, str], list[int]] = {}
    for cell in cells:
        if isinstance(cell, Interval):
            counts.setdefault((cell.kind, cell.over), []).append(cell.n)
    found: list[str] = []
    for (kind, over), own in counts.items():
        low, high = min(own), max(own)
        number = f"{low:,}" if low == high else f"{low:,} to {high:,}"
        found.append(f"{kind}, over {number} {over if high != 1 else over.removesuffix('s')}")
    return found


def _text(cell: Cell, column: Column, states_n: bool) -> str:
    if cell is None or cell != cell:
        return column.missing
    if isinstance(cell, str):
        return cell
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, int):
        return format(cell, "," if "," in column.format else "")
    if isinstance(cell, float):
        return format(cell, column.format)
    value, low, high = (_text(each, column, states_n=False) for each in (cell.value, cell.low, cell.high))
    ends = [f"{low}..{high}"] if cell.low < cell.high else []
    ends += [f"n = {cell.n:,}"] if states_n else []
    return f"{value} ({', '.join(ends)})" if ends and cell.value == cell.value else value


def _plain_markdown(text: str) -> str:
    """Escape what would be markup, a cell's end or an invisible character."""
    text = escape_invisible(text).replace("&", "&amp;").replace("<", "&lt;")
    return "".join(f"\\{sign}" if sign in "\\|`*_[]" else sign for sign in text)


def _csv_values(cell: Cell, is_wide: bool) -> tuple[Cell, ...]:
    if isinstance(cell, Interval):
        return *(_csv_values(each, False)[0] for each in (cell.value, cell.low, cell.high)), cell.n
    value = str(cell).lower() if isinstance(cell, bool) else None if cell != cell else cell
    return (value, None, None, None) if is_wide else (value,)


def _json_value(cell: Cell) -> Any:
    return cell.plain if isinstance(cell, Interval) else None if cell != cell else cell


def _sort_key(cell: Cell) -> float:
    """Return what a page sorts a column of numbers by."""
    number = cell.value if isinstance(cell, Interval) else cell
    return float("nan") if number is None or isinstance(number, str) else float(number)
