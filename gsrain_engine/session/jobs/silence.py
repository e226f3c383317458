"""How long a worker has said nothing, in words: it may think long, or somebody has stopped its process."""

from collections.abc import Callable
from time import monotonic

import psutil

_LONG_S = 60.0
"""Few steps of any job take longer."""
_LOOKED_AT_EVERY_S = 2.0


class Silence:
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
