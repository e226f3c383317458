"""Draws a session into a texture, frame by frame: looks at the sky, uploads staged scenes in slices, saves stills."""

import logging
import time
from collections.abc import Hashable, Iterator

import moderngl
import numpy as np

from gsrain_engine.render.context import is_software
from gsrain_engine.render.pictures import write_picture
from gsrain_engine.render.scene_view import Shot, draw_shot
from gsrain_engine.render.screen import Screen
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.render.splat_renderer import SplatRenderer

from .cpu_picture import CpuPicture
from .session import Session, StagedScene

logger = logging.getLogger("gsrain")


class LiveView:
    """What the viewport shows. Lives in the window's OpenGL context and on its thread.

    On a GPU, OpenGL draws. Where OpenGL is a software rasterizer, the processor draws the same picture by itself
    several times faster; until its kernels are compiled OpenGL stands in.
    """

    def __init__(self, context: moderngl.Context, session: Session) -> None:
        self.session = session
        self._opengl = SplatRenderer(context)
        self._cpu = CpuPicture(context) if is_software(context) else None
        self._screen = Screen(context)
        self._texture: moderngl.Texture | None = None
        self._shown: Hashable = None
        self._staged: StagedScene | None = None
        self._upload: Iterator[float] = iter(())

    def draw(self, width: int, height: int) -> moderngl.Texture:
        """Draw the present moment for a viewport of a size in pixels; the texture's first row is the picture's.

        When nothing has changed since the last call, the last texture comes back.
        """
        session = self.session
        self._go_on_uploading()
        shrink = session.view.shrink
        shot = session.shot(max(1, width // shrink), max(1, height // shrink), float(shrink))
        state = _fingerprint(session, shot, self._on_cpu)
        if self._texture is None or state != self._shown or session.sky_is_stale:
            self._texture = self._draw_anew(shot)
            self._shown = state
        self._save_screenshot(self._texture)
        return self._texture

    @property
    def is_settled(self) -> bool:
        """Whether the back end that draws is the one that will go on drawing."""
        return self._cpu is None or self._cpu.is_ready

    @property
    def last_texture(self) -> int:
        """OpenGL name of the last picture, 0 before the first."""
        return self._texture.glo if self._texture is not None else 0

    @property
    def _on_cpu(self) -> bool:
        return self._cpu is not None and self._cpu.is_ready

    def _draw_anew(self, shot: Shot) -> moderngl.Texture:
        session, started = self.session, time.perf_counter()
        cpu = self._cpu if self._cpu is not None and self._cpu.is_ready else None
        renderer = self._opengl if cpu is None else cpu.renderer
        if session.sky_is_stale:
            sky = sky_color(renderer, session.scene, shot.camera)
            session.sky, session.sky_is_stale = sky.color, False
            if not sky.found:
                logger.info("The scene shows no sky: drops take the colour of an overcast one")
        rain = draw_shot(renderer, session.scene, session.rainfall, session.sky, shot)
        picture = self._opengl.picture if cpu is None else cpu.upload()
        texture = self._screen.show(picture, session.view.background, 2.0**session.view.gain_ev)
        session.backend = renderer.name
        session.statistics = {
            "frame ms": 1000 * (time.perf_counter() - started),
            **{f"{stage} ms": value for stage, value in renderer.statistics.stages_ms.items()},
            "Gaussians": renderer.statistics.gaussians,
            "splats drawn": renderer.statistics.splats_drawn,
            "drops drawn": rain.drops_drawn if rain is not None else 0,
            "haze Gaussians": rain.haze_drawn if rain is not None else 0,
        }
        return texture

    def _go_on_uploading(self) -> None:
        """Bring the next slice of a staged scene to the GPU; when all is there, swap it in."""
        if self.session.staged is not self._staged:
            self._staged = self.session.staged
            self._upload = iter(()) if self._on_cpu else self._slices()
        if self._staged is not None and next(self._upload, None) is None:
            self._staged = None
            self.session.swap_in()

    def _slices(self) -> Iterator[float]:
        assert self._staged is not None
        scene = self._staged.scene
        for member in (*scene.layers, *scene.actors):
            yield from self._opengl.upload(member.gaussians)

    def _save_screenshot(self, texture: moderngl.Texture) -> None:
        path, self.session.screenshot = self.session.screenshot, None
        if path is None:
            return
        pixels = np.frombuffer(texture.read(), np.uint8).reshape(texture.height, texture.width, 4)
        try:
            write_picture(path, np.ascontiguousarray(pixels[..., :3]))
        except OSError as error:
            logger.error("%s: the screenshot can't be saved: %s", path, error.strerror or error)
        else:
            logger.info("Saved %s", path)


def _fingerprint(session: Session, shot: Shot, on_cpu: bool) -> Hashable:
    """Everything that a picture depends on; scenes and rains are values and compare by identity."""
    camera, view = shot.camera, session.view
    velocity = b"" if shot.velocity_m_s is None else shot.velocity_m_s.tobytes()
    raining = session.rain.intensity_mm_h > 0
    return (
        session.scene, session.rainfall if raining else None, session.sky, shot.time_s,
        camera.world_to_camera.tobytes(), camera.width, camera.height, camera.fx, velocity if raining else b"",
        view.background, view.gain_ev, on_cpu,
    )  # fmt: skip
