"""Splashes: crowns and droplets of drops that land on wet ground."""

from dataclasses import replace

import numpy as np

from ...rain.frame import RainFrame
from ...rain.simulation import RainSimulation
from ...scene.gaussians import Gaussians
from ...scene.ground_water import WetGround, ground_heights
from ...scene.scene import Scene
from ...water.films import WaterFilms
from ...water.leveled_ground import leveled_view
from ...water.splashes import Splashes
from ..frame_input import FrameInput
from .base import Factor, FrameParts


class SplashPass:
    """Splashes near the camera, where a scene has wet colors and ground of a known height."""

    name = "splashes"
    factor = Factor(name, "splashes and rings", {"splashes": False}, {"splashes": True}, needs_wet_ground=True)

    def active(self, frame: FrameInput) -> bool:
        rainfall = frame.rainfall
        if rainfall is None or frame.falling is None or frame.is_photograph:
            return False
        return has_splashes(frame.scene, rainfall, frame.wetness)

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        rain = parts.rain or frame.falling
        assert frame.rainfall is not None and rain is not None
        parts.rain = replace(rain, splashes=draw_splashes(frame.scene, frame.rainfall, rain))


def has_splashes(scene: Scene, rainfall: RainSimulation, wetness: float) -> bool:
    """Return whether drops that land are drawn: on wet ground of a known height, where a scene has wet colors."""
    is_known = scene.ground_m is not None or (scene.water is not None and scene.water.heights_m is not None)
    return rainfall.rain.splashes and wetness > 0 and is_known and scene.has_rainy_light


def draw_splashes(scene: Scene, rainfall: RainSimulation, rain: RainFrame) -> Gaussians | None:
    """Splashes on a scene's ground in front of a camera; None without any."""
    heights = wet_ground(scene, leveled_view(rain.view.camera, scene.water, scene.ground_m or 0.0).ground_m)
    found = Splashes(rainfall, rain, WaterFilms.of(rainfall, scene.water), heights).gaussians()
    return found if len(found) else None


def wet_ground(scene: Scene, ground_m: float) -> WetGround:
    """Ground on which a scene's drops splash; its height is `ground_m` outside of the map of water."""
    layers = [layer for layer in scene.layers if layer.visible and layer.wet_sh is not None]
    poses = [np.ascontiguousarray(scene.scene_to_world @ layer.to_scene) for layer in layers]
    surfaces = [(layer.gaussians, pose) for layer, pose in zip(layers, poses, strict=True)]
    return ground_heights(surfaces, ground_m, scene.water)
