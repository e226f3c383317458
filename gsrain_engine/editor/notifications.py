"""The last log records, for the window to show: the same that the command line prints."""

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
        self.lines.append(LogLine(record.levelno, escape_invisible(record.getMessage()), at, details))


def describe_error(what: str, error: Exception) -> str:
    """Log what went wrong, with a traceback where it is our own fault; returns it in one sentence."""
    foreseen = isinstance(error, SceneFormatError | OSError | MemoryError | ValueError)
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    sentence = reason if isinstance(error, SceneFormatError) else f"{what}: {reason}"
    _logger.error("%s", sentence, exc_info=error if not foreseen else None)
    return sentence


# § What the session asks a person, one question after the other, and what happens on each answer.


@dataclass(frozen=True)
class Answer:
    """One button."""

    label: str
    run: Callable[[], None]
    help: str = ""
    """One sentence: what happens then."""


@dataclass(frozen=True)
class Question:
    """A question that has to be answered before anything else."""

    title: str
    text: str
    answers: tuple[Answer, ...]
    """The first is what Enter means, the last, which changes nothing, what Escape means."""
    progress: Callable[[], Progress] | None = None
    """Progress of the work that it is about, asked for in each frame."""
    enter_answers: bool = True
    """Whether Enter gives the first answer; not where that would end work."""


def do_nothing() -> None:
    """Do nothing: what Cancel means."""


class Questions:
    """A queue. Whoever draws the window shows the first one and hands back what was answered."""

    def __init__(self) -> None:
        self._waiting: tuple[Question, ...] = ()

    @property
    def present(self) -> Question | None:
        """What a person is asked now."""
        return self._waiting[0] if self._waiting else None

    def ask(self, question: Question) -> None:
        """Ask a person, after what was asked before; the same is not asked twice at once."""
        if all((each.title, each.text) != (question.title, question.text) for each in self._waiting):
            self._waiting = (*self._waiting, question)

    def before_replacing(self, paths: Sequence[Path], write: Callable[[], None]) -> None:
        """Write at once where none of the files is there yet, else when a person says so."""
        there = [path for path in paths if path.exists()]
        if there:
            self.ask(_replace_question(there, write))
        else:
            write()

    def withdraw(self, question: Question) -> None:
        """Ask no more: what the question is about has settled itself."""
        self._waiting = tuple(each for each in self._waiting if each is not question)

    def answer(self, answer: Answer) -> None:
        self._waiting = self._waiting[1:]
        answer.run()


def _replace_question(there: Sequence[Path], write: Callable[[], None]) -> Question:
    """Ask whether files that are there already may be written over; `write` does it."""
    are = "are" if len(there) > 1 else "is"
    listed = ", ".join(path.name for path in there[:3]) + (f" and {len(there) - 3} more" if len(there) > 3 else "")
    yes = Answer("Replace", write, "Write over what is there.")
    return Question(
        "Replace?", f"{listed} {are} there already.", (yes, Answer("Cancel", do_nothing, "Leave it as it is."))
    )
