"""Drives of the miniature world, written as each driving data set has them."""

import json
import pickle
import shutil
import zlib
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.datasets.kitti import CAMERA_HEIGHT_M, IMU_HEIGHT_M
from gsrain_engine.datasets.kitti_objects import LIDAR_HEIGHT_M
from gsrain_engine.datasets.waymo import parsed
from mini_drive import BOX_LWH, FOCAL, HEIGHT, STEP_M, WIDTH, YAW, MiniDrive, quaternion, turned
from tfrecord_framing import framed
from waymo_lidar import BEAMS, LIDAR_TO_VEHICLE, pixel_poses, range_image

Rows = dict[str, list[dict[str, Any]]]
"""Rows of tables, by their names."""


DRIVE = MiniDrive()
INTRINSICS = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
"""K as OpenCV counts pixels, from their centers."""


def text_row(values: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in values.ravel())


# Damage

Change = bytes | None | Callable[[bytes], bytes]
"""New content of a file, None to remove it (or a folder), or a function of its content."""


def damaged(write: Callable[[Path], object], changes: dict[str, Change], below: str = ".") -> Callable[[Path], Path]:
    """Return a function that writes a drive, changes some of its files, and returns the path `below` to open."""

    def write_damaged(folder: Path) -> Path:
        write(folder)
        for name, change in changes.items():
            file = folder / name
            if change is None:
                shutil.rmtree(file) if file.is_dir() else file.unlink()
            else:
                file.write_bytes(change(file.read_bytes()) if callable(change) else change)
        return folder / below

    return write_damaged


def edited(change: Callable[[Any], object], form: Any = json) -> Callable[[bytes], bytes]:
    """Change the values in the content of a file, of JSON or (`form` pickle) a pickle."""

    def edit(content: bytes) -> bytes:
        values = form.loads(content)
        change(values)
        written = form.dumps(values)
        return written if isinstance(written, bytes) else written.encode()

    return edit


# DGP


def write_dgp(folder: Path, drive: MiniDrive = DRIVE, camera_lens: dict[str, float] | None = None) -> Path:
    scene = folder / "scene_07"
    for name in ("calibration", "ontology", "bounding_box_3d/LIDAR", "rgb/CAM", "point_cloud/LIDAR"):
        (scene / name).mkdir(parents=True)
    lens = {"fx": FOCAL, "fy": FOCAL, "cx": WIDTH / 2 - 0.5, "cy": HEIGHT / 2 - 0.5, "skew": 0.0, **(camera_lens or {})}
    zero = dict.fromkeys(lens, 0.0)
    calibration = {
        "names": ["LIDAR", "CAM"],
        "extrinsics": [_pose(drive.lidar_to_vehicle), _pose(drive.camera_to_vehicle)],
        "intrinsics": [zero, lens],
    }
    (scene / "calibration" / "cal.json").write_text(json.dumps(calibration))
    (scene / "ontology" / "ont.json").write_text(json.dumps({"items": [{"id": 4, "name": "Car"}]}))
    data: list[dict[str, Any]] = []
    samples: list[dict[str, Any]] = []
    for k in range(drive.samples):
        vehicle = drive.vehicle_to_world(k)
        stamp = f"2464-11-12T01:04:{10 + 0.5 * k:09.6f}Z"
        (scene / f"rgb/CAM/{k}.jpg").write_bytes(drive.jpeg(k))
        points = drive.lidar_points(k).astype(np.float64)
        np.savez_compressed(
            scene / f"point_cloud/LIDAR/{k}.npz", data=np.column_stack([points, np.full(len(points), 0.5)])
        )
        box = np.linalg.inv(drive.lidar_to_vehicle) @ drive.box_to_vehicle(k)
        sides = dict(zip(("length", "width", "height"), BOX_LWH, strict=True))
        row = {"class_id": 4, "instance_id": 7, "num_points": 60, "box": {**sides, "pose": _pose(box)}}
        (scene / f"bounding_box_3d/LIDAR/{k}.json").write_text(json.dumps({"annotations": [row]}))
        cloud = {
            "filename": f"point_cloud/LIDAR/{k}.npz",
            "point_format": ["X", "Y", "Z", "INTENSITY"],
            "annotations": {"1": f"bounding_box_3d/LIDAR/{k}.json"},
            "pose": _pose(vehicle @ drive.lidar_to_vehicle),
        }
        image = {"filename": f"rgb/CAM/{k}.jpg", "width": WIDTH, "height": HEIGHT}
        image["pose"] = _pose(vehicle @ drive.camera_to_vehicle)
        for key, kind, value in ((f"l{k}", "point_cloud", cloud), (f"c{k}", "image", image)):
            name = "LIDAR" if kind == "point_cloud" else "CAM"
            data.append({"key": key, "id": {"name": name, "timestamp": stamp}, "datum": {kind: value}})
        samples.append({"id": {"timestamp": stamp}, "calibration_key": "cal", "datum_keys": [f"l{k}", f"c{k}"]})
    file = scene / "scene_abc.json"
    file.write_text(json.dumps({"name": "mini", "data": data, "samples": samples, "ontologies": {"1": "ont"}}))
    splits = {"0": {"filenames": ["scene_07/scene_abc.json", "scene_09/scene_abc.json"]}}
    (folder / "scene_dataset_v1.json").write_text(json.dumps({"scene_splits": splits}))
    return file


