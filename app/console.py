"""The one door to the terminal: tables, lines, progress, logs and errors of all commands pass through it.

Names come from files, servers and other people. None of them steers the terminal, adds a line, turns the reading
direction or is read as rich's markup, for every piece of text is escaped here, and markup is never parsed. A test
refuses rich, the built-in `print` and the standard streams anywhere else in the program.
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
    """Rich's console that shows text as it is: no markup, no emoji codes, no highlights; what can't be seen escaped.

    Line breaks are those of a table, or of calls: one in a text is a part of some name, and escaped too.
    """

    def __init__(self, **options: Any) -> None:
        """Write to standard output, or where rich's own options (`file`, `stderr`, `width`, `soft_wrap`) say."""
        super().__init__(**{**options, "markup": False, "emoji": False, "highlight": False})

    def render_str(self, text: str, **options: Any) -> Text:
        """Turn text into what is shown: cells, titles, and lines all come by here."""
        return super().render_str(
            escape_invisible(text), **{**options, "markup": False, "emoji": False, "highlight": False}
        )

    def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
        """Render anything; what was a `Text` before it came here is escaped now."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:  # the line breaks of wrapped text stay
                yield Segment("\n".join(map(escape_invisible, segment.text.split("\n"))), segment.style)


_WIDE_COLUMNS = 100_000
"""More than any table of names has: rich cuts what is wider than its console."""


def wide_console() -> Console:
    """Return a console that cuts and folds nothing, however narrow the terminal is: it wraps longer lines itself."""
    return Console(soft_wrap=True, width=_WIDE_COLUMNS)


def bold(text: str) -> Text:
    return Text(escape_invisible(text), "bold")


class WordsColumn(ProgressColumn):
    """A column of a progress bar: what is being done, or the same words all the time."""

    def __init__(self, words: str | None = None) -> None:
        """Show these words; without any, the task's description."""
        super().__init__()
        self._words = words

    def render(self, task: Task) -> Text:
        return Text(escape_invisible(task.description if self._words is None else self._words))


def print(*words: object, file: IO[str] | None = None) -> None:
    """Print one line, as the built-in `print` does; what can't be seen is escaped, line breaks in names too."""
    stream = sys.stdout if file is None else file
    if stream is not None:  # pyright: ignore  # it is where a shell has closed it
        stream.write(escape_invisible(" ".join(map(str, words))) + "\n")


def print_lines(text: str, file: IO[str] | None = None) -> None:
    """Print text that the program itself has broken into lines: a table of words, or JSON."""
    for line in text.removesuffix("\n").split("\n"):
        print(line, file=file)


def use_any_encoding() -> None:
    """Let the standard streams write letters that their encoding lacks as escapes, not fail on them."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):  # a stream of another kind, as in tests; or closed
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore


def console_log() -> logging.Handler:
    """Return a handler that prints log records to standard error, each one line; tracebacks keep their lines."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_OneLine())
    return handler


class _OneLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        lines = [record.getMessage()]
        if record.exc_info:
            lines += self.formatException(record.exc_info).splitlines()
        return "\n".join(map(escape_invisible, lines))
