"""Progress bars with an estimate of the time left; files and pipes get only the final state."""

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
    """Show a bar while the block runs; call the yielded function with the work done (default 1). Errors remove the bar.

    With `draws`, the first run on a machine prints that kernels are compiled first.
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
            bar.live.transient, bar.console.quiet = True, not bar.console.is_terminal  # leave one line: the error
            raise


def followed(work: Generator[Step, None, _Result]) -> _Result:
    """Run a job, show its progress and current step, and return its result."""
    columns = [WordsColumn(), BarColumn(), TimeElapsedColumn(), WordsColumn("ETA"), TimeRemainingColumn()]
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        shown = bar.add_task("Reading", total=1.0)

        def show(step: Step) -> None:
            message = step.message if step.warning is None else f"{step.message}. Warning: {step.warning}"
            bar.update(shown, completed=step.fraction, description=message)

        return run_to_end(work, show)