def _pose(matrix: np.ndarray) -> dict[str, Any]:
    turn = dict(zip(("qw", "qx", "qy", "qz"), quaternion(matrix), strict=True))
    return {"translation": dict(zip("xyz", matrix[:3, 3].tolist(), strict=True)), "rotation": turn}


# nuScenes, its own tables and the info files of MMDetection3D


def write_nuscenes(root: Path, drive: MiniDrive = DRIVE, scenes: tuple[str, ...] = ("scene-0061",)) -> None:
    """The tables of the devkit's schema; the drive happens in each scene, 100 s apart."""
    length, width, height = BOX_LWH
    matrix = INTRINSICS.tolist()
    tables: Rows = defaultdict(list)
    tables |= {
        "sensor": [
            {"token": "s-cam", "channel": "CAM_FRONT", "modality": "camera"},
            {"token": "s-top", "channel": "LIDAR_TOP", "modality": "lidar"},
            {"token": "s-radar", "channel": "RADAR_FRONT", "modality": "radar"},
        ],
        "calibrated_sensor": [
            {"token": "c-cam", "sensor_token": "s-cam", **_placed(drive.camera_to_vehicle), "camera_intrinsic": matrix},
            {"token": "c-top", "sensor_token": "s-top", **_placed(drive.lidar_to_vehicle), "camera_intrinsic": []},
            {"token": "c-radar", "sensor_token": "s-radar", **_placed(np.eye(4)), "camera_intrinsic": []},
        ],
        "category": [{"token": "car", "name": "vehicle.car", "description": ""}],
    }
    for channel in ("CAM_FRONT", "LIDAR_TOP", "RADAR_FRONT"):
        (root / "samples" / channel).mkdir(parents=True, exist_ok=True)
    for number, scene in enumerate(scenes):
        tables["scene"].append({"token": f"t-{scene}", "name": scene, "nbr_samples": drive.samples, "description": ""})
        tables["instance"].append({"token": f"i-{scene}", "category_token": "car", "nbr_annotations": drive.samples})
        for k in range(drive.samples):
            key, time = f"{scene}-{k}", int(drive.time(k) * 1e6) + number * 100_000_000
            sample = {"token": key, "timestamp": time, "scene_token": f"t-{scene}", "prev": "", "next": ""}
            tables["sample"].append(sample)
            tables["ego_pose"].append({"token": f"e-{key}", "timestamp": time, **_placed(drive.vehicle_to_world(k))})
            box = {"sample_token": key, "instance_token": f"i-{scene}", "size": [width, length, height]}
            tables["sample_annotation"].append({"token": f"a-{key}", **box, **_placed(drive.box_to_world())})
            points = drive.lidar_points(k)
            rows = np.column_stack([points, np.full(len(points), 9.0), np.zeros(len(points))]).astype(np.float32)
            shared = {"sample_token": key, "ego_pose_token": f"e-{key}", "timestamp": time, "is_key_frame": True}
            for channel, sensor, suffix, content in (
                ("CAM_FRONT", "c-cam", "jpg", drive.jpeg(k)),
                ("LIDAR_TOP", "c-top", "pcd.bin", rows.tobytes()),
            ):
                file = f"samples/{channel}/{key}.{suffix}"
                named = {"token": f"d-{channel}-{key}", "calibrated_sensor_token": sensor, "filename": file}
                tables["sample_data"].append({**named, **shared})
                (root / file).write_bytes(content)
    # A picture between two samples, and a radar, which is nothing for us.
    between = {**tables["sample_data"][0], "token": "between", "is_key_frame": False}
    radar = {"token": "radar", "calibrated_sensor_token": "c-radar", "is_key_frame": True}
    tables["sample_data"] += [{**between, "timestamp": between["timestamp"] + 83_000}, {**between, **radar}]
    (root / "v1.0-mini").mkdir(exist_ok=True)
    for name, rows in tables.items():
        (root / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows))


def _placed(pose: np.ndarray) -> dict[str, Any]:
    return {"translation": pose[:3, 3].tolist(), "rotation": quaternion(pose)}


