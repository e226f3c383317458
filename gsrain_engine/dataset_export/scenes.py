"""Scenes with a rig on a drive, and drives of scenarios, as sources of data sets."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np
from jaxtyping import UInt8

from ..datasets.geometry import OPENCV_FROM_VEHICLE_AXES, Pose, translation_pose
from ..evaluation.lidar.scan import LidarTurn, scene_turns, surface_depth
from ..evaluation.lidar.sensor import LidarSensor
from ..rain.settings import RainSettings
from ..rain.simulation import OVERCAST, RainSimulation
from ..render.draw import draw
from ..render.export_settings import DEFAULT_SIZE_PX
from ..render.label_export import instances, object_annotation
from ..render.object_labels import visible_objects
from ..render.provenance import PictureProvenance, provenance_of
from ..render.renderer import Renderer
from ..render.sequence import FrameSequence, RigCameraView, find_rig_cameras
from ..render.sky_color import SkyColor
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.objects import scene_objects
from ..scene.recorded_drive import sensor_height_m
from ..scene.scene import RigCamera, Scene
from ..simulation.agents.registry import open_agent
from ..simulation.playback import RolloutPlayback
from ..simulation.rollout import Rollout
from ..simulation.scenario import Scenario
from ..simulation.sensors import camera_of_width
from ..simulation.simulation import Simulation, run_drive
from ..simulation.video import RolloutCamera
from .source import DatasetChoice, DatasetMoment, DatasetSource, ObjectLabels, PicturesInRain, PlacedBox, Shot

DEFAULT_RATE_HZ = 2.0
"""Moments per second of scenes and scenarios: that of nuScenes' annotated samples."""

SCENARIO_DRIVER = "oracle-idm"
"""Agent that drives a scenario once, for all rains: it needs no cameras."""


Colors = UInt8[np.ndarray, "h w 3"]


class _RenderedSource(DatasetSource):
    """Labels, depth and lidar of a scene at each moment."""

    def __init__(self, sensor: LidarSensor | None) -> None:
        self._sensor = sensor
        self.has_lidar = sensor is not None
        self._rings = 1 if sensor is None else len(sensor.elevations_deg)
        self._at = lru_cache(maxsize=1)(self._scene_at)

    @abstractmethod
    def _scene_at(self, moment: int) -> tuple[Scene, float]:
        """Return the scene at a moment, and the time of scene and rain."""

    @abstractmethod
    def _camera(self, moment: int, camera: str) -> Camera:
        """Return a camera at a moment."""

    def shot(self, moment: int, camera: str) -> Shot:
        return Shot(self.moments[moment].time_s, self._camera(moment, camera))

    def boxes(self, moment: int) -> list[PlacedBox]:
        scene, time_s = self._at(moment)
        found: list[PlacedBox] = []
        for each in scene_objects(scene):
            pose = each.track.pose(time_s)
            if pose is None or not len(each.rows):
                continue
            to_world = scene.scene_to_world @ pose
            to_world[:3, :3] /= scene.metres_per_unit
            length, width, height = (scene.metres_per_unit * side for side in each.size_lwh)
            found.append(PlacedBox(each.id, each.class_name, (length, width, height), to_world))
        return found

    def labels(self, renderer: Renderer, moment: int, camera: str) -> ObjectLabels:
        scene, time_s = self._at(moment)
        lens = self._camera(moment, camera)
        visible = visible_objects(renderer, scene, scene_objects(scene), lens, time_s)
        depth = surface_depth(scene, time_s, lens)
        return ObjectLabels([object_annotation(each) for each in visible], instances(visible, lens), depth)

    def clear_turn(self, moment: int) -> LidarTurn | None:
        if self._sensor is None:
            return None
        scene, time_s = self._at(moment)
        (turn,) = scene_turns(scene, self._sensor, [time_s])
        beams = replace(turn.beams, intensities=turn.beams.reflectances.astype(np.float32), full_intensity=1.0)
        return replace(turn, beams=beams)


# Scenes


