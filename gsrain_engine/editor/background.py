"""Background work of an editor: functions in threads, whose results are taken on the main thread."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

from ..scene.progress import Progress

_Result = TypeVar("_Result")
Lane = Literal["files", "opening", "drives", "capture", "matching", "obstacles"]
"""Functions of a lane run one after another, independently of other lanes."""
_THREADS: dict[Lane, int] = {"opening": 2}  # opening does not wait for one that it supersedes, which can't be stopped
_WRITING: tuple[Lane, ...] = ("files", "drives")  # lanes that end what waits in them; that of others is dropped


@dataclass(eq=False)
class Task(Generic[_Result]):
    """A function in a thread; it ends when its result, or its error, is taken on the main thread."""

    title: str
    """Title for the user, who may wait for it; empty for others."""
    progress: Progress
    lane: Lane
    future: Future[_Result]
    on_result: Callable[[_Result], object]
    on_error: Callable[[Exception], object]
    state: Literal["running", "finished", "failed", "cancelled"] = field(default="running", init=False)

    def cancel(self) -> None:
        """Discard the result; a file in writing is completed nevertheless."""
        self.state = "cancelled"
        self.future.cancel()


class Background:
    """Threads of an editor. Main thread only; call `poll` once a frame."""

    def __init__(self) -> None:
        self.tasks: list[Task[Any]] = []
        """Running tasks in the order of their start."""
        self._lanes: dict[Lane, ThreadPoolExecutor] = {}

    def submit(self, work: Callable[..., _Result], *arguments: Any, lane: Lane = "files") -> Future[_Result]:
        """Call a function in a thread; `poll` does not take its result."""
        if lane not in self._lanes:
            self._lanes[lane] = ThreadPoolExecutor(_THREADS.get(lane, 1), thread_name_prefix=lane)
        return self._lanes[lane].submit(work, *arguments)

    def start(
        self,
        work: Callable[[], _Result],
        on_result: Callable[[_Result], object],
        on_error: Callable[[Exception], object],
        title: str = "",
        message: str = "",
        *,
        lane: Lane = "files",
    ) -> Task[_Result]:
        """Call a function in a thread; `message` is its progress."""
        task = Task(title, Progress(0.0, message), lane, self.submit(work, lane=lane), on_result, on_error)
        self.tasks.append(task)
        return task

    @property
    def titled(self) -> list[Task[Any]]:
        """Running tasks for which the user may wait."""
        return [each for each in self.tasks if each.title]

    def is_working(self, lane: Lane) -> bool:
        return any(each.lane == lane for each in self.tasks)

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until all functions of running tasks have ended, where there are no frames; `poll` takes the results."""
        wait_for([each.future for each in self.tasks], timeout_s)

    def poll(self) -> None:
        """Take the results of the tasks that have ended."""
        for task in [each for each in self.tasks if each.future.done()]:
            self.tasks.remove(task)
            if task.state == "cancelled":
                continue
            try:
                result = task.future.result()
            except Exception as error:  # any error of a disk or a file: the window must survive
                task.state = "failed"
                task.on_error(error)
            else:
                task.state = "finished"
                task.on_result(result)

    def close(self) -> None:
        """End the threads, after all writes; further calls do nothing."""
        for lane, thread in self._lanes.items():
            thread.shutdown(wait=lane != "opening", cancel_futures=lane not in _WRITING)
