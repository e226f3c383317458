"""Services shared by the editor's parts: jobs, questions, preferences, and the open capture."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgspec

from ..rain.settings import RainSettings
from ..scene.progress import Progress
from ..scene.scene import Scene
from .capture_view import CaptureController
from .jobs.job import Job, JobRunner, ThreadTask
from .notifications import Answer, Question, Questions, describe_error, do_nothing
from .preferences import Preferences, PreferencesStore
from .viewport.options import Texture
from .viewport_state import ViewportState

Work = Job[Any] | ThreadTask[Any]


class EditorServices(ViewportState):
    """A viewport with the services shared by the editor's components."""

    def __init__(self, scene: Scene, rain: RainSettings | None, files: ThreadPoolExecutor) -> None:
        """Start with a scene; `files` is the thread for reading and writing."""
        super().__init__(scene, rain)
        self.jobs = JobRunner(files, self.report_problem)
        self.previews: dict[Job[Any], Texture] = {}
        self.statistics: dict[str, float] = {}
        """Figures of the last frame by name, in the order of the Statistics panel."""
        self.captures = CaptureController(self)
        self.questions = Questions()
        self._files = files
        self._awaited: tuple[tuple[Work, ...], Callable[[], None], Question] | None = None
        """Work, the action to run after it has ended, and the question that is open meanwhile."""
        self._preferences = PreferencesStore(files)
        if self._preferences.trouble is not None:
            self.questions.ask(Question("Preferences", self._preferences.trouble, (Answer("OK", do_nothing),)))

    # Jobs

    @property
    def why_wait(self) -> str | None:
        """Reason why no job that needs the whole machine can start now, in one sentence, or None."""
        if self.jobs.running:
            return f"Wait for {self.jobs.running[0].title}, or cancel it."
        return "Wait for the scene that is being brought into the picture." if self.staged is not None else None

    def when_idle(self, work: Sequence[Work], what: str, act: Callable[[], None]) -> None:
        """Call `act` after work has ended; if jobs run, the user first chooses to wait or to stop them.

        `what` ends the sentence "Wait for it before you ...". Always waits for reading and writing of files, which take
        seconds.
        """
        self._wait_no_more()
        running = tuple(each for each in work if each.state == "running")
        jobs = [each for each in running if isinstance(each, Job)]

        def stop() -> None:
            for job in jobs:
                job.cancel()
            self.when_idle(work, what, act)

        def wait() -> None:
            text = f"GSRAIN will {what} as soon as {names} {'has' if len(running) == 1 else 'have'} ended."
            cancel = Answer("Cancel", self._wait_no_more, f"Don't {what}; the work goes on.")
            answers = (Answer(f"Stop {them}", stop, losses), cancel) if jobs else (cancel,)
            question = Question("Waiting", text, answers, progress, enter_answers=not jobs)
            self._awaited = running, act, question
            if any(each.state == "running" for each in running):
                self.questions.ask(question)

        def progress() -> Progress:
            first = next((each for each in running if each.state == "running"), running[-1])
            return first.progress._replace(message=first.title)

        if not running:
            act()
            return
        names = " and ".join(each.title for each in running)
        them, are = ("it", "is") if len(running) == 1 else ("them", "are")
        losses = f"What {'is' if len(jobs) == 1 else 'are'} not through is lost; of a recording, the part so far stays."
        if not jobs:
            wait()
            return
        text = f"{names} {are} still at work. Wait for {them} before you {what}, or stop {them}?"
        answers = (
            Answer("Wait", wait, f"Take in the result, then {what}."),
            Answer(f"Stop {them}", stop, losses),
            Answer("Cancel", do_nothing, f"Don't {what}; the work goes on."),
        )
        self.questions.ask(Question("Work goes on", text, answers, progress))

    def _go_on_when_idle(self) -> None:
        """Run the waiting action after its work has ended; drop it if work failed."""
        work, act, _ = self._awaited or ((), do_nothing, None)
        if all(each.state != "running" for each in work):
            self._wait_no_more()
            if all(each.state != "failed" for each in work):
                act()

    def _wait_no_more(self) -> None:
        if self._awaited is not None:
            self.questions.withdraw(self._awaited[2])
            self._awaited = None

    # Preferences

    @property
    def preferences(self) -> Preferences:
        """Settings of the program, independent of the scene."""
        return self._preferences.value

    def set_preference(self, **fields: object) -> None:
        """Change and save preferences; a value out of bounds is reported in `problem`."""
        try:
            self._preferences.change(**fields)
        except msgspec.ValidationError as error:
            self.problem = describe_error("That can't be preferred", error)
