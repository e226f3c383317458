"""Scenes of NVIDIA's NuRec: Gaussians of several nodes, road users on tracks, a rig and a cubemap of the sky.

Sources: `threedgrut/export` in https://github.com/nv-tlabs/3dgrut, whose files have one node and no tracks, and the
layout of AlpaSim's artifacts as https://github.com/autowarefoundation/3dgs_io documents it. A `.nurec` is gzip of
MessagePack, {"nre_data": {"state_dict": {KEY: bytes of an array, "KEY.shape": its shape}}}; `checkpoint.ckpt` in a
`.usdz` has tensors under the same keys. Gaussians are as before activation, x forward, y left, z up at the start.
"""

import io
import logging
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float64, Int64

from gsrain_engine.safe_io.errors import SceneFormatError, convert_checked
from gsrain_engine.safe_io.limits import max_expanded_bytes, read_file
from gsrain_engine.safe_io.text_files import json_values
from gsrain_engine.scene.camera import DEFAULT_EXPOSURE_S
from gsrain_engine.scene.formats import Format, gunzip, printable_name
from gsrain_engine.scene.formats.boxed_actor import FORWARD, UP, boxed_actor, hidden_actor, poses_of, track_of
from gsrain_engine.scene.formats.stored_zip import read_member
from gsrain_engine.scene.formats.tensors import MISFITS, SplatTensors, activated_rows, array_of, misfit, tensors_in
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.recorded_drive import MICROSECONDS
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, RigCamera, Scene
from gsrain_engine.scene.sky_dome import checked_cubemap, dome_layer, sample_cubemap
from gsrain_engine.scene.transforms import flatten_scene

logger = logging.getLogger("gsrain")
CHECKPOINT = "checkpoint.ckpt"
_TRACKS, _RIGS, _SUMMARY = "sequence_tracks.json", "rig_trajectories.json", "datasource_summary.json"
_NODES, _SKY, _EXTRA = "gaussians_nodes.", "background.textures", "_extra_state"
_ARRAYS = ("positions", "scales", "rotations", "densities", "features_albedo", "features_specular")
_TO_CUBEMAP = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])  # to right, up, back
_MAX_JSON_BYTES = 1 << 28
_RIG_HEIGHT_M = 1.5  # of our ego frame above NuRec's, which is on the ground
_RIG = "recorded"
_CLASSES = {"automobile": "car", "vehicle": "car", "heavy_truck": "truck", "person": "pedestrian", "rider": "cyclist"}
"""Classes of tracks by their names there; others keep theirs."""


def read_nurec(path: Path) -> Gaussians:
    """Read all visible Gaussians of a `.nurec`; see `read_nurec_scene`."""
    return flatten_scene(read_nurec_scene(path))


def read_nurec_scene(path: Path) -> Scene:
    """Read the nodes of a `.nurec` as layers, and its sky; road users are hidden: their tracks are in the `.usdz`.

    Raises `SceneFormatError` if the file is damaged or holds no Gaussians.
    """
    name = printable_name(path.name[: -len(".nurec")] or "scene")
    return _NurecReader(path, state_of_volume(path, read_file(path))).scene(name)


def state_of_volume(path: Path, data: bytes) -> dict[str, Any]:
    """Arrays and plain values of a `.nurec`, which may be part of the file at `path`, by key without its first dot."""
    unpacked = gunzip(path, data, max_expanded_bytes(len(data)))
    del data  # large, like what is unpacked from it
    try:
        decoded = msgspec.msgpack.decode(unpacked)
        del unpacked
        state = decoded["nre_data"]["state_dict"]
        return {str(key).removeprefix("."): _array(state, key) for key in state if not str(key).endswith(".shape")}
    except (msgspec.DecodeError, RecursionError, *MISFITS) as error:
        raise SceneFormatError(path, f"no NuRec volume: {error}") from None


def state_in_usdz(path: Path, archive: zipfile.ZipFile, most: int) -> dict[str, Any]:
    """Tensors and plain values of the checkpoint in a `.usdz`, by key without `model.`."""
    found = tensors_in(path, io.BytesIO(read_member(path, archive, CHECKPOINT, most)))
    state = found.get("state_dict") if isinstance(found, Mapping) else None
    if not isinstance(state, Mapping):
        raise SceneFormatError(path, f"{CHECKPOINT} in it holds no state_dict")
    return {str(key).removeprefix("model."): value for key, value in state.items()}


