"""Scenes of SplatSim, Autoware's simulator (`splatsim.scene/v2` and `/v3`): chunks of SPZ, tracks, assets, rigs, a sky.

Source: the documentation of https://github.com/autowarefoundation/3dgs_io. The file is a stored zip. Its world has z up
(east, north, up) and meters; rigs are on the ground below the rear axle, x forward, y left, z up; objects have their
origin at the center of their box; quaternions are xyzw, times microseconds. SPZ files hold these axes as they are.
"""

import hashlib
import logging
import re
import uuid
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.datasets.io.images import opened_image
from gsrain_engine.safe_io.errors import SceneFormatError, convert_checked
from gsrain_engine.safe_io.text_files import json_values
from gsrain_engine.scene.camera import DEFAULT_EXPOSURE_S
from gsrain_engine.scene.formats import check_room, printable_name
from gsrain_engine.scene.formats.boxed_actor import FORWARD, UP, boxed_actor, poses_of, track_of
from gsrain_engine.scene.formats.spz import decode_spz, encode_spz, spz_size
from gsrain_engine.scene.formats.stored_zip import read_member, write_stored_zip
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from gsrain_engine.scene.geometry import quaternions_from_matrices
from gsrain_engine.scene.recorded_drive import MICROSECONDS, logical_cameras, scene_id, sensor_height_m, timestamps_us
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, RigCamera, Scene
from gsrain_engine.scene.sky_dome import dome_layer, sample_panorama
from gsrain_engine.scene.transforms import FILE_UP, bake_item, transform_gaussians

from .nurec import METADATA, scene_id_in

