"""Renderer of carla-canvas: a served scene in rain, with its road users where CARLA's are.

carla-canvas (PyPI, MIT) has the messages, the state of CARLA's world, sensor models and encodings; it calls a renderer
for pictures and lidar rays. Its frame "right_handed" is CARLA's world with y negated: x forward, y left, z up, meters.
"""

import logging
import math
from dataclasses import replace
from fnmatch import fnmatchcase
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8
from msgspec import structs

from gsrain_engine.evaluation.lidar.scan import scan_in_rain, scan_scene
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput, Quality
from gsrain_engine.render.view import RenderView, leveled_frame
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Actor, PoseTrack, RigCamera, Scene
from gsrain_engine.simulation.serving.scenes import Moment, Pose, ServedScene, ServedScenes, track_through
from gsrain_engine.water.spray import spray_of

logger = logging.getLogger("gsrain")
FRAME = "right_handed"

_STEP_S = 0.05  # before a frame, at which poses follow from velocities
_FASTEST_M_S = 100.0
_FARTHEST_M = 1e6
_EGO_HEIGHT_M = 1.5  # of the ego frame above the origin of CARLA's vehicles, which is on the ground
_SHUTTER = "200.0"  # CARLA's default of `shutter_speed`, in 1/s
_SHORTEST_S, _LONGEST_S = 1e-5, 0.1
_LARGEST_MAPPING = 1000
STEEPEST_DEG = 60.0
"""Largest elevation of a lidar's beams."""
_LIDAR_MATT = 0.2  # near-infrared reflectance of all surfaces

CLASSES: dict[str, tuple[str, ...]] = {
    "car": ("car", "van"), "van": ("van", "car"), "truck": ("truck", "bus"), "bus": ("bus", "truck"),
    "motorcycle": ("motorcycle", "cyclist"), "bicycle": ("cyclist", "bicycle"), "walker": ("pedestrian", "person"),
}  # fmt: skip
"""Classes of actors that stand for those of CARLA's blueprints (`base_type`), the best first."""

_ROAD_USERS = {name for names in CLASSES.values() for name in names}


