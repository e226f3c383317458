"""Terminal output of all commands: lines, tables, progress bars, logs and errors.

Names come from files, servers and other people. All text is escaped here and never parsed as rich markup, so that a
name can't control the terminal, add a line or change the text direction. A test rejects rich, the built-in `print` and
the standard streams anywhere else in the program.
"""

import logging
import sys
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from typing import IO, TYPE_CHECKING, Any, TypeVar

import rich.console
from rich import progress
from rich.segment import Segment
from rich.text import Text

from gsrain_engine.safe_io.text_files import escape_invisible

if TYPE_CHECKING:
    from gsrain_engine.scene.progress import Progress

_PLAIN = {"markup": False, "emoji": False, "highlight": False}
_WIDE_COLUMNS = 100_000  # wider than any table of names: rich truncates what is wider than its console


class Console(rich.console.Console):
    """Rich console that prints text literally: no markup, emoji codes or highlights; invisible characters are escaped.

    Only tables and separate calls break lines; a line break within a text is escaped too.
    """

    def __init__(self, **options: Any) -> None:
        """Write to standard output, or as rich's own options (`file`, `stderr`, `width`, `soft_wrap`) set."""
        super().__init__(**{**options, **_PLAIN})

    def render_str(self, text: str, **options: Any) -> Text:
        """Escape text; cells, titles and lines all pass through here."""
        return super().render_str(escape_invisible(text), **{**options, **_PLAIN})

    def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
        """Render anything; text that was already a `Text` is escaped now."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:  # keep the line breaks of wrapped text
                yield Segment("\n".join(map(escape_invisible, segment.text.split("\n"))), segment.style)


def wide_console() -> Console:
    """Return a console that never truncates or folds, even in a narrow terminal, which wraps longer lines itself."""
    return Console(soft_wrap=True, width=_WIDE_COLUMNS)


def counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}" + ("" if count == 1 else "s")


def print(*words: object, file: IO[str] | None = None, flush: bool = False) -> None:
    """Print one line, as the built-in `print` does; invisible characters and line breaks are escaped."""
    stream = sys.stdout if file is None else file
    if stream is not None:  # pyright: ignore  # it is where a shell has closed it
        stream.write(escape_invisible(" ".join(map(str, words))) + "\n")
        if flush:
            stream.flush()


def print_lines(text: str, file: IO[str] | None = None) -> None:
    """Print text that the program itself has broken into lines, such as JSON."""
    for line in text.removesuffix("\n").split("\n"):
        print(line, file=file)


def use_any_encoding() -> None:
    """Make the standard streams escape characters that their encoding lacks, instead of raising."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):  # another kind of stream, as in tests, or closed
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore


class _ConsoleLog(logging.StreamHandler[Any]):
    """Handler of the present standard error: while a progress bar is shown, lines are printed above it."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)


def console_log() -> logging.Handler:
    """Return a handler that prints log records to standard error, one line each; tracebacks keep their lines."""
    handler = _ConsoleLog(sys.stderr)
    handler.setFormatter(_OneLine())
    return handler


class _OneLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        lines = [record.getMessage()]
        if record.exc_info:
            lines += self.formatException(record.exc_info).splitlines()
        return "\n".join(map(escape_invisible, lines))


# Progress bars with an estimate of the time left; files and pipes get lines, or only the final state

_Result = TypeVar("_Result")

_ESTIMATED_S = 3600.0
"""Period whose finished steps give the time left; much longer than a step, which of a sweep takes minutes."""


@contextmanager
def progress_bar(title: str, total: float) -> Generator[Callable[..., None]]:
    """Show a bar while the block runs; call the yielded function with the work done (default 1).

    Errors remove the bar.
    """
    with _bar(progress.MofNCompleteColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total)
        try:
            yield lambda done=1: bar.advance(task, done)
        except BaseException:
            bar.live.transient, bar.console.quiet = True, not bar.console.is_terminal  # leave one line: the error
            raise


def run_with_progress(work: "Generator[Progress, None, _Result]", line_every_s: float = 60.0) -> _Result:
    """Run a job, show its progress and current step, and return its result.

    A file or pipe gets lines instead of a bar: a step's message if `line_every_s` seconds have passed since the last.
    """
    from gsrain_engine.scene.progress import run_to_end  # loads NumPy, which startup avoids

    console = Console(stderr=True)
    with _bar(_WarningColumn(), console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("Reading", total=1.0, warning="")
        printed_s = time.monotonic()

        def show(step: "Progress") -> None:
            nonlocal printed_s
            if not console.is_terminal and (now_s := time.monotonic()) - printed_s >= line_every_s:
                print(f"{step.fraction:.0%} {step.message}", file=sys.stderr)
                printed_s = now_s
            bar.update(task, completed=step.fraction, description=step.message, warning=step.warning or "")

        return run_to_end(work, show)


def _bar(*counts: progress.ProgressColumn, **options: Any) -> progress.Progress:
    times = progress.TimeElapsedColumn(), _WordsColumn("ETA"), progress.TimeRemainingColumn()
    words = _WordsColumn(), progress.BarColumn(), *counts, *times
    return progress.Progress(*words, speed_estimate_period=_ESTIMATED_S, **options)


class _WordsColumn(progress.ProgressColumn):
    """Text column of a progress bar: a fixed text or the task's description."""

    def __init__(self, words: str | None = None) -> None:
        super().__init__()
        self._words = words

    def render(self, task: progress.Task) -> Text:
        return Text(escape_invisible(task.description if self._words is None else self._words))


class _WarningColumn(progress.ProgressColumn):
    """Column with the warning of a job's latest step."""

    def render(self, task: progress.Task) -> Text:
        return Text(escape_invisible(task.fields["warning"]), style="yellow")
