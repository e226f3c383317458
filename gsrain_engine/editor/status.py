"""Status of the editor for the window: the last problem, log lines, questions, and actions that wait for work."""

import logging
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from ..safe_io.errors import SceneFormatError
from ..safe_io.text_files import escape_invisible
from ..scene.progress import PENDING, Progress

logger = logging.getLogger("gsrain")


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
    """Log an error, with a traceback if it is unexpected; return it as one sentence, after `what` failed if given."""
    is_expected = isinstance(error, SceneFormatError | OSError | MemoryError | ValueError)
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    sentence = reason if isinstance(error, SceneFormatError) else f"{what}: {reason}" if what else str(error)
    logger.error("%s", sentence, exc_info=None if is_expected else error)
    return sentence


# Questions


def do_nothing() -> None:
    """Action of Cancel."""


@dataclass(frozen=True)
class Answer:
    """A button of a question."""

    label: str
    run: Callable[[], None] = do_nothing
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


class StatusBus:
    """The last problem, the log, and the questions to the user. Only this class sets a problem."""

    def __init__(self) -> None:
        self.problem: str | None = None
        """Last error, in one sentence; the viewport shows it until it is dismissed, or a scene or capture is opened."""
        self.log = LogLines()
        self._questions: tuple[Question, ...] = ()
        logger.setLevel(logging.INFO)
        logger.addHandler(self.log)

    def report(self, error: Exception | str, what: str = "") -> None:
        """Log an error and set it as the problem, after `what` failed if that is given."""
        if isinstance(error, Exception):
            self.problem = describe_error(what, error)
        else:
            self.problem = error
            logger.error("%s", error)

    def dismiss(self) -> None:
        """Clear the problem."""
        self.problem = None

    def close(self) -> None:
        logger.removeHandler(self.log)

    @property
    def question(self) -> Question | None:
        """Question that the window draws; it blocks everything else."""
        return self._questions[0] if self._questions else None

    def ask(self, question: Question) -> None:
        """Append a question, unless an equal one is waiting."""
        if all((each.title, each.text) != (question.title, question.text) for each in self._questions):
            self._questions = (*self._questions, question)

    def ask_before_replacing(self, paths: Sequence[Path], write: Callable[[], None]) -> None:
        """Write at once if none of the files exists, otherwise after confirmation."""
        there = [path for path in paths if path.exists()]
        if not there:
            write()
            return
        are = "are" if len(there) > 1 else "is"
        listed = ", ".join(path.name for path in there[:3]) + (f" and {len(there) - 3} more" if len(there) > 3 else "")
        answers = Answer("Replace", write, "Write over what is there."), Answer("Cancel", help="Leave it as it is.")
        self.ask(Question("Replace?", f"{listed} {are} there already.", answers))

    def answer(self, answer: Answer) -> None:
        """Answer the first question."""
        self._questions = self._questions[1:]
        answer.run()

    def withdraw(self, question: Question) -> None:
        """Remove a question that no longer applies."""
        self._questions = tuple(each for each in self._questions if each is not question)


# Actions that wait for background work


@runtime_checkable
class Work(Protocol):
    """A job, or a file that is read or written."""

    @property
    def title(self) -> str: ...

    @property
    def state(self) -> str: ...

    @property
    def progress(self) -> Progress: ...

    def cancel(self) -> None: ...


class DeferredAction:
    """An action that replaces the document or ends the program, as soon as background work has ended."""

    def __init__(self, status: StatusBus) -> None:
        self._status = status
        self._work: Sequence[Work] = ()
        self._act: Callable[[], None] = do_nothing
        self._question: Question | None = None

    @property
    def is_waiting(self) -> bool:
        return self._question is not None

    def when_idle(self, jobs: Sequence[Work], tasks: Sequence[Work], what: str, act: Callable[[], None]) -> None:
        """Call `act` after work has ended; if jobs run, the user first chooses to wait or to stop them.

        `what` ends the sentence "Wait for it before you ...". Always waits for `tasks`: reading and writing of files,
        which take seconds.
        """
        self._forget()
        jobs = [each for each in jobs if each.state in PENDING]
        running = [*jobs, *(each for each in tasks if each.state in PENDING)]
        if not running:
            act()
            return
        names = " and ".join(each.title for each in running)
        them, are = ("it", "is") if len(running) == 1 else ("them", "are")
        losses = f"What {'is' if len(jobs) == 1 else 'are'} not through is lost; of a recording, the part so far stays."

        def progress() -> Progress:
            first = next((each for each in running if each.state in PENDING), running[-1])
            return first.progress._replace(message=first.title)

        def stop() -> None:
            for job in jobs:
                job.cancel()
            self.when_idle((), tasks, what, act)

        def wait() -> None:
            text = f"GSRAIN will {what} as soon as {names} {'has' if len(running) == 1 else 'have'} ended."
            cancel = Answer("Cancel", self._forget, f"Don't {what}; the work goes on.")
            answers = (Answer(f"Stop {them}", stop, losses), cancel) if jobs else (cancel,)
            self._work, self._act = running, act
            self._question = Question("Waiting", text, answers, progress, enter_answers=not jobs)
            if any(each.state in PENDING for each in running):
                self._status.ask(self._question)

        if not jobs:
            wait()
            return
        text = f"{names} {are} still at work. Wait for {them} before you {what}, or stop {them}?"
        answers = (
            Answer("Wait", wait, f"Take in the result, then {what}."),
            Answer(f"Stop {them}", stop, losses),
            Answer("Cancel", help=f"Don't {what}; the work goes on."),
        )
        self._status.ask(Question("Work goes on", text, answers, progress))

    def poll(self) -> None:
        """Run the action after its work has ended; drop it if work failed."""
        if self._question is None or any(each.state in PENDING for each in self._work):
            return
        act, has_failed = self._act, any(each.state == "failed" for each in self._work)
        self._forget()
        if not has_failed:
            act()

    def _forget(self) -> None:
        if self._question is not None:
            self._status.withdraw(self._question)
        self._work, self._act, self._question = (), do_nothing, None
