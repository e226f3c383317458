"""Our rain in front of a photograph: what a renderer would give if the scene behind the rain were that picture."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, UInt8

from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.raster.cpu_renderer import CpuRenderer
from gsrain_engine.render.scene_view import Shot, rain_in
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.srgb import linear_to_srgb, srgb_to_linear

Window = tuple[int, int, int, int]
"""Left, top, width, height of a part of a picture, in pixels."""

_NO_SCENE = Scene("no scene", (), up=(0.0, 0.0, 1.0))


def cropped(camera: Camera, window: Window) -> Camera:
    """Return the camera that sees only a window of this one's picture."""
    x, y, width, height = window
    return replace(camera, cx=camera.cx - x, cy=camera.cy - y, width=width, height=height)


def rain_frames(
    background: UInt8[np.ndarray, "h w"],
    noise_levels: Float32[np.ndarray, "h w"],
    camera: Camera,
    rainfall: Rainfall,
    times_s: Sequence[float],
    drop_levels: float,
) -> Iterator[UInt8[np.ndarray, "h w"]]:
    """Render grey frames of a camera that stands still (world: metres, z up) before a background behind all rain.

    `drop_levels` is a drop's display level (0-255). With W the rain's share of a pixel as the renderer composites it,
    B the background and S the drop's light: enc((1 - W) dec(B) + W S), or mixed as display values where the rain says
    so; then white noise of the given standard deviation, seeded by the rain's seed, and whole grey levels.
    """
    shot = Shot(camera)
    display, drop = background.astype(np.float32) / 255, drop_levels / 255
    linear = rainfall.rain.rain_light == "linear"
    encode, decode = (linear_to_srgb, srgb_to_linear) if linear else (np.asarray, np.asarray)
    behind, light = decode(display), float(decode(np.array([drop]))[0])
    random = np.random.default_rng(rainfall.rain.seed)
    renderer = CpuRenderer()
    for time_s in times_s:
        renderer.draw([], camera, rain_in(_NO_SCENE, rainfall, (1.0, 1.0, 1.0), replace(shot, time_s=float(time_s))))
        share = renderer.read().rgba[..., 3]
        mixed = 255 * encode((1 - share) * behind + share * light)
        noisy = mixed + noise_levels * random.standard_normal(background.shape, np.float32)
        yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
