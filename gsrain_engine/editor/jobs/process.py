"""Workers of jobs: run a generator of `Progress` in another process, or in a thread, and poll it without blocking.

Small messages travel through a pipe, the latest preview through shared memory, results as files. A process that dies is
a failed job. Worker processes have low CPU priority.
"""

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent import futures
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.shared_memory import SharedMemory
from time import monotonic
from typing import Any, Literal

import lazy_loader
import numpy as np
import psutil
from jaxtyping import Int64, UInt8

from ...safe_io.errors import sentence_of
from ...safe_io.limits import receive_message
from ...scene.progress import Progress
from ...threads import WORKER_NICENESS, thread_limit, usable_cores

cv2: Any = lazy_loader.load("cv2")  # only large previews need it

JobState = Literal["queued", "running", "finished", "failed", "cancelled"]
Work = Callable[..., Iterator[Progress]]
"""Function at the top level of a module, so that the new process can import it by name."""

_MAX_MESSAGE_BYTES = 1 << 24
_OUT_OF_MEMORY = "the machine ran out of memory: close other programs, or work with smaller images or fewer Gaussians"
_ENDED = "the worker was ended from outside (SIGTERM)"


class WorkerProcess:
    """A function running in another process. Call `poll` once a frame."""

    def __init__(self, work: Work, *arguments: Any) -> None:
        """Start the process; raises any error of its creation. Arguments must be picklable; pass large ones by file."""
        self.state: JobState = "running"
        self.error: str | None = None
        """Error in one line; `details` has the traceback."""
        self.details: str | None = None
        self._step = Progress(0.0, "Starting")
        self._pixels: UInt8[np.ndarray, "h w 3"] | None = None
        context = multiprocessing.get_context("spawn")
        self._messages, theirs = context.Pipe(duplex=False)
        self.preview = SharedImage()
        """Latest preview image."""
        self._process = context.Process(target=_run, args=(theirs, self.preview.name, work, arguments), daemon=True)
        try:
            with thread_limit(usable_cores()):
                self._process.start()
        except BaseException:
            self._messages.close()
            self.preview.close()
            raise
        finally:
            theirs.close()
        self.pid = self._process.pid or 0
        self._watchdog = WorkerWatchdog(self.pid)

    @property
    def progress(self) -> Progress:
        """Latest step, with the latest preview, and a warning if the worker has been silent for long."""
        return self._step._replace(preview=self._pixels, warning=self._watchdog.warning or self._step.warning)

    def wait(self, timeout_s: float) -> None:
        """Wait for a message or the end of the worker."""
        wait([self._messages], timeout_s)

    def poll(self) -> list[Progress]:
        """Process the worker's messages since the last call, and return its steps among them; never blocks."""
        steps = list[Progress]()
        if self.state != "running":
            return steps
        try:
            while self.state == "running" and self._messages.poll():
                message = receive_message(self._messages, _MAX_MESSAGE_BYTES)
                self._watchdog.heard()
                if isinstance(message, Progress):
                    steps.append(message)
                elif message is None:
                    self.state = "finished"
                else:
                    self._fail(*message)
        except (EOFError, OSError) as error:
            self._process.join(timeout=1.0)
            details = None if isinstance(error, EOFError) else traceback.format_exc()
            self._fail(_death(self._process.exitcode), details)
        self._step = steps[-1] if steps else self._step
        if (pixels := self.preview.take()) is not None:
            self._pixels = pixels
        return steps

    def cancel(self) -> None:
        """Terminate the worker without waiting for it; unfinished work is lost."""
        if self.state == "running":
            self._process.terminate()
            if psutil.POSIX:
                with suppress(ProcessLookupError):  # a stopped process receives SIGTERM only after SIGCONT
                    os.kill(self.pid, signal.SIGCONT)
            self.state = "cancelled"

    def close(self) -> None:
        """Wait for the process to end and free its resources; any thread may call this, once."""
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._messages.close()
        self.preview.close()

    def _fail(self, error: str, details: str | None) -> None:
        self.state, self.error, self.details = "failed", error, details


