"""Rain in front of photographs."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ..datasets.capture import Capture, CaptureFrame
from ..rain.frame import RainFrame, SkyLight
from ..rain.simulation import OVERCAST, RainSimulation
from ..render.draw import RenderView, ego_view, rain_camera
from ..render.renderer import Renderer
from ..scene.geometry import linear_to_srgb, srgb_to_linear
from ..scene.scene import Scene

_LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
"""World-to-camera transform that looks ahead over a road, for images without poses."""


def rain_on_photo(
    renderer: Renderer,
    world: Scene,
    rainfall: RainSimulation,
    shot: RenderView,
    photo: UInt8[np.ndarray, "h w 3"],
    sky: SkyLight = OVERCAST,
) -> UInt8[np.ndarray, "h w 3"]:
    """Composite rain over the photograph B, W its share of a pixel and S its light: enc((1-W) dec(B) + W S).

    Rain falls as if everything in the photograph were far behind it; haze is the paper's Gaussians, since a medium has
    no distances here. `world` tells the vehicle's motion.
    """
    if rainfall.state_at(shot.time_s).intensity_mm_h == 0:
        return photo
    falling = rainfall.frame(shot.time_s, rain_camera(world, rainfall, shot), sky)
    renderer.draw([], shot.camera, falling)
    return composite_on_photo(renderer.read().rgba[..., 3:], falling, photo)


def composite_on_photo(
    share: Float32[np.ndarray, "h w 1"],
    falling: RainFrame,
    photo: UInt8[np.ndarray, "h w 3"],
    kept: Float32[np.ndarray, "h w 1"] | None = None,
    airlight: Float[np.ndarray, "3"] | None = None,
) -> UInt8[np.ndarray, "h w 3"]:
    """Composite drops with a share W of each pixel over a photograph, of which a medium keeps T and adds airlight A.

    enc((1 - W) (T dec(B) + (1 - T) dec(A)) + W dec(S)), in linear light if that is how the rain adds its own.
    """
    encode, decode = (linear_to_srgb, srgb_to_linear) if falling.is_linear else (np.asarray, np.asarray)
    behind = decode(photo.astype(np.float64) / 255)
    if kept is not None and airlight is not None:
        behind = kept * behind + (1 - kept) * decode(airlight)
    mixed = encode((1 - share) * behind + share * decode(falling.color))
    return np.rint(np.clip(mixed, 0, 1) * 255).astype(np.uint8)


def photo_view(world: Scene, capture: Capture, view: CaptureFrame) -> RenderView:
    """View of the world of the rain (meters, z up) from a captured camera; a level one over a road without poses."""
    camera = view.camera
    camera = camera.moved(world.scene_to_world) if capture.has_poses else replace(camera, world_to_camera=_LEVEL)
    return ego_view(world, camera, view.time_s)