class SceneSource(_RenderedSource):
    """A scene with its recorded drive: pictures of its rig, or along its camera path where it has none."""

    kind = "scene"

    def __init__(
        self,
        scene: Scene,
        choice: DatasetChoice = DatasetChoice(),  # noqa: B008  # a value
        facts: Mapping[str, Any] | None = None,
    ) -> None:
        """Use cameras of the scene's rigs, by default those of the first one.

        Raises ValueError for a scene without rig and path, and for cameras that it lacks.
        """
        self.name, self.facts = scene.name or "scene", dict(facts or {})
        ego = scene.ego if scene.rigs and scene.ego is not None and scene.ego.valid.any() else None
        self._views: dict[str, RigCameraView | CameraPath] = {}
        super().__init__(None if ego is None else choice.sensor)
        self._size: dict[str, tuple[int, int]] = {}
        left_out: list[str] = [] if scene_objects(scene) else [f"scene {self.name!r} has no actors, so no boxes"]
        if ego is not None:
            chosen = find_rig_cameras(scene, choice.cameras or (next(iter(scene.rigs)),))
            bent = [each.name for each in chosen if _mounted(each).is_bent]
            if bent:
                left_out.append(f"lens and rolling shutter of {', '.join(bent)}: the layouts hold pinholes")
            straight = {
                name: tuple(_straight(each, choice.width_px) for each in cameras)
                for name, cameras in scene.rigs.items()
            }
            scene = replace(scene, rigs=straight)
            times = ego.times[ego.valid]
            first_s, last_s = float(times[0]), float(times[-1])
            for each in chosen:
                view = RigCameraView(scene, each.rig, each.name)
                self._views[each.name] = view
                self._size[each.name] = view.at(first_s).width, view.at(first_s).height
            if len(self._views) < len(chosen):
                raise ValueError(f"cameras: two cameras of scene {self.name!r} share a name; expected those of one rig")
        elif scene.path is not None:
            if choice.cameras:
                raise ValueError(f"cameras: scene {self.name!r} has no rig, only a camera path")
            left_out.append(f"scene {self.name!r} has no vehicle with cameras: one camera on its path, no lidar")
            first_s, last_s = scene.path.start_s, scene.path.end_s
            width, height = DEFAULT_SIZE_PX
            wide = choice.width_px or width
            self._views["FRONT"], self._size["FRONT"] = scene.path, (wide, round(height * wide / width))
        else:
            raise ValueError(f"scene {self.name!r} has neither a vehicle with cameras nor a camera path")
        rate_hz = choice.rate_hz or DEFAULT_RATE_HZ
        self._scene, self._rate, self._first_s = scene, rate_hz, first_s
        count = max(int(np.floor((last_s - first_s) * rate_hz + 1e-6)) + 1, 1)
        self.cameras, self.left_out = tuple(self._views), tuple(left_out)
        times_s = [first_s + k / rate_hz for k in range(min(count, choice.moments or count))]
        self._sequences = self._of(RainSimulation.start(RainSettings()))
        self.moments = tuple(DatasetMoment(time_s, self._vehicle(time_s)) for time_s in times_s)

    def _of(self, rainfall: RainSimulation) -> dict[str, FrameSequence]:
        return {
            name: FrameSequence(
                self._scene, rainfall, view, *self._size[name], self._rate, self._first_s, in_scene_time=True
            )
            for name, view in self._views.items()
        }

    def _vehicle(self, time_s: float) -> Pose:
        ego, above = self._scene.ego_to_world(time_s), sensor_height_m(self._scene)
        if ego is None:
            (sequence,) = self._sequences.values()
            ego = sequence.shot_at(time_s).camera.camera_to_world @ OPENCV_FROM_VEHICLE_AXES
        return ego @ translation_pose(np.array([0.0, 0.0, -above]))

    def _scene_at(self, moment: int) -> tuple[Scene, float]:
        return self._scene, self.moments[moment].time_s

    def _camera(self, moment: int, camera: str) -> Camera:
        return self._sequences[camera].shot(moment).camera

    def in_rain(self, renderer: Renderer, rain: RainSettings) -> PicturesInRain:
        return _SceneInRain(renderer, self._of(RainSimulation.start(rain)))


class _SceneInRain:
    def __init__(self, renderer: Renderer, sequences: Mapping[str, FrameSequence]) -> None:
        self._renderer, self._sequences = renderer, sequences
        self._sky: SkyColor | None = None

    def picture(self, moment: int, camera: str) -> tuple[Colors, PictureProvenance]:
        if self._sky is None:  # of the first camera, so that all agree
            first = next(iter(self._sequences.values()))
            self._sky = first.sky(self._renderer) if first.rainfall.can_rain else SkyColor(OVERCAST, found=False)
        sequence = self._sequences[camera]
        picture = sequence.image(self._renderer, moment, self._sky)
        return picture, provenance_of(sequence.frame_input(sequence.shot(moment), self._sky))


