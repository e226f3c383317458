"""Opens the `cuda` back end where there is a GPU, torch and gsplat; none of them is imported before that."""

import importlib.util
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.members import Part

if TYPE_CHECKING:
    from .cuda_renderer import CudaRenderer

_NEEDED = ("torch", "gsplat")


class NoCudaError(OSError):
    """gsplat can't draw on this machine; says what is missing and how to get it."""


def open_cuda_renderer() -> "CudaRenderer":
    """Make the renderer and draw one Gaussian with it: gsplat compiles its kernels with nvcc at its first use.

    Raises:
        NoCudaError: When torch, gsplat or the GPU is missing, or gsplat fails.
    """
    for name in _NEEDED:
        if importlib.util.find_spec(name) is None:
            raise NoCudaError(f"the cuda back end needs {name}, which is not installed: pip install 'gsrain[cuda]'")
    torch: Any = import_module("torch")
    if not torch.cuda.is_available():
        raise NoCudaError("the cuda back end needs an NVIDIA GPU, and torch sees none: use --backend cpu or opengl")
    try:
        gsplat: Any = import_module("gsplat")
        from .cuda_renderer import CudaRenderer

        renderer = CudaRenderer(gsplat.rasterization, "cuda")
        renderer.draw([_one_gaussian()], Camera(16, 16, 16.0, 16.0, 8.0, 8.0))
        renderer.read()
    except Exception as error:  # compilers and drivers fail in their own ways: whatever they say goes into the message
        raise NoCudaError(
            f"gsplat can't draw here; it needs the CUDA toolkit (nvcc) of torch's version: {error}"
        ) from error
    return renderer


def _one_gaussian() -> Part:
    f = np.float32
    color = sh_from_color(np.full((1, 3), 0.5, f))
    axes = np.array([[1, 0, 0, 0]], f)
    return Part(Gaussians(np.array([[0, 0, 2]], f), np.full((1, 3), 0.1, f), axes, np.ones(1, f), color), np.eye(4))
