"""Pictures and lidar turns of scenes in rain, as AlpaSim's requests ask for them.

Poses are in the world, meters and z up. A picture depends on its request alone: neither on earlier ones nor on those of
other clients. The poses of actors are those of the request; one that it does not list is not there.
"""

import io
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import UInt8
from msgspec import structs
from PIL import Image

from gsrain_engine.evaluation.lidar.scan import scan_in_rain, scan_scene
from gsrain_engine.evaluation.lidar.sensor import SENSORS, LidarSensor
from gsrain_engine.render.view import leveled_frame
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.geometry import matrices_from_quaternions, quaternions_from_matrices
from gsrain_engine.scene.lens_faces import LensFace, assemble, lens_faces
from gsrain_engine.scene.recorded_drive import sensor_height_m, start_s, timestamps_us
from gsrain_engine.scene.rolling_shutter import ReadoutDirection, RollingShutter
from gsrain_engine.scene.scene import Actor, PoseTrack, RigCamera, Scene
from gsrain_engine.simulation.serving.scenes import Moment, Pose, RequestError, ServedScene, ServedScenes, track_through
from gsrain_engine.water.spray import spray_of

from .lenses import LensError, camera_of, write_lens
from .messages import enum_name, message

_MAX_TIME_US = 10**12
_FARTHEST_M = 1e6
_UNIT = 0.1  # that the length of a quaternion may differ from 1, as those that clients interpolate do
_LARGEST_BANDS = 32  # of a picture with a rolling shutter, each from poses of its own
_BAND_SHIFT_PX = 1.5  # that points at the near distance move from band to band
_NEAR_M = 6.0
_LIDAR_MATT = 0.2  # near-infrared reflectance of all surfaces
_ALIVE: Callable[[], bool] = lambda: True  # noqa: E731
_FORMATS = ("PNG", "JPEG", "RGB_UINT8_PLANAR")

LIDARS: dict[str, LidarSensor] = {
    "PANDAR128": SENSORS["128"],
    "AT128": structs.replace(
        SENSORS["128"], name="forward, 128 beams, 905 nm, 210 m at 10 %", range_m=210.0, azimuth_limit_deg=60.0,
        azimuth_step_deg=0.1, elevations_deg=tuple(np.linspace(-12.5, 12.9, 128).round(3).tolist()),
    ),
}  # fmt: skip
"""AlpaSim's lidars by the classes of sensors here: beams, range and field of view are the makers'."""