def write_infos(folder: Path, drive: MiniDrive = DRIVE, layout: str = "1.x", times: list[float] | None = None) -> Path:
    """An info file of version 1.x, or of one before with boxes as of then ("0.x") or of its last candidates ("rc").

    "waymo" is one of version 1.x of Waymo's drives, in the folders of KITTI.
    """
    if layout == "waymo":
        return _write_waymo_infos(folder, drive)
    matrix = INTRINSICS.tolist()
    rows: list[dict[str, Any]] = []
    for k in range(drive.samples):
        for name in ("samples/CAM_FRONT", "samples/LIDAR_TOP"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / f"samples/CAM_FRONT/{k}.jpg").write_bytes(drive.jpeg(k))
        points = drive.lidar_points(k)
        columns = np.column_stack([points, np.full((len(points), 2), 3.0, np.float32)])
        columns.astype(np.float32).tofile(folder / f"samples/LIDAR_TOP/{k}.pcd.bin")
        vehicle, time = drive.vehicle_to_world(k), (times or [drive.time(s) for s in range(drive.samples)])[k]
        box = np.linalg.inv(drive.lidar_to_vehicle) @ drive.box_to_vehicle(k)
        yaw = float(np.arctan2(box[1, 0], box[0, 0]))
        length, width, height = BOX_LWH
        if layout == "1.x":
            lidar_to_camera = np.linalg.inv(drive.camera_to_vehicle) @ drive.lidar_to_vehicle
            camera = {"img_path": f"{k}.jpg", "cam2img": matrix, "lidar2cam": lidar_to_camera, "timestamp": time}
            lidar = {"lidar_path": f"{k}.pcd.bin", "num_pts_feats": 5, "lidar2ego": drive.lidar_to_vehicle}
            instance = {"bbox_3d": [*box[:3, 3], length, width, height, yaw], "bbox_label_3d": 0}
            row = {"ego2global": vehicle, "images": {"CAM_FRONT": camera}, "lidar_points": lidar}
            rows.append({"timestamp": time, **row, "instances": [instance]})
            continue
        sides, turn = ([width, length], -yaw - np.pi / 2) if layout == "0.x" else ([length, width], yaw)
        placed = _info_pose("ego2global", vehicle)
        camera = {
            "data_path": f"./data/nuscenes/samples/CAM_FRONT/{k}.jpg",
            "timestamp": time * 1e6,
            "cam_intrinsic": np.array(matrix),
            **_info_pose("sensor2ego", drive.camera_to_vehicle),
        }
        rows.append(
            {
                "lidar_path": f"./data/nuscenes/samples/LIDAR_TOP/{k}.pcd.bin",
                "timestamp": time * 1e6,
                **placed,
                **_info_pose("lidar2ego", drive.lidar_to_vehicle),
                "cams": {"CAM_FRONT": {**camera, **placed}},
                "gt_boxes": np.array([[*box[:3, 3], *sides, height, turn]]),
                "gt_names": np.array(["Car"]),
            }
        )
    metainfo = {"categories": {"Car": 0}, "dataset": "nuscenes"}
    values = {"metainfo": metainfo, "data_list": rows} if layout == "1.x" else {"infos": rows, "metadata": {}}
    file = folder / "nuscenes_infos_train.pkl"
    file.write_bytes(pickle.dumps(values))
    return file


def _write_waymo_infos(folder: Path, drive: MiniDrive) -> Path:
    rows: list[dict[str, Any]] = []
    for name in ("image_0", "image_1", "velodyne"):
        (folder / "training" / name).mkdir(parents=True)
    for k in range(drive.samples):
        (folder / f"training/image_0/{k:07d}.jpg").write_bytes(drive.jpeg(k))
        (folder / f"training/image_1/{k:07d}.jpg").write_bytes(b"of another camera")
        points = drive.lidar_points(k) @ drive.lidar_to_vehicle[:3, :3].T + drive.lidar_to_vehicle[:3, 3]
        columns = np.column_stack([points, np.full((len(points), 3), 3.0)]).astype(np.float32)
        columns.tofile(folder / f"training/velodyne/{k:07d}.bin")
        box, (length, width, height) = drive.box_to_vehicle(k), BOX_LWH
        bottom = [*box[:2, 3], box[2, 3] - height / 2]
        yaw = float(np.arctan2(box[1, 0], box[0, 0]))
        to_camera = np.linalg.inv(drive.camera_to_vehicle)
        camera = {"img_path": f"{k:07d}.jpg", "cam2img": np.column_stack([INTRINSICS, np.zeros(3)])}
        rows.append(
            {
                "timestamp": round(drive.time(k) * 1e6),
                "ego2global": drive.vehicle_to_world(k),
                "images": {"CAM_FRONT": {**camera, "lidar2cam": to_camera}},
                "lidar_points": {"lidar_path": f"{k:07d}.bin", "num_pts_feats": 6},
                "instances": [{"bbox_3d": [*bottom, length, width, height, yaw], "bbox_label_3d": 0}],
            }
        )
    file = folder / "waymo_infos_train.pkl"
    file.write_bytes(pickle.dumps({"metainfo": {"dataset": "waymo"}, "data_list": rows}))
    return file


def _info_pose(name: str, pose: np.ndarray) -> dict[str, Any]:
    return {f"{name}_translation": pose[:3, 3], f"{name}_rotation": quaternion(pose)}


