"""How long recolouring takes, stage by stage, on pictures whose colours are known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from gsrain_engine.raster.rasterizer import rasterize
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.progress import finished
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.srgb import linear_to_srgb, srgb_to_linear

from .recolor_scene import recolor_scene
from .settings import RecolorSettings
from .views import TargetView

_DARKER = np.array([0.5, 0.55, 0.62])
"""Share of light that the pictures keep, by channel: about what an overcast sky and wet ground leave."""
_HALF_HEIGHT = 0.5
"""From here down pictures are darker still, as wet ground is: no map of all colours alike explains them."""
_WET_SHARE = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoloringTimes:
    """What one recolouring took."""

    scene: str
    gaussians: int
    seen: int
    """Gaussians that some view shows: the unknowns are their harmonics."""
    views: int
    width: int
    height: int
    iterations: int
    seconds: float
    stages_s: dict[str, float]
    """Set-up (looking from every view), choosing (how far to trust), solving, measuring."""
    iteration_ms: float
    """Solving over iterations: one forward and one transposed pass over all views."""
    weights_mb: float
    """Memory of all views' blending weights."""
    psnr_before_db: float
    """Mean over the views, of the clear scene against the pictures."""
    psnr_db: float
    """And of the recoloured one."""


def time_recoloring(
    scene: Scene, cameras: Sequence[tuple[float, Camera]], settings: RecolorSettings
) -> RecoloringTimes:
    """Recolour a scene to darkened pictures of itself; cameras are in the world (metres), each with its moment in s.

    Raises ValueError where no camera sees anything of the scene.
    """
    targets = [
        TargetView(f"view {number}", camera, time_s, darkened(rasterize(scene.parts(time_s), camera).rgba[..., :3]))
        for number, (time_s, camera) in enumerate(cameras)
    ]
    recolored = finished(recolor_scene(scene, targets, (), settings))
    return RecoloringTimes(
        scene=scene.name,
        gaussians=scene.gaussian_count,
        seen=len(recolored.setup.problem.rows),
        views=len(targets),
        width=targets[0].camera.width,
        height=targets[0].camera.height,
        iterations=len(recolored.lengths),
        seconds=sum(recolored.seconds.values()),
        stages_s=dict(recolored.seconds),
        iteration_ms=1000 * recolored.seconds["solving"] / max(len(recolored.lengths), 1),
        weights_mb=recolored.weights_mb,
        psnr_before_db=float(np.mean([view.psnr_clear_db for view in recolored.views])),
        psnr_db=float(np.mean([view.psnr_db for view in recolored.views])),
    )


def darkened(picture: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """Return a picture (display colour) with less light, and still less in its lower half."""
    light = _DARKER * srgb_to_linear(np.clip(picture, 0, 1).astype(np.float64))
    light[int(_HALF_HEIGHT * len(light)) :] *= _WET_SHARE
    return np.clip(linear_to_srgb(light), 0, 1).astype(np.float32)