class Simulator(ServedScenes):
    """Scenes that answer AlpaSim's requests."""

    def picture(self, request: Any, is_active: Callable[[], bool] = _ALIVE) -> bytes:
        """Encoded picture of an `RGBRenderRequest`. Raises `RequestError`, also when the client is gone."""
        served = self.served(request.scene_id)
        if request.insert_ego_mask:
            raise RequestError("UNIMPLEMENTED", "insert_ego_mask: there are no masks of the ego vehicle")
        kind = enum_name("ImageFormat", request.image_format) if request.image_format else "PNG"
        if kind not in _FORMATS:
            raise RequestError("UNIMPLEMENTED", f"image_format: {kind} is not written, {', '.join(_FORMATS)} are")
        if not 0 <= request.image_quality <= 100:
            raise RequestError("INVALID_ARGUMENT", f"image_quality: must be 0 to 100, not {request.image_quality:g}")
        spec = request.camera_intrinsics
        width = request.resolution_w or spec.resolution_w
        height = request.resolution_h or spec.resolution_h
        try:
            camera = _camera(spec.SerializeToString(deterministic=True), width, height)
        except LensError as error:
            raise RequestError("UNIMPLEMENTED" if "support" in str(error) else "INVALID_ARGUMENT", str(error)) from None
        moment = _moment(request, served)
        return _encoded(self._drawn(served, request, camera, moment, is_active), kind, request.image_quality)

    def _drawn(
        self, served: ServedScene, request: Any, camera: Camera, moment: Moment, is_active: Callable[[], bool]
    ) -> UInt8[np.ndarray, "h w 3"]:
        spec = request.camera_intrinsics
        mounted = served.cameras.get(spec.logical_id)
        scene = _moved_scene(served, request, moment, mounted)
        direction = _ROLLING.get(enum_name("ShutterType", spec.shutter_type))  # else global, as UNKNOWN is
        if served.rainfall.rain.glass == "none" and self.renderer.draws_lenses:
            time_s, pose = moment.at(0.5)
            rolling = None if direction is None else _rolling(moment, direction)
            if not is_active():
                raise RequestError("CANCELLED", "the client is gone")
            camera = replace(camera, rolling=rolling)
            return self.view(served, scene, camera, pose, np.eye(3), time_s, moment, mounted)
        return self._assembled(served, scene, camera, direction, moment, mounted, is_active)

    def _assembled(
        self, served: ServedScene, scene: Scene, camera: Camera, direction: ReadoutDirection | None, moment: Moment,
        mounted: RigCamera | None, is_active: Callable[[], bool],
    ) -> UInt8[np.ndarray, "h w 3"]:  # fmt: skip
        """Picture put together from pinhole pictures, and from bands of a rolling shutter: with glass, or by quads."""
        has_glass = served.rainfall.rain.glass != "none"
        faces = () if camera.lens is None else lens_faces(camera)
        if has_glass and len(faces) > 1:
            raise RequestError("UNIMPLEMENTED", "camera_intrinsics: water on glass is drawn up to 124 degrees only")
        axis, is_backward = int(direction in ("right", "left")), direction in ("up", "left")
        count = _bands(camera, faces, moment) if direction is not None and not has_glass else 1
        size = (camera.height, camera.width)[axis]
        ends = np.linspace(0, size, min(count, size) + 1).astype(int).tolist()
        picture = np.zeros((camera.height, camera.width, 3), np.uint8)
        for first, last in pairwise(ends):
            middle = (first + last) / 2 / size
            time_s, pose = moment.at(1 - middle if is_backward else middle)
            part = (slice(first, last), slice(None)) if axis == 0 else (slice(None), slice(first, last))
            band, cut = (camera, faces) if len(ends) == 2 else _band(camera, faces, axis, first, last)
            if faces and not cut:
                continue
            views: list[UInt8[np.ndarray, "a b 3"]] = []
            for each, turn in [(face.camera, face.turn) for face in cut] or [(band, np.eye(3))]:
                if not is_active():
                    raise RequestError("CANCELLED", "the client is gone")
                views.append(self.view(served, scene, each, pose, turn, time_s, moment, mounted))
            picture[part] = assemble(cut, views)[part] if cut else views[0]
        return picture

    def lidar(self, request: Any) -> Any:
        """`LidarRenderReturn` of a `LidarRenderRequest`: all beams at the end of the turn, points in the sensor frame.

        Intensities are apparent reflectances, without correction for rain.
        """
        served = self.served(request.scene_id)
        kind = enum_name("LidarDeviceType", request.lidar_config.lidar_type)
        if kind not in LIDARS:
            raise RequestError("UNIMPLEMENTED", f"lidar_config.lidar_type: {kind} is not one of {', '.join(LIDARS)}")
        sensor, moment = LIDARS[kind], _moment(request, served)
        scene = _moved_scene(served, request, moment, None)
        beams = scan_scene(scene, moment.end_s, moment.end, sensor, _LIDAR_MATT)
        anchor = leveled_frame(moment.end[:3, 0], moment.end[:3, 3])
        spray = spray_of(scene, served.rainfall, moment.end_s)
        rainy = scan_in_rain(beams, sensor, served.rainfall, anchor, spray=spray)
        to_sensor = np.linalg.inv(moment.end)
        points = rainy.sweep.points_m.astype(np.float64) @ to_sensor[:3, :3].T + to_sensor[:3, 3]
        ranges = np.linalg.norm(points, axis=1)
        seen = np.where(rainy.is_false, rainy.signals * sensor.detectable(ranges), beams.reflectances[rainy.beams])
        intensities = np.clip(np.nan_to_num(seen, posinf=1.0), 0, 1).astype("<f4")
        answer = message("LidarRenderReturn")(num_points=len(points))
        answer.point_xyzs.extend(points.astype(np.float32).ravel().tolist())
        answer.point_intensities.extend(intensities.tolist())
        answer.point_xyzs_buffer = points.astype("<f4").tobytes()
        answer.point_intensities_buffer = intensities.tobytes()
        return answer

    def cameras(self, request: Any) -> Any:
        """`AvailableCamerasReturn`: the cameras of a scene's rigs, in the rig on the ground."""
        served = self.served(request.scene_id)
        up = np.eye(4)
        up[2, 3] = sensor_height_m(served.scene)
        answer = message("AvailableCamerasReturn")()
        for name, camera in served.cameras.items():
            row = answer.available_cameras.add(logical_id=name)
            spec = row.intrinsics
            spec.logical_id, spec.resolution_w, spec.resolution_h = name, camera.width, camera.height
            shutters = {direction: number for number, direction in enumerate(_ROLLING.values(), 1)}
            spec.shutter_type = shutters[camera.readout_direction] if camera.readout_s > 0 else 5  # GLOBAL
            write_lens(spec, camera)
            _write_pose(row.rig_to_camera, up @ camera.camera_to_ego)  # camera to rig, whatever its name says
        return answer

    def trajectories(self, request: Any) -> Any:
        """`AvailableTrajectoriesReturn`: the recorded drive of the rig on the ground."""
        scene = self.served(request.scene_id).scene
        answer = message("AvailableTrajectoriesReturn")()
        if scene.ego is not None and len(scene.ego.times):
            trajectory = answer.available_trajectories.add().trajectory
            down = np.eye(4)
            down[2, 3] = -sensor_height_m(scene)
            times = zip(scene.ego.times.tolist(), timestamps_us(scene.ego, scene), strict=True)
            for time_s, time_us in times:
                pose = scene.ego_to_world(time_s)
                if pose is not None:
                    _write_pose(trajectory.poses.add(timestamp_us=time_us).pose, pose @ down)
        return answer


