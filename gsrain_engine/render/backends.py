"""Which renderer draws: OpenGL on a GPU, the processor elsewhere."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import Literal

from gsrain_engine.raster.cpu_renderer import CpuRenderer

from .context import NoOpenGLError, is_software, open_context
from .renderer import Renderer
from .splat_renderer import SplatRenderer

Backend = Literal["auto", "opengl", "cpu", "cuda"]


@contextmanager
def open_renderer(backend: Backend = "auto") -> Generator[Renderer]:
    """Open a renderer without a window for as long as the block runs.

    auto takes OpenGL where a GPU executes it. A software rasterizer would draw the same picture on the same processor
    several times slower than the `cpu` back end does, which also needs no OpenGL at all.

    Raises `NoOpenGLError` when OpenGL was asked for and can't be had.
    """
    if backend == "cpu":
        yield CpuRenderer()
        return
    try:
        context = open_context()
    except NoOpenGLError:
        if backend == "opengl":
            raise
        yield CpuRenderer()
        return
    with context:
        if backend == "auto" and is_software(context):
            yield CpuRenderer()
        else:
            yield SplatRenderer(context)
