"""Simulated sensors: camera views of the scene in rain from the moving ego vehicle, and semantic labels."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, UInt8, UInt16

from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.draw import draw
from ..render.frame_input import FILTERS, CameraMemory, FrameInput, Mount, Quality
from ..render.level_of_detail import LodCut
from ..render.object_labels import draw_labels
from ..render.passes.spray import has_spray
from ..render.provenance import PictureProvenance, provenance_of
from ..render.renderer import PendingImage, Renderer
from ..render.sky_color import SkyColor, sky_color
from ..render.view import RenderView
from ..scene.camera import Camera
from ..scene.objects import coco_class
from ..scene.rolling_shutter import rotation_of
from ..scene.scene import Actor, RigCamera, Scene
from ..water.glass import CameraMotion, PastMotion
from .agents.base import CameraView, SensorRequirements, front_camera


class RigRenderer:
    """Renders the cameras that an agent needs. One rain simulation spans the whole drive."""

    def __init__(
        self,
        renderer: Renderer,
        rain: RainSettings,
        cameras: Sequence[RigCamera],
        needs: SensorRequirements,
        cut: LodCut | None = None,
    ) -> None:
        """Use a renderer that must stay open as long as this object is in use.

        Images are drawn with a level-of-detail `cut`, but for agents that need depth, which is exact.
        """
        self._renderer, self._cameras, self._needs = renderer, cameras, needs
        self._cut = None if needs.depth else cut
        self._rainfall = RainSimulation.start(rain)
        self._sky: SkyColor | None = None
        self._memory = CameraMemory()
        self.provenance: dict[str, PictureProvenance] = {}
        """Of the first picture of each camera."""
        self._drive: list[_RigMotion] = []

    def views(
        self, scene: Scene, rig_to_world: Float64[np.ndarray, "4 4"], velocity_m_s: Float64[np.ndarray, "3"],
        yaw_rate_rad_s: float, time_s: float,
    ) -> dict[str, CameraView]:  # fmt: skip
        """Render the cameras at a scene time. `velocity_m_s` is the velocity of the rig origin in the world."""
        drawn: dict[str, Callable[[], CameraView]] = {}
        self._drive.append(_RigMotion(time_s, rig_to_world, velocity_m_s, yaw_rate_rad_s))
        for mounted in self._cameras:
            camera = self._drive[-1].camera(mounted)
            if self._sky is None:  # computed once, so that all cameras and frames agree
                self._sky = sky_color(self._renderer, scene, camera, thinning=self._cut)
            velocity = self._drive[-1].of(mounted).velocity_m_s
            semantic = instances = None
            if self._needs.semantic:
                labels = draw_labels(self._renderer, scene, camera, time_s)
                semantic = semantic_ids(scene)[labels]
                layers = len(scene.layers)
                instances = np.where(labels > layers, labels - layers, 0).astype(np.uint16)
            mount = Mount(self._memory, mounted.name, self._past(mounted), mounted.camera_to_ego[:3, :3])
            view = RenderView(camera, time_s, velocity)
            frame = FrameInput.of(scene, self._rainfall, self._sky, view, Quality(thinning=self._cut), mount=mount)
            if mounted.name not in self.provenance:
                self.provenance[mounted.name] = provenance_of(frame)
            with_depth = self._needs.depth and not has_spray(frame)  # spray has no depth of its own
            picture = draw(self._renderer, frame.changed(quality=Quality(with_depth=with_depth, thinning=self._cut)))
            depth = np.array(picture.frame().depth) if with_depth else None
            image = picture.request_uint8()  # read back while the next picture is drawn
            if self._needs.depth and not with_depth:
                clear = frame.changed(quality=Quality(with_depth=True), is_clear=True, without=FILTERS)
                depth = np.array(draw(self._renderer, clear).frame().depth)
            drawn[mounted.name] = partial(_camera_view, image, camera, depth, semantic, instances)
        return {name: view() for name, view in drawn.items()}

    def _past(self, mounted: RigCamera) -> PastMotion:
        """Motion of a camera during the drive: that of the last step, and before the first step that of the first."""
        times = [each.time_s for each in self._drive]

        def motion(time_s: float) -> CameraMotion:
            then = self._drive[max(bisect_right(times, time_s + 1e-6) - 1, 0)]
            return then.of(mounted, time_s - then.time_s)

        return motion


def _camera_view(
    image: PendingImage,
    camera: Camera,
    depth: Float32[np.ndarray, "h w"] | None,
    semantic: UInt8[np.ndarray, "h w"] | None,
    instances: UInt16[np.ndarray, "h w"] | None,
) -> CameraView:
    return CameraView(image(), camera, depth, semantic, instances)


class _RigMotion(NamedTuple):
    """Motion of a rig at a step of the drive."""

    time_s: float
    rig_to_world: Float64[np.ndarray, "4 4"]
    velocity_m_s: Float64[np.ndarray, "3"]
    yaw_rate_rad_s: float

    def camera(self, mounted: RigCamera) -> Camera:
        """Camera in the world, which moves on during its readout."""
        half_s = mounted.readout_s / 2
        return mounted.camera(self.rig_to_world, mounted.rolling(self._pose(-half_s), self._pose(half_s)))

    def _pose(self, later_s: float) -> Float64[np.ndarray, "4 4"]:
        """Pose of the rig a time later or earlier, at constant velocity and yaw rate."""
        pose = self.rig_to_world.copy()
        turn = rotation_of(np.array([0.0, 0.0, later_s * self.yaw_rate_rad_s]))
        pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], pose[:3, 3] + later_s * self.velocity_m_s
        return pose

    def of(self, mounted: RigCamera, later_s: float = 0.0) -> CameraMotion:
        """Orientation and velocity of a camera of the rig, and its place a time later or earlier."""
        pose = self.rig_to_world @ mounted.camera_to_ego
        arm = pose[:3, 3] - self.rig_to_world[:3, 3]
        turning = self.yaw_rate_rad_s * np.array([-arm[1], arm[0], 0.0])
        return CameraMotion(pose[:3, :3], self.velocity_m_s + turning, pose[:3, 3] + later_s * self.velocity_m_s)


def rig_cameras(scene: Scene, name: str | None) -> tuple[RigCamera, ...]:
    """Return the cameras of a rig, by default the first one, or none. Raises ValueError for an unknown rig."""
    if name is None:
        return next(iter(scene.rigs.values()), ())
    if name not in scene.rigs:
        raise ValueError(f"scene {scene.name!r} has no rig {name!r}, only {', '.join(scene.rigs) or 'none'}")
    return scene.rigs[name]


def needed_cameras(cameras: Sequence[RigCamera], needs: SensorRequirements) -> tuple[RigCamera, ...]:
    """Return the cameras that an agent needs, in the order of the rig. Raises ValueError if one is missing."""
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
    """Return a camera with the same field of view at another width; the height is rounded to an even number."""
    scale = width_px / camera.width
    height = 2 * round(camera.height * scale / 2)
    return replace(
        camera, width=width_px, height=height, fx=camera.fx * scale, fy=camera.fy * scale,
        cx=camera.cx * scale, cy=camera.cy * scale,
    )  # fmt: skip


# Semantic classes: Cityscapes training ids, which HUGSIM and most driving agents use

UNKNOWN = 255

_OF_CLASS = {
    "person": 11, "rider": 12, "cyclist": 12, "car": 13, "truck": 14, "bus": 15, "train": 16, "motorcycle": 17,
    "bicycle": 18, "traffic light": 6, "stop sign": 7,
}  # fmt: skip

_OF_LAYER = {
    "road": 0, "ground": 0, "pavements": 1, "sidewalk": 1, "houses": 2, "buildings": 2, "surroundings": 2,
    "furniture": 5, "trees": 8, "vegetation": 8, "sky": 10, "parked cars": 13, "parked trucks": 14,
    "parked buses": 15, "pedestrians": 11, "bicycles": 18, "traffic lights": 6,
}  # fmt: skip
"""Layer names with a known class, including those of the built-in street."""


def semantic_ids(scene: Scene) -> UInt8[np.ndarray, " members_and_nothing"]:
    """Return the semantic id of each label of `draw_labels`; the first, for pixels without content, is sky."""
    ids = [_OF_LAYER["sky"]]
    for member in scene.members:
        if isinstance(member, Actor):
            ids.append(_OF_CLASS.get(coco_class(member.class_name), UNKNOWN))
        else:
            ids.append(_OF_LAYER["sky"] if member.kind == "sky" else _OF_LAYER.get(member.name, UNKNOWN))
    return np.array(ids, np.uint8)