# Argoverse 2, sensor logs


def drive_above_its_axle() -> MiniDrive:
    return MiniDrive(road_m=-0.33)


ARGOVERSE_LOG = "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"


def write_argoverse2(folder: Path, drive: MiniDrive | None = None) -> Path:
    """A log as the public reader opens it: tables of Arrow, turns of half-precision points in the vehicle's frame."""
    import pytest

    arrow = pytest.importorskip("pyarrow")
    drive, log = drive or drive_above_its_axle(), folder / ARGOVERSE_LOG
    camera = "ring_front_center"
    for part in ("calibration", f"sensors/cameras/{camera}", "sensors/lidar"):
        (log / part).mkdir(parents=True)

    def write(name: str, rows: dict[str, Any], compression: str = "lz4") -> None:
        table = arrow.table(rows)
        count = table.num_rows
        index = {"kind": "range", "name": None, "start": 0, "stop": count, "step": 1}
        table = table.replace_schema_metadata({"pandas": json.dumps({"index_columns": [index], "columns": []})})
        options = arrow.ipc.IpcWriteOptions(compression=compression)
        with (
            arrow.OSFile(str(log / name), "wb") as sink,
            arrow.ipc.new_file(sink, table.schema, options=options) as file,
        ):
            file.write_table(table)

    lens = {
        "fx_px": FOCAL,
        "fy_px": FOCAL,
        "cx_px": WIDTH / 2 - 0.5,
        "cy_px": HEIGHT / 2 - 0.5,
        "k1": -0.24,
        "k2": -0.2,
        "k3": 0.3,
    }
    sizes = {"height_px": HEIGHT, "width_px": WIDTH}
    lens_rows = {name: [value] for name, value in lens.items()}
    lens_rows |= {name: arrow.array([value], arrow.uint16()) for name, value in sizes.items()}
    write("calibration/intrinsics.feather", {"sensor_name": [camera], **lens_rows})
    sensors = {
        camera: drive.camera_to_vehicle,
        "up_lidar": drive.lidar_to_vehicle,
        "down_lidar": drive.lidar_to_vehicle,
    }
    write("calibration/egovehicle_SE3_sensor.feather", {"sensor_name": list(sensors), **_poses([*sensors.values()])})
    times = [round(drive.time(k) * 1e9) for k in range(drive.samples)]
    write(
        "city_SE3_egovehicle.feather",
        {"timestamp_ns": times, **_poses([drive.vehicle_to_world(k) for k in range(drive.samples)])},
    )
    names = ("length_m", "width_m", "height_m")
    boxes = {name: [side] * drive.samples for name, side in zip(names, BOX_LWH, strict=True)}
    placed = _poses([drive.box_to_vehicle(k) for k in range(drive.samples)])
    words = {"track_uuid": ["1046f12a"] * drive.samples, "category": ["REGULAR_VEHICLE"] * drive.samples}
    write(
        "annotations.feather",
        {"timestamp_ns": times, **words, **boxes, **placed, "num_interior_pts": [60] * drive.samples},
    )
    for k, time_ns in enumerate(times):
        (log / f"sensors/cameras/{camera}/{time_ns}.jpg").write_bytes(drive.jpeg(k))
        mount = drive.lidar_to_vehicle
        points = (drive.lidar_points(k) @ mount[:3, :3].T + mount[:3, 3]).astype(np.float16)
        count = len(points)
        rows = {axis: points[:, column] for column, axis in enumerate("xyz")}
        rows |= {"intensity": np.full(count, 9, np.uint8), "laser_number": np.arange(count, dtype=np.uint8) % 64}
        write(
            f"sensors/lidar/{time_ns}.feather", {**rows, "offset_ns": np.arange(count, dtype=np.int32) * 1000}, "zstd"
        )
    return log


def _poses(poses: list[np.ndarray]) -> dict[str, list[float]]:
    turns = np.array([quaternion(pose) for pose in poses])
    columns = {name: turns[:, column].tolist() for column, name in enumerate(("qw", "qx", "qy", "qz"))}
    return columns | {f"t{axis}_m": [float(pose[k, 3]) for pose in poses] for k, axis in enumerate("xyz")}


# KITTI, raw and odometry

EARTH_M = 6378137.0
LATITUDE, LONGITUDE, ALTITUDE = 49.011, 8.417, 112.8
BASELINE_M = 0.06


def drive_on_the_road() -> MiniDrive:
    return MiniDrive(road_m=-IMU_HEIGHT_M, offset=(0.0, 0.0, 0.0))


RAW = "2011_09_26_drive_0005_sync"


