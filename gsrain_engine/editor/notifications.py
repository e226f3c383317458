"""Log lines, error messages, and questions for the window."""

import logging
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from ..safe_io.text_files import escape_invisible
from ..scene.files import SceneFormatError
from ..scene.progress import Progress

_logger = logging.getLogger("gsrain")


class LogLine(NamedTuple):
    """A log record for display."""

    level: int
    """As in `logging`: 20 information, 30 warning, 40 error."""
    text: str
    at: datetime
    """Local time."""
    details: str = ""
    """Traceback, if any."""


class LogLines(logging.Handler):
    """Log handler that keeps the newest records of the program."""

    def __init__(self, most: int = 500) -> None:
        super().__init__(logging.INFO)
        self.lines: deque[LogLine] = deque(maxlen=most)

    def emit(self, record: logging.LogRecord) -> None:
        details = "".join(traceback.format_exception(*record.exc_info)) if record.exc_info else ""
        at = datetime.fromtimestamp(record.created)
        self.lines.append(LogLine(record.levelno, escape_invisible(record.getMessage()), at, details))


def describe_error(what: str, error: Exception) -> str:
    """Log an error, with a traceback if it is unexpected; return it as one sentence."""
    is_expected = isinstance(error, SceneFormatError | OSError | MemoryError | ValueError)
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    sentence = reason if isinstance(error, SceneFormatError) else f"{what}: {reason}"
    _logger.error("%s", sentence, exc_info=None if is_expected else error)
    return sentence


# Questions


@dataclass(frozen=True)
class Answer:
    """A button of a question."""

    label: str
    run: Callable[[], None]
    help: str = ""
    """One sentence about the consequence."""


@dataclass(frozen=True)
class Question:
    """A question that blocks everything else until it is answered."""

    title: str
    text: str
    answers: tuple[Answer, ...]
    """Enter chooses the first, Escape the last, which changes nothing."""
    progress: Callable[[], Progress] | None = None
    """Progress of the work in question, called in each frame."""
    enter_answers: bool = True
    """True if Enter gives the first answer; False if that would end work."""


def do_nothing() -> None:
    """Action of Cancel."""


class Questions:
    """Queue of questions. The window draws the first one and returns its answer."""

    def __init__(self) -> None:
        self._waiting: tuple[Question, ...] = ()

    @property
    def present(self) -> Question | None:
        return self._waiting[0] if self._waiting else None

    def ask(self, question: Question) -> None:
        """Append a question, unless an equal one is waiting."""
        if all((each.title, each.text) != (question.title, question.text) for each in self._waiting):
            self._waiting = (*self._waiting, question)

    def before_replacing(self, paths: Sequence[Path], write: Callable[[], None]) -> None:
        """Write at once if none of the files exists, otherwise after confirmation."""
        there = [path for path in paths if path.exists()]
        if not there:
            write()
            return
        are = "are" if len(there) > 1 else "is"
        listed = ", ".join(path.name for path in there[:3]) + (f" and {len(there) - 3} more" if len(there) > 3 else "")
        answers = (
            Answer("Replace", write, "Write over what is there."),
            Answer("Cancel", do_nothing, "Leave it as it is."),
        )
        self.ask(Question("Replace?", f"{listed} {are} there already.", answers))

    def withdraw(self, question: Question) -> None:
        """Remove a question that no longer applies."""
        self._waiting = tuple(each for each in self._waiting if each is not question)

    def answer(self, answer: Answer) -> None:
        self._waiting = self._waiting[1:]
        answer.run()
