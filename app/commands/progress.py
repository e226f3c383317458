"""A progress bar with an estimate of the time left; on a file or pipe it stays silent."""

from collections.abc import Callable, Generator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


@contextmanager
def progress_bar(title: str, total: float) -> Generator[Callable[..., None]]:
    """Show a bar while the block runs; call what it yields with the work done (default 1)."""
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    with Progress(*columns, TextColumn("ETA"), TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total)

        def advance(done: float = 1) -> None:
            bar.advance(task, done)

        yield advance
