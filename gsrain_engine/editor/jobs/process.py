"""Worker processes: run a generator of `Progress` in another process and poll it without blocking.

Small messages travel through a pipe, the latest preview through shared memory, results as files. A worker that dies is
a failed job. Workers have low CPU priority.
"""

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.shared_memory import SharedMemory
from time import monotonic
from typing import Any, Literal

import cv2
import numpy as np
import psutil
from jaxtyping import Int64, UInt8

from ...safe_io.limits import receive_message
from ...scene.files import sentence_of
from ...scene.progress import Progress

JobState = Literal["running", "finished", "failed", "cancelled"]
Work = Callable[..., Iterator[Progress]]
"""Function at the top level of a module, so that the new process can import it by name."""

_MAX_MESSAGE_BYTES = 1 << 24
_NICENESS = 10  # on POSIX systems; keeps the window responsive
_OUT_OF_MEMORY = "the machine ran out of memory: close other programs, or work with smaller images or fewer Gaussians"


class WorkerProcess:
    """A function running in another process. Call `poll` once a frame."""

    def __init__(self, title: str, work: Work, *arguments: Any) -> None:
        """Start at once. Arguments must be picklable; pass large ones by file. Raises any error of process creation."""
        context = multiprocessing.get_context("spawn")
        self.title = title
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Starting")
        self.error: str | None = None
        """Error in one line; `details` has the traceback."""
        self.details: str | None = None
        self._messages, theirs = context.Pipe(duplex=False)
        self._image = SharedImage()
        arguments = (theirs, self._image.name, work, arguments)
        self._process = context.Process(target=_run, args=arguments, daemon=True)
        try:
            self._process.start()
        except BaseException:
            self._messages.close()
            self._image.close()
            raise
        finally:
            theirs.close()
        self._silence = WorkerWatchdog(self._process.pid or 0)
        self._said = self.progress.message

    @property
    def waitable(self) -> Connection:
        """Connection for `multiprocessing.connection.wait`: ready on a message or when the worker has ended."""
        return self._messages

    def poll(self) -> None:
        """Process the worker's messages since the last call; never blocks."""
        if self.state != "running":
            return
        try:
            while self.state == "running" and self._messages.poll():
                self._take(receive_message(self._messages, _MAX_MESSAGE_BYTES))
        except (EOFError, OSError):
            self._process.join(timeout=1.0)
            if self.state == "running":
                self._fail(_death(self._process.exitcode), None)
        if (pixels := self._image.take()) is not None:
            self.progress = self.progress._replace(preview=pixels)
        if self.state == "running":
            self._tell_silence()

    def cancel(self) -> None:
        """Terminate the worker without waiting for it; unfinished work is lost."""
        if self.state == "running":
            self._process.terminate()
            if psutil.POSIX and self._process.pid is not None:
                with suppress(ProcessLookupError):  # a stopped process receives SIGTERM only after SIGCONT
                    os.kill(self._process.pid, signal.SIGCONT)
            self.state = "cancelled"

    def close(self) -> None:
        """Wait for the process to end and free its resources; any thread may call this, once."""
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._messages.close()
        self._image.close()

    def _take(self, message: Any) -> None:
        self._silence.heard()
        if isinstance(message, Progress):
            self._said = message.message
            self.progress = message._replace(preview=self.progress.preview)
        elif message is None:
            self.progress = Progress(1.0, "Done", self.progress.preview)
            self.state = "finished"
        else:
            self._fail(*message)

    def _tell_silence(self) -> None:
        words = self._silence.words
        message = f"{self._said} ({words})" if words else self._said
        if message != self.progress.message:
            self.progress = self.progress._replace(message=message)

    def _fail(self, error: str, details: str | None) -> None:
        self.state, self.error, self.details = "failed", error, details


