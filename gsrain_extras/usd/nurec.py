"""Descriptions of drives as NVIDIA's NuRec and AlpaSim read them: JSON and YAML files inside a `.usdz`.

Field names follow AlpaSim's readers (NVlabs/alpasim, `alpasim_utils/scenario.py`, `scene_metadata.py`) and NCore's
camera models. AlpaSim's rig has its origin on the ground, x forward, y left, z up; its cuboids are at their centers.
"""

import hashlib
import re
from typing import Any

import msgspec
import numpy as np
import yaml
from jaxtyping import Float64

from gsrain_engine.scene.geometry import quaternions_from_matrices
from gsrain_engine.scene.recorded_drive import (
    MICROSECONDS,
    logical_cameras,
    scene_id,
    sensor_height_m,
    timestamps_us,
)
from gsrain_engine.scene.scene import Actor, PoseTrack, RigCamera, Scene

METADATA = "metadata.yaml"
_NAME = re.compile(r"[\w.:-][\w .:-]{0,199}")  # of a scene, as a file may state it
_BOX_LWH_M = [4.6, 1.85, 1.5]  # of the ego vehicle: the default of `simulation.vehicle.Vehicle`
_BOX_CENTER_M = [1.3, 0.0, 0.75]  # from its rig, on the ground below the rear axle
_SEQUENCE = "gsrain"
_LEAD_US = 100_000  # of the drive before its first picture, as AlpaSim's shutters may open before a frame begins


def nurec_files(scene: Scene) -> dict[str, bytes]:
    """Files that describe the drive of the ego vehicle, its cameras and the tracks of actors; empty without a drive."""
    if scene.ego is None or not len(scene.ego.times):
        return {}
    cameras = [*logical_cameras(scene).items()]
    times = timestamps_us(scene.ego, scene)
    down = np.eye(4)
    down[2, 3] = -sensor_height_m(scene)
    poses = [pose @ down for pose in _poses(scene.ego.moved(scene.scene_to_world))]
    exposure_us = max(1, round(MICROSECONDS * _exposure_s(cameras)))
    after = [time for time in times if time - times[0] >= _LEAD_US]
    frames = [[time, time + exposure_us] for time in after or times]
    rig = {
        "world_to_nre": {"matrix": np.eye(4).tolist()},
        "T_world_base": np.eye(4).tolist(),
        "camera_calibrations": {
            f"{name}@{_SEQUENCE}": _calibration(index, name, camera, np.linalg.inv(down))
            for index, (name, camera) in enumerate(cameras)
        },
        "rig_trajectories": [
            {
                "sequence_id": _SEQUENCE,
                "T_rig_world_timestamps_us": times,
                "T_rig_worlds": [pose.tolist() for pose in poses],
                "cameras_frame_timestamps_us": {f"{name}@{_SEQUENCE}": frames for name, _ in cameras},
                "rig_bbox": {"centroid": _BOX_CENTER_M, "dim": _BOX_LWH_M, "rot": [0.0, 0.0, 0.0]},
            }
        ],
    }
    tracks = msgspec.json.encode({_SEQUENCE: _tracks(scene)})
    encoded = msgspec.json.encode(rig)
    digest = hashlib.sha256(encoded + tracks).hexdigest()
    metadata = {
        "scene_id": scene_id(scene),
        "version_string": "gsrain",
        "training_date": "1970-01-01",
        "dataset_hash": digest,
        "uuid": f"{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}",
        "is_resumable": False,
        "sensors": {"camera_ids": [name for name, _ in cameras], "lidar_ids": []},
        "logger": {},
        "time_range": {"start": float(times[0]), "end": float(times[-1])},
    }
    text = yaml.safe_dump(metadata, sort_keys=False).encode()
    return {METADATA: text, "rig_trajectories.json": encoded, "sequence_tracks.json": tracks}


def scene_id_in(metadata: bytes) -> str | None:
    """Name of a scene that `metadata.yaml` states; None if it states none that can be one."""
    try:
        found = yaml.safe_load(metadata)
    except (yaml.YAMLError, ValueError, RecursionError):
        return None
    name = found.get("scene_id") if isinstance(found, dict) else None
    return name if isinstance(name, str) and _NAME.fullmatch(name) else None


def _poses(track: PoseTrack) -> list[Float64[np.ndarray, "4 4"]]:
    return [PoseTrack.pose(_whole(track), time) for time in track.times.tolist()]  # pyright: ignore[reportReturnType]


def _whole(track: PoseTrack) -> PoseTrack:
    """The track without its gaps, so that each sample has a pose."""
    return PoseTrack(track.times, track.positions, track.quaternions_wxyz, np.ones(len(track.times), np.bool_))


def _exposure_s(cameras: list[tuple[str, RigCamera]]) -> float:
    return max((camera.exposure_s for _, camera in cameras), default=0.0)


def _calibration(index: int, name: str, camera: RigCamera, up: Float64[np.ndarray, "4 4"]) -> dict[str, Any]:
    return {
        "sequence_id": _SEQUENCE,
        "logical_sensor_name": name,
        "unique_sensor_idx": index,
        "T_sensor_rig": (up @ camera.camera_to_ego).tolist(),
        "camera_model": {
            "type": "opencv-pinhole",
            "parameters": {
                "resolution": [camera.width, camera.height],
                "shutter_type": "GLOBAL",
                "external_distortion_parameters": None,
                "principal_point": [camera.cx, camera.cy],
                "focal_length": [camera.fx, camera.fy],
                "radial_coeffs": [0.0] * 6,
                "tangential_coeffs": [0.0] * 2,
                "thin_prism_coeffs": [0.0] * 4,
            },
        },
    }


def _tracks(scene: Scene) -> dict[str, Any]:
    """Tracks of the visible actors: centers of their boxes, quaternions in the order x, y, z, w."""
    actors = [actor for actor in scene.actors if actor.visible and len(actor.track.times)]
    return {
        "tracks_data": {
            "tracks_id": [actor.id for actor in actors],
            "tracks_label_class": [actor.class_name for actor in actors],
            "tracks_flags": [["CONTROLLABLE"] for _ in actors],
            "tracks_timestamps_us": [timestamps_us(actor.track, scene) for actor in actors],
            "tracks_poses": [_track_poses(actor, scene) for actor in actors],
        },
        "cuboidtracks_data": {
            "cuboids_dims": [[edge * scene.metres_per_unit for edge in actor.size_lwh] for actor in actors]
        },
    }


def _track_poses(actor: Actor, scene: Scene) -> list[list[float]]:
    rows: list[list[float]] = []
    for pose in _poses(actor.track.moved(scene.scene_to_world)):
        center = pose[:3, 3] + pose[:3, 2] * (actor.size_lwh[2] * scene.metres_per_unit / 2)
        w, x, y, z = np.asarray(quaternions_from_matrices(pose[:3, :3]), np.float64).tolist()
        rows.append([*center.tolist(), x, y, z, w])
    return rows
