"""A progress bar with an estimate of the time left; in a file or pipe there is only how it ended."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TypeVar

from gsrain_engine.compile_cache import has_any_kernel
from gsrain_engine.scene.progress import Progress as Step
from gsrain_engine.scene.progress import run_to_end

from .console import (
    BarColumn,
    Console,
    MofNCompleteColumn,
    Progress,
    TimeElapsedColumn,
    TimeRemainingColumn,
    WordsColumn,
)

_Result = TypeVar("_Result")

_FIRST_TIME = "The first time on a machine, code for its processor is compiled before the first frame: a minute or two."


@contextmanager
def progress_bar(title: str, total: float, *, draws: bool = False) -> Generator[Callable[..., None]]:
    """Show a bar while the block runs; call what it yields with the work done (default 1). A failure takes it away.

    Where the block `draws`, it is said that the first time on a machine begins with compiling.
    """
    columns = [WordsColumn(), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    with Progress(*columns, WordsColumn("ETA"), TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        if draws and bar.console.is_terminal and not has_any_kernel():
            bar.console.print(_FIRST_TIME)
        task = bar.add_task(title, total=total)

        def advance(done: float = 1) -> None:
            bar.advance(task, done)

        try:
            yield advance
        except BaseException:
            bar.live.transient, bar.console.quiet = True, not bar.console.is_terminal  # one line is left: what is wrong
            raise


def followed(work: Generator[Step, None, _Result]) -> _Result:
    """Do a piece of work, show how far it is and what it does, and return what comes out."""
    columns = [WordsColumn(), BarColumn(), TimeElapsedColumn(), WordsColumn("ETA"), TimeRemainingColumn()]
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        shown = bar.add_task("Reading", total=1.0)
        return run_to_end(work, lambda step: bar.update(shown, completed=step.fraction, description=step.message))
