"""The jobs' newest preview pictures as textures. Lives in the window's OpenGL context and on its thread."""

import moderngl

from ..desk import Desk
from ..jobs.background_job import BackgroundJob
from .kept_texture import KeptTexture


class JobPreviews:
    """Keeps one texture for each job that shows something, as long as it runs."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._kept: dict[BackgroundJob, KeptTexture] = {}

    def update(self, session: Desk) -> None:
        """Bring what is new to the GPU and tell the session. Once a frame."""
        for job in [each for each in self._kept if each.state != "running"]:
            self._kept.pop(job).show(None)
        for job in session.running_jobs:
            if job.progress.preview is not None:
                self._kept.setdefault(job, KeptTexture(self._context)).show(job.progress.preview)
        session.previews = {job: texture for job, kept in self._kept.items() if (texture := kept.texture) is not None}