class CanvasRenderer:
    """Renderer of one program's world. It has the attributes and methods of `carla_canvas.Renderer`."""

    name = "gsrain"
    camera_outputs = frozenset({"rgb", "depth"})
    coordinate_frame = FRAME

    def __init__(self, scenes: ServedScenes, version: str) -> None:
        self.options: dict[str, Any] = {}
        self.version = version
        self._scenes = scenes
        self._served: ServedScene | None = None
        self._to_scene = np.eye(4)
        self._actors: list[tuple[str, str]] = []
        self._missing: set[str] = set()

    @property
    def lidar_types(self) -> list[str]:
        """Blueprints of the lidars that it has rays for; the semantic one needs classes, which scenes don't have."""
        return ["sensor.lidar.ray_cast"]

    # Worlds

    def load_world(self, world: Any) -> None:
        """Choose the scene of a map: `assets.maps`, the scene of the map's name, or the only one.

        Raises `ValueError` for anything wrong in `assets` and for a map without a scene.
        """
        scenes, name = self._scenes.scenes, str(world.map_basename)
        assets = _mapping("renderer.assets", world.config.get("assets") or {}, ("maps", "actors"))
        chosen: dict[str, Any] = {}
        for pattern, row in _mapping("renderer.assets.maps", assets.get("maps") or {}).items():
            if fnmatchcase(name, pattern) or fnmatchcase(str(world.map_name), pattern):
                chosen = _mapping(f"renderer.assets.maps.{pattern}", row, ("scene", "transform"))
                break
        wanted = str(chosen.get("scene", name))
        if wanted not in scenes and len(scenes) == 1 and "scene" not in chosen:
            wanted = next(iter(scenes))
        if wanted not in scenes:
            raise ValueError(f"map {name[:80]!r}: there is no scene {wanted[:80]!r}, only {', '.join(scenes)}")
        actors = _mapping("renderer.assets.actors", assets.get("actors") or {})
        known = {actor.id for actor in scenes[wanted].scene.actors}
        rows: list[tuple[str, str]] = []
        for pattern, row in actors.items():
            asset = (
                row
                if isinstance(row, str)
                else _mapping(f"renderer.assets.actors.{pattern}", row, ("asset",)).get("asset")
            )
            if asset not in known:
                told = ", ".join(sorted(known)) or "none"
                raise ValueError(
                    f"renderer.assets.actors.{pattern}: the scene has no actor {str(asset)[:80]!r}, only {told}"
                )
            rows.append((pattern, str(asset)))
        self._to_scene = np.linalg.inv(_placement(chosen.get("transform") or {}))
        self._served, self._actors, self._missing = scenes[wanted], rows, set()

    # Pictures

    def render_camera(self, view: Any) -> Any:
        """`carla_canvas.CameraFrame` of a view: colors in rain, depth of the scene's surfaces along the view axis."""
        served = self._world()
        camera, moment, mounted = self._camera(view)
        scene = self._scene_of(view.scene, view.sensor_id, moment, mounted)
        frame = import_module("carla_canvas").CameraFrame()
        if "rgb" in view.outputs:
            frame.rgb = self._colors(served, scene, camera, moment, mounted)
        if "depth" in view.outputs:
            frame.depth = self._depth(served, scene, camera, moment)
        return frame

    def _colors(
        self, served: ServedScene, scene: Scene, camera: Camera, moment: Moment, mounted: RigCamera
    ) -> UInt8[np.ndarray, "h w 3"]:
        return self._scenes.view(served, scene, camera, moment.end, np.eye(3), moment.end_s, moment, mounted)

    def _depth(self, served: ServedScene, scene: Scene, camera: Camera, moment: Moment) -> Float32[np.ndarray, "h w"]:
        camera = replace(camera, world_to_camera=np.linalg.inv(moment.end))
        quality = Quality(with_depth=True, thinning=served.cut)
        frame = FrameInput.of(scene, None, served.sky, RenderView(camera, moment.end_s), quality)
        depth = draw(self._scenes.renderer, frame).frame().depth
        assert depth is not None
        return np.where(depth > 0, depth, np.inf).astype(np.float32)

    def _camera(self, view: Any) -> tuple[Camera, Moment, RigCamera]:
        """Camera without a pose, its poses, and how it is mounted on its vehicle."""
        given, sensor = view.camera, view.sensor_id
        turned = np.asarray(view.pose_matrix(), np.float64)
        _check_pose(f"sensor {sensor}", turned)
        pose = self._to_scene @ turned @ _CAMERA_AXES
        moment = self._moment(view, pose)
        shutter = _number(f"sensor {sensor}: shutter_speed", view.attributes.get("shutter_speed", _SHUTTER))
        exposure_s = min(max(1 / max(shutter, 1e-9), _SHORTEST_S), _LONGEST_S)
        width, height, focal = int(given.width), int(given.height), float(given.focal)
        camera = Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4), exposure_s)
        ego = self._ego(view)
        on_ego = _CAMERA_AXES if ego is None else np.linalg.inv(ego) @ pose
        mounted = RigCamera("camera", width, height, focal, focal, width / 2, height / 2, on_ego, exposure_s)
        return camera, moment, mounted

    def _ego(self, view: Any) -> Pose | None:
        """Ego frame in the scene, 1.5 m above the origin of the sensor's vehicle."""
        parent = view.parent_matrix()
        if parent is None:
            return None
        _check_pose(f"vehicle of sensor {view.sensor_id}", parent)
        up = np.eye(4)
        up[2, 3] = _EGO_HEIGHT_M
        return self._to_scene @ np.asarray(parent, np.float64) @ up

    def _moment(self, view: Any, pose: Pose) -> Moment:
        """Poses of a sensor at the frame's time and shortly before it, by the velocity of its vehicle."""
        time_s = view.scene.elapsed_seconds
        if not 0 <= time_s <= _FARTHEST_M:
            raise ValueError(f"timestamp.elapsed_seconds: must be 0 to {_FARTHEST_M:g}, not {time_s:g}")
        info = view.scene.actors.get(view.sensor_id)
        carrier = info.parent_id if info is not None and info.parent_id in view.scene.states else view.sensor_id
        return self._moving(time_s, pose, view.scene.states.get(carrier))

    def _moving(self, time_s: float, pose: Pose, state: Any) -> Moment:
        velocity = np.zeros(3) if state is None else np.array(state.velocity, np.float64) * (1, -1, 1)
        if not (np.abs(velocity) <= _FASTEST_M_S).all() or np.linalg.norm(velocity) > _FASTEST_M_S:
            velocity = np.zeros(3)
        before = pose.copy()
        before[:3, 3] -= _STEP_S * (self._to_scene[:3, :3] @ velocity)
        return Moment(time_s - _STEP_S, time_s, before, pose)

    # Road users

    def _scene_of(self, world: Any, sensor: int, moment: Moment, mounted: RigCamera | None) -> Scene:
        """The scene with CARLA's road users, but for the sensor's own vehicle; unknown ones are left out."""
        scene = self._world().scene
        to_file = np.linalg.inv(scene.scene_to_world)
        actors = [actor for actor in scene.actors if actor.class_name not in _ROAD_USERS]  # such as traffic lights
        motions: dict[str, PoseTrack] = {}
        for info, transform in world.bodies(exclude={sensor, *world.ancestors(sensor)}):
            actor = self._stand_in(scene, info)
            if actor is None:
                continue
            box, body = info.bounding_box, np.asarray(transform.matrix(FRAME), np.float64)
            _check_pose(f"actor {info.id}", body)
            bottom = np.eye(4)
            bottom[:3, 3] = box.location[0], -box.location[1], box.location[2] - box.extent[2]
            _check_pose(f"actor {info.id}: bounding_box", bottom)
            poses = self._moving(moment.end_s, self._to_scene @ body @ bottom, world.states.get(info.id))
            name = f"carla-{info.id}"
            motions[name] = track_through(poses, poses.start, poses.end).moved(to_file)
            actors.append(replace(actor, id=name, track=motions[name]))
        ego = None
        if mounted is not None and world.parent_transform(sensor) is not None:
            to_ego = np.linalg.inv(mounted.camera_to_ego)
            ego = track_through(moment, moment.start @ to_ego, moment.end @ to_ego).moved(to_file)
            motions["ego"] = ego
        return replace(scene, actors=tuple(actors), ego=ego, motions=motions)

    def _stand_in(self, scene: Scene, info: Any) -> Actor | None:
        """Actor of the scene whose Gaussians a road user gets: the named one, or that of its class and nearest size."""
        by_id = {actor.id: actor for actor in scene.actors}
        for pattern, asset in self._actors:
            if info.matches(pattern):
                return by_id[asset]
        kind = str(info.type_id)
        if not kind.startswith(("vehicle.", "walker.")):
            return None  # lights and signs are the scene's own
        base = "walker" if kind.startswith("walker.") else str(info.attributes.get("base_type", "car")).lower() or "car"
        sizes = [2 * abs(each) for each in info.bounding_box.extent]
        for name in CLASSES.get(base, ("car",)):
            found = [actor for actor in scene.actors if actor.class_name == name]
            if found:
                return min(found, key=lambda actor: _size_difference(actor, sizes))
        if kind not in self._missing:
            self._missing.add(kind)
            logger.warning("%s: the scene has no actor like it, so it is not drawn", kind)
        return None

    # Lidar

    def cast_lidar_rays(self, view: Any) -> Any:
        """`carla_canvas.RayHits` of a turn's rays in rain: ranges (infinite where nothing returns) and reflectances."""
        served = self._world()
        pose = np.asarray(view.pose_matrix(), np.float64)
        _check_pose(f"sensor {view.sensor_id}", pose)
        pose = self._to_scene @ pose
        moment = self._moment(view, pose)
        own = np.asarray(view.body_directions(), np.float64).reshape(-1, 3)
        ranges, intensities = np.full(len(own), np.inf), np.zeros(len(own))
        if len(own):
            beams = [math.degrees(math.asin(max(-1.0, min(1.0, each)))) for each in (own[:, 2].min(), own[:, 2].max())]
            if not -STEEPEST_DEG <= beams[0] <= beams[1] <= STEEPEST_DEG:
                raise ValueError(
                    f"sensor {view.sensor_id}: lower_fov, upper_fov: must be within +-{STEEPEST_DEG:g} degrees"
                )
            sensor = structs.replace(
                SENSORS["128"],
                name="CARLA's",
                elevations_deg=tuple(beams),
                farthest_m=min(max(view.max_distance, 1), 2000),
            )
            scene = self._scene_of(view.scene, view.sensor_id, moment, None)
            clear = scan_scene(scene, moment.end_s, pose, sensor, _LIDAR_MATT, own)
            anchor = leveled_frame(pose[:3, 0], pose[:3, 3])
            spray = spray_of(scene, served.rainfall, moment.end_s)
            rainy = scan_in_rain(clear, sensor, served.rainfall, anchor, spray=spray)
            found = np.linalg.norm(rainy.sweep.points_m.astype(np.float64) - rainy.sweep.origin_m, axis=1)
            seen = np.where(rainy.is_false, rainy.signals * sensor.detectable(found), clear.reflectances[rainy.beams])
            ranges[rainy.beams], intensities[rainy.beams] = found, np.clip(np.nan_to_num(seen, posinf=1.0), 0, 1)
        return import_module("carla_canvas.renderer").RayHits(ranges, intensity=intensities)

    def _world(self) -> ServedScene:
        if self._served is None:
            raise ValueError("LoadWorld comes first")
        return self._served


