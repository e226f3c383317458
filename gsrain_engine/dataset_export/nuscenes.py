"""nuScenes: samples of cameras and a lidar, and the thirteen tables of its development kit.

Facts: docs/schema_nuscenes.md of github.com/nutonomy/nuscenes-devkit (Caesar et al. 2020).
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..datasets.geometry import Pose, intrinsics, invert_pose
from ..render.images import write_image
from ..report.numbers import write_text
from ..safe_io.file_names import file_word
from ..scene.geometry import quaternions_from_matrices
from ..scene.objects import coco_class
from .layout import DatasetLayout, LabeledDataset, camera_word, timestamp_us
from .source import DatasetSource, LidarRows, PlacedBox

VERSION = "v1.0-rain"
"""Name of the folder of tables, which readers ask for."""

_LIDAR = "LIDAR_TOP"
_MAP = "maps/none.png"
_WHITE = 100.0
"""Intensity of a white, matt surface, of 0 to 255: brighter ones reflect light back to where it comes from."""

_TO_LIDAR = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""From x forward, y left to the axes of nuScenes' lidar: x right, y forward, z up."""

_CATEGORIES = {
    "car": "vehicle.car", "truck": "vehicle.truck", "bus": "vehicle.bus.rigid", "train": "vehicle.bus.rigid",
    "motorcycle": "vehicle.motorcycle", "bicycle": "vehicle.bicycle", "person": "human.pedestrian.adult",
    "rider": "vehicle.bicycle", "cyclist": "vehicle.bicycle",
}  # fmt: skip
"""Categories of nuScenes by class of COCO; names that are nuScenes' own stay, others become static objects."""

_ATTRIBUTES = "vehicle.moving", "vehicle.stopped", "pedestrian.moving", "pedestrian.standing"
_MOVING_M_S = 0.2
_VISIBILITY = (("1", "v0-40", 0.4), ("2", "v40-60", 0.6), ("3", "v60-80", 0.8), ("4", "v80-100", np.inf))
"""Tokens, levels and upper ends of the visible share."""

_Row = dict[str, Any]


class NuscenesLayout(DatasetLayout):
    """`samples/CHANNEL/SCENE__CHANNEL__TIMESTAMP.jpg` and tables in `v1.0-rain`."""

    name = "nuscenes"
    summary = f"samples/CAM_FRONT/..., samples/{_LIDAR}/..., tables in {VERSION}"
    needs_poses = True

    def picture_file(self, source: DatasetSource, moment: int, camera: str) -> str:
        shot = source.shot(moment, camera)
        assert shot is not None
        return _file(source, _channel(camera), timestamp_us(shot.time_s, source), "jpg")

    def sweep_files(self, source: DatasetSource, moment: int) -> Sequence[str]:
        return [_file(source, _LIDAR, timestamp_us(source.sweep_time_s(moment), source), "pcd.bin")]

    def sweep_bytes(self, rows: LidarRows) -> bytes:
        """Return rows x, y, z (x right, y forward, z up), intensity (0..255) and ring, as 32-bit floats."""
        points = rows.points_m @ _TO_LIDAR[:3, :3].T
        light = np.clip(np.rint(_WHITE * rows.intensities), 0, 255)
        return np.column_stack([points, light, rows.rings]).astype("<f4").tobytes()

    def write_tables(self, dataset: LabeledDataset, folder: Path) -> None:
        tables = _Tables(dataset, self).tables
        for name, rows in tables.items():
            write_text(folder / VERSION / f"{name}.json", json.dumps(rows, indent=0) + "\n")
        write_image(folder / _MAP, Image.fromarray(np.zeros((8, 8), np.uint8)))


