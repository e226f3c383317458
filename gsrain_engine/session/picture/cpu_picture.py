"""The processor's pictures as textures, once its kernels are compiled; compiling happens in the background."""

import logging
import threading
from typing import get_args

import moderngl
import numpy as np

from gsrain_engine.kernel_cache import mark_kernels
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall, View
from gsrain_engine.raster.cpu_renderer import CpuRenderer
from gsrain_engine.raster.projection import FEW
from gsrain_engine.render.look import Look
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.drawing_order import put_into_drawing_order
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.members import Part

logger = logging.getLogger("gsrain")


class CpuPicture:
    """A CPU renderer and the texture its pictures go to."""

    def __init__(self, context: moderngl.Context) -> None:
        self.renderer = CpuRenderer()
        self._context = context
        self._texture: moderngl.Texture | None = None
        self._compiled = threading.Event()
        self._is_compiling = False
        self.has_failed = False
        """Whether the kernels can't be compiled, so that it will never be ready."""

    def compile(self) -> None:
        """Begin to compile the kernels, or to load them, in the background; once."""
        if not self._is_compiling:
            self._is_compiling = True
            threading.Thread(target=self._compile, name="compile kernels", daemon=True).start()

    @property
    def is_ready(self) -> bool:
        """Whether drawing will not have to wait for a compiler."""
        return self._compiled.is_set()

    def upload(self) -> moderngl.Texture:
        """Bring the renderer's last picture into a texture."""
        rgba = self.renderer.read().rgba
        size = (rgba.shape[1], rgba.shape[0])
        if self._texture is None or self._texture.size != size:
            if self._texture is not None:
                self._texture.release()
            self._texture = self._context.texture(size, 4, dtype="f4")
            self._texture.filter = moderngl.NEAREST, moderngl.NEAREST
        self._texture.write(np.ascontiguousarray(rgba))
        return self._texture

    def _compile(self) -> None:
        try:
            compile_kernels()
        except Exception:  # OpenGL goes on drawing, slower: the window must not end over this
            self.has_failed = True
            logger.exception("The processor's kernels can't be compiled; OpenGL draws instead")
        else:
            self._compiled.set()


def compile_kernels() -> None:
    """Draw one Gaussian, and many, in every way there is, so that each kernel is compiled (or read from the cache)."""
    one = _balls(1)
    camera = Camera(32, 32, 32.0, 32.0, 16.0, 16.0)
    renderer, parts = CpuRenderer(), [Part(one, np.eye(4))]
    for degree in (1, 4, 9, 16):
        renderer.draw([Part(one.with_sh(np.zeros((1, degree, 3), np.float32)), np.eye(4))], camera, with_depth=True)
    renderer.draw([Part(_balls(FEW), np.eye(4))], camera)
    view = View(camera, np.eye(4), np.zeros(3))
    for mixing in ("linear", "display"):
        rain = Rain(intensity_mm_h=1.0, rain_light=mixing)
        renderer.draw(parts, camera, Rainfall.start(rain).at(0.0, view))
    put_into_drawing_order(one)
    for look in get_args(Look):
        renderer.draw(parts, camera, look=look)
    mark_kernels()


def _balls(count: int) -> Gaussians:
    """Gaussians in front of a camera at the origin, all in one place."""
    means, quaternions = np.zeros((count, 3), np.float32), np.zeros((count, 4), np.float32)
    means[:, 2], quaternions[:, 0] = 2, 1
    scales, opacities = np.full((count, 3), 0.1, np.float32), np.ones(count, np.float32)
    return Gaussians(means, scales, quaternions, opacities, np.zeros((count, 1, 3), np.float32))