def scene_in_usdz(path: Path, archive: zipfile.ZipFile, states: list[dict[str, Any]], name: str) -> Scene:
    """Scene of the volumes, or the checkpoint, of a `.usdz`, with the tracks and the rig that are described in it."""
    found = {
        part: convert_checked(json_values(read_member(path, archive, part, _MAX_JSON_BYTES)), dict[str, Any])
        for part in (_TRACKS, _RIGS, _SUMMARY)
        if part in archive.namelist()
    }
    summary = found.get(_SUMMARY, {})
    tracks = found.get(_TRACKS) or summary.get("sequence_tracks_dynamic") or {}
    rigs = found.get(_RIGS) or summary.get("rig_trajectories") or {}
    state: dict[str, Any] = {}
    for each in states:
        state |= each
    return _NurecReader(path, state, tracks, rigs).scene(name)


def _array(state: Mapping[str, Any], key: str) -> Any:
    """Value of a key; bytes with a shape are half floats, or integers of the size that fits."""
    value, shape = state[key], state.get(f"{key}.shape")
    if not isinstance(value, bytes) or shape is None:
        return value
    count = int(np.prod(shape, dtype=np.int64))
    kinds = {1: "u1", 2: "<f2", 4: "<i4", 8: "<i8"}
    kind = kinds[len(value) // count if count else 2]
    return np.frombuffer(value, kind).reshape(shape)


class _BoxTrack(NamedTuple):
    class_name: str
    size_lwh: Float64[np.ndarray, "3"]
    times_us: Int64[np.ndarray, " t"]
    poses: Float64[np.ndarray, "t 4 4"]


class _NurecReader:
    """Reads one scene; raises `SceneFormatError` for all that does not fit."""

    def __init__(self, path: Path, state: dict[str, Any], tracks: Any = None, rigs: Any = None) -> None:
        self.path, self.state = path, state
        try:
            self.tracks = dict(_tracks(tracks or {}))
            self.rigs = rigs or {}
            driven = [np.array(each["T_rig_world_timestamps_us"], np.int64) for each in self.drives]
        except MISFITS as error:
            raise misfit(path, error) from None
        moments = [*(each.times_us for each in self.tracks.values()), *driven]
        self.start_us = min((int(each.min()) for each in moments if len(each)), default=0)
        self.end_us = max((int(each.max()) for each in moments if len(each)), default=0)

    @property
    def drives(self) -> list[dict[str, Any]]:
        return [each for each in self.rigs.get("rig_trajectories") or [] if each.get("T_rig_worlds")]

    def scene(self, name: str) -> Scene:
        try:
            return self._scene(name)
        except SceneFormatError:
            raise
        except MISFITS as error:
            raise misfit(self.path, error) from None

    def _scene(self, name: str) -> Scene:
        layers: list[Layer] = []
        actors: list[Actor] = []
        for node in self.nodes:
            gaussians, fit = self.gaussians(node)
            cuboids = self.state.get(f"{_NODES}{node}.gaussian_cuboid_ids")
            if cuboids is not None:
                actors += self.actors(node, gaussians, np.asarray(cuboids, np.int64).reshape(-1)[fit])
            else:
                layers.append(Layer(printable_name(node), gaussians))
        if not layers and not actors:
            raise SceneFormatError(self.path, "it holds no Gaussians (.gaussians_nodes)")
        if (textures := self.state.get(_SKY)) is not None:
            cubemap = checked_cubemap(array_of(textures))
            layers.append(dome_layer(lambda ways: sample_cubemap(cubemap, ways @ _TO_CUBEMAP.T), layers))
        ego, rig, ground_m = self.ego()
        return Scene(name, tuple(layers), tuple(actors), ground_m=ground_m, ego=ego, rigs={_RIG: rig} if rig else {})

    @property
    def nodes(self) -> list[str]:
        """Names of the nodes that have all arrays of Gaussians."""
        found = [key.removeprefix(_NODES).removesuffix(".positions") for key in self.state if key.startswith(_NODES)]
        return [
            each for each in dict.fromkeys(found) if all(f"{_NODES}{each}.{name}" in self.state for name in _ARRAYS)
        ]

    def gaussians(self, node: str) -> tuple[Gaussians, "np.ndarray[tuple[int], np.dtype[np.bool_]]"]:
        """Gaussians of a node, of colors over time the mean, and which of its rows they are."""
        means, scales, quaternions, logits, albedo, specular = (
            self.state[f"{_NODES}{node}.{name}"] for name in _ARRAYS
        )
        constant = albedo.reshape(len(means), -1, 3)[:, :1]
        others = specular.reshape(len(means), -1, 3)
        return activated_rows(self.path, SplatTensors(means, scales, quaternions, logits, constant, others))

    def actors(self, node: str, gaussians: Gaussians, cuboids: Int64[np.ndarray, " n"]) -> Iterator[Actor]:
        """Road users of a node, by the numbers that its Gaussians have; hidden without a track."""
        extra = self.state.get(_EXTRA)
        listed = extra.get("obj_track_ids") if isinstance(extra, Mapping) else None
        names = [str(each) for each in listed.get(node, [])] if isinstance(listed, Mapping) else []
        untracked = 0
        for k in np.unique(cuboids).tolist():
            name = names[k] if 0 <= k < len(names) else f"{node}_{k}"
            own, label = gaussians.take(np.flatnonzero(cuboids == k)), printable_name(name.split("@")[0])
            track = self.tracks.get(name)
            if track is None or not len(track.times_us):
                untracked += 1
                yield hidden_actor(label, own)
                continue
            corners = np.stack([-track.size_lwh / 2, track.size_lwh / 2])
            times = (track.times_us - self.start_us) / MICROSECONDS
            valid = np.ones(len(times), np.bool_)
            valid[-1] = int(track.times_us[-1]) >= self.end_us
            yield boxed_actor(label, track.class_name, own, FORWARD, UP, corners, times, track.poses, valid)
        if untracked:
            logger.warning("%s: %d road users have no track in it: they are hidden actors", self.path, untracked)

    def ego(self) -> tuple[PoseTrack | None, tuple[RigCamera, ...], float | None]:
        """Track of the rig at our height above its ground, its cameras without lenses, and the height of the ground."""
        if not self.drives:
            return None, (), None
        drive = self.drives[0]
        to_scene = np.array((self.rigs.get("world_to_nre") or {}).get("matrix", np.eye(4)), np.float64)
        poses = to_scene @ np.array(drive["T_rig_worlds"], np.float64).reshape(-1, 4, 4)
        times_us = np.array(drive["T_rig_world_timestamps_us"], np.int64)
        times, rows = np.unique(times_us, return_index=True)
        if len(times_us) != len(poses) or not np.isfinite(poses).all():
            raise ValueError("the rig's poses and times must be as many, and finite")
        up = np.eye(4)
        up[2, 3] = _RIG_HEIGHT_M
        track = track_of((times - self.start_us) / MICROSECONDS, poses[rows] @ up, np.ones(len(times), np.bool_))
        cameras: list[RigCamera] = []
        left_out: list[str] = []
        for key, calibration in (self.rigs.get("camera_calibrations") or {}).items():
            label = printable_name(str(calibration.get("logical_sensor_name") or key).split("@")[0])
            camera = _pinhole(label, calibration, np.linalg.inv(up))
            cameras += [] if camera is None else [camera]
            left_out += [label] if camera is None else []
        if left_out:
            logger.warning("%s: cameras with lenses are left out: %s", self.path, ", ".join(left_out))
        return track, tuple(cameras), float(np.median(poses[:, 2, 3]))


def _tracks(sequences: Mapping[str, Any]) -> Iterator[tuple[str, _BoxTrack]]:
    """Tracks by their names; poses are x, y, z and a quaternion xyzw of the center of the box."""
    for sequence in sequences.values():
        tracks, boxes = sequence["tracks_data"], sequence.get("cuboidtracks_data") or {}
        names = tracks["tracks_id"]
        classes = tracks.get("tracks_label_class") or ["object"] * len(names)
        sizes = boxes.get("cuboids_dims") or [[0.0, 0.0, 0.0]] * len(names)
        rows = zip(names, classes, sizes, tracks["tracks_timestamps_us"], tracks["tracks_poses"], strict=True)
        for name, label, size, times, values in rows:
            poses = np.array(values, np.float64).reshape(-1, 7)
            times_us, order = np.unique(np.array(times, np.int64), return_index=True)
            if len(times) != len(poses) or not np.isfinite(poses).all():
                raise ValueError(f"track {name!r} must have as many poses as times, of finite numbers")
            placed = poses_of(poses[order, :3], poses[order][:, [6, 3, 4, 5]]) if len(order) else np.zeros((0, 4, 4))
            yield str(name), _BoxTrack(_CLASSES.get(label, str(label)), np.array(size, np.float64), times_us, placed)


def _pinhole(name: str, calibration: Mapping[str, Any], down: Float64[np.ndarray, "4 4"]) -> RigCamera | None:
    """Camera of a calibration; None for one with a lens, which would be drawn wrongly."""
    model = calibration["camera_model"]
    parameters = model["parameters"]
    bent = [*parameters.get("radial_coeffs", []), *parameters.get("tangential_coeffs", [])]
    if "focal_length" not in parameters or any(bent):
        return None
    width, height = (int(each) for each in parameters["resolution"])
    (fx, fy), (cx, cy) = parameters["focal_length"], parameters["principal_point"]
    mounted = down @ np.array(calibration["T_sensor_rig"], np.float64).reshape(4, 4)
    return RigCamera(name, width, height, float(fx), float(fy), float(cx), float(cy), mounted, DEFAULT_EXPOSURE_S)


FORMAT = Format(
    ".nurec",
    read_nurec,
    None,
    "volumes of NVIDIA's NuRec and 3DGRUT: nodes as layers, the sky; road users without tracks",
    read_scene=read_nurec_scene,
)