def _death(exit_code: int | None) -> str:
    """Describe the end of a process that sent no error."""
    if exit_code is not None and exit_code == -getattr(signal, "SIGKILL", 9):
        return f"the worker was killed: by hand, or because {_OUT_OF_MEMORY}"
    if exit_code is None:
        return "the pipe to the worker broke, though its process goes on"
    if exit_code >= 0:
        return f"the worker died (exit code {exit_code})"
    try:
        return f"the worker died of {signal.Signals(-exit_code).name}"
    except ValueError:
        return f"the worker died of signal {-exit_code}"


def _run(messages: Connection, picture_name: str, work: Work, arguments: tuple[Any, ...]) -> None:
    """Run the work in the new process; send Progress for each step, None at the end, (line, traceback) on failure."""
    if psutil.POSIX:
        os.nice(WORKER_NICENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    picture = SharedImage(picture_name)
    try:
        for progress in work(*arguments):
            if progress.preview is not None:
                picture.write(progress.preview)
            messages.send(progress._replace(preview=None))
        messages.send(None)
    except SystemExit:
        with suppress(BrokenPipeError):
            messages.send((_ENDED, traceback.format_exc()))
        raise
    except Exception as error:
        with suppress(BrokenPipeError):  # the window has closed the pipe
            messages.send((_sentence(error), traceback.format_exc()))
    finally:
        picture.close()
        messages.close()


def _end_with_parent() -> None:
    """Send SIGTERM to this process when the window is gone, killed perhaps."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)


def _sentence(error: Exception) -> str:
    """Describe an error for users; torch raises RuntimeError when out of memory."""
    text = str(error) or type(error).__name__
    if isinstance(error, MemoryError) or "out of memory" in text or "can't allocate memory" in text:
        return f"{_OUT_OF_MEMORY} ({text})"
    return sentence_of(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"


class WorkerThread:
    """A function running in a thread of this process, with the interface of a `WorkerProcess`."""

    def __init__(self, work: Work, *arguments: Any) -> None:
        """Start the thread."""
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Starting")
        self.result: Any = None
        """Return value of the generator."""
        self.error: str | None = None
        self.details: str | None = None
        thread = futures.ThreadPoolExecutor(max_workers=1)
        self._running = thread.submit(self._run, work, arguments)
        thread.shutdown(wait=False)

    def wait(self, timeout_s: float) -> None:
        """Wait for the end of the work."""
        futures.wait([self._running], timeout_s)

    def poll(self) -> list[Progress]:
        """Return the latest step."""
        return [self.progress]

    def cancel(self) -> None:
        """Stop at the next step of the work, without waiting for it."""
        if self.state == "running":
            self.state = "cancelled"

    def close(self) -> None:
        """Do nothing: a thread frees its own resources."""

    def _run(self, work: Work, arguments: tuple[Any, ...]) -> None:
        try:
            steps = work(*arguments)
            while self.state == "running":
                self.progress = next(steps)
        except StopIteration as end:
            self.result, self.state = end.value, "finished"
        except Exception as error:  # as of a process: the job fails
            self.error, self.details, self.state = _sentence(error), traceback.format_exc(), "failed"


# Latest preview in shared memory, read without blocking

_MAX_PIXELS = 1024 * 768
_SHARED_PLACE = "/dev/shm"  # of Linux
_NUMBERS = 3  # version of the image, odd while it is being written; its height and its width


class SharedImage:
    """An image that one process writes and another one copies; only the latest counts.

    The process that creates it frees it; another one attaches by `name`. Where the system has no shared memory, or too
    little, the name is empty and there are no images.
    """

    def __init__(self, name: str | None = None) -> None:
        self._memory = _shared_memory(name)
        self.name = "" if self._memory is None else self._memory.name
        self._is_own, self._is_closed = name is None, self._memory is None
        self._version = 0

    def write(self, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
        """Publish an image; larger ones are scaled down."""
        if self._is_closed:
            return
        shrink = np.sqrt(pixels.shape[0] * pixels.shape[1] / _MAX_PIXELS)
        if shrink > 1:
            size = max(1, int(pixels.shape[1] / shrink)), max(1, int(pixels.shape[0] / shrink))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        numbers = self._numbers()
        numbers[0] += 1
        numbers[1:] = pixels.shape[:2]
        self._pixels(pixels.shape[0], pixels.shape[1])[:] = pixels
        numbers[0] += 1

    def take(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """Copy the latest image; None if it was read before, or is being written: a later call finds it."""
        if self._is_closed:
            return None
        version, height, width = self._numbers().tolist()
        if version == self._version or version % 2 or not 0 < height * width <= _MAX_PIXELS:
            return None
        pixels = self._pixels(height, width).copy()
        if int(self._numbers()[0]) != version:
            return None
        self._version = version
        return pixels

    def close(self) -> None:
        """Close the memory; its creator frees it. Further calls do nothing."""
        if not self._is_closed:
            self._is_closed = True
            assert self._memory is not None
            self._memory.close()
            if self._is_own:
                self._memory.unlink()

    # Arrays are created anew each time: memory that an array refers to can't be closed.

    def _numbers(self) -> Int64[np.ndarray, " numbers"]:
        assert self._memory is not None and self._memory.buf is not None, "closed"
        return np.frombuffer(self._memory.buf, np.int64, _NUMBERS)

    def _pixels(self, height: int, width: int) -> UInt8[np.ndarray, "h w 3"]:
        assert self._memory is not None and self._memory.buf is not None, "closed"
        return np.frombuffer(self._memory.buf, np.uint8, 3 * height * width, 8 * _NUMBERS).reshape(height, width, 3)


def _shared_memory(name: str | None) -> SharedMemory | None:
    """Create shared memory, or attach to one of a name; None if the system has none."""
    if name is not None:
        return SharedMemory(name) if name else None
    size = 8 * _NUMBERS + 3 * _MAX_PIXELS
    try:
        if sys.platform == "linux":
            place = os.statvfs(_SHARED_PLACE)
            if place.f_bavail * place.f_frsize < size:
                return None  # writing to it would end the process by SIGBUS
        return SharedMemory(create=True, size=size)
    except OSError:
        return None


# Watchdog

_LONG_S = 60.0  # minimum silence to report; few steps of any job take longer
_CHECK_INTERVAL_S = 2.0


class WorkerWatchdog:
    """Describes the silence of a worker process, which may be busy or stopped."""

    def __init__(self, pid: int, now: Callable[[], float] = monotonic) -> None:
        """`now` is a monotonic clock in seconds."""
        self._pid, self._now = pid, now
        self._heard_s = self._checked_s = now()
        self._is_stopped = False

    def heard(self) -> None:
        """Note a message from the worker, which ends its silence."""
        self._heard_s, self._is_stopped = self._now(), False

    @property
    def warning(self) -> str | None:
        """Description of a long silence, or None. Changes once a minute at most."""
        now = self._now()
        if now - max(self._heard_s, self._checked_s) > _CHECK_INTERVAL_S:
            self._checked_s = now
            try:
                self._is_stopped = psutil.Process(self._pid).status() == psutil.STATUS_STOPPED
            except psutil.Error:
                self._is_stopped = False  # the process is gone; its pipe reports that
        if self._is_stopped:
            return f"process {self._pid} is stopped: kill -CONT {self._pid} lets it go on"
        minutes = int((now - self._heard_s) / _LONG_S)
        return f"no news for {minutes} min" if minutes else None


def install_sigterm_handler() -> None:
    """In a worker: unwind on SIGTERM, so that files such as videos are closed properly."""

    def end(*_: object) -> None:
        sys.exit(1)

    signal.signal(signal.SIGTERM, end)
