"""Choice of the renderer: OpenGL on a GPU, the CPU elsewhere, gsplat (CUDA) on request."""

import importlib.util
import logging
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .render.cpu.renderer import CpuRenderer
from .render.gsplat_build import ANNOUNCEMENT, gsplat_is_built
from .render.opengl.context import NoOpenGLError, check_context, is_software, open_context
from .render.opengl.renderer import SplatRenderer
from .render.renderer import Renderer, processor_name
from .scene.camera import Camera
from .scene.gaussians import Gaussians, sh_from_color
from .scene.scene import DrawItem

if TYPE_CHECKING:
    from .render.cuda import CudaRenderer

logger = logging.getLogger("gsrain")
Backend = Literal["auto", "opengl", "cpu", "cuda"]


@contextmanager
def open_renderer(backend: Backend = "auto") -> Generator[Renderer]:
    """Open a renderer without a window while the block runs. Several may be open and take turns.

    `auto` takes OpenGL if a GPU executes it. Otherwise it takes the `cpu` back end, which draws the same image several
    times faster than a software rasterizer and needs no OpenGL. `cuda` sorts rain only roughly into the scene, so
    `auto` never selects it.

    Raises:
        NoOpenGLError: When OpenGL was requested and is not available.
        NoCudaError: When gsplat was requested and can't draw here.
        LostContextError: When the GPU is lost while the block runs.
    """
    if backend in ("cpu", "cuda"):
        yield CpuRenderer() if backend == "cpu" else open_cuda_renderer()
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
            takes_cpu = backend == "auto" and is_software(context)
            renderer = CpuRenderer() if takes_cpu else SplatRenderer(context, activates=True)
        yield renderer
    except Exception:
        with context:
            check_context(context)  # the lost context is the cause of any other error
        raise
    finally:
        context.release()


def device_of(renderer: Renderer) -> str:
    """Name the device that executes a renderer's drawing."""
    if isinstance(renderer, SplatRenderer):
        return renderer.context.info["GL_RENDERER"]
    return getattr(renderer, "device_name", None) or processor_name()


# CUDA back end. It imports torch and gsplat only when it is requested.


class NoCudaError(OSError):
    """Raised if gsplat can't draw on this machine; the message names what is missing and how to get it."""


def open_cuda_renderer() -> "CudaRenderer":
    """Create the renderer and draw one Gaussian: gsplat compiles its kernels with nvcc on first use.

    Raises:
        NoCudaError: When torch, gsplat or the GPU is missing, or gsplat fails.
    """
    for name in ("torch", "gsplat"):
        if importlib.util.find_spec(name) is None:
            raise NoCudaError(f"the cuda back end needs {name}, which is not installed: pip install 'gsrain[cuda]'")
    torch: Any = import_module("torch")
    if not torch.cuda.is_available():
        raise NoCudaError("the cuda back end needs an NVIDIA GPU, and torch sees none: use --backend cpu or opengl")
    try:
        if not gsplat_is_built():
            logger.warning(ANNOUNCEMENT)
        gsplat: Any = import_module("gsplat")
        from .render.cuda import CudaRenderer

        renderer = CudaRenderer(gsplat.rasterization, "cuda")
        one, color = np.ones((1, 3), np.float32), sh_from_color(np.full((1, 3), 0.5, np.float32))
        axes = np.array([[1, 0, 0, 0]], np.float32)
        gaussian = Gaussians(one * np.array([0, 0, 2], np.float32), 0.1 * one, axes, np.ones(1, np.float32), color)
        renderer.draw([DrawItem(gaussian, np.eye(4))], Camera(16, 16, 16.0, 16.0, 8.0, 8.0))
        renderer.read()
    except Exception as error:  # compilers and drivers raise errors of many types: the message quotes them
        raise NoCudaError(
            f"gsplat can't draw here; it needs the CUDA toolkit (nvcc) of torch's version: {error}"
        ) from error
    return renderer
