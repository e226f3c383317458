"""A document with the work around it: jobs, what a person is asked and prefers, a capture beside it."""

from concurrent.futures import ThreadPoolExecutor

import msgspec

from gsrain_engine.rain.rain import Rain
from gsrain_engine.scene.scene import Scene

from .capture.capture_view import CaptureView
from .document.viewed_document import ViewedDocument
from .jobs.background_job import BackgroundJob
from .log import told
from .preferences.kept_preferences import KeptPreferences
from .preferences.preferences import Preferences
from .questions import Answer, Question, Questions, nothing
from .view.texture import Texture


class Desk(ViewedDocument):
    """What the parts of a session know of it: they are given the desk that they lie on."""

    def __init__(self, scene: Scene, rain: Rain | None, files: ThreadPoolExecutor) -> None:
        """Begin with a scene; `files` is the thread where reading and writing happens."""
        super().__init__(scene, rain)
        self.jobs: list[BackgroundJob] = []
        """Those that run and those that have ended, in the order of their start, until a person clears them."""
        self.previews: dict[BackgroundJob, Texture] = {}
        """What running jobs show of their work."""
        self.statistics: dict[str, float] = {}
        """Figures of the last frame, by name: the Statistics panel shows them in this order."""
        self.captures = CaptureView()
        self.questions = Questions()
        self._preferences = KeptPreferences(files)
        if self._preferences.trouble is not None:
            self.questions.ask(Question("Preferences", self._preferences.trouble, (Answer("OK", nothing),)))

    @property
    def running_jobs(self) -> list[BackgroundJob]:
        """Jobs that have not ended."""
        return [job for job in self.jobs if job.state == "running"]

    def start(self, job: BackgroundJob) -> None:
        """Look after a job from now on."""
        self.jobs.append(job)

    def clear_jobs(self) -> None:
        """Forget the jobs that have ended."""
        self.jobs = self.running_jobs

    @property
    def preferences(self) -> Preferences:
        """Settings of the program, whatever the scene."""
        return self._preferences.value

    def prefer(self, **fields: object) -> None:
        """Change preferences and keep them; what is out of bounds is told in `problem`."""
        try:
            self._preferences.change(**fields)
        except msgspec.ValidationError as error:
            self.problem = told("That can't be preferred", error)
