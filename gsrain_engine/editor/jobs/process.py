"""Background jobs: a generator of `Progress` in a process of its own, watched from the main thread without waiting.

Small messages travel through a pipe, the newest picture through shared memory; results travel as files. A worker that
dies is a failed job, nothing more. Workers yield the processor to the window.
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
"""A function at the top level of a module: it is found again by its name in the new process."""

_MAX_MESSAGE_BYTES = 1 << 24

_NICENESS = 10
"""On POSIX systems: the window's frames come first, and a worker has all that they leave."""

_OUT_OF_MEMORY = "the machine ran out of memory: close other programs, or work with smaller images or fewer Gaussians"


class WorkerProcess:
    """One piece of work in another process. Call `poll` once a frame."""

    def __init__(self, title: str, work: Work, *arguments: Any) -> None:
        """Start at once. The arguments must survive pickling; large ones go by file. Raises what starting raises."""
        context = multiprocessing.get_context("spawn")
        self.title = title
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Starting")
        self.error: str | None = None
        """What went wrong, as one line; `details` has the rest."""
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
        """What `multiprocessing.connection.wait` can wait for: something was said, or the worker is gone."""
        return self._messages

    def poll(self) -> None:
        """Take in what the worker has said since the last call; never waits."""
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
        """Tell the worker to stop, without waiting for it; whatever it had not finished is dropped."""
        if self.state == "running":
            self._process.terminate()
            if psutil.POSIX and self._process.pid is not None:
                with suppress(ProcessLookupError):  # one that somebody has stopped hears of its end only so
                    os.kill(self._process.pid, signal.SIGCONT)
            self.state = "cancelled"

    def close(self) -> None:
        """Wait for the process to be gone and free what it held; any thread may do this, once."""
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
    """Say what ended a process that had nothing to say itself."""
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
    """Do the work in the new process: Progress for each step, None at the end, (line, traceback) when it fails."""
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
        pass  # nobody is interested any more
    except Exception as error:
        messages.send((_sentence(error), traceback.format_exc()))
    finally:
        picture.close()
        messages.close()


def _end_with_parent() -> None:
    """End when the window is gone, killed perhaps, as if it had asked for that: nobody would take what comes out."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)


def _sentence(error: Exception) -> str:
    """What went wrong, for a person: torch tells of missing memory as a RuntimeError."""
    said = str(error) or type(error).__name__
    if isinstance(error, MemoryError) or "out of memory" in said or "can't allocate memory" in said:
        return f"{_OUT_OF_MEMORY} ({said})"
    return sentence_of(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"


# § A worker's newest picture, in memory that two processes share: the window looks when it likes, nobody waits.

_MAX_PIXELS = 1024 * 768

_SLOT_BYTES = 3 * _MAX_PIXELS

_NUMBERS = 7
"""Number of the newest picture; then for each of two slots the number of its picture, its height and its width."""


class SharedImage:
    """Two slots that a writer fills in turn; a reader takes the one that was filled last.

    The process that makes it frees it; another one attaches by `name`.
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
        """Show a picture; one that is too large is shown smaller."""
        shrink = np.sqrt(pixels.shape[0] * pixels.shape[1] / _MAX_PIXELS)
        if shrink > 1:
            size = max(1, int(pixels.shape[1] / shrink)), max(1, int(pixels.shape[0] / shrink))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        numbers = self._numbers()
        number = int(numbers[0]) + 1
        slot = number % 2
        numbers[1 + 3 * slot] = 0  # whoever reads this slot now sees that it has changed
        self._pixels(slot, pixels.shape[0], pixels.shape[1])[:] = pixels
        numbers[1 + 3 * slot : 4 + 3 * slot] = number, pixels.shape[0], pixels.shape[1]
        numbers[0] = number

    def take(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """Copy the newest picture; None where there is none that was not taken yet."""
        if self._is_closed:
            return None
        numbers = self._numbers()
        number = int(numbers[0])
        slot = number % 2
        found, height, width = numbers[1 + 3 * slot : 4 + 3 * slot].tolist()
        if number == self._accept:
            return None
        if found != number or not 0 < height * width <= _MAX_PIXELS:
            return None  # it is being written over: the next look finds a newer one
        pixels = self._pixels(slot, height, width).copy()
        if int(numbers[1 + 3 * slot]) != number:
            return None
        self._accept = number
        return pixels

    def close(self) -> None:
        """Let go of the memory; who has made it frees it. To be called once more does nothing."""
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
        # Made anew each time: memory that an array looks at can't be closed.
        return np.frombuffer(self._bytes, np.int64, _NUMBERS)

    def _pixels(self, slot: int, height: int, width: int) -> UInt8[np.ndarray, "h w 3"]:
        first = 8 * _NUMBERS + slot * _SLOT_BYTES
        flat = np.frombuffer(self._bytes, np.uint8, 3 * height * width, first)
        return flat.reshape(height, width, 3)


# § How long a worker has said nothing, in words: it may think long, or somebody has stopped its process.

_LONG_S = 60.0
"""Few steps of any job take longer."""

_LOOKED_AT_EVERY_S = 2.0


class WorkerWatchdog:
    """The silence of one process."""

    def __init__(self, pid: int, now: Callable[[], float] = monotonic) -> None:
        """`now` is a clock in seconds that never goes back."""
        self._pid, self._now = pid, now
        self._heard_s = self._looked_s = now()
        self._is_stopped = False

    def heard(self) -> None:
        """Something was said."""
        self._heard_s, self._is_stopped = self._now(), False

    @property
    def words(self) -> str:
        """What is worth telling; nothing where it is not silent for long. Changes once a minute at most."""
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
        return False  # it is gone, which its pipe tells


# § How a worker ends when it is told to: whatever it writes is closed first.


def install_sigterm_handler() -> None:
    """In a worker: unwind when the process is told to end, so that its videos are closed properly."""
    signal.signal(signal.SIGTERM, _leave)


def _leave(*_: object) -> None:
    sys.exit(1)