def write_kitti(day: Path, drive: MiniDrive | None = None) -> Path:
    """A drive as the raw data has it; the lidar's frame here is turned a little, and rectification turns too."""
    drive, folder = drive or drive_on_the_road(), day / RAW
    for part in ("oxts/data", "image_02/data", "velodyne_points/data"):
        (folder / part).mkdir(parents=True)
    lidar_to_imu = turned(np.radians(2.0), (1.0, 0.1, 1.8 - IMU_HEIGHT_M))
    baseline = np.eye(4)
    baseline[0, 3] = BASELINE_M
    first_to_imu = drive.camera_to_vehicle @ baseline
    rectify = np.eye(4)
    cosine, sine = np.cos(0.01), np.sin(0.01)
    rectify[1:3, 1:3] = [[cosine, -sine], [sine, cosine]]
    to_camera = np.linalg.inv(rectify) @ np.linalg.inv(first_to_imu) @ lidar_to_imu
    projection = INTRINSICS @ baseline[:3]
    lines = [
        "calib_time: 09-Jan-2012 13:57:47",
        f"R_rect_00: {text_row(rectify[:3, :3])}",
        f"P_rect_02: {text_row(projection)}",
    ]
    (day / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    for file, pose in (("velo_to_cam", to_camera), ("imu_to_velo", np.linalg.inv(lidar_to_imu))):
        text = (
            f"calib_time: 15-Mar-2012 11:37:16\nR: {text_row(pose[:3, :3])}\nT: {text_row(pose[:3, 3])}\ndelta_f: 0 0\n"
        )
        (day / f"calib_{file}.txt").write_text(text)
    scale = np.cos(np.radians(LATITUDE))
    poses = ""
    for k in range(drive.samples):
        x, y, _ = drive.vehicle_to_world(k)[:3, 3]
        start = np.log(np.tan(np.pi / 4 + np.radians(LATITUDE) / 2))
        latitude = np.degrees(2 * np.arctan(np.exp(y / (EARTH_M * scale) + start)) - np.pi / 2)
        longitude = LONGITUDE + np.degrees(x / (EARTH_M * scale))
        record = [latitude, longitude, ALTITUDE, 0.0, 0.0, YAW, *([0.0] * 24)]
        (folder / f"oxts/data/{k:010d}.txt").write_text(" ".join(f"{value:.14g}" for value in record))
        (folder / f"image_02/data/{k:010d}.jpg").write_bytes(drive.jpeg(k))
        local = drive.lidar_points(k) @ drive.lidar_to_vehicle[:3, :3].T + drive.lidar_to_vehicle[:3, 3]
        back = np.linalg.inv(lidar_to_imu)
        points = local @ back[:3, :3].T + back[:3, 3]
        rows = np.column_stack([points, np.full(len(points), 0.25)]).astype(np.float32)
        rows.tofile(folder / f"velodyne_points/data/{k:010d}.bin")
        box = back @ drive.box_to_vehicle(k)
        angle = np.arctan2(box[1, 0], box[0, 0])
        place = [box[0, 3], box[1, 3], box[2, 3] - BOX_LWH[2] / 2]
        numbers = "".join(f"<{n}>{v:.9g}</{n}>" for n, v in zip(("tx", "ty", "tz", "rz"), (*place, angle), strict=True))
        poses += f"<item>{numbers}<rx>0</rx><ry>0</ry><state>2</state></item>"
    stamps = "".join(f"2011-09-26 13:02:{25 + 0.5 * k:012.9f}\n" for k in range(drive.samples))
    for sensor in ("oxts", "image_02", "velodyne_points"):
        (folder / sensor / "timestamps.txt").write_text(stamps)
    length, width, height = BOX_LWH
    sizes = f"<objectType>Car</objectType><h>{height}</h><w>{width}</w><l>{length}</l><first_frame>0</first_frame>"
    item = f"<item>{sizes}<poses><count>3</count>{poses}</poses><finished>1</finished></item>"
    (folder / "tracklet_labels.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        f"<boost_serialization><tracklets><count>1</count>{item}</tracklets></boost_serialization>\n"
    )
    return folder


def write_kitti_objects(root: Path, drive: MiniDrive | None = None) -> Path:
    """Pictures as the object benchmark has them, here of one drive; the world is the lidar's frame of each."""
    drive, folder = drive or MiniDrive(road_m=-LIDAR_HEIGHT_M), root / "training"
    for part in ("image_2", "calib", "velodyne", "label_2"):
        (folder / part).mkdir(parents=True)
    baseline = np.eye(4)
    baseline[0, 3] = BASELINE_M
    rectify = np.eye(4)
    rectify[1:3, 1:3] = [[np.cos(0.01), -np.sin(0.01)], [np.sin(0.01), np.cos(0.01)]]
    to_first = np.linalg.inv(baseline) @ np.linalg.inv(drive.camera_to_vehicle)
    unrectified = np.linalg.inv(rectify) @ to_first
    for k in range(drive.samples):
        lines = [f"P{camera}: {text_row(INTRINSICS @ baseline[:3])}" for camera in (0, 1, 2, 3)]
        lines += [f"R0_rect: {text_row(rectify[:3, :3])}", f"Tr_velo_to_cam: {text_row(unrectified[:3])}"]
        (folder / f"calib/{k:06d}.txt").write_text(
            "\n".join([*lines, f"Tr_imu_to_velo: {text_row(np.eye(4)[:3])}", ""])
        )
        (folder / f"image_2/{k:06d}.jpg").write_bytes(drive.jpeg(k))
        points = drive.lidar_points(k) @ drive.lidar_to_vehicle[:3, :3].T + drive.lidar_to_vehicle[:3, 3]
        rows = np.column_stack([points, np.full(len(points), 0.25)]).astype(np.float32)
        rows.tofile(folder / f"velodyne/{k:06d}.bin")
        box = to_first @ drive.box_to_vehicle(k)
        length, width, height = BOX_LWH
        x, y, z = box[:3, 3] + height / 2 * -box[:3, 2]
        turn = np.arctan2(-box[2, 0], box[0, 0])
        numbers = " ".join(f"{value:.9f}" for value in (height, width, length, x, y, z, turn))
        label = f"Car 0.00 0 -1.57 10.0 10.0 20.0 20.0 {numbers}\n"
        ignored = "DontCare -1 -1 -10 5.0 5.0 9.0 9.0 -1 -1 -1 -1000 -1000 -1000 -10\n"
        (folder / f"label_2/{k:06d}.txt").write_text(label + ignored)
    return folder


def write_kitti_infos(root: Path) -> Path:
    """The same pictures, and the info file that MMDetection3D makes of them."""
    folder = write_kitti_objects(root)
    rows: list[dict[str, Any]] = []
    for number in range(DRIVE.samples):
        lines = (folder / f"calib/{number:06d}.txt").read_text().splitlines()
        matrices = {name: np.array(words.split(), float) for name, _, words in (each.partition(":") for each in lines)}
        projection, rectify, to_camera = np.eye(4), np.eye(4), np.eye(4)
        projection[:3] = matrices["P2"].reshape(3, 4)
        rectify[:3, :3] = matrices["R0_rect"].reshape(3, 3)
        to_camera[:3] = matrices["Tr_velo_to_cam"].reshape(3, 4)
        words = (folder / f"label_2/{number:06d}.txt").read_text().split()
        height, width, length, *place, turn = (float(word) for word in words[8:15])
        box = {"bbox_3d": [*place, length, height, width, turn], "bbox_label_3d": 0}
        camera = {"img_path": f"{number:06d}.jpg", "cam2img": projection, "lidar2cam": rectify @ to_camera}
        images = {"CAM0": {"cam2img": projection}, "CAM2": camera, "R0_rect": rectify}
        lidar = {"lidar_path": f"{number:06d}.bin", "num_pts_feats": 4}
        rows.append({"sample_idx": number, "images": images, "lidar_points": lidar, "instances": [box]})
    file = root / "kitti_infos_train.pkl"
    file.write_bytes(pickle.dumps({"metainfo": {"categories": {"Car": 0}}, "data_list": rows}))
    return file


KITTI360_DRIVE = "2013_05_28_drive_0000_sync"


def write_kitti360(root: Path, drive: MiniDrive = DRIVE) -> None:
    """A drive of the second camera, numbered from 1; the inertial unit looks down, and rectification turns."""
    imu_to_vehicle = np.diag([1.0, -1.0, -1.0, 1.0])
    baseline, rectify = np.eye(4), np.eye(4)
    baseline[0, 3] = -BASELINE_M
    cosine, sine = np.cos(0.01), np.sin(0.01)
    rectify[1:3, 1:3] = [[cosine, -sine], [sine, cosine]]
    first_to_imu = imu_to_vehicle @ drive.camera_to_vehicle @ baseline @ rectify
    first_to_lidar = np.linalg.inv(drive.lidar_to_vehicle) @ imu_to_vehicle @ first_to_imu
    folder, turns = root / "data_2d_raw" / KITTI360_DRIVE, root / "data_3d_raw" / KITTI360_DRIVE / "velodyne_points"
    places = root / "data_poses" / KITTI360_DRIVE
    for each in (root / "calibration", folder / "image_01/data_rect", folder / "image_02", turns / "data", places):
        each.mkdir(parents=True)
    (root / "calibration/perspective.txt").write_text(
        f"calib_time: 30-Jul-2019\nR_rect_00: {text_row(rectify[:3, :3])}\n"
        f"P_rect_01: {text_row(INTRINSICS @ baseline[:3])}\n"
    )
    (root / "calibration/calib_cam_to_pose.txt").write_text(f"image_00: {text_row(first_to_imu[:3])}\n")
    (root / "calibration/calib_cam_to_velo.txt").write_text(text_row(first_to_lidar[:3]) + "\n")
    rows = ""
    for k in range(drive.samples):
        rows += f"{k + 1} {text_row((drive.vehicle_to_world(k) @ imu_to_vehicle)[:3])}\n"
        (folder / f"image_01/data_rect/{k + 1:010d}.jpg").write_bytes(drive.jpeg(k))
        points = drive.lidar_points(k)
        np.column_stack([points, np.full(len(points), 0.25)]).astype(np.float32).tofile(
            turns / f"data/{k + 1:010d}.bin"
        )
    (places / "poses.txt").write_text(rows)
    stamps = "".join(f"2013-05-28 08:46:{2 + 0.5 * (k - 1):012.9f}\n" for k in range(drive.samples + 1))
    for each in (folder / "image_01", turns):
        (each / "timestamps.txt").write_text(stamps)
    scaled = drive.box_to_world() @ np.diag([*BOX_LWH, 1.0])
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    numbers = {"semanticId": 13, "instanceId": 7, "start_frame": 1, "end_frame": drive.samples, "timestamp": -1}
    words = "".join(f"<{name}>{value}</{name}>" for name, value in numbers.items())
    matrices = "".join(
        f'<{name} type_id="opencv-matrix"><rows>{m.shape[0]}</rows><cols>{m.shape[1]}</cols><dt>f</dt>'
        f"<data>\n{text_row(m)}</data></{name}>"
        for name, m in (("transform", scaled), ("vertices", corners))
    )
    (root / "data_3d_bboxes/train").mkdir(parents=True)
    (root / f"data_3d_bboxes/train/{KITTI360_DRIVE}.xml").write_text(
        f'<?xml version="1.0"?>\n<opencv_storage><object1><label>car</label>{words}{matrices}</object1>'
        f"<object2><label>building</label>{words}{matrices}</object2></opencv_storage>\n"
    )


TO_OPENCV = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Axes x forward, y left, z up to OpenCV's."""

STEREO_M = 0.54
ODOMETRY_LIDAR = turned(np.radians(1.0), (-0.27, 0.0, 0.08))
TURN = np.radians(4.0)


def odometry_pose(sample: int) -> np.ndarray:
    """First camera's place with axes as ours; the car goes ahead, then turns left."""
    return turned(TURN * max(sample - 1, 0), (STEP_M * sample, 0.0, 0.0))


def write_sequence(root: Path, number: str = "00") -> Path:
    """A sequence with the pictures of both color cameras; poses in the axes of the first camera, as KITTI has them."""
    folder = root / "sequences" / number
    (root / "poses").mkdir(parents=True, exist_ok=True)
    lines: list[str] = []
    for camera, shift in ((2, 0.06), (3, 0.06 - STEREO_M)):
        (folder / f"image_{camera}").mkdir(parents=True)
        placed = np.column_stack([np.eye(3), [shift, 0, 0]])
        lines.append(f"P{camera}: {text_row(INTRINSICS @ placed)}")
        for k in range(3):
            (folder / f"image_{camera}/{k:06d}.jpg").write_bytes(DRIVE.jpeg(k))
    (folder / "calib.txt").write_text("\n".join([*lines, f"Tr: {text_row((TO_OPENCV @ ODOMETRY_LIDAR)[:3])}"]) + "\n")
    (folder / "times.txt").write_text("".join(f"{k * 0.1037:e}\n" for k in range(3)))
    poses = [TO_OPENCV @ odometry_pose(k) @ np.linalg.inv(TO_OPENCV) for k in range(3)]
    (root / "poses" / f"{number}.txt").write_text("".join(text_row(pose[:3]) + "\n" for pose in poses))
    (folder / "velodyne").mkdir()
    for k in range(3):
        x, y = np.meshgrid(np.linspace(-9, 9, 25), np.linspace(-6, 6, 17))
        road = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -CAMERA_HEIGHT_M)])
        back = np.linalg.inv(ODOMETRY_LIDAR)
        rows = np.column_stack([road @ back[:3, :3].T + back[:3, 3], np.full(len(road), 0.5)])
        rows.astype(np.float32).tofile(folder / f"velodyne/{k:06d}.bin")
    return folder


