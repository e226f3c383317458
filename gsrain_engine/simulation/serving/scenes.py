"""Scenes in rain that a server draws for other programs, from any pose, with road users where the others say.

Poses are in the world, meters and z up. A picture depends on its request alone: neither on earlier ones nor on those of
other clients.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, UInt8

from ...backends import open_renderer
from ...choices import Backend
from ...rain.simulation import RainSimulation
from ...render.draw import draw
from ...render.frame_input import FrameInput, Mount, Quality
from ...render.level_of_detail import LodCut, lod_cut
from ...render.renderer import Renderer
from ...render.sky_color import SkyColor, sky_color
from ...render.view import RenderView, ego_view
from ...scene.camera import DEFAULT_EXPOSURE_S, Camera
from ...scene.geometry import quaternions_from_matrices
from ...scene.recorded_drive import logical_cameras
from ...scene.scene import PoseTrack, RigCamera, Scene
from ...water.glass import CameraMotion

Pose = Float64[np.ndarray, "4 4"]

_FASTEST_M_S = 100.0
_PAST_S = 5.0  # for which moving objects go on backward with the speed of their two poses, for the spray behind them


class RequestError(Exception):
    """A request that can't be answered: the name of gRPC's status, and one sentence that names the field."""

    def __init__(self, status: str, text: str) -> None:
        super().__init__(text)
        self.status = status
        self.text = text


@dataclass(frozen=True, slots=True, eq=False)
class ServedScene:
    """A scene with its rain, which requests name by its id."""

    id: str
    scene: Scene
    rainfall: RainSimulation
    sky: SkyColor
    cut: LodCut | None

    @property
    def cameras(self) -> dict[str, RigCamera]:
        """Cameras of its rigs by the names that AlpaSim uses."""
        return logical_cameras(self.scene)


class Moment(NamedTuple):
    """Start and end of a frame, and the poses of its sensor at its start and end."""

    start_s: float
    end_s: float
    start: Pose
    end: Pose

    def at(self, part: float) -> tuple[float, Pose]:
        """Time and pose of the sensor at a part, 0..1, of the frame."""
        time_s = self.start_s + part * (self.end_s - self.start_s)
        pose = track_through(self, self.start, self.end, has_past=False).pose(time_s)
        return time_s, self.start if pose is None else pose

    @property
    def velocity_m_s(self) -> Float64[np.ndarray, "3"]:
        return _velocity(self, self.start, self.end)


class ServedScenes:
    """Scenes and the renderer that draws them. Use it from one thread."""

    def __init__(self, backend: Backend) -> None:
        """Open the renderer; raises what `open_renderer` does. Call `close` in the end."""
        self._opened = open_renderer(backend)
        self.renderer: Renderer = self._opened.__enter__()
        self.scenes: dict[str, ServedScene] = {}

    def add(self, name: str, scene: Scene, rainfall: RainSimulation) -> None:
        """Add a scene; its sky is measured at the start of its drive, so that all pictures agree on it."""
        cut = lod_cut(scene, None)
        pose = scene.ego_to_world(float(scene.ego.times[0])) if scene.ego is not None and len(scene.ego.times) else None
        place = np.eye(4) if pose is None else pose
        world_to_camera = np.linalg.inv(place @ _FORWARD)
        sky = sky_color(self.renderer, scene, Camera.from_fov(64, 48, 45.0, world_to_camera), thinning=cut)
        self.scenes[name] = ServedScene(name, scene, rainfall, sky, cut)

    def close(self) -> None:
        self._opened.__exit__(None, None, None)

    def served(self, scene_id: str) -> ServedScene:
        """Scene of an id; "*" is the only one. Raises `RequestError` if there is none."""
        if scene_id == "*" and len(self.scenes) == 1:
            return next(iter(self.scenes.values()))
        if scene_id not in self.scenes:
            known = ", ".join(self.scenes)
            raise RequestError("NOT_FOUND", f"scene_id: there is no scene {scene_id[:80]!r}, only {known}")
        return self.scenes[scene_id]

    def view(
        self, served: ServedScene, scene: Scene, camera: Camera, pose: Pose, turn: Float64[np.ndarray, "3 3"],
        time_s: float, moment: Moment, mounted: RigCamera | None,
    ) -> UInt8[np.ndarray, "a b 3"]:  # fmt: skip
        """One picture, as the camera stores it, of a `scene` whose actors are in their places.

        `turn` is the rotation of the camera from its pose; `mounted` is the camera on the vehicle, if there is one.
        """
        facing = pose.copy()
        facing[:3, :3] = pose[:3, :3] @ turn
        exposure_s = DEFAULT_EXPOSURE_S if mounted is None else mounted.exposure_s
        camera = replace(camera, world_to_camera=np.linalg.inv(facing), exposure_s=exposure_s)
        velocity = moment.velocity_m_s
        view = RenderView(camera, time_s, velocity) if scene.ego is None else ego_view(scene, camera, time_s)
        own = None if mounted is None else mounted.camera_to_ego[:3, :3] @ turn

        def past(then_s: float) -> CameraMotion:
            return CameraMotion(facing[:3, :3], velocity, facing[:3, 3] + (then_s - time_s) * velocity)

        mount = Mount(past=past, camera_to_vehicle=own)  # metered anew: a picture must not depend on others
        frame = FrameInput.of(scene, served.rainfall, served.sky, view, Quality(thinning=served.cut), mount=mount)
        return draw(self.renderer, frame).read_uint8()


_FORWARD = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
"""Axes of a camera that looks along x of a frame with z up."""


def _velocity(moment: Moment, start: Pose, end: Pose) -> Float64[np.ndarray, "3"]:
    """Velocity between two poses of a frame; 0 for a frame without duration, or a jump."""
    seconds = moment.end_s - moment.start_s
    velocity = (end[:3, 3] - start[:3, 3]) / seconds if seconds > 0 else np.zeros(3)
    return velocity if np.linalg.norm(velocity) <= _FASTEST_M_S else np.zeros(3)


def track_through(moment: Moment, start: Pose, end: Pose, *, has_past: bool = True) -> PoseTrack:
    """Track through the two poses of a frame, in the world; with a past, at constant velocity before and after."""
    if moment.end_s <= moment.start_s:
        return PoseTrack.standing(start)
    rows = [(moment.start_s, start, start[:3, 3]), (moment.end_s, end, end[:3, 3])]
    if has_past:
        step = _PAST_S * _velocity(moment, start, end)
        before = (moment.start_s - _PAST_S, start, start[:3, 3] - step)
        rows = [before, *rows, (moment.end_s + _PAST_S, end, end[:3, 3] + step)]
    turns = quaternions_from_matrices(np.stack([pose[:3, :3] for _, pose, _ in rows]))
    return PoseTrack(
        np.array([time for time, _, _ in rows]),
        np.stack([place for _, _, place in rows]),
        np.asarray(turns, np.float64),
        np.ones(len(rows), np.bool_),
    )


def scene_ids(names: Sequence[str]) -> list[str]:
    """Names of scenes made different by numbers."""
    found: list[str] = []
    for name in names:
        number, unused = 2, name
        while unused in found:
            unused, number = f"{name}-{number}", number + 1
        found.append(unused)
    return found
