"""HUGSIM's two named pipes, `obs_pipe` and `plan_pipe`, with a watch over who is at their other ends.

A message has neither length nor version: whoever writes opens, writes and closes, whoever reads does so to the end.
"""

import errno
import os
import time
from collections.abc import Callable
from pathlib import Path

from gsrain_engine.untrusted.limits import (
    ByteBudget,
    Deadline,
    InputError,
    TooLargeError,
    open_pipe,
    read_pipe,
    write_pipe,
)

from ..agents.client_error import ClientError

OBSERVATIONS, PLANS = "obs_pipe", "plan_pipe"
_LONGEST_PAUSE_S = 0.02
_MOMENTS = 25
"""Pauses in which a client that has let go of a pipe may end: why it did is told then."""
_ROOM_BYTES = 1 << 20


class Patience:
    """How long to wait for a client, and whether there still is one to wait for."""

    def __init__(self, seconds: float, ended: Callable[[], str | None]) -> None:
        """Begin to wait now; `ended` says how the client ended, in a clause, none while it runs or is not known."""
        self.deadline, self._ended = Deadline(seconds), ended

    def check(self, done: str) -> None:
        """Raise ClientError where it makes no sense to wait on until it has `done` something."""
        ended = self._ended()
        if ended is not None:
            raise ClientError(f"the client {ended} before it had {done}")
        if not self.deadline.left_s:
            raise self.late(done)

    def late(self, done: str) -> ClientError:
        """Return the error of a client that has not `done` something in time, however much of it has come."""
        return ClientError(f"the client has not {done} within {self.deadline.seconds:g} s")

    def failed(self, done: str, why: str) -> ClientError:
        """Return the error of a client that has left a pipe: that it ended, if that is why, else `why`."""
        for _ in range(_MOMENTS):
            try:
                self.check(done)
            except ClientError as ended:
                return ended
            time.sleep(_LONGEST_PAUSE_S)
        return ClientError(why)


class Pipes:
    """The pipes in a folder; made where they are missing, since either side may come first."""

    def __init__(self, folder: Path) -> None:
        """Make ready. Raises ClientError where there can be no pipes."""
        if not hasattr(os, "mkfifo"):
            raise ClientError("this system has no named pipes, by which HUGSIM's clients are spoken to")
        folder.mkdir(parents=True, exist_ok=True)
        self._observations, self._plans = folder / OBSERVATIONS, folder / PLANS
        for path in (self._observations, self._plans):
            try:
                os.mkfifo(path)
            except FileExistsError:
                if not path.is_fifo():
                    raise ClientError(f"{path} is there, and it is no pipe: move it away") from None
            except OSError as problem:
                raise ClientError(f"no pipe can be made: {problem}") from None

    def send(self, message: memoryview | bytes, patience: Patience) -> None:
        """Write a message for the client; done when it has taken all but what a pipe holds.

        Raises ClientError where it does not come for it, leaves in the midst of it, or ends.
        """
        pipe = self._reached(patience)
        try:
            _widen(pipe)
            write_pipe(pipe, message, patience.deadline, lambda: patience.check("read the observation"))
        except TimeoutError:
            raise patience.late("read the observation") from None
        except BrokenPipeError:
            raise patience.failed(
                "read the observation", "the client closed obs_pipe before it had read the observation"
            ) from None
        finally:
            os.close(pipe)

    def receive(self, patience: Patience, most_bytes: int) -> bytes:
        """Read the client's reply to its end.

        Raises ClientError where none comes, where it is longer than allowed, or where the client ends.
        """
        try:
            pipe = open_pipe(self._plans, os.O_RDONLY)
        except OSError as problem:
            raise ClientError(f"the pipe can't be opened: {problem}") from None
        try:
            budget = ByteBudget(most_bytes, self._plans)
            reply = read_pipe(pipe, budget, patience.deadline, lambda: patience.check("answered"))
        except TimeoutError:
            raise patience.late("answered") from None
        except TooLargeError:
            raise ClientError(f"the client answers more than {most_bytes} bytes") from None
        finally:
            os.close(pipe)
        if not reply:
            raise patience.failed("answered", "the client opened plan_pipe and closed it without an answer")
        return reply

    def _reached(self, patience: Patience) -> int:
        """Open for writing once there is somebody who reads; there is no way to be told, so it is tried."""
        pause = 0.0005
        while True:
            try:
                return open_pipe(self._observations, os.O_WRONLY)
            except OSError as problem:
                if isinstance(problem, InputError) or problem.errno != errno.ENXIO:
                    raise ClientError(f"the pipe can't be opened: {problem}") from None
            patience.check("opened obs_pipe")
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE_S)


def _widen(pipe: int) -> None:
    """Let the pipe hold more at once, where the system can: a message is megabytes."""
    import fcntl  # Windows has none: there is no way here on it, but this file can be read

    resize = getattr(fcntl, "F_SETPIPE_SZ", None)
    if resize is not None:
        try:
            fcntl.fcntl(pipe, resize, _ROOM_BYTES)
        except OSError:
            return