# Waymo, records and tables

SEGMENTS = ("10023947602400723454_1120_000_1140_000", "20023947602400723454_20_000_40_000")


def write_frames(
    file: Path, drive: MiniDrive = DRIVE, *, shift_m: float = 0.0, change: Callable[[int, Any], None] | None = None
) -> None:
    """Frames with one camera, a lidar with one return, and the parked car. The vehicle moves while the lidar turns."""
    records: list[bytes] = []
    for k in range(drive.samples):
        frame = parsed("Frame", b"")
        frame.timestamp_micros = int(drive.time(k) * 1e6)
        frame.pose.transform.extend(drive.vehicle_to_world(k).ravel())
        frame.context.name = "segment-7"
        camera = frame.context.camera_calibrations.add(name=1, width=WIDTH, height=HEIGHT)
        camera.intrinsic.extend([FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, 0, 0, 0, 0, 0])
        camera.extrinsic.transform.extend((drive.camera_to_vehicle @ TO_OPENCV).ravel())
        image = frame.images.add(name=1, image=drive.jpeg(k), pose_timestamp=drive.time(k), shutter=0.003)
        image.pose.transform.extend(drive.vehicle_to_world(k).ravel())
        laser = frame.context.laser_calibrations.add(name=1)
        laser.beam_inclinations.extend(BEAMS)
        laser.extrinsic.transform.extend(LIDAR_TO_VEHICLE.ravel())
        returned = frame.lasers.add(name=1).ri_return1
        returned.range_image_compressed = matrix_message(range_image(drive, k, shift_m))
        returned.range_image_pose_compressed = matrix_message(pixel_poses(drive, k, shift_m))
        pose = drive.box_to_vehicle(k)
        label = frame.laser_labels.add(id="car", type=1)
        label.box.center_x, label.box.center_y, label.box.center_z = pose[:3, 3]
        label.box.length, label.box.width, label.box.height = BOX_LWH
        label.box.heading = np.arctan2(pose[1, 0], pose[0, 0])
        if change:
            change(k, frame)
        records.append(framed(frame.SerializeToString()))
    file.write_bytes(b"".join(records))