class _Tables:
    def __init__(self, dataset: LabeledDataset, layout: NuscenesLayout) -> None:
        self._dataset, self._source, self._layout = dataset, dataset.source, layout
        self.tables: dict[str, list[_Row]] = {
            name: []
            for name in (
                "category", "attribute", "visibility", "instance", "sensor", "calibrated_sensor", "ego_pose", "log",
                "scene", "sample", "sample_data", "sample_annotation", "map",
            )
        }  # fmt: skip
        self._add_sensors()
        self._add_samples()
        self._add_annotations()

    def _token(self, *words: object) -> str:
        """Token of a row: 32 hex digits that are always the same."""
        return hashlib.md5("|".join(map(str, (self._source.name, *words))).encode(), usedforsecurity=False).hexdigest()

    def _add_sensors(self) -> None:
        source = self._source
        for camera in source.cameras:
            matrix = next(
                intrinsics(shot.camera, 0.0)
                for number in range(len(source.moments))
                if (shot := source.shot(number, camera)) is not None
            )
            self._add_sensor(_channel(camera), "camera", source.camera_to_vehicle(camera), matrix.tolist())
        if (lidar := self._lidar_to_vehicle) is not None:
            self._add_sensor(_LIDAR, "lidar", lidar @ _TO_LIDAR.T, [])

    def _add_sensor(self, channel: str, modality: str, to_vehicle: Pose, matrix: list[list[float]]) -> None:
        sensor = self._token("sensor", channel)
        self.tables["sensor"].append({"token": sensor, "channel": channel, "modality": modality})
        calibrated = {"token": self._token("calibrated_sensor", channel), "sensor_token": sensor}
        self.tables["calibrated_sensor"].append(calibrated | _posed(to_vehicle) | {"camera_intrinsic": matrix})

    @property
    def _lidar_to_vehicle(self) -> Pose | None:
        placed = zip(self._source.moments, self._dataset.lidar_to_world, strict=True)
        found = (invert_pose(moment.vehicle_to_world) @ pose for moment, pose in placed if pose is not None)
        return next(found, None)

    def _add_samples(self) -> None:
        source, tables = self._source, self.tables
        log, scene = self._token("log"), self._token("scene")
        tables["log"].append(
            {"token": log, "logfile": source.name, "vehicle": "", "date_captured": "", "location": source.name}
        )
        tables["map"].append(
            {"token": self._token("map"), "log_tokens": [log], "category": "semantic_prior", "filename": _MAP}
        )
        samples = [self._token("sample", number) for number in range(len(source.moments))]
        tables["scene"].append({
            "token": scene, "log_token": log, "nbr_samples": len(samples), "first_sample_token": samples[0],
            "last_sample_token": samples[-1], "name": _scene_name(source),
            "description": f"{source.kind} {source.name}",
        })  # fmt: skip
        lidar_to_vehicle = self._lidar_to_vehicle
        for number, (token, (before, after)) in enumerate(zip(samples, _neighbors(samples), strict=True)):
            time = timestamp_us(source.sweep_time_s(number), source)
            row = {"token": token, "timestamp": time, "prev": before, "next": after, "scene_token": scene}
            tables["sample"].append(row)
        for camera in source.cameras:
            to_vehicle = invert_pose(source.camera_to_vehicle(camera))
            rows = [
                self._data(
                    number, _channel(camera), self._layout.picture_file(source, number, camera), "jpg", shot.time_s,
                    shot.camera.camera_to_world @ to_vehicle, (shot.camera.width, shot.camera.height),
                )
                for number in range(len(samples))
                if (shot := source.shot(number, camera)) is not None
            ]  # fmt: skip
            tables["sample_data"] += _chained(rows)
        rows = []
        for number, pose in enumerate(self._dataset.lidar_to_world):
            if pose is not None and lidar_to_vehicle is not None:
                (file,) = self._layout.sweep_files(source, number)
                vehicle = pose @ invert_pose(lidar_to_vehicle)
                rows.append(self._data(number, _LIDAR, file, "pcd", source.sweep_time_s(number), vehicle, (0, 0)))
        tables["sample_data"] += _chained(rows)

    def _data(
        self, moment: int, channel: str, file: str, form: str, time_s: float, vehicle_to_world: Pose,
        size: tuple[int, int],
    ) -> _Row:  # fmt: skip
        """Row of a sensor's file; the pose of the vehicle at its time gets the same token, as in nuScenes."""
        token, time = self._token("sample_data", channel, moment), timestamp_us(time_s, self._source)
        self.tables["ego_pose"].append({"token": token, "timestamp": time} | _posed(vehicle_to_world))
        return {
            "token": token, "sample_token": self._token("sample", moment), "ego_pose_token": token,
            "calibrated_sensor_token": self._token("calibrated_sensor", channel), "timestamp": time,
            "fileformat": form, "is_key_frame": True, "height": size[1], "width": size[0], "filename": file,
        }  # fmt: skip

    def _add_annotations(self) -> None:
        tables, dataset = self.tables, self._dataset
        tables["attribute"] = [
            {"token": self._token("attribute", each), "name": each, "description": ""} for each in _ATTRIBUTES
        ]
        tables["visibility"] = [
            {"token": token, "level": level, "description": f"visible share of an object: {level[1:]} %"}
            for token, level, _ in _VISIBILITY
        ]
        visible: dict[tuple[int, str], float] = {}
        for (moment, _), objects in dataset.objects.items():
            for each in objects:
                key = moment, str(each["object"])
                visible[key] = max(visible.get(key, 0.0), float(each["visibility"]))
        placed: dict[str, list[tuple[int, PlacedBox, int]]] = defaultdict(list)
        for moment, (boxes, counts) in enumerate(zip(dataset.boxes, dataset.lidar_points, strict=True)):
            for box, count in zip(boxes, counts, strict=True):
                if count or (moment, box.id) in visible:
                    placed[box.id].append((moment, box, count))
        categories = sorted({_category(each[0][1].class_name) for each in placed.values()})
        tables["category"] = [
            {"token": self._token("category", name), "name": name, "description": "", "index": index}
            for index, name in enumerate(categories)
        ]
        for id, seen in placed.items():
            self._add_instance(id, seen, visible)

    def _add_instance(
        self, id: str, placed: Sequence[tuple[int, PlacedBox, int]], visible: dict[tuple[int, str], float]
    ) -> None:
        tokens = [self._token("sample_annotation", id, moment) for moment, _, _ in placed]
        name = _category(placed[0][1].class_name)
        instance = {
            "token": self._token("instance", id), "category_token": self._token("category", name),
            "nbr_annotations": len(tokens), "first_annotation_token": tokens[0], "last_annotation_token": tokens[-1],
        }  # fmt: skip
        self.tables["instance"].append(instance)
        rows: list[_Row] = []
        for token, (moment, box, count) in zip(tokens, placed, strict=True):
            length, width, height = box.size_lwh_m
            center = box.to_world.copy()
            center[:3, 3] += center[:3, 2] * (height / 2)
            share = visible.get((moment, id), 0.0)
            attribute = _attribute(name, self._speed_m_s(moment, box))
            rows.append(
                {
                    "token": token, "sample_token": self._token("sample", moment),
                    "instance_token": instance["token"],
                    "visibility_token": next(level for level, _, end in _VISIBILITY if share < end),
                    "attribute_tokens": [] if attribute is None else [self._token("attribute", attribute)],
                    "size": [round(width, 4), round(length, 4), round(height, 4)], "num_lidar_pts": count,
                    "num_radar_pts": 0,
                } | _posed(center)
            )  # fmt: skip
        self.tables["sample_annotation"] += _chained(rows)

    def _speed_m_s(self, moment: int, box: PlacedBox) -> float:
        """Speed by the places at the moments before and after; 0 for an object that has none of them."""
        places = [
            (self._source.sweep_time_s(number), other.to_world[:3, 3])
            for number in (moment - 1, moment, moment + 1)
            if 0 <= number < len(self._dataset.boxes)
            for other in self._dataset.boxes[number]
            if other.id == box.id
        ]
        (first_s, first), (last_s, last) = places[0], places[-1]
        return float(np.linalg.norm(last - first)) / (last_s - first_s) if last_s > first_s else 0.0


