"""Which renderer draws: OpenGL on a GPU, the processor elsewhere, gsplat where it is asked for."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import Literal

from gsrain_engine.raster.cpu_renderer import CpuRenderer
from gsrain_engine.raster.cuda_backend import open_cuda_renderer
from gsrain_engine.render.context import NoOpenGLError, is_software, open_context
from gsrain_engine.render.lost_context import check_context
from gsrain_engine.render.machine import processor
from gsrain_engine.render.offscreen_renderer import OffscreenRenderer
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.splat_renderer import SplatRenderer

Backend = Literal["auto", "opengl", "cpu", "cuda"]


@contextmanager
def open_renderer(backend: Backend = "auto") -> Generator[Renderer]:
    """Open a renderer without a window for as long as the block runs. Several can be open, and take turns.

    auto takes OpenGL where a GPU executes it. A software rasterizer would draw the same picture on the same processor
    several times slower than the `cpu` back end does, which also needs no OpenGL at all. `cuda` sorts rain only roughly
    in among the scene and is never taken unasked.

    Raises:
        NoOpenGLError: When OpenGL was asked for and can't be had.
        NoCudaError: When gsplat was asked for and can't draw here.
        LostContextError: When the GPU is lost while the block runs.
    """
    if backend == "cpu":
        yield CpuRenderer()
        return
    if backend == "cuda":
        yield open_cuda_renderer()
        return
    try:
        context = open_context()
    except NoOpenGLError:
        if backend == "opengl":
            raise
        yield CpuRenderer()
        return
    try:
        with context:
            renderer = CpuRenderer() if backend == "auto" and is_software(context) else OffscreenRenderer(context)
        yield renderer
    except Exception:
        with context:
            check_context(context)  # whatever goes wrong in a lost context does so because of it
        raise
    finally:
        context.release()


def device_of(renderer: Renderer) -> str:
    """Name what executes a renderer's drawing."""
    if isinstance(renderer, SplatRenderer):
        return renderer.context.info["GL_RENDERER"]
    return getattr(renderer, "device_name", None) or processor()