def _death(exit_code: int | None) -> str:
    """Describe the end of a process that sent no error."""
    if exit_code is not None and exit_code == -getattr(signal, "SIGKILL", 9):
        return f"the worker was killed: by hand, or because {_OUT_OF_MEMORY}"
    if exit_code is not None and exit_code < 0:
        return f"the worker died of {_signal_name(-exit_code)}"
    return f"the worker died (exit code {exit_code})"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _run(messages: Connection, picture_name: str, work: Work, arguments: tuple[Any, ...]) -> None:
    """Run the work in the new process; send Progress for each step, None at the end, (line, traceback) on failure."""
    if psutil.POSIX:
        psutil.Process().nice(_NICENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    picture = SharedImage(picture_name)
    try:
        for progress in work(*arguments):
            if progress.preview is not None:
                picture.write(progress.preview)
            messages.send(progress._replace(preview=None))
        messages.send(None)
    except BrokenPipeError:
        pass  # the window closed the pipe
    except Exception as error:
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
    said = str(error) or type(error).__name__
    if isinstance(error, MemoryError) or "out of memory" in said or "can't allocate memory" in said:
        return f"{_OUT_OF_MEMORY} ({said})"
    return sentence_of(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"


# Latest preview in shared memory, read without blocking

_MAX_PIXELS = 1024 * 768
_SLOT_BYTES = 3 * _MAX_PIXELS
_NUMBERS = 7  # number of the latest image; then for each of two slots the number of its image, its height and its width


class SharedImage:
    """Two slots that a writer fills in turn; a reader copies the latest.

    The process that creates it frees it; another one attaches by `name`.
    """

    def __init__(self, name: str | None = None) -> None:
        size = 8 * _NUMBERS + 2 * _SLOT_BYTES
        self._memory = SharedMemory(name, create=name is None, size=size if name is None else 0)
        self._is_own, self._is_closed = name is None, False
        self._accept = 0

    @property
    def name(self) -> str:
        return self._memory.name

    def write(self, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
        """Publish an image; larger ones are scaled down."""
        shrink = np.sqrt(pixels.shape[0] * pixels.shape[1] / _MAX_PIXELS)
        if shrink > 1:
            size = max(1, int(pixels.shape[1] / shrink)), max(1, int(pixels.shape[0] / shrink))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        numbers = self._numbers()
        number = int(numbers[0]) + 1
        slot = number % 2
        numbers[1 + 3 * slot] = 0  # invalidates the slot for a reader that is copying it
        self._pixels(slot, pixels.shape[0], pixels.shape[1])[:] = pixels
        numbers[1 + 3 * slot : 4 + 3 * slot] = number, pixels.shape[0], pixels.shape[1]
        numbers[0] = number

    def take(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """Copy the latest image; None if it was read before."""
        if self._is_closed:
            return None
        numbers = self._numbers()
        number = int(numbers[0])
        slot = number % 2
        found, height, width = numbers[1 + 3 * slot : 4 + 3 * slot].tolist()
        if number == self._accept:
            return None
        if found != number or not 0 < height * width <= _MAX_PIXELS:
            return None  # it is being overwritten: the next call finds a newer one
        pixels = self._pixels(slot, height, width).copy()
        if int(numbers[1 + 3 * slot]) != number:
            return None
        self._accept = number
        return pixels

    def close(self) -> None:
        """Close the memory; its creator frees it. Further calls do nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._memory.close()
            if self._is_own:
                self._memory.unlink()

    @property
    def _bytes(self) -> memoryview:
        assert self._memory.buf is not None, "closed"
        return self._memory.buf

    def _numbers(self) -> Int64[np.ndarray, " numbers"]:
        # Created anew each time: memory referenced by an array can't be closed.
        return np.frombuffer(self._bytes, np.int64, _NUMBERS)

    def _pixels(self, slot: int, height: int, width: int) -> UInt8[np.ndarray, "h w 3"]:
        first = 8 * _NUMBERS + slot * _SLOT_BYTES
        flat = np.frombuffer(self._bytes, np.uint8, 3 * height * width, first)
        return flat.reshape(height, width, 3)


# Watchdog

_LONG_S = 60.0  # minimum silence to report; few steps of any job take longer
_LOOKED_AT_EVERY_S = 2.0


class WorkerWatchdog:
    """Describes the silence of a worker process, which may be busy or stopped."""

    def __init__(self, pid: int, now: Callable[[], float] = monotonic) -> None:
        """`now` is a monotonic clock in seconds."""
        self._pid, self._now = pid, now
        self._heard_s = self._looked_s = now()
        self._is_stopped = False

    def heard(self) -> None:
        """Note a message from the worker, which ends its silence."""
        self._heard_s, self._is_stopped = self._now(), False

    @property
    def words(self) -> str:
        """Description of a long silence, or "". Changes once a minute at most."""
        now = self._now()
        if now - max(self._heard_s, self._looked_s) > _LOOKED_AT_EVERY_S:
            self._looked_s, self._is_stopped = now, _is_stopped(self._pid)
        if self._is_stopped:
            return f"process {self._pid} is stopped: kill -CONT {self._pid} lets it go on"
        minutes = int((now - self._heard_s) / _LONG_S)
        return f"no news for {minutes} min" if minutes else ""


def _is_stopped(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_STOPPED
    except psutil.Error:
        return False  # the process is gone; its pipe reports that


# Termination


def install_sigterm_handler() -> None:
    """In a worker: unwind on SIGTERM, so that files such as videos are closed properly."""
    signal.signal(signal.SIGTERM, _leave)


def _leave(*_: object) -> None:
    sys.exit(1)
