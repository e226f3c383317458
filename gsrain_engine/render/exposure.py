"""One frame from several pictures: samples inside its pixels, and sub-frames of its exposure."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float32

from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.scene.scene import Scene

from .frame import Color, Frame
from .light import to_display, to_light
from .look import Look
from .renderer import Renderer
from .scene_view import Shot, draw_shot


def expose(
    renderer: Renderer,
    scene: Scene,
    rainfall: Rainfall | None,
    sky: Color,
    shots: Sequence[Shot],
    supersampling: int = 1,
    *,
    with_depth: bool = False,
    look: Look = "splats",
) -> Frame:
    """Take the mean of shots, each drawn `supersampling` times wider and higher. Depth is that of the last shot.

    The samples inside a pixel are averaged as the renderer blends: premultiplied, in display values. The sub-frames are
    averaged as a sensor adds them up: in linear light.
    """
    total: Float32[np.ndarray, "h w 4"] | None = None
    frame: Frame | None = None
    for shot in shots:
        fine = _finer(shot, supersampling)
        draw_shot(renderer, scene, rainfall, sky, fine, with_depth=with_depth, look=look)
        frame = renderer.read()
        if supersampling > 1:
            frame = replace(frame, rgba=_mean_of_blocks(frame.rgba, supersampling))
        if len(shots) > 1:
            light = to_light(frame.rgba)
            total = light if total is None else total + light
    assert frame is not None, "an exposure needs at least one shot"
    return frame if total is None else replace(frame, rgba=to_display(total / np.float32(len(shots))))


def _finer(shot: Shot, times: int) -> Shot:
    """The same shot in more pixels; which drops exist still follows from the output image's focal length."""
    if times == 1:
        return shot
    camera = shot.camera
    focal_px = shot.focal_px or float(np.sqrt(camera.fx * camera.fy))
    return replace(shot, camera=camera.resized(times * camera.width, times * camera.height), focal_px=focal_px)


def _mean_of_blocks(rgba: Float32[np.ndarray, "H W 4"], side: int) -> Float32[np.ndarray, "h w 4"]:
    height, width = rgba.shape[0] // side, rgba.shape[1] // side
    return rgba.reshape(height, side, width, side, 4).mean(axis=(1, 3), dtype=np.float32)
