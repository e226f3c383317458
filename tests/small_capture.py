"""Views of the small street, as a camera rig that drives through it would take them: rendered, with depth and sky."""

from dataclasses import replace

import numpy as np

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene
from rasterized import rasterize
from training.small_street import small_street


def small_capture(moments: int = 4, width: int = 96, with_depth: bool = True) -> Capture:
    scene = small_street(degree=0)
    scene = replace(scene, layers=scene.layers[:2], actors=())
    views = [_view(scene, position, width, with_depth) for position in np.linspace(0, 3, moments).tolist()]
    return Capture("small street", tuple(views), ego=scene.ego)


def _view(scene: Scene, position_m: float, width: int, with_depth: bool) -> CaptureFrame:
    # Camera axes (x right, y down, z forward) of one that looks along +x of the world.
    world_to_camera = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, -position_m], [0, 0, 0, 1]])
    height = 2 * width // 3
    camera = Camera(width, height, 0.7 * width, 0.7 * width, width / 2, height / 2, world_to_camera)
    frame = rasterize(scene.parts(), camera)
    depth = np.where(frame.depth < 50, frame.depth, 0).astype(np.float32)
    return CaptureFrame(
        f"{position_m:.2f}m",
        camera,
        np.clip(np.rint(frame.rgba[..., :3] * 255), 0, 255).astype(np.uint8),
        time_s=position_m / 6,
        sensor="FRONT",
        depth_source=depth if with_depth else None,
        sky_source=frame.depth >= 50,
    )
