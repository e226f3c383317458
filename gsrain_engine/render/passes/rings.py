"""Rings: waves of drops that land in water that mirrors."""

import numpy as np

from ...rain.simulation import RainSimulation
from ...scene.scene import Scene
from ...water.films import WaterFilms
from ...water.impacts import GroundImpacts
from ...water.leveled_ground import LeveledView
from ...water.rings import RingWaves
from ..frame_input import FrameInput
from .base import FrameParts


class Rings:
    """Rings in the water before the camera, which blur what its mirror shows."""

    name, factor = "rings", None  # a part of splashes

    def active(self, frame: FrameInput) -> bool:
        return frame.reflecting_ground is not None

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        ground = frame.reflecting_ground
        assert frame.rainfall is not None and ground is not None
        parts.waves = ring_waves(frame.scene, frame.rainfall, ground.view, frame.time_s, frame.view.focal_px)


def ring_waves(
    scene: Scene, rainfall: RainSimulation, view: LeveledView, time_s: float, focal_px: float | None
) -> RingWaves | None:
    """Rings of drops that land before a camera; None where there are none."""
    if not rainfall.rain.splashes or scene.water is None:
        return None
    camera = view.camera
    ahead, focal = camera.world_to_camera[2, :2], focal_px or float(np.sqrt(camera.fx * camera.fy))
    length = float(np.hypot(*ahead))
    heading = ahead / length if length > 1e-6 else np.array([1.0, 0.0])
    depth = WaterFilms.of(rainfall, scene.water).at(time_s)
    impacts = GroundImpacts(rainfall)
    return RingWaves(impacts, time_s, depth, scene.water, camera.position, heading, view.ground_m, focal)
