"""Input of gsplat and of training: arrays on their device, and a camera as arguments of `gsplat.rasterization`."""

from importlib import import_module
from typing import Any

import numpy as np

from ..scene.camera import Camera
from .cpu.splats import DILATION_PX2, nearest_m

torch: Any = import_module("torch")
Tensor = Any
"""torch is an optional dependency: this module is imported only if it is installed, and its types can't be named."""


def view_arguments(camera: Camera, device: Any) -> dict[str, Any]:
    """Arguments of `gsplat.rasterization` for a camera's image and our conventions."""
    intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    size = {"width": camera.width, "height": camera.height}
    lens = uploaded(np.array(intrinsics, np.float32), device)
    return {"Ks": lens[None], **size, "near_plane": nearest_m(camera), "eps2d": DILATION_PX2}


def uploaded(values: np.ndarray, device: Any) -> Tensor:
    """Copy an array to a device without waiting for it: on CUDA from pinned memory, which torch frees after the copy.

    For small arrays and single images: the pinned copy stays allocated for the next one.
    """
    tensor = torch.from_numpy(np.ascontiguousarray(values))
    if torch.device(device).type != "cuda":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)
