"""Draws a session into a texture, frame by frame: looks at the sky, uploads staged scenes in slices, saves stills."""

import logging
import time
from collections.abc import Iterator

import moderngl
import numpy as np

from gsrain_engine.render.pictures import write_picture
from gsrain_engine.render.scene_view import draw_shot
from gsrain_engine.render.screen import Screen
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.render.splat_renderer import SplatRenderer

from .session import Session, StagedScene

logger = logging.getLogger("gsrain")


class LiveView:
    """What the viewport shows. Lives in the window's OpenGL context and on its thread."""

    def __init__(self, context: moderngl.Context, session: Session) -> None:
        self.session = session
        self._renderer = SplatRenderer(context)
        self._screen = Screen(context)
        self._staged: StagedScene | None = None
        self._upload: Iterator[float] = iter(())

    def draw(self, width: int, height: int) -> moderngl.Texture:
        """Draw the present moment; the texture's first row is the picture's first row."""
        session, started = self.session, time.perf_counter()
        self._go_on_uploading()
        if session.sky_is_stale:
            sky = sky_color(self._renderer, session.scene, session.shot(width, height).camera)
            session.sky, session.sky_is_stale = sky.color, False
            if not sky.found:
                logger.info("The scene shows no sky: drops take the colour of an overcast one")
        shot = session.shot(width, height)
        rain = draw_shot(self._renderer, session.scene, session.rainfall, session.sky, shot)
        gain = 2.0**session.view.gain_ev
        texture = self._screen.show(self._renderer.picture, session.view.background, gain)
        statistics = self._renderer.statistics
        session.statistics = {
            "frame ms": 1000 * (time.perf_counter() - started),
            **{f"{stage} ms": value for stage, value in statistics.stages_ms.items()},
            "Gaussians": statistics.gaussians,
            "splats drawn": statistics.splats_drawn,
            "drops drawn": rain.drops_drawn if rain is not None else 0,
            "haze Gaussians": rain.haze_drawn if rain is not None else 0,
        }
        self._save_screenshot(texture)
        return texture

    def _go_on_uploading(self) -> None:
        """Bring the next slice of a staged scene to the GPU; when all is there, swap it in."""
        if self.session.staged is not self._staged:
            self._staged = self.session.staged
            self._upload = self._slices()
        if self._staged is not None and next(self._upload, None) is None:
            self._staged = None
            self.session.swap_in()

    def _slices(self) -> Iterator[float]:
        assert self._staged is not None
        scene = self._staged.scene
        for member in (*scene.layers, *scene.actors):
            yield from self._renderer.upload(member.gaussians)

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
