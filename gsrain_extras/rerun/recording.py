"""Rerun export of roll-outs: the scene's points, boxes, planned points, plots, log and camera images, with a layout."""

from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import scipy
from jaxtyping import Float32, Float64, Int64, UInt8

from gsrain_engine.optional_packages import import_package
from gsrain_engine.safe_io.files import whole_file
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.drive_exports import DriveExport, FinishedDrive
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.ground import recorded_route
from gsrain_engine.simulation.metrics.collisions import gaps_m, times_to_collision_s
from gsrain_engine.simulation.rollout import CameraImage, Rollout, RolloutStep

MOST_POINTS = 150_000
"""Points that stand for a scene: its Gaussians near the drive with the most visible area."""

_NEAR_M = 80.0  # of the ego vehicle's places: what is farther would be in the way of the view
_MAX_RADIUS_M = 0.25  # of a point

_TIMELINE = "time"
_JPEG_QUALITY = 90
_ABOVE_GROUND_M = 0.05
_EYE_M, _EYE_TARGET_M = (-12.0, 0.0, 6.0), (15.0, 0.0, 0.0)  # in the frame of the ego vehicle at the start
_EGO_COLOR, _USER_COLOR = (31, 115, 191, 140), (217, 140, 51, 190)
_HIT_COLOR, _PLAN_COLOR, _ROUTE_COLOR = (219, 31, 38, 230), (38, 191, 89, 255), (153, 163, 173, 204)


def write_rollout_rerun(
    path: Path,
    rollout: Rollout,
    scene: Scene | None = None,
    route: Route | None = None,
    pictures: Iterable[CameraImage] = (),
) -> None:
    """Write a roll-out as a Rerun recording (.rrd) atomically. World frame, meters, z up.

    The timeline `time` is that of the simulation, from 0. Entities: world/scene (points), world/route, world/ego with
    its box, world/road_users, world/plan, world/camera with its images, motion/... (speed in m/s, acceleration, gap and
    time to collision) and log. `pictures` are in the order of steps and are consumed lazily.

    Raises `MissingPackageError` without rerun-sdk, and ValueError for an image without a step.
    """
    rerun: Any = import_package("rerun", "a Rerun file")
    with whole_file(path) as partial:
        name = f"{rollout.scenario_name}, {rollout.agent}, {rollout.intensity_mm_h:g} mm/h, seed {rollout.seed}"
        stream = rerun.RecordingStream("gsrain", recording_id=name)
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        stream.save(partial, default_blueprint=_layout(import_module("rerun.blueprint"), rollout))
        try:
            _RerunWriter(rerun, stream, rollout).write(scene, route, iter(pictures))
            stream.flush()
        finally:
            stream.disconnect()


def _layout(blueprint: Any, rollout: Rollout) -> Any:
    """Camera images and plots next to the scene, seen from behind the ego vehicle's first place."""
    motion, ahead = ["motion/speed_m_s", "motion/acceleration_m_s2"], ["motion/ttc_s", "motion/gap_m"]
    plots = blueprint.Vertical(
        blueprint.TimeSeriesView(origin="motion", contents=motion, name="Motion"),
        blueprint.TimeSeriesView(origin="motion", contents=ahead, name="Ahead"),
        blueprint.TextLogView(origin="log", name="Log"),
    )
    left = blueprint.Vertical(blueprint.Spatial2DView(origin="world/camera", name="Camera"), plots)
    start = rollout.steps[0].ego
    eye, target = (
        (*start.state.to_world(np.array([place[:2]]))[0], start.z_m + place[2]) for place in (_EYE_M, _EYE_TARGET_M)
    )
    controls = blueprint.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1))
    world = blueprint.Spatial3DView(origin="world", name="World", eye_controls=controls)
    return blueprint.Blueprint(blueprint.Horizontal(left, world, column_shares=[2, 3]), collapse_panels=True)