_CAMERA_AXES = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
"""OpenCV's axes in those of a sensor's body: x forward, y left, z up."""


def _placement(given: Any) -> Pose:
    """Scene to CARLA's world, right-handed, of `transform: {location: [x, y, z], rotation: [pitch, yaw, roll]}`."""
    fields = _mapping("renderer.assets.maps: transform", given, ("location", "rotation"))
    rows: list[tuple[float, float, float]] = []
    for name in ("location", "rotation"):
        row = fields.get(name, [0, 0, 0])
        if not isinstance(row, list) or len(row) != 3:  # pyright: ignore[reportUnknownArgumentType]
            raise ValueError(f"renderer.assets.maps: transform.{name}: must be three numbers")
        x, y, z = (_number(f"renderer.assets.maps: transform.{name}", each) for each in row)  # pyright: ignore[reportUnknownVariableType]
        rows.append((x, y, z))
    matrix = np.asarray(import_module("carla_canvas.geometry").Transform(*rows).matrix(FRAME), np.float64)
    _check_pose("renderer.assets.maps: transform", matrix)
    return matrix


def _mapping(name: str, given: Any, fields: tuple[str, ...] | None = None) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise ValueError(f"{name}: must be a mapping")
    if len(given) > _LARGEST_MAPPING:  # pyright: ignore[reportUnknownArgumentType]
        raise ValueError(f"{name}: must have at most {_LARGEST_MAPPING:,} entries")
    found: dict[str, Any] = {str(key): value for key, value in given.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    for key in found if fields is not None else ():
        if key not in (fields or ()):
            raise ValueError(f"{name}: {key[:80]!r} is not one of {', '.join(fields or ())}")
    return found


def _number(name: str, given: Any) -> float:
    try:
        found = float(given)
    except (TypeError, ValueError):
        found = math.nan
    if not math.isfinite(found):
        raise ValueError(f"{name}: must be a finite number, not {str(given)[:40]!r}")
    return found


def _check_pose(name: str, pose: Any) -> None:
    if not np.isfinite(pose).all() or np.abs(pose[:3, 3]).max() > _FARTHEST_M:
        raise ValueError(f"{name}: its transform must be finite, at most {_FARTHEST_M:g} m from the origin")


def _size_difference(actor: Actor, sizes_m: list[float]) -> float:
    pairs = zip(actor.size_lwh, sizes_m, strict=True)
    return float(sum(abs(math.log(max(own, 1e-3) / max(other, 1e-3))) for own, other in pairs))
