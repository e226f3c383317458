"""The last log records, for the window to show: the same that the command line prints."""

import logging
from collections import deque
from typing import NamedTuple


class LogLine(NamedTuple):
    """One record as a person reads it."""

    level: int
    """As in `logging`: 20 information, 30 warning, 40 error."""
    text: str


class LogLines(logging.Handler):
    """Keeps the newest records of the program's loggers."""

    def __init__(self, most: int = 500) -> None:
        """Keep at most so many lines."""
        super().__init__(logging.INFO)
        self.lines: deque[LogLine] = deque(maxlen=most)

    def emit(self, record: logging.LogRecord) -> None:
        """Take in a record."""
        self.lines.append(LogLine(record.levelno, record.getMessage()))
