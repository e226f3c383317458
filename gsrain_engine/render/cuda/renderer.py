"""CUDA renderer: scene and rain with gsplat on an NVIDIA GPU, for data-center GPUs with hardly any graphics pipeline.

gsplat has the same conventions as the other renderers: 0.3 px^2 of dilation, alpha cut at 1/255 and at most 0.999, end
at a transmittance of 1e-4 (Ye et al. 2025). This renderer has been tested only on torch's CPU with a stand-in for
gsplat based on our own rasterizer (tests/render/cuda/gsplat_stand_in.py), not with gsplat or a GPU.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from ...rain.simulation import RainFrame
from ...scene.camera import Camera
from ...scene.scene import DrawItem
from ..cpu.projection import DILATION_PX2, NEAR_M, project
from ..renderer import Frame, RenderMode, RenderStatistics, Stopwatch
from .gaussians import CameraSpace, CudaArrays, Tensor
from .rain import DepthSlabs, composite_rain_slabs, slab_edge_channels, split_into_depth_slabs

torch: Any = import_module("torch")
_MIN_WEIGHT = 0.5  # minimum alpha of pixels with depth, as in the other renderers


class CudaRenderer:
    """Renders scene and rain into one image.

    Args:
        rasterize: `gsplat.rasterization`, or a function with the same signature.
        device: torch device, such as "cuda".
    """

    name = "cuda"

    def __init__(self, rasterize: Callable[..., tuple[Tensor, Tensor, dict[str, Any]]], device: str) -> None:
        self.statistics = RenderStatistics()
        self._rasterize = rasterize
        self._device = device
        self._arrays = CudaArrays(device)
        self._frame: tuple[Tensor, Tensor | None] | None = None

    @property
    def device_name(self) -> str:
        return torch.cuda.get_device_name() if self._device.startswith("cuda") else self._device

    def draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        look: RenderMode = "splats",
    ) -> None:
        """Draw parts and rain as one compositing; `read` returns the image.

        `camera` is in the world (meters). The scene is sorted exactly; rain is inserted in slabs of depth, see
        `composite_rain_slabs`. Depth is the scene's own.

        Raises:
            ValueError: For any render mode except "splats".
        """
        if look != "splats":
            raise ValueError(f"the cuda back end shows splats only; look at {look} with --backend opengl or cpu")
        self.statistics = RenderStatistics(stages_ms={"project": 0.0, "draw": 0.0, "rain": 0.0})
        falling = rain if rain is not None and len(rain.gaussians) else None
        with self._timed("project"):
            scene = self._arrays.before_camera(list(parts), camera)
        slabs: DepthSlabs | None = None
        if falling is not None:
            with self._timed("rain"):
                drops = DrawItem(falling.gaussians, np.eye(4))
                slabs = split_into_depth_slabs(project([drops], camera, [np.ones(drops.drawn_count, np.bool_)]))
        with self._timed("draw"):
            image, alpha = self._composited(scene, camera, slabs)
            rgba = torch.cat([image[..., :3], alpha], dim=-1)
            depth = _expected_depth(image[..., 3], alpha[..., 0]) if with_depth else None
        if falling is not None and slabs is not None:
            with self._timed("rain"):
                rgba = composite_rain_slabs(rgba, image[..., 4:], slabs, falling)
            self.statistics.drops_drawn, self.statistics.haze_drawn = falling.drops_drawn, falling.haze_drawn
            self.statistics.splats_drawn += len(slabs.shapes)
        drawn = sum(part.drawn_count for part in parts)
        self.statistics.gaussians = drawn + (len(falling.gaussians) if falling is not None else 0)
        self._frame = rgba, depth
        self._arrays.release_unused()

    def read(self) -> Frame:
        assert self._frame is not None, "draw before reading the picture"
        rgba, depth = self._frame
        return Frame(rgba.cpu().numpy(), depth.cpu().numpy() if depth is not None else None)

    def _composited(self, scene: CameraSpace, camera: Camera, slabs: DepthSlabs | None) -> tuple[Tensor, Tensor]:
        """Blend color, depth and, for rain, one channel per slab edge: (h, w, 4 + edges) and alpha (h, w, 1)."""
        depths = scene.means[:, 2]
        channels = [scene.colors, depths[:, None], *([slab_edge_channels(depths, slabs)] if slabs is not None else [])]
        colors = torch.cat(channels, dim=1)
        if not len(depths):  # gsplat rejects an empty scene
            blank = torch.zeros((camera.height, camera.width, colors.shape[1] + 1), device=self._device)
            return blank[..., :-1], blank[..., -1:]
        intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
        images, alphas, found = self._rasterize(
            means=scene.means,
            quats=scene.quaternions,
            scales=scene.scales,
            opacities=scene.opacities,
            colors=colors,
            viewmats=torch.eye(4, device=self._device)[None],  # already in the camera's frame
            Ks=torch.tensor(intrinsics, device=self._device)[None],
            width=camera.width,
            height=camera.height,
            near_plane=NEAR_M,
            eps2d=DILATION_PX2,
        )
        self.statistics.splats_drawn = int((found["radii"] > 0).all(dim=-1).sum())
        return images[0], alphas[0]

    def _timed(self, stage: str) -> "_SynchronizedStopwatch":
        return _SynchronizedStopwatch(self.statistics.stages_ms, stage, self._device)


class _SynchronizedStopwatch(Stopwatch):
    """Waits for the device at the end of a stage, so that stage times don't overlap."""

    def __init__(self, stages: dict[str, float], stage: str, device: str) -> None:
        super().__init__(stages, stage)
        self._device = device

    def __exit__(self, *_: object) -> None:
        if self._device.startswith("cuda"):
            torch.cuda.synchronize()
        super().__exit__()


def _expected_depth(weighted: Tensor, weight: Tensor) -> Tensor:
    return torch.where(weight > _MIN_WEIGHT, weighted / torch.clamp(weight, min=_MIN_WEIGHT), 0.0)