class _RerunWriter:
    def __init__(self, rerun: Any, stream: Any, rollout: Rollout) -> None:
        self._rerun, self._stream, self._rollout = rerun, stream, rollout

    def write(self, scene: Scene | None, route: Route | None, pictures: Any) -> None:
        rerun, rollout, waiting = self._rerun, self._rollout, next(pictures, None)
        self._log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        about = msgspec.json.format(msgspec.json.encode(rollout.scenario, order="sorted")).decode()
        self._log("scenario", rerun.TextDocument(about, media_type="application/json"), static=True)
        if scene is not None:
            places = np.array([(step.ego.x_m, step.ego.y_m) for step in rollout.steps])
            points, colors, radii = scene_points(scene, float(rollout.scenario.get("start_s", 0.0)), places)
            self._log("world/scene", rerun.Points3D(points, colors=colors, radii=radii), static=True)
        if route is not None:
            height = np.full((len(route.points), 1), rollout.steps[0].ego.z_m + _ABOVE_GROUND_M / 2)
            line = rerun.LineStrips3D([np.hstack([route.points, height])], colors=[_ROUTE_COLOR], radii=[0.04])
            self._log("world/route", line, static=True)
        for step, ttc, gap in zip(rollout.steps, times_to_collision_s(rollout), gaps_m(rollout), strict=True):
            self._stream.set_time(_TIMELINE, duration=step.time_s)
            self._step(step, float(ttc), float(gap))
            while waiting is not None and waiting.step == step.step:
                self._image(waiting)
                waiting = next(pictures, None)
        if waiting is not None:
            first, last = rollout.steps[0].step, rollout.steps[-1].step
            raise ValueError(f"picture of step {waiting.step}: expected rising steps within {first}..{last}")

    def _step(self, step: RolloutStep, ttc_s: float, gap_m: float) -> None:
        rerun, ego, vehicle = self._rerun, step.ego, self._rollout.vehicle
        turn = rerun.RotationAxisAngle(axis=[0, 0, 1], radians=ego.yaw_rad)
        self._log("world/ego", rerun.Transform3D(translation=[ego.x_m, ego.y_m, ego.z_m], rotation=turn))
        box = rerun.Boxes3D(
            centers=[[vehicle.middle_m, 0, vehicle.height_m / 2]],
            sizes=[[vehicle.length_m, vehicle.width_m, vehicle.height_m]],
            colors=[_EGO_COLOR if step.collision is None else _HIT_COLOR], labels=["ego"], show_labels=False,
        )  # fmt: skip
        self._log("world/ego/box", box)
        here = [(user, self._rollout.users[user.id].size_lwh_m) for user in step.road_users]
        middles = [(user.x_m, user.y_m, user.z_m + size[2] / 2) for user, size in here]
        turns = [(0.0, 0.0, np.sin(user.yaw_rad / 2), np.cos(user.yaw_rad / 2)) for user, _ in here]
        users = rerun.Boxes3D(
            centers=np.reshape(middles, (-1, 3)), sizes=np.reshape([size for _, size in here], (-1, 3)),
            quaternions=np.reshape(turns, (-1, 4)),
            colors=[_HIT_COLOR if step.collision == user.id else _USER_COLOR for user, _ in here],
            labels=[f"{user.id}, {user.speed_m_s:.1f} m/s" for user, _ in here],
        )  # fmt: skip
        self._log("world/road_users", users)
        self._log("world/plan", self._plan(step))
        motion = {
            "speed_m_s": ego.speed_m_s, "acceleration_m_s2": ego.acceleration_m_s2, "steer_rad": ego.steer_rad,
            "ttc_s": ttc_s, "route_left_m": step.route_left_m, "gap_m": gap_m,
        }  # fmt: skip
        for name, value in motion.items():
            if np.isfinite(value):
                self._log(f"motion/{name}", rerun.Scalars(value))
        if step is self._rollout.steps[0]:
            run = self._rollout
            line = f"{run.scenario_name}: {run.agent} drives in {run.intensity_mm_h:g} mm/h"
            self._log("log", rerun.TextLog(line, level="INFO"))
        if step.collision is not None:
            line = f"collision with {step.collision} at {ego.speed_m_s:.2f} m/s"
            self._log("log", rerun.TextLog(line, level="ERROR"))
        if step is self._rollout.steps[-1]:
            self._log("log", rerun.TextLog(f"end: {self._rollout.end}", level="INFO"))

    def _plan(self, step: RolloutStep) -> Any:
        if not step.plan:
            return self._rerun.Clear(recursive=False)
        places = step.ego.state.to_world(np.array([(0.0, 0.0), *step.plan], np.float64))
        height = np.full((len(places), 1), step.ego.z_m + _ABOVE_GROUND_M)
        return self._rerun.LineStrips3D([np.hstack([places, height])], colors=[_PLAN_COLOR], radii=[0.1])

    def _image(self, picture: CameraImage) -> None:
        rerun, camera = self._rerun, picture.camera
        pose = camera.camera_to_world
        self._log("world/camera", rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        pinhole = rerun.Pinhole(
            image_from_camera=matrix, resolution=[camera.width, camera.height], camera_xyz=rerun.ViewCoordinates.RDF,
            image_plane_distance=1.0,
        )  # fmt: skip
        self._log("world/camera", pinhole)
        bgr = np.ascontiguousarray(picture.image[..., ::-1])
        _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        self._log("world/camera", rerun.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg"))

    def _log(self, entity: str, value: Any, *, static: bool = False) -> None:
        self._stream.log(entity, value, static=static)


def scene_points(
    scene: Scene, time_s: float, places_m: Float64[np.ndarray, "p 2"]
) -> tuple[Float32[np.ndarray, "n 3"], UInt8[np.ndarray, "n 4"], Float32[np.ndarray, " n"]]:
    """Centers (m, world), colors (RGBA) and radii (m) of a scene's background near places, at most `MOST_POINTS`.

    Chosen by visible area: opacity times the product of the two larger scales. Sky and moving actors are left out.
    """
    parts = [
        part
        for layer in scene.layers
        if layer.visible and layer.kind != "sky" and (part := scene.part(layer, time_s)) is not None
    ]
    if not parts:
        return np.zeros((0, 3), np.float32), np.zeros((0, 4), np.uint8), np.zeros(0, np.float32)
    kept = [part.remaining for part in parts]
    units = [np.cbrt(abs(float(np.linalg.det(part.to_world[:3, :3])))) for part in parts]
    scales = np.concatenate([np.sort(each.scales, axis=1) * unit for each, unit in zip(kept, units, strict=True)])
    means = np.concatenate(
        [each.means @ part.to_world[:3, :3].T + part.to_world[:3, 3] for each, part in zip(kept, parts, strict=True)]
    )
    areas = np.concatenate([each.opacities for each in kept]) * scales[:, 1] * scales[:, 2]
    distances, _ = scipy.spatial.cKDTree(places_m).query(means[:, :2], distance_upper_bound=_NEAR_M)
    areas[~np.isfinite(distances)] = 0
    ordered = np.argsort(-areas, kind="stable")[: min(MOST_POINTS, np.count_nonzero(areas))]
    chosen: Int64[np.ndarray, " m"] = np.sort(ordered)
    base = np.concatenate([each.sh[:, 0] for each in kept])[chosen] * SH_C0 + 0.5
    colors = np.clip(np.rint(255 * base), 0, 255).astype(np.uint8)
    rgba = np.concatenate([colors, np.full((len(colors), 1), 255, np.uint8)], axis=1)
    radii = np.minimum(np.sqrt(scales[chosen, 1] * scales[chosen, 2]), _MAX_RADIUS_M).astype(np.float32)
    return means[chosen].astype(np.float32), rgba, radii


def _export(drive: FinishedDrive, path: Path) -> None:
    write_rollout_rerun(path, drive.rollout, drive.scene, recorded_route(drive.scene), drive.camera_images())


EXPORT = DriveExport((".rrd",), _export, packages=("rerun",), cameras="front")
