"""The job that films a finished drive: save the document aside, draw the drive in another process, say where it is."""

import logging
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from gsrain_engine.backends import open_renderer
from gsrain_engine.drive.playback.played_rollout import PlayedRollout
from gsrain_engine.drive.rollouts.json_lines import read_rollout, write_rollout
from gsrain_engine.drive.rollouts.rollout import Rollout
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..jobs.copied_scene_job import CopiedSceneJob
from ..jobs.orderly_end import end_files_when_told
from ..jobs.worker import Job
from ..log import told

logger = logging.getLogger("gsrain")


class DriveFilmJob(CopiedSceneJob):
    """One film, as `gsrain drive` makes it."""

    def __init__(
        self, scene: Scene, rollout: Rollout, film: Path, fps: float, files: ThreadPoolExecutor, known: KnownFiles
    ) -> None:
        title = f"Film {film.name}"
        super().__init__(title, scene, known, files, partial(_started, title, rollout, film, fps))
        self._film = film

    def _said(self, error: Exception) -> str:
        return told(f"{self._film} can't be filmed", error)

    def _take(self, last: Progress) -> None:
        logger.info("Filmed the drive %s", self._film)


def _started(title: str, rollout: Rollout, film: Path, fps: float, copy: Path) -> Job:
    beside = copy.parent / "rollout.jsonl"
    write_rollout(beside, rollout)
    return Job(title, film_in_worker, copy, beside, film, fps)


def film_in_worker(scene_folder: Path, rollout: Path, film: Path, fps: float) -> Iterator[Progress]:
    """Film as work of another process; told to end, it ends the film first.

    Raises:
        ValueError: Where the scene has no rig, or not what the roll-out shows.
        OSError: When the film can't be written.
    """
    # Matplotlib loads slowly: not before the first film.
    from gsrain_engine.drive.playback.drive_film import film_drive
    from gsrain_engine.drive.playback.drive_video import DriveVideo

    end_files_when_told()
    yield Progress(0.0, "Reading the scene")
    played = PlayedRollout(read_rollout(rollout), open_to_draw(str(scene_folder)))
    with open_renderer() as renderer:
        yield from film_drive(film, DriveVideo(played, renderer), fps)
