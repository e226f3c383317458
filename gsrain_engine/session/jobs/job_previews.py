"""The jobs' newest preview pictures as textures. Lives in the window's OpenGL context and on its thread."""

import moderngl
import numpy as np
from jaxtyping import UInt8

from ..session import Session
from .background_job import BackgroundJob, JobPreview


class JobPreviews:
    """Keeps one texture for each job that shows something, as long as it runs."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shown: dict[BackgroundJob, tuple[UInt8[np.ndarray, "h w 3"], moderngl.Texture]] = {}

    def update(self, session: Session) -> None:
        """Bring what is new to the GPU and tell the session. Once a frame."""
        for job in [each for each in self._shown if each.state != "running"]:
            self._shown.pop(job)[1].release()
        for job in session.running_jobs:
            pixels = job.progress.preview
            if pixels is not None and (job not in self._shown or self._shown[job][0] is not pixels):
                self._shown[job] = pixels, self._texture(job, pixels)
        session.previews = {
            job: JobPreview(texture.glo, texture.width, texture.height) for job, (_, texture) in self._shown.items()
        }

    def _texture(self, job: BackgroundJob, pixels: UInt8[np.ndarray, "h w 3"]) -> moderngl.Texture:
        size = pixels.shape[1], pixels.shape[0]
        texture = self._shown[job][1] if job in self._shown else None
        if texture is not None and texture.size == size:
            texture.write(np.ascontiguousarray(pixels))
            return texture
        if texture is not None:
            texture.release()
        return self._context.texture(size, 3, np.ascontiguousarray(pixels), alignment=1)
