"""What the cameras of the ego vehicle see: the scene in its rain, in which the vehicle's own motion is felt."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, UInt8

from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.draw import RenderView, draw_view
from ..render.object_labels import draw_labels
from ..render.renderer import Renderer
from ..render.sky_color import SkyColor, sky_color
from ..scene.camera import Camera
from ..scene.objects import coco_class
from ..scene.scene import Actor, RigCamera, Scene
from .agents.base import CameraView, SensorRequirements, front_camera


class RigRenderer:
    """Draws for the cameras that an agent needs. One rain falls through a whole drive."""

    def __init__(
        self, renderer: Renderer, rain: RainSettings, cameras: Sequence[RigCamera], needs: SensorRequirements
    ) -> None:
        """Draw with a renderer, which stays open for as long as this is used."""
        self._renderer, self._cameras, self._needs = renderer, cameras, needs
        self._rainfall = RainSimulation.start(rain)
        self._sky: SkyColor | None = None

    def views(
        self,
        scene: Scene,
        rig_to_world: Float64[np.ndarray, "4 4"],
        velocity_m_s: Float64[np.ndarray, "3"],
        yaw_rate_rad_s: float,
        time_s: float,
    ) -> dict[str, CameraView]:
        """Draw a moment, at a time of the scene. `velocity_m_s` is the rig origin's, in the world."""
        views: dict[str, CameraView] = {}
        for mounted in self._cameras:
            camera = placed_camera(mounted, rig_to_world)
            if self._sky is None:  # taken once, so that all cameras and moments agree
                self._sky = sky_color(self._renderer, scene, camera)
            arm = camera.position - rig_to_world[:3, 3]
            velocity = velocity_m_s + yaw_rate_rad_s * np.array([-arm[1], arm[0], 0.0])
            views[mounted.name] = self._view(scene, RenderView(camera, time_s, velocity))
        return views

    def _view(self, scene: Scene, shot: RenderView) -> CameraView:
        semantic = instances = None
        if self._needs.semantic:
            labels = draw_labels(self._renderer, scene, shot.camera, shot.time_s)
            semantic = semantic_ids(scene)[labels]
            layers = len(scene.layers)
            instances = np.where(labels > layers, labels - layers, 0).astype(np.uint16)
        sky = self._sky
        assert sky is not None
        color = sky.at(self._rainfall.wetness_at(shot.time_s))
        draw_view(self._renderer, scene, self._rainfall, color, shot, with_depth=self._needs.depth)
        frame = self._renderer.read()
        depth = None if frame.depth is None else frame.depth.copy()
        return CameraView(frame.to_uint8(), shot.camera, depth, semantic, instances)


def rig_cameras(scene: Scene, name: str | None) -> tuple[RigCamera, ...]:
    """Return the cameras of a scene's rig; without a name of its first one, none where it has no rig.

    Raises ValueError for a rig that it does not have.
    """
    if name is None:
        return next(iter(scene.rigs.values()), ())
    if name not in scene.rigs:
        raise ValueError(f"scene {scene.name!r} has no rig {name!r}, only {', '.join(scene.rigs) or 'none'}")
    return scene.rigs[name]


def needed_cameras(cameras: Sequence[RigCamera], needs: SensorRequirements) -> tuple[RigCamera, ...]:
    """Return the cameras that an agent needs, in the order of the rig.

    Raises ValueError for a name that the rig does not have, and where there are no cameras at all.
    """
    names = set(needs.cameras)
    if names and not cameras:
        raise ValueError("the agent needs pictures, and the scene has no rig of cameras")
    if "front" in names:
        names = (names - {"front"}) | {front_camera(tuple(cameras)).name}
    if "all" in names:
        names = {each.name for each in cameras}
    missing = sorted(names - {each.name for each in cameras})
    if missing:
        known = ", ".join(each.name for each in cameras)
        raise ValueError(f"the agent needs camera {missing[0]}; the rig has only {known}")
    return tuple(each for each in cameras if each.name in names)


def camera_of_width(camera: RigCamera, width_px: int) -> RigCamera:
    """Return a camera that shows the same in another size; the height is rounded to a whole, even number."""
    scale = width_px / camera.width
    height = 2 * round(camera.height * scale / 2)
    return replace(
        camera, width=width_px, height=height, fx=camera.fx * scale, fy=camera.fy * scale,
        cx=camera.cx * scale, cy=camera.cy * scale,
    )  # fmt: skip


def placed_camera(mounted: RigCamera, rig_to_world: Float64[np.ndarray, "4 4"]) -> Camera:
    """Return a rig's camera in the world, metres."""
    world_to_camera = np.linalg.inv(rig_to_world @ mounted.camera_to_ego)
    return Camera(
        mounted.width, mounted.height, mounted.fx, mounted.fy, mounted.cx, mounted.cy, world_to_camera,
        mounted.exposure_s,
    )  # fmt: skip


# § Semantic classes of what a scene shows, as Cityscapes' training ids: what HUGSIM and most drivers speak.

UNKNOWN = 255

_OF_CLASS = {
    "person": 11, "rider": 12, "cyclist": 12, "car": 13, "truck": 14, "bus": 15, "train": 16, "motorcycle": 17,
    "bicycle": 18, "traffic light": 6, "stop sign": 7,
}  # fmt: skip

_OF_LAYER = {
    "road": 0, "ground": 0, "pavements": 1, "sidewalk": 1, "houses": 2, "buildings": 2, "surroundings": 2,
    "furniture": 5, "trees": 8, "vegetation": 8, "sky": 10, "parked cars": 13, "parked trucks": 14,
}  # fmt: skip
"""Names of layers that say what they show; those of the built-in street among them."""


def semantic_ids(scene: Scene) -> UInt8[np.ndarray, " members_and_nothing"]:
    """Return the semantic id of each label of `draw_labels`; the first, for pixels that show nothing, is sky."""
    ids = [_OF_LAYER["sky"]]
    for member in scene.members:
        if isinstance(member, Actor):
            ids.append(_OF_CLASS.get(coco_class(member.class_name), UNKNOWN))
        else:
            ids.append(_OF_LAYER["sky"] if member.kind == "sky" else _OF_LAYER.get(member.name, UNKNOWN))
    return np.array(ids, np.uint8)