def _attribute(category: str, speed_m_s: float) -> str | None:
    moves = speed_m_s > _MOVING_M_S
    if category.startswith("human.pedestrian"):
        return "pedestrian.moving" if moves else "pedestrian.standing"
    if category.startswith("vehicle.") and category not in ("vehicle.bicycle", "vehicle.motorcycle"):
        return "vehicle.moving" if moves else "vehicle.stopped"
    return None


def _category(class_name: str) -> str:
    if class_name.startswith(("vehicle.", "human.", "movable_object.", "static_object.")):
        return class_name
    known = coco_class(class_name)
    return _CATEGORIES.get(known, f"static_object.{known.replace(' ', '_')}")


def _channel(camera: str) -> str:
    word = camera_word(camera).upper()
    return word if word.startswith("CAM") else f"CAM_{word}"


def _scene_name(source: DatasetSource) -> str:
    word = file_word(source.name)
    return word if word.startswith("scene-") else f"scene-{word}"


def _file(source: DatasetSource, channel: str, timestamp: int, suffix: str) -> str:
    return f"samples/{channel}/{file_word(source.name)}__{channel}__{timestamp:016d}.{suffix}"


def _posed(pose: Pose) -> _Row:
    w, x, y, z = np.asarray(quaternions_from_matrices(pose[None, :3, :3]), np.float64)[0].tolist()
    return {"translation": pose[:3, 3].tolist(), "rotation": [w, x, y, z]}


def _neighbors(tokens: Sequence[str]) -> list[tuple[str, str]]:
    return list(zip(["", *tokens], [*tokens[1:], ""], strict=False)) if tokens else []


def _chained(rows: Sequence[_Row]) -> list[_Row]:
    """Return rows with the tokens of those before and after them; "" at the ends."""
    tokens = [str(each["token"]) for each in rows]
    return [row | {"prev": a, "next": b} for row, (a, b) in zip(rows, _neighbors(tokens), strict=True)]