_ROLLING: dict[str, ReadoutDirection] = {
    "ROLLING_TOP_TO_BOTTOM": "down", "ROLLING_LEFT_TO_RIGHT": "right",
    "ROLLING_BOTTOM_TO_TOP": "up", "ROLLING_RIGHT_TO_LEFT": "left",
}  # fmt: skip


def _rolling(moment: Moment, direction: ReadoutDirection) -> RollingShutter:
    try:
        return RollingShutter.between(moment.start, moment.end, moment.end_s - moment.start_s, direction)[1]
    except ValueError as error:
        raise RequestError("INVALID_ARGUMENT", f"frame_start_us, frame_end_us, sensor_pose: {error}") from None


@lru_cache(maxsize=8)
def _camera(spec: bytes, width: int, height: int) -> Camera:
    return camera_of(message("CameraSpec").FromString(spec), width, height)


def _bands(camera: Camera, faces: tuple[LensFace, ...], moment: Moment) -> int:
    """Number of bands of a rolling shutter: enough that near points move little from one to the next."""
    focal_px = max([face.camera.fx for face in faces] or [camera.fx])
    turned = moment.start[:3, :3].T @ moment.end[:3, :3]
    angle = float(np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1)))
    shift_m = float(np.linalg.norm(moment.end[:3, 3] - moment.start[:3, 3]))
    return int(np.clip(np.ceil(focal_px * (angle + shift_m / _NEAR_M) / _BAND_SHIFT_PX), 1, _LARGEST_BANDS))


def _band(
    camera: Camera, faces: tuple[LensFace, ...], axis: int, first: int, last: int
) -> tuple[Camera, tuple[LensFace, ...]]:
    """Part of a camera: of a pinhole the rows or columns alone, else the faces cut to what these are sampled from."""
    if not faces:
        if axis == 0:
            return replace(camera, height=last - first, cy=camera.cy - first), ()
        return replace(camera, width=last - first, cx=camera.cx - first), ()
    inside = np.zeros((camera.height, camera.width), np.bool_)
    inside[(slice(first, last), slice(None)) if axis == 0 else (slice(None), slice(first, last))] = True
    found: list[LensFace] = []
    for face in faces:
        covered = face.covered & inside
        if covered.any():
            columns, rows = face.columns[covered], face.rows[covered]
            left, top = (max(int(np.floor(each.min())) - 1, 0) for each in (columns, rows))
            width = min(int(np.ceil(columns.max())) + 2, face.camera.width) - left
            height = min(int(np.ceil(rows.max())) + 2, face.camera.height) - top
            cut = replace(face.camera, width=width, height=height, cx=face.camera.cx - left, cy=face.camera.cy - top)
            found.append(LensFace(cut, face.turn, face.columns - left, face.rows - top, covered))
    return camera, tuple(found)


# Poses


