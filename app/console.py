"""Terminal output of all commands: tables, lines, progress bars, logs and errors.

Names come from files, servers and other people. All text is escaped here and never parsed as rich markup, so that a
name can't control the terminal, add a line or change the text direction. A test rejects rich, the built-in `print` and
the standard streams anywhere else in the program.
"""

import logging
import sys
from collections.abc import Iterable
from contextlib import suppress
from typing import IO, Any

import rich.console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from gsrain_engine.safe_io.text_files import escape_invisible

__all__ = [
    "BarColumn", "Console", "MofNCompleteColumn", "Progress", "Table", "TimeElapsedColumn", "TimeRemainingColumn",
    "WordsColumn", "bold", "console_log", "print", "print_lines", "use_any_encoding", "wide_console",
]  # fmt: skip


class Console(rich.console.Console):
    """Rich console that prints text literally: no markup, emoji codes or highlights; invisible characters are escaped.

    Only tables and separate calls break lines; a line break within a text is escaped too.
    """

    def __init__(self, **options: Any) -> None:
        """Write to standard output, or as rich's own options (`file`, `stderr`, `width`, `soft_wrap`) set."""
        super().__init__(**{**options, "markup": False, "emoji": False, "highlight": False})

    def render_str(self, text: str, **options: Any) -> Text:
        """Escape text; cells, titles and lines all pass through here."""
        return super().render_str(
            escape_invisible(text), **{**options, "markup": False, "emoji": False, "highlight": False}
        )

    def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
        """Render anything; text that was already a `Text` is escaped now."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:  # keep the line breaks of wrapped text
                yield Segment("\n".join(map(escape_invisible, segment.text.split("\n"))), segment.style)


_WIDE_COLUMNS = 100_000  # wider than any table of names: rich truncates what is wider than its console


def wide_console() -> Console:
    """Return a console that never truncates or folds, even in a narrow terminal, which wraps longer lines itself."""
    return Console(soft_wrap=True, width=_WIDE_COLUMNS)


def bold(text: str) -> Text:
    return Text(escape_invisible(text), "bold")


class WordsColumn(ProgressColumn):
    """Text column of a progress bar: a fixed text or the task's description."""

    def __init__(self, words: str | None = None) -> None:
        super().__init__()
        self._words = words

    def render(self, task: Task) -> Text:
        return Text(escape_invisible(task.description if self._words is None else self._words))


def print(*words: object, file: IO[str] | None = None) -> None:
    """Print one line, as the built-in `print` does; invisible characters and line breaks are escaped."""
    stream = sys.stdout if file is None else file
    if stream is not None:  # pyright: ignore  # it is where a shell has closed it
        stream.write(escape_invisible(" ".join(map(str, words))) + "\n")


def print_lines(text: str, file: IO[str] | None = None) -> None:
    """Print text that the program itself has broken into lines, such as JSON."""
    for line in text.removesuffix("\n").split("\n"):
        print(line, file=file)


def use_any_encoding() -> None:
    """Make the standard streams escape characters that their encoding lacks, instead of raising."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):  # another kind of stream, as in tests, or closed
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore


def console_log() -> logging.Handler:
    """Return a handler that prints log records to standard error, one line each; tracebacks keep their lines."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_OneLine())
    return handler


class _OneLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        lines = [record.getMessage()]
        if record.exc_info:
            lines += self.formatException(record.exc_info).splitlines()
        return "\n".join(map(escape_invisible, lines))
