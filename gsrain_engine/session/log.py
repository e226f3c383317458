"""The last log records, for the window to show: the same that the command line prints."""

import logging
import traceback
from collections import deque
from datetime import datetime
from typing import NamedTuple

from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.untrusted.printable import escaped

_logger = logging.getLogger("gsrain")


class LogLine(NamedTuple):
    """One record as a person reads it."""

    level: int
    """As in `logging`: 20 information, 30 warning, 40 error."""
    text: str
    at: datetime
    """Local time."""
    details: str = ""
    """Traceback, where there is one."""


class LogLines(logging.Handler):
    """Keeps the newest records of the program's loggers."""

    def __init__(self, most: int = 500) -> None:
        super().__init__(logging.INFO)
        self.lines: deque[LogLine] = deque(maxlen=most)

    def emit(self, record: logging.LogRecord) -> None:
        details = "".join(traceback.format_exception(*record.exc_info)) if record.exc_info else ""
        at = datetime.fromtimestamp(record.created)
        self.lines.append(LogLine(record.levelno, escaped(record.getMessage()), at, details))


def told(what: str, error: Exception) -> str:
    """Log what went wrong, with a traceback where it is our own fault; returns it in one sentence."""
    foreseen = isinstance(error, SceneFormatError | OSError | MemoryError | ValueError)
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    sentence = reason if isinstance(error, SceneFormatError) else f"{what}: {reason}"
    _logger.error("%s", sentence, exc_info=error if not foreseen else None)
    return sentence
