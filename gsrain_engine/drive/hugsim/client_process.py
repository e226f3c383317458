"""The other half of a HUGSIM drive as a process of our own: started, watched, and seen out."""

import os
import shlex
import signal
import subprocess
from pathlib import Path

from gsrain_engine.untrusted.limits import open_file

from ..agents.client_error import ClientError

OUTPUT = "output.txt"
"""What the client prints, in the folder of the pipes, as HUGSIM keeps it."""
_TAIL_BYTES = 2000


class ClientProcess:
    """A client started with a command line: the folder of the pipes takes the place of {folder}, else comes last.

    HUGSIM's `zsh SCRIPT CUDA_ID OUTPUT_DIR` is written "zsh SCRIPT CUDA_ID".
    """

    def __init__(self, command: str, folder: Path) -> None:
        """Start it, in a session of its own. Raises ClientError where it can't be."""
        try:
            words = shlex.split(command)
        except ValueError as problem:
            raise ClientError(f"the client's command {command!r} can't be read: {problem}") from None
        if not words:
            raise ClientError("the client's command is empty")
        placed = [word.replace("{folder}", str(folder)) for word in words]
        placed += [] if any("{folder}" in word for word in words) else [str(folder)]
        self._output = folder / OUTPUT
        try:
            with self._output.open("wb") as output:
                self._process = subprocess.Popen(
                    placed, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
                )
        except OSError as problem:
            raise ClientError(f"the client can't be started: {problem}") from None

    @property
    def ended(self) -> str | None:
        """How it ended, as a clause with its last words; none while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        how = f"with exit code {code}" if code >= 0 else f"by {_signal_name(-code)}"
        words = self._last_words()
        said = f", its last words in {self._output}: {words!r}," if words else ""
        return f"ended {how}{said}"

    def wait(self, within_s: float) -> bool:
        """Whether it has ended of itself, within a time."""
        try:
            self._process.wait(within_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def stop(self, within_s: float = 5.0) -> None:
        """End it and what it has started, if it still runs: asked first, forced after a time."""
        if self._process.poll() is not None:
            return
        for each in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(self._process.pid, each)
            except ProcessLookupError:
                break
            if self.wait(within_s):
                break
        self._process.wait()

    def _last_words(self) -> str:
        try:
            with open_file(self._output) as output:
                output.seek(max(0, os.fstat(output.fileno()).st_size - _TAIL_BYTES))
                lines = output.read(_TAIL_BYTES).decode(errors="replace").split("\n")
        except OSError:
            return ""
        return next((line.strip()[-300:] for line in reversed(lines) if line.strip()), "")


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