logger = logging.getLogger("gsrain")
SCENE = "scene.json"
_SCHEMAS = ("splatsim.scene/v2", "splatsim.scene/v3")
_TRACKS_SCHEMA, _RIGS_SCHEMA, _ASSETS_SCHEMA = (
    "splatsim.sequence_tracks/v2", "splatsim.rig_trajectories/v2", "splatsim.actor_assets/v1",
)  # fmt: skip
_TRACKS, _RIGS, _ASSETS, _SKYBOX = "sequence_tracks.json", "rig_trajectories.json", "actor_assets.json", "skybox.png"
_MAX_JSON_BYTES = 1 << 28
_CHUNK_M, _CHUNK_GAUSSIANS = 50.0, 200_000
_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""From the axes that our reader of SPZ gives to the numbers in the file, and back."""

_RIG_HEIGHT_M = 1.5  # of our ego frame above the rig's, which is on the ground
_RIG = "ego"
_ASSET_NAME = re.compile(r"[^A-Za-z0-9._-]")
_FRAMES = {
    "world": {"handedness": "right", "up_axis": "z", "type": "ENU"},
    "rig": {"forward": "+x", "left": "+y", "up": "+z", "origin": "ground_under_rear_axle"},
    "camera": {"model_axes": "opencv_+z_forward"},
    "lidar": {"axes": "+x_forward_+y_left_+z_up"},
    "quaternion_order": "xyzw",
    "matrix_layout": "row_major",
    "vector_convention": "column_vector_child_to_parent",
    "length_units": "meters",
    "time_units": "microseconds",
}
_OBJECT_FRAME = {
    "handedness": "right",
    "forward": "+x",
    "left": "+y",
    "up": "+z",
    "origin": "bbox_center",
    "quaternion_order": "xyzw",
    "length_units": "meters",
    "scale": "metric",
}
"""Conventions that readers compare word by word."""

_STAGE = b"""#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "World"
{
    custom asset sceneIndex = @./scene.json@
}
"""

_Vector = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]


# Contents of the JSON files, as far as they are read


class _ChunkRow(msgspec.Struct, frozen=True):
    uri: str


class _ChunkIndex(msgspec.Struct, frozen=True):
    chunks: list[_ChunkRow] | None = None


class _SceneIndex(msgspec.Struct, frozen=True):
    schema: str
    gaussians: _ChunkIndex


class _PoseRow(msgspec.Struct, frozen=True):
    timestamp_us: int
    translation: _Vector
    rotation: _Quaternion


class _TrackRow(msgspec.Struct, frozen=True):
    track_id: str
    class_name: str
    size: _Vector
    frames: list[_PoseRow] = []


class _TrackRows(msgspec.Struct, frozen=True):
    tracks: list[_TrackRow] = []


class _MountRow(msgspec.Struct, frozen=True):
    translation: _Vector
    rotation: _Quaternion


class _ModelRow(msgspec.Struct, frozen=True):
    type: str
    parameters: dict[str, Any] = {}


class _CameraRow(msgspec.Struct, frozen=True):
    name: str
    sensor_in_rig: _MountRow
    camera_model: _ModelRow


class _RigRow(msgspec.Struct, frozen=True):
    rig_id: str
    poses: list[_PoseRow] = []
    cameras: list[_CameraRow] = []


class _RigRows(msgspec.Struct, frozen=True):
    rigs: list[_RigRow] = []


class _AssetRow(msgspec.Struct, frozen=True):
    asset_id: str
    uri: str
    size: _Vector


class _BindingRow(msgspec.Struct, frozen=True):
    track_id: str
    asset_id: str
    fit_mode: str = "rigid"


class _AssetBank(msgspec.Struct, frozen=True):
    assets: list[_AssetRow] = []
    instances: list[_BindingRow] = []


# Reading


def is_splatsim(path: Path, archive: zipfile.ZipFile) -> bool:
    """Return whether a zip file has the description of such a scene."""
    if SCENE not in archive.namelist():
        return False
    data = read_member(path, archive, SCENE, _MAX_JSON_BYTES)
    try:
        values = json_values(data)
    except ValueError as error:
        raise SceneFormatError(path, f"{SCENE} in it: {error}") from None
    return isinstance(values, dict) and str(values.get("schema")).startswith("splatsim.scene/")


def scene_in_zip(path: Path, archive: zipfile.ZipFile, most: int) -> Scene:
    """Read a scene: its chunks as a layer, the sky as a dome, tracks with an asset as actors, the first rig as the ego.

    `most` limits the bytes of a member. Raises `SceneFormatError` for damage, and for other versions.
    """
    reader = _SplatSimReader(path, archive, most)
    try:
        return reader.scene()
    except SceneFormatError:
        raise
    except (ValueError, LookupError, ArithmeticError, OSError) as error:
        raise SceneFormatError(path, f"its contents don't fit together: {error}") from None


class _SplatSimReader:
    def __init__(self, path: Path, archive: zipfile.ZipFile, most: int) -> None:
        self.path, self.archive, self.most = path, archive, most
        self.names = frozenset(archive.namelist())

    def scene(self) -> Scene:
        index: _SceneIndex = self.values(SCENE, _SceneIndex)
        if index.schema not in _SCHEMAS:
            raise SceneFormatError(self.path, f"{SCENE} in it is {index.schema}: {' and '.join(_SCHEMAS)} are read")
        listed = index.gaussians.chunks
        chunks = (
            sorted(name for name in self.names if name.startswith("chunks/") and name.endswith(".spz"))
            if listed is None
            else [chunk.uri for chunk in listed]
        )
        if not chunks:
            raise SceneFormatError(self.path, "it has no chunks of Gaussians")
        name = scene_id_in(self.member(METADATA)) if METADATA in self.names else None
        packed = [self.spz(each) for each in chunks]
        sizes = [spz_size(self.path, each) for each in packed]
        most_harmonics = COEFFICIENTS_OF_DEGREE[max(degree for _, degree in sizes)]
        check_room(self.path, sum(count for count, _ in sizes), most_harmonics)
        layers = [Layer("scene", Gaussians.concatenate([self.decoded(each) for each in packed]))]
        if _SKYBOX in self.names:
            panorama = self.panorama()
            layers.append(dome_layer(lambda ways: sample_panorama(panorama, ways), layers))
        tracks: _TrackRows = self.values(_TRACKS, _TrackRows) if _TRACKS in self.names else _TrackRows()
        rigs: _RigRows = self.values(_RIGS, _RigRows) if _RIGS in self.names else _RigRows()
        driven = [rig for rig in rigs.rigs if rig.poses][:1]
        moments = [pose.timestamp_us for track in tracks.tracks for pose in track.frames]
        moments += [pose.timestamp_us for rig in driven for pose in rig.poses]
        start_us, end_us = min(moments, default=0), max(moments, default=0)
        ego, cameras, ground_m = self.rig(driven[0], start_us) if driven else (None, (), None)
        return Scene(
            printable_name(name or self.path.name.removesuffix(".usdz").removesuffix(".splatsim") or "scene"),
            tuple(layers),
            tuple(self.actors(tracks, start_us, end_us)),
            ground_m=ground_m,
            ego=ego,
            rigs={_RIG: cameras} if cameras else {},
        )

    def member(self, name: str) -> bytes:
        return read_member(self.path, self.archive, name, min(self.most, _MAX_JSON_BYTES))

    def values(self, name: str, kind: Any) -> Any:
        try:
            return convert_checked(json_values(self.member(name)), kind)
        except ValueError as error:
            raise SceneFormatError(self.path, f"{name} in it: {error}") from None

    def spz(self, name: str) -> bytes:
        return read_member(self.path, self.archive, name, self.most)

    def decoded(self, packed: bytes) -> Gaussians:
        return transform_gaussians(decode_spz(self.path, packed), _AXES)

    def panorama(self) -> Float32[np.ndarray, "h w 3"]:
        with opened_image(read_member(self.path, self.archive, _SKYBOX, self.most), _SKYBOX) as found:
            return np.asarray(found.convert("RGB"), np.float32) / np.float32(255)

    def actors(self, tracks: _TrackRows, start_us: int, end_us: int) -> Iterator[Actor]:
        bank: _AssetBank = self.values(_ASSETS, _AssetBank) if _ASSETS in self.names else _AssetBank()
        assets = {asset.asset_id: asset for asset in bank.assets}
        bound = {each.track_id: each for each in bank.instances if each.asset_id in assets}
        clouds: dict[str, Gaussians] = {}
        bare = 0
        for track in tracks.tracks:
            if not track.frames:
                continue
            if track.track_id not in bound:
                bare += 1
                continue
            instance = bound[track.track_id]
            asset = assets[instance.asset_id]
            if asset.asset_id not in clouds:
                clouds[asset.asset_id] = self.decoded(self.spz(asset.uri))
            gaussians, size = clouds[asset.asset_id], np.array(asset.size, np.float64)
            ratios = np.array(track.size, np.float64) / size
            if instance.fit_mode == "uniform" or (instance.fit_mode == "stretch" and np.ptp(ratios) < 1e-3):
                scale = float(np.cbrt(ratios.prod()))
                gaussians, size = transform_gaussians(gaussians, np.diag([scale, scale, scale, 1.0])), scale * size
            elif instance.fit_mode == "stretch":
                logger.warning("%s: %s keeps its own shape: Gaussians can't be stretched", self.path, track.track_id)
            times, poses = _samples(track.frames, start_us)
            valid = np.ones(len(times), np.bool_)
            valid[-1] = track.frames[-1].timestamp_us >= end_us
            corners = np.stack([-size / 2, size / 2])
            name = printable_name(track.track_id)
            yield boxed_actor(name, track.class_name, gaussians, FORWARD, UP, corners, times, poses, valid)
        if bare:
            logger.warning("%s: %d tracks have no Gaussians of their own and are left out", self.path, bare)

    def rig(self, rig: _RigRow, start_us: int) -> tuple[PoseTrack, tuple[RigCamera, ...], float]:
        times, poses = _samples(rig.poses, start_us)
        up = _raised(_RIG_HEIGHT_M)
        left_out = [camera.name for camera in rig.cameras if camera.camera_model.type != "pinhole"]
        if left_out:
            logger.warning("%s: cameras with lenses are left out: %s", self.path, ", ".join(left_out))
        pinholes = [camera for camera in rig.cameras if camera.camera_model.type == "pinhole"]
        cameras = tuple(_rig_camera(camera, np.linalg.inv(up)) for camera in pinholes)
        ego = track_of(times, poses @ up, np.ones(len(times), np.bool_))
        return ego, cameras, float(np.median(poses[:, 2, 3]))


def _samples(
    frames: Sequence[_PoseRow], start_us: int
) -> tuple[Float64[np.ndarray, " t"], Float64[np.ndarray, "t 4 4"]]:
    turns = np.array([frame.rotation for frame in frames], np.float64)
    poses = poses_of([frame.translation for frame in frames], turns[:, [3, 0, 1, 2]])
    times = np.array([(frame.timestamp_us - start_us) / MICROSECONDS for frame in frames])
    if not np.isfinite(poses).all() or not (np.diff(times) > 0).all():
        raise ValueError("poses must be finite and unit quaternions, at increasing times")
    return times, poses


def _rig_camera(camera: _CameraRow, down: Float64[np.ndarray, "4 4"]) -> RigCamera:
    values = camera.camera_model.parameters
    (width, height), place = values["resolution"], camera.sensor_in_rig
    x, y, z, w = place.rotation
    mounted = down @ poses_of([place.translation], [(w, x, y, z)])[0]
    fx, fy, cx, cy = (float(values[name]) for name in ("fx", "fy", "cx", "cy"))
    return RigCamera(printable_name(camera.name), int(width), int(height), fx, fy, cx, cy, mounted, DEFAULT_EXPOSURE_S)


def _raised(height_m: float) -> Float64[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[2, 3] = height_m
    return matrix


# Writing


def write_splatsim(gaussians: Gaussians, path: Path) -> None:
    """Write Gaussians, in PLY axes, as a scene of one layer."""
    write_splatsim_scene(Scene("scene", (Layer("gaussians", gaussians),), up=FILE_UP), path)


def write_splatsim_scene(scene: Scene, path: Path) -> None:
    """Write all visible layers in chunks, actors as assets on tracks, the ego vehicle and its cameras. Deterministic.

    Raises `ValueError` if it has no visible layer, or a number that SPZ can't hold.
    """
    still = [
        transform_gaussians(bake_item(part), part.to_world)
        for part in (scene.part(layer) for layer in scene.layers if layer.visible)
        if part is not None
    ]
    gaussians = Gaussians.concatenate(still)
    if not len(gaussians):
        raise ValueError("a scene of SplatSim has at least one visible layer with Gaussians")
    files: dict[str, bytes] = {}
    chunks: list[dict[str, Any]] = []
    for number, part in enumerate(_chunks(gaussians)):
        name = f"chunks/chunk_{number:06d}.spz"
        files[name] = encode_spz(transform_gaussians(part, _AXES))
        low, high = (end(part.means, axis=0).tolist() for end in (np.min, np.max))
        chunks.append({"uri": name, "n_points": len(part), "bbox_min": low, "bbox_max": high})
    extras: dict[str, str] = {}
    actors = [actor for actor in scene.actors if actor.visible and len(actor.track.times) and len(actor.gaussians)]
    if actors:
        files |= _actor_files(scene, actors)
        extras |= {"sequence_tracks": _TRACKS, "actor_assets": _ASSETS}
    if scene.ego is not None and len(scene.ego.times):
        files[_RIGS] = msgspec.json.encode(_rig_values(scene, scene.ego))
        extras["rig_trajectories"] = _RIGS
    version = metadata.version("gsrain")
    index = {
        "schema": _SCHEMAS[-1],
        "producer": {"tool": "gsrain", "tool_version": version},
        "world": {"frame_convention": _FRAMES, "ecef_anchor": np.eye(4).tolist()},
        "gaussians": {
            "chunk_format": "spz/ngsp-v4",
            "chunks": chunks,
            "n_gaussians": len(gaussians),
            "sh_degree": gaussians.sh_degree,
            "frame": "world",
        },
        "extras": extras,
        "render_defaults": {"exposure": 1.0, "near_plane": 0.01, "far_plane": 10_000.0},
    }
    digest = hashlib.sha256(b"".join(files.values())).digest()
    card = {
        "uuid": str(uuid.UUID(bytes=digest[:16])),
        "scene_id": scene_id(scene),
        "version_string": f"gsrain/{version}",
    }
    head = {
        "default.usda": _STAGE,
        METADATA: msgspec.json.encode(card),
        SCENE: msgspec.json.encode(index),
    }
    write_stored_zip(path, head | files, 64)


def _chunks(gaussians: Gaussians) -> Iterator[Gaussians]:
    """Gaussians by squares of the ground, at most `_CHUNK_GAUSSIANS` at a time."""
    cells = np.floor(gaussians.means[:, :2] / np.float32(_CHUNK_M)).astype(np.int64)
    order = np.lexsort((cells[:, 1], cells[:, 0]))
    sorted_cells = cells[order]
    ends = np.flatnonzero((np.diff(sorted_cells, axis=0) != 0).any(axis=1)) + 1
    for group in np.split(order, ends):
        for first in range(0, len(group), _CHUNK_GAUSSIANS):
            yield gaussians.take(np.sort(group[first : first + _CHUNK_GAUSSIANS]))


def _actor_files(scene: Scene, actors: Sequence[Actor]) -> dict[str, bytes]:
    """Assets, their list, and the tracks of actors."""
    unit = scene.metres_per_unit
    tracks: list[dict[str, Any]] = []
    assets: list[dict[str, Any]] = []
    files: dict[str, bytes] = {}
    for number, actor in enumerate(actors):
        name = f"a{number:03d}-{_ASSET_NAME.sub('_', actor.id)[:100]}"
        size = [edge * unit for edge in actor.size_lwh]
        to_center = np.diag([unit, unit, unit, 1.0])
        to_center[2, 3] = -size[2] / 2
        part = scene.part(actor, float(actor.track.times[0]))
        own = transform_gaussians(actor.gaussians if part is None else bake_item(part), to_center)
        uri = f"actor_assets/{name}/asset.spz"
        files[uri] = encode_spz(transform_gaussians(own, _AXES))
        low, high = (end(own.means, axis=0).tolist() for end in (np.min, np.max))
        assets.append(
            {
                "asset_id": name, "uri": uri, "class_name": actor.class_name or "object", "motion": "rigid",
                "size": size, "bbox_min": low, "bbox_max": high, "n_points": len(own), "sh_degree": own.sh_degree,
                "provenance": {}, "metadata": {},
            }
        )  # fmt: skip
        center = _raised(size[2] / 2)
        tracks.append(
            {
                "track_id": actor.id, "class_name": actor.class_name or "object", "size": size, "flag": "NONE",
                "frames": _frames(scene, actor.track, center), "metadata": {},
            }
        )  # fmt: skip
    bound = [
        {"track_id": actor.id, "asset_id": asset["asset_id"], "fit_mode": "rigid", "metadata": {}}
        for actor, asset in zip(actors, assets, strict=True)
    ]
    bank = {"schema": _ASSETS_SCHEMA, "frame": "object", "object_frame": _OBJECT_FRAME}
    files[_ASSETS] = msgspec.json.encode({**bank, "assets": assets, "instances": bound})
    header = {"schema": _TRACKS_SCHEMA, "frame": "world", "frame_convention": _FRAMES}
    files[_TRACKS] = msgspec.json.encode({**header, "tracks": tracks})
    return files


def _rig_values(scene: Scene, ego: PoseTrack) -> dict[str, Any]:
    height = sensor_height_m(scene)
    cameras: list[dict[str, Any]] = []
    for name, camera in logical_cameras(scene).items():
        size = [camera.width, camera.height]
        model = {"resolution": size, "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        cameras.append(
            {
                "name": name,
                "sensor_in_rig": _place(_raised(height) @ camera.camera_to_ego),
                "camera_model": {"type": "pinhole", "parameters": model},
                "metadata": {},
                "calibration_resolution": size,
            }
        )
    rig = {"rig_id": _RIG, "poses": _frames(scene, ego, _raised(-height)), "cameras": cameras, "lidars": []}
    header = {"schema": _RIGS_SCHEMA, "frame": "world", "frame_convention": _FRAMES}
    return {**header, "rigs": [{**rig, "metadata": {}}]}


def _frames(scene: Scene, track: PoseTrack, local: Float64[np.ndarray, "4 4"]) -> list[dict[str, Any]]:
    """Samples of a track in the world, each `@ local`."""
    whole = replace(track.moved(scene.scene_to_world), valid=np.ones(len(track.times), np.bool_))
    poses = (whole.pose(time) for time in track.times.tolist())
    times = timestamps_us(track, scene)
    return [
        {"timestamp_us": time, **_place(pose @ local)}
        for time, pose in zip(times, poses, strict=True)
        if pose is not None
    ]


def _place(pose: Float64[np.ndarray, "4 4"]) -> dict[str, Any]:
    w, x, y, z = np.asarray(quaternions_from_matrices(pose[:3, :3]), np.float64).tolist()
    return {"translation": pose[:3, 3].tolist(), "rotation": [x, y, z, w]}


def lost_in_splatsim(lost: list[str]) -> list[str]:
    """Select from phrases of `lost_when_flattened` those that apply to a scene of SplatSim."""
    kept = ("ego vehicle", "rig camera", "actor")
    return [each for each in lost if "hidden" in each or not any(word in each for word in kept)]