def matrix_message(values: np.ndarray) -> bytes:
    message = parsed("MatrixFloat", b"")
    message.data = values.astype("<f4").tobytes()
    message.shape.dims.extend(values.shape)
    return zlib.compress(message.SerializeToString())


def segment_tables(drive: MiniDrive, shift_m: float = 0.0) -> Rows:
    """The components of one segment, with columns named as by the data set."""
    lens = {
        "f_u": FOCAL,
        "f_v": FOCAL,
        "c_u": WIDTH / 2,
        "c_v": HEIGHT / 2,
        "k1": 0,
        "k2": 0,
        "p1": 0,
        "p2": 0,
        "k3": 0,
    }
    camera = {f"intrinsic.{name}": float(value) for name, value in lens.items()}
    camera |= {"extrinsic.transform": (drive.camera_to_vehicle @ TO_OPENCV).ravel().tolist()}
    laser = {
        "extrinsic.transform": LIDAR_TO_VEHICLE.ravel().tolist(),
        "beam_inclination.min": float(BEAMS[0]),
        "beam_inclination.max": float(BEAMS[-1]),
        "beam_inclination.values": BEAMS.tolist(),
    }
    tables: Rows = {
        "camera_calibration": [
            {"key.camera_name": 1, **_columns("CameraCalibration", camera | {"width": WIDTH, "height": HEIGHT})}
        ],
        "lidar_calibration": [{"key.laser_name": 1, **_columns("LiDARCalibration", laser)}],
        **{name: [] for name in ("vehicle_pose", "camera_image", "lidar", "lidar_pose", "lidar_box")},
    }
    for k in range(drive.samples):
        pose, placed = drive.vehicle_to_world(k).ravel().tolist(), drive.box_to_vehicle(k)
        image = {
            "image": drive.jpeg(k),
            "pose.transform": pose,
            "pose_timestamp": drive.time(k),
            "rolling_shutter_params.shutter": 0.003,
        }
        box = {f"box.center.{axis}": float(value) for axis, value in zip("xyz", placed[:3, 3], strict=True)}
        box |= {f"box.size.{axis}": side for axis, side in zip("xyz", BOX_LWH, strict=True)}
        box |= {"box.heading": float(np.arctan2(placed[1, 0], placed[0, 0])), "type": 1}
        for table, key, component, values in (
            ("vehicle_pose", {}, "VehiclePose", {"world_from_vehicle.transform": pose}),
            ("camera_image", {"key.camera_name": 1}, "CameraImage", image),
            ("lidar", {"key.laser_name": 1}, "LiDAR", _matrix(range_image(drive, k, shift_m))),
            ("lidar_pose", {"key.laser_name": 1}, "LiDARPose", _matrix(pixel_poses(drive, k, shift_m))),
            ("lidar_box", {"key.laser_object_id": "car"}, "LiDARBox", box),
        ):
            time = int(drive.time(k) * 1e6)
            tables[table].append({"key.frame_timestamp_micros": time, **key, **_columns(component, values)})
    return tables


def _columns(component: str, values: dict[str, Any]) -> dict[str, Any]:
    return {f"[{component}Component].{name}": value for name, value in values.items()}


def _matrix(values: np.ndarray) -> dict[str, Any]:
    name = "range_image_return1"
    return {f"{name}.values": values.ravel().tolist(), f"{name}.shape": list(values.shape)}


def write_segment(root: Path, tables: Rows, segment: str = SEGMENTS[0]) -> None:
    from pyarrow import Table, parquet

    for component, rows in tables.items():
        (root / component).mkdir(parents=True, exist_ok=True)
        table = Table.from_pylist([{"key.segment_context_name": segment, **row} for row in rows])
        parquet.write_table(table, root / component / f"{segment}.parquet", row_group_size=2)
