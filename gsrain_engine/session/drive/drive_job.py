"""The job that drives: save the document aside, drive through the copy in another process, open what came of it."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

from gsrain_engine.drive.scenario.scenario import Scenario
from gsrain_engine.rain.rain import Rain
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..jobs.copied_scene_job import CopiedSceneJob
from ..jobs.worker import Job
from .drive_wishes import DriveWishes
from .drive_work import drive_in_worker, rollout_files
from .opened_rollout import OpenedRollout, open_rollout

Reading = Future[list[OpenedRollout]]


class DriveJob(CopiedSceneJob):
    """One drive, or one in each of several rains."""

    def __init__(
        self,
        scene: Scene,
        scenario: Scenario,
        wishes: DriveWishes,
        rains: Sequence[Rain],
        files: ThreadPoolExecutor,
        known: KnownFiles,
        take: Callable[[Reading], None],
    ) -> None:
        """Start; `take` gets the roll-outs while they are being read."""
        title = f"Drive {scenario.name} with {wishes.agent}"
        work = partial(_started, title, scenario, wishes, tuple(rains))
        super().__init__(title, scene, known, files, work)
        self._count, self._hand_over = len(rains), take

    def _take(self, last: Progress) -> None:
        # The folder is removed by the same thread, behind this.
        self._hand_over(self._folder.do(lambda folder: _read(folder, self._count)))


def _started(title: str, scenario: Scenario, wishes: DriveWishes, rains: tuple[Rain, ...], copy: Path) -> Job:
    return Job(title, drive_in_worker, copy, scenario, wishes, rains)


def _read(folder: Path, count: int) -> list[OpenedRollout]:
    return [open_rollout(path, is_own=False) for path in rollout_files(folder, count)]