def _moment(request: Any, served: ServedScene) -> Moment:
    """Times and poses of a request, checked."""
    start_us, end_us = request.frame_start_us, request.frame_end_us
    if not start_us <= end_us <= _MAX_TIME_US:
        told = f"0 <= start <= end <= {_MAX_TIME_US} must hold, not {start_us} and {end_us}"
        raise RequestError("INVALID_ARGUMENT", f"frame_start_us, frame_end_us: {told}")
    if not request.HasField("sensor_pose"):
        raise RequestError("INVALID_ARGUMENT", "sensor_pose: must be set")
    start, end = _pose_pair("sensor_pose", request.sensor_pose)
    zero = start_s(served.scene)
    return Moment(zero + start_us / 1e6, zero + end_us / 1e6, start, end)


def _pose_pair(name: str, pair: Any) -> tuple[Pose, Pose]:
    """Poses at start and end of a frame; a missing one is the other."""
    found = [_pose(f"{name}.{part}", getattr(pair, part)) for part in ("start_pose", "end_pose") if pair.HasField(part)]
    if not found:
        raise RequestError("INVALID_ARGUMENT", f"{name}: start_pose or end_pose must be set")
    return found[0], found[-1]


def _pose(name: str, pose: Any) -> Pose:
    place = np.array([pose.vec.x, pose.vec.y, pose.vec.z], np.float64)
    quaternion = np.array([pose.quat.w, pose.quat.x, pose.quat.y, pose.quat.z], np.float64)
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite(place).all() or np.abs(place).max() > _FARTHEST_M:
        raise RequestError("INVALID_ARGUMENT", f"{name}.vec: must be finite, at most {_FARTHEST_M:g} m from the origin")
    if not abs(length - 1) < _UNIT:
        raise RequestError("INVALID_ARGUMENT", f"{name}.quat: must be a quaternion of length 1, not {length:g}")
    matrix = np.eye(4)
    matrix[:3, :3] = matrices_from_quaternions(quaternion / length)
    matrix[:3, 3] = place
    return matrix


def _write_pose(target: Any, pose: Pose) -> None:
    w, x, y, z = np.asarray(quaternions_from_matrices(pose[:3, :3]), np.float64).tolist()
    target.vec.x, target.vec.y, target.vec.z = pose[:3, 3].tolist()
    target.quat.w, target.quat.x, target.quat.y, target.quat.z = w, x, y, z


def _moved_scene(served: ServedScene, request: Any, moment: Moment, mounted: RigCamera | None) -> Scene:
    """The scene with actors at the poses of a request, and the ego vehicle where the camera on it says."""
    scene = served.scene
    to_scene = np.linalg.inv(scene.scene_to_world)
    by_id = {actor.id: actor for actor in scene.actors}
    actors: list[Actor] = []
    motions: dict[str, PoseTrack] = {}
    for row in request.dynamic_objects:
        actor = by_id.get(row.track_id)
        if actor is None:
            continue  # a road user of the simulator that the scene has no Gaussians of
        if actor.id in motions:
            raise RequestError("INVALID_ARGUMENT", f"dynamic_objects[{row.track_id[:40]!r}]: is listed twice")
        down = np.eye(4)
        down[2, 3] = -actor.size_lwh[2] * scene.metres_per_unit / 2  # AlpaSim's poses are of the middle of the box
        start, end = (pose @ down for pose in _pose_pair(f"dynamic_objects[{row.track_id[:40]!r}]", row.pose_pair))
        motions[actor.id] = track_through(moment, start, end).moved(to_scene)
        actors.append(replace(actor, track=motions[actor.id]))
    ego = None
    if mounted is not None:
        camera_to_ego = np.linalg.inv(mounted.camera_to_ego)
        ego = track_through(moment, moment.start @ camera_to_ego, moment.end @ camera_to_ego).moved(to_scene)
        motions["ego"] = ego
    order = {actor.id: index for index, actor in enumerate(scene.actors)}
    actors.sort(key=lambda actor: order[actor.id])
    return replace(scene, actors=tuple(actors), ego=ego, motions=motions)


def _encoded(picture: UInt8[np.ndarray, "h w 3"], kind: str, quality: float) -> bytes:
    if kind == "RGB_UINT8_PLANAR":
        return np.ascontiguousarray(picture.transpose(2, 0, 1)).tobytes()
    file = io.BytesIO()
    options: dict[str, Any] = {"quality": round(quality) or 95} if kind == "JPEG" else {"compress_level": 3}
    Image.fromarray(picture).save(file, kind, **options)
    return file.getvalue()