def _mounted(view: RigCameraView) -> RigCamera:
    return next(each for each in view.scene.rigs[view.rig] if each.name == view.name)


def _straight(camera: RigCamera, width_px: int | None) -> RigCamera:
    straight = replace(camera, lens=None, readout_s=0.0)
    return straight if width_px is None else camera_of_width(straight, width_px)


# Scenarios


class ScenarioSource(_RenderedSource):
    """A scenario that is driven once, in its own rain: its moments, boxes and cameras are those of all rains."""

    kind = "scenario"

    def __init__(
        self,
        scenario: Scenario,
        scene: Scene,
        choice: DatasetChoice = DatasetChoice(),  # noqa: B008  # a value
        facts: Mapping[str, Any] | None = None,
    ) -> None:
        """Drive the scenario by `SCENARIO_DRIVER`.

        Raises ValueError for a scene that lacks what the scenario needs, or has no rig, and for unknown cameras.
        """
        super().__init__(choice.sensor)
        if choice.width_px is not None:
            scenario = msgspec.structs.replace(scenario, picture_width_px=choice.width_px)
        self.name, self.facts = scenario.name, dict(facts or {})
        agent = open_agent(SCENARIO_DRIVER)
        try:
            rollout = run_drive(Simulation(scenario, scene), agent)
        finally:
            agent.close()
        self._rollout, self._base = rollout, scene
        self._played = RolloutPlayback(rollout, scene)
        rig = {each.name: each for each in self._played.rig.cameras}
        if not rig:
            raise ValueError(f"scene {scene.name!r} has no vehicle with cameras, of which the pictures could be")
        unknown = next((name for name in choice.cameras if name not in rig), None)
        if unknown is not None:
            raise ValueError(f"cameras: the rig has no camera {unknown!r}, only {', '.join(rig)}")
        self._mounted = {name: rig[name] for name in dict.fromkeys(choice.cameras or rig)}
        self.cameras = tuple(self._mounted)
        bent = [name for name, each in self._mounted.items() if each.is_bent]
        self.left_out = (f"lens and rolling shutter of {', '.join(bent)}: the layouts hold pinholes",) if bent else ()
        rate_hz = choice.rate_hz or DEFAULT_RATE_HZ
        count = int(np.floor(self._played.end_s * rate_hz + 1e-6)) + 1
        times_s = [k / rate_hz for k in range(min(count, choice.moments or count))]
        above = translation_pose(np.array([0.0, 0.0, -self._played.rig.height_m]))
        self.moments = tuple(DatasetMoment(t, self._played.rig_to_world(t) @ above) for t in times_s)

    def _scene_at(self, moment: int) -> tuple[Scene, float]:
        time_s = self.moments[moment].time_s
        return self._played.scene(time_s), self._played.scene_time_s(time_s)

    def _camera(self, moment: int, camera: str) -> Camera:
        return self._mounted[camera].camera(self._played.rig_to_world(self.moments[moment].time_s)).pinhole

    def in_rain(self, renderer: Renderer, rain: RainSettings) -> PicturesInRain:
        scenario = self._rollout.scenario | {"rain": msgspec.to_builtins(rain)}
        rollout: Rollout = msgspec.structs.replace(self._rollout, scenario=scenario)
        played = RolloutPlayback(rollout, self._base)
        return _ScenarioInRain(renderer, played, self._mounted, [each.time_s for each in self.moments])


class _ScenarioInRain:
    def __init__(
        self, renderer: Renderer, played: RolloutPlayback, mounted: Mapping[str, RigCamera], times_s: Sequence[float]
    ) -> None:
        self._renderer, self._played, self._mounted, self._times_s = renderer, played, mounted, times_s
        self._cameras: dict[str, RolloutCamera] = {}

    def picture(self, moment: int, camera: str) -> tuple[Colors, PictureProvenance]:
        if not self._cameras:  # the sky is that of the first one, so that all agree
            sky: SkyColor | None = None
            for name, each in self._mounted.items():
                self._cameras[name] = RolloutCamera(self._played, self._renderer, each, sky=sky)
                sky = self._cameras[name].sky
        frame = self._cameras[camera].frame(self._times_s[moment])
        return draw(self._renderer, frame).read_uint8(), provenance_of(frame)
