"""Driving data sets: the miniature world comes back exactly from each, and damage costs only what it hits."""

import json
import pickle
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, CaptureError
from gsrain_engine.datasets.driving_log import DrivingLog
from gsrain_engine.datasets.geometry import rigid_pose
from gsrain_engine.datasets.io.records import ParquetFile, parquet_module
from gsrain_engine.datasets.io.safe_pickle import read_pickle
from gsrain_engine.datasets.kitti import CAMERA_HEIGHT_M, KittiCamera, oxts_poses
from gsrain_engine.datasets.nuscenes import read_nuscenes
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.datasets.waymo import WaymoLaser, message_kinds, vehicle_poses
from lidar_edges import agreement_when_turned
from mini_drive import HEIGHT, WIDTH, MiniDrive, points_inside, turned
from tfrecord_framing import framed

from .sample_drives import (
    ARGOVERSE_LOG,
    DRIVE,
    EARTH_M,
    KITTI360_DRIVE,
    LATITUDE,
    LONGITUDE,
    RAW,
    SEGMENTS,
    STEREO_M,
    TO_OPENCV,
    TURN,
    damaged,
    drive_above_its_axle,
    drive_on_the_road,
    edited,
    segment_tables,
    write_argoverse2,
    write_dgp,
    write_frames,
    write_infos,
    write_kitti,
    write_kitti360,
    write_nuscenes,
    write_segment,
    write_sequence,
)

INFOS = "nuscenes_infos_train.pkl"


def write_records(folder: Path, drive: MiniDrive = DRIVE, shift_m: float = 0.0) -> None:
    write_frames(folder / "some.tfrecord", drive, shift_m=shift_m)


def write_waymo_tables(folder: Path, drive: MiniDrive = DRIVE, shift_m: float = 0.0) -> None:
    write_segment(folder / "training", segment_tables(drive, shift_m))


class Miniature(NamedTuple):
    """A data set that a miniature drive is written as, and what is particular to it."""

    kind: str
    write: Callable[[Path, MiniDrive], object]
    opened: tuple[str, ...]
    """Paths that name the drive."""
    sensor: str
    intensity: float
    box_class: str = "Car"
    drive: MiniDrive = DRIVE


_MMDETECTION = "MMDetection3D"
_DGP = (".", "scene_07", "scene_07/scene_abc.json", "scene_dataset_v1.json")
MINIATURES = {
    "dgp": Miniature("DGP", write_dgp, _DGP, "CAM", 0.5),
    "nuscenes": Miniature("nuScenes", write_nuscenes, (".", "v1.0-mini"), "CAM_FRONT", 9.0, "vehicle.car"),
    "kitti-raw": Miniature("KITTI raw", write_kitti, (".", RAW), "image_02", 0.25, drive=drive_on_the_road()),
    "argoverse2": Miniature(
        "Argoverse 2",
        write_argoverse2,
        (ARGOVERSE_LOG,),
        "ring_front_center",
        9.0,
        "REGULAR_VEHICLE",
        drive=drive_above_its_axle(),
    ),
    "kitti-360": Miniature("KITTI-360", write_kitti360, (".", KITTI360_DRIVE), "image_01", 0.25, "car"),
    **{
        f"infos-{layout}": Miniature(
            _MMDETECTION, partial(write_infos, layout=layout), (".", INFOS), "CAM_FRONT", 3.0, ""
        )
        for layout in ("1.x", "rc", "0.x")
    },
    **{
        f"waymo-{name}-{shift_m}": Miniature(kind, partial(write, shift_m=shift_m), (".",), "FRONT", 0.5, "vehicle")
        for name, kind, write in (
            ("records", "Waymo Perception v1", write_records),
            ("tables", "Waymo Perception v2", write_waymo_tables),
        )
        for shift_m in (0.0, 0.8)  # how far the vehicle moves while the lidar turns
    },
}


@pytest.mark.parametrize("name", MINIATURES)
def test_a_miniature_is_read_exactly(name: str, tmp_path: Path) -> None:
    kind, write, opened, sensor, intensity, box_class, drive = MINIATURES[name]
    write(tmp_path, drive)
    for below in opened:
        found = capture_format(tmp_path / below)
        assert found is not None and found.name == kind
        capture = open_capture(tmp_path / below)
        if kind.startswith("Waymo"):
            check_waymo(capture)
        else:
            drive.check(capture, has_boxes=False)
            check_boxes(capture, drive, box_class)
        assert capture.sensors == (sensor,)
        first = 1 if kind == "KITTI-360" else 0
        assert [view.name for view in capture] == [f"{k + first:04d}_{sensor}" for k in range(3)]
        assert [view.time_s for view in capture] == pytest.approx([0.0, 0.5, 1.0])
        assert [int(view.image[0, 0, 0]) for view in capture] == pytest.approx([40, 60, 80], abs=3)
        # OpenCV counts pixels from their centers, we from their edges.
        assert capture[0].lens is None and (capture[0].camera.cx, capture[0].camera.cy) == (WIDTH / 2, HEIGHT / 2)
        for sweep in capture.sweeps:
            assert sweep.intensities is not None and set(sweep.intensities) == {np.float32(intensity)}
        assert [problem for problem in capture.problems if "scene_09" not in problem and "fisheye" not in problem] == []


def test_info_files_of_waymo_are_read_exactly(tmp_path: Path) -> None:
    capture = open_capture(write_infos(tmp_path, layout="waymo"))
    higher = np.array([0.0, 0.0, 2.18 - 1.8])  # of Waymo's lidar
    sweeps = tuple(replace(sweep, origin_m=sweep.origin_m - higher) for sweep in capture.sweeps)
    DRIVE.check(replace(capture, sweeps=sweeps), has_boxes=False)
    check_boxes(capture, DRIVE, "")
    assert [view.time_s for view in capture] == pytest.approx([0.0, 0.5, 1.0])
    assert {box.class_name for box in capture.boxes} == {"Car"} and not capture.problems


def check_boxes(capture: Capture, drive: MiniDrive, box_class: str) -> None:
    if box_class:
        drive.check_boxes(capture, box_class)
        return
    # Without identities there is a box for each sample, around its time.
    assert [box.id for box in capture.boxes] == ["0-0", "1-0", "2-0"]
    for number, sweep in enumerate(capture.sweeps):
        held = [points_inside(capture, sweep.points_m, k, sweep.time_s, slack_m=-0.008) for k in range(3)]
        assert held == [60 if k == number else 0 for k in range(3)]


def check_waymo(capture: Capture) -> None:
    """Assert the geometry, and that every point lies on the road or on the parked car."""
    origins = [sweep.origin_m[2] for sweep in capture.sweeps]
    np.testing.assert_allclose(origins, 2.18 - EGO_HEIGHT_M, atol=2e-3)
    np.testing.assert_allclose(capture[0].camera.position[2], 1.6 - EGO_HEIGHT_M, atol=2e-3)
    assert capture[0].camera.exposure_s == pytest.approx(0.003)
    assert capture.ego is not None
    assert np.linalg.norm(capture.ego.positions[-1]) == pytest.approx(3.0, abs=2e-3)
    (box,) = capture.boxes
    assert (box.id, box.class_name) == ("car", "vehicle")
    for sweep in capture.sweeps:
        on_road = np.abs(sweep.points_m[:, 2] + EGO_HEIGHT_M) < 5e-3
        held = points_inside(capture, sweep.points_m[~on_road], 0, sweep.time_s, slack_m=5e-3)
        assert 10 <= held == np.count_nonzero(~on_road)
        assert np.count_nonzero(on_road) > 500


def test_a_sequence_of_kitti_odometry_is_read_exactly(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path)
    for path in (tmp_path, folder):
        assert getattr(capture_format(path), "name", "") == "KITTI odometry"
        capture = open_capture(path)
        assert (capture.problems, len(capture), capture.sensors) == ((), 6, ("image_2", "image_3"))
    assert [view.time_s for view in capture][::2] == pytest.approx([0.0, 0.1037, 0.2074])
    left, right = capture[0].camera, capture[1].camera
    # The first camera is at the origin of its poses; the second color camera is to the right of the other.
    np.testing.assert_allclose(left.position, [0.0, 0.06, CAMERA_HEIGHT_M - EGO_HEIGHT_M], atol=1e-5)
    np.testing.assert_allclose(right.position - left.position, [0.0, -STEREO_M, 0.0], atol=1e-5)
    np.testing.assert_allclose(left.world_to_camera[:3, :3], TO_OPENCV[:3, :3], atol=1e-6)
    assert capture.ego is not None
    np.testing.assert_allclose(capture.ego.positions, [[0, 0, 0], [1.5, 0, 0], [3.0, 0, 0]], atol=1e-5)
    pose = capture.ego.pose(0.2074)
    assert pose is not None
    np.testing.assert_allclose(pose[:3, 0], [np.cos(TURN), np.sin(TURN), 0.0], atol=1e-5)
    for sweep in capture.sweeps:
        assert np.abs(sweep.points_m[:, 2] + EGO_HEIGHT_M).max() < 1e-3
    origin = [-0.27, 0.0, 0.08 + CAMERA_HEIGHT_M - EGO_HEIGHT_M]
    np.testing.assert_allclose(capture.sweeps[0].origin_m, origin, atol=1e-3)


# Parts of a data set


def test_nuscenes_reads_a_chosen_scene_and_pictures_between_samples_when_asked(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, DRIVE, ("scene-0061", "scene-0103"))
    first, chosen = open_capture(tmp_path), open_capture(tmp_path / "scene-0103")
    assert first.name == "scene-0061" and str(tmp_path / "scene-0103") in first.problems[0]
    assert (chosen.name, chosen.problems) == ("scene-0103", ())
    DRIVE.check(chosen, has_boxes=False)
    assert [view.time_s for view in read_nuscenes(tmp_path, key_frames_only=False)] == [0.0, 0.083, 0.5, 1.0]
    with pytest.raises(CaptureError, match="no scene 'scene-7'; it has scene-0061, scene-0103"):
        open_capture(tmp_path / "scene-7")
    for file in tmp_path.glob("samples/*/scene-0061*"):
        file.unlink()
    assert open_capture(tmp_path).name == "scene-0103"


def test_drives_of_an_info_file_are_split_where_time_jumps(tmp_path: Path) -> None:
    file = write_infos(tmp_path, times=[10.0, 10.5, 900.0])
    assert len(open_capture(file)) == 2
    assert f"open another as {file}/1" in open_capture(tmp_path).problems[0]
    assert [view.image[0, 0, 0] for view in open_capture(file / "1")] == pytest.approx([80], abs=3)
    with pytest.raises(CaptureError, match="has drives 0 to 1, not 2"):
        open_capture(file / "2")


def test_a_segment_of_waymo_is_chosen_by_its_name_or_a_file(tmp_path: Path) -> None:
    for segment, samples in zip(SEGMENTS, (3, 2), strict=True):
        write_segment(tmp_path, segment_tables(MiniDrive(samples=samples)), segment)
    first = open_capture(tmp_path)
    assert len(first) == 3 and str(tmp_path / SEGMENTS[1]) in first.problems[0]
    for path in (tmp_path / SEGMENTS[1], tmp_path / "lidar" / f"{SEGMENTS[1]}.parquet"):
        assert len(open_capture(path)) == 2


def test_of_several_sequences_one_with_poses_is_read(tmp_path: Path) -> None:
    for number in ("04", "11"):
        write_sequence(tmp_path, number)
    (tmp_path / "poses/11.txt").unlink()
    capture = open_capture(tmp_path)
    assert capture.name == "04" and "sequences/11" in capture.problems[0]


@pytest.mark.parametrize(
    ("extra", "lens"),
    [
        ({"k1": -0.3, "p1": 0.01}, ("opencv", (-0.3, 0.0, 0.01, 0.0, 0.0))),
        ({"k1": 0.1, "k6": 0.2}, ("opencv", (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2))),
        ({"fisheye": 1, "k1": 0.1, "k4": 0.4}, ("fisheye", (0.1, 0.0, 0.0, 0.4))),
    ],
)
def test_the_lens_of_dgp_is_that_of_its_calibration(tmp_path: Path, extra: dict[str, float], lens: Any) -> None:
    found = open_capture(write_dgp(tmp_path, DRIVE, extra))[0].lens
    assert found is not None and (found.model, found.coefficients) == lens


def test_a_dgp_scene_without_a_lidar_has_the_vehicle_of_its_camera(tmp_path: Path) -> None:
    def without_lidar(values: Any) -> None:
        for sample in values["samples"]:
            sample["datum_keys"] = [key for key in sample["datum_keys"] if key.startswith("c")]

    capture = open_capture(damaged(write_dgp, {"scene_07/scene_abc.json": edited(without_lidar)})(tmp_path))
    assert not capture.sweeps and capture.ego is not None
    np.testing.assert_allclose(capture[0].camera.position[2], 1.6 - EGO_HEIGHT_M, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(capture.ego.positions[-1]), 3.0, atol=1e-6)


# Facts of the data sets


def test_poses_of_oxts_are_those_of_a_mercator_projection() -> None:
    """A hundredth of a degree to the north is 1113 m on that map, scaled as at the first place; to the east as well."""
    records = [
        np.array([LATITUDE, LONGITUDE, 10.0, 0, 0, 0]),
        np.array([LATITUDE + 0.01, LONGITUDE, 12.0, 0, 0, np.pi / 2]),
    ]
    first, second = oxts_poses(records)
    np.testing.assert_allclose(first, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(second[:3, 3], [0.0, np.radians(0.01) * EARTH_M, 2.0], rtol=2e-4, atol=1e-9)
    np.testing.assert_allclose(second[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)
    up = oxts_poses([np.array([LATITUDE, LONGITUDE, 0.0, 0.2, -0.1, 0.0])])[0]
    np.testing.assert_allclose(up[:3, 0], [np.cos(0.1), 0.0, np.sin(0.1)], atol=1e-12)  # pitch below 0: nose up
    assert up[2, 1] > 0  # roll above 0: the left side is up


def test_the_published_calibration_of_kitti_puts_the_camera_where_the_paper_has_it() -> None:
    """The numbers of 2011_09_26: the left color camera is 27 cm before, 6 cm left of and 8 cm below the lidar."""

    def numbers(text: str, columns: int) -> np.ndarray:
        return np.array([float(word) for word in text.split()]).reshape(3, columns)

    turn = (
        "7.533745e-03 -9.999714e-01 -6.166020e-04 1.480249e-02 7.280733e-04 -9.998902e-01 9.998621e-01 7.523790e-03 "
        "1.480755e-02"
    )
    rectify = (
        "9.999239e-01 9.837760e-03 -7.445048e-03 -9.869795e-03 9.999421e-01 -4.278459e-03 7.402527e-03 4.351614e-03 "
        "0.9999631"
    )
    projection = "721.5377 0 609.5593 44.85728 0 721.5377 172.8540 0.2163791 0 0 1 0.002745884"
    to_first = rigid_pose(numbers(turn, 3), np.array([-4.069766e-03, -7.631618e-02, -2.717806e-01]))
    lidar_to_first = rigid_pose(numbers(rectify, 3), np.zeros(3)) @ to_first
    in_lidar = np.linalg.inv(KittiCamera("image_02", numbers(projection, 4)).from_first @ lidar_to_first)
    np.testing.assert_allclose(in_lidar[:3, 3], [0.27, 0.06, -0.08], atol=0.02)
    np.testing.assert_allclose(in_lidar[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=0.02)


def test_a_pixel_of_waymos_lidar_is_moved_by_its_own_pose() -> None:
    """Against rotation matrices that are multiplied out: yaw after pitch after roll, as dataset.proto defines them."""
    random = np.random.default_rng(4)
    ranges, poses = random.uniform(1, 50, (3, 4, 2)), random.uniform(-1, 1, (3, 4, 6))
    vehicle_to_world, to_vehicle = turned(0.7, (3.0, -2.0, 1.0)), turned(-0.4, (1.4, 0.2, 2.0))
    laser = WaymoLaser(to_vehicle, np.zeros(0), (-0.3, 0.1))
    points, _ = laser.points(ranges.astype(np.float32), poses.astype(np.float32), vehicle_to_world)
    still, _ = laser.points(ranges.astype(np.float32), None, vehicle_to_world)
    for k, (roll, pitch, yaw, *place) in enumerate(poses.reshape(-1, 6)):
        about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        in_world = turned(yaw, (0, 0, 0))[:3, :3] @ about_y @ about_x @ still[k] + place
        expected = np.linalg.inv(vehicle_to_world) @ [*in_world, 1.0]
        np.testing.assert_allclose(points[k], expected[:3], atol=1e-5)
    # Row 0 is the highest of evenly spaced beams; column 0 looks backwards in the vehicle's directions.
    first = still[0] - to_vehicle[:3, 3]
    assert np.arctan2(first[2], np.hypot(first[0], first[1])) == pytest.approx(-0.3 + 0.4 * 2.5 / 3)
    assert np.arctan2(first[1], first[0]) == pytest.approx(np.pi * (1 - 1 / 4))


# Damage


def cut(count: int) -> Callable[[bytes], bytes]:
    return lambda content: content[:-count]


def records_with(change: Callable[[Any], object]) -> Callable[[Path], Path]:
    """Records whose second frame is changed."""

    def write(folder: Path) -> Path:
        write_frames(folder / "a.tfrecord", change=lambda k, frame: change(frame) if k == 1 else None)
        return folder

    return write


def without_calibration(frame: Any) -> None:
    del frame.context.camera_calibrations[:]


def with_range_image(data: bytes) -> Callable[[Any], None]:
    def change(frame: Any) -> None:
        frame.lasers[0].ri_return1.range_image_compressed = data

    return change


def tables_with(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        tables = segment_tables(DRIVE)
        change(tables)
        write_segment(folder, {name: rows for name, rows in tables.items() if rows})
        return folder

    return write


def cell(table: str, column: str, value: Callable[[Any], Any]) -> Callable[[Path], Path]:
    """Tables of Waymo with one value changed, in the second row."""

    def change(tables: dict[str, Any]) -> None:
        tables[table][1][column] = value(tables[table][1][column])

    return tables_with(change)


def second_camera_mirrored(tables: dict[str, Any]) -> None:
    mirrored = {"[CameraCalibrationComponent].extrinsic.transform": (-np.eye(4)).ravel().tolist()}
    tables["camera_calibration"].append({**tables["camera_calibration"][0], "key.camera_name": 2, **mirrored})


def only_pictures(tables: dict[str, Any]) -> None:
    for name in ("lidar", "lidar_pose", "lidar_calibration", "lidar_box"):
        tables[name].clear()


def tracklets(text: bytes) -> Callable[[Path], Path]:
    return damaged(write_kitti, {f"{RAW}/tracklet_labels.xml": text}, RAW)


def unrectified(folder: Path) -> Path:
    return write_kitti(folder).rename(folder / "2011_09_26_drive_0005_extract")


def log_with(changes: dict[str, Any]) -> Callable[[Path], Path]:
    return damaged(
        write_argoverse2, {f"{ARGOVERSE_LOG}/{name}": change for name, change in changes.items()}, ARGOVERSE_LOG
    )


def table(change: Callable[[Any], Any]) -> Callable[[bytes], bytes]:
    """Change of a table of Arrow."""

    def changed(content: bytes) -> bytes:
        arrow = pytest.importorskip("pyarrow")
        found, sink = change(arrow.ipc.open_file(content).read_all()), arrow.BufferOutputStream()
        with arrow.ipc.new_file(sink, found.schema) as writer:
            writer.write_table(found)
        return sink.getvalue().to_pybytes()

    return changed


def with_column(name: str, change: Callable[[list[Any]], list[Any]]) -> Callable[[bytes], bytes]:
    def changed(found: Any) -> Any:
        place = found.schema.get_field_index(name)
        return found.set_column(place, name, [change(found[name].to_pylist())])

    return table(changed)


def without_column(name: str) -> Callable[[bytes], bytes]:
    return table(lambda found: found.drop_columns([name]))


TURNS = [f"sensors/lidar/{round(MiniDrive().time(k) * 1e9)}.feather" for k in range(3)]
FRONT = "sensors/cameras/ring_front_center"
FRONTS = [f"{FRONT}/{round(MiniDrive().time(k) * 1e9)}.jpg" for k in range(3)]
POSES, MOUNTS = "city_SE3_egovehicle.feather", "calibration/egovehicle_SE3_sensor.feather"
LENSES, LABELS = "calibration/intrinsics.feather", "annotations.feather"

LOG_HOLES: list[tuple[dict[str, Any], int, int, str]] = [
    ({FRONTS[1]: None}, 2, 3, ""),
    ({FRONTS[1]: cut(20)}, 2, 3, "the picture is cut off"),
    ({FRONTS[1]: b""}, 2, 3, f"{FRONTS[1].removeprefix('sensors/cameras/')} left out"),
    ({TURNS[0]: None}, 3, 2, ""),
    ({TURNS[0]: cut(40)}, 3, 2, "not a Feather file that can be read"),
    ({TURNS[0]: b"ARROW1"}, 3, 2, "not a Feather file that can be read"),
    ({TURNS[1]: without_column("z")}, 3, 2, "has no column 'z'"),
    ({TURNS[1]: without_column("intensity")}, 3, 2, "has no column 'intensity'"),
    ({TURNS[1]: with_column("x", lambda rows: [None, *rows[1:]])}, 3, 2, "its column 'x' has 1 gaps"),
    ({TURNS[1]: with_column("x", lambda rows: ["far"] * len(rows))}, 3, 2, "and the type string"),
    ({TURNS[1]: with_column("y", lambda rows: [float("inf"), *rows[1:]])}, 3, 2, "not finite, or farther than 100 km"),
    ({POSES: with_column("timestamp_ns", lambda rows: [rows[0] + 5, *rows[1:]])}, 2, 2, f"its time is not in {POSES}"),
    ({POSES: with_column("qw", lambda rows: [float("nan"), *rows[1:]])}, 2, 2, f"row 0 of {POSES} left out"),
    ({MOUNTS: with_column("sensor_name", lambda rows: [rows[0], "top", "low"])}, 3, 0, f"it is not in {MOUNTS}"),
    ({LABELS: cut(30)}, 3, 3, f"{LABELS} left out"),
    ({LABELS: without_column("category")}, 3, 3, "has no column 'category'"),
    ({LABELS: with_column("length_m", lambda rows: [-1.0, *rows[1:]])}, 3, 3, f"box 0 of {LABELS} left out"),
]
"""Damaged files of a log, the numbers of views and sweeps that are left, and what names it."""


@pytest.mark.parametrize(("changes", "views", "sweeps", "named"), LOG_HOLES)
def test_damage_in_a_log_of_argoverse_costs_what_it_hits(
    changes: dict[str, Any], views: int, sweeps: int, named: str, tmp_path: Path
) -> None:
    capture = open_capture(log_with(changes)(tmp_path))
    assert (len(capture), len(capture.sweeps)) == (views, sweeps)
    assert named in "\n".join(capture.problems) and bool(capture.problems) == bool(named)
    assert all("\n" not in problem for problem in capture.problems)


WITH_HOLES: list[tuple[Callable[[Path], Path], int, int, tuple[str, ...]]] = [
    (damaged(write_dgp, {
        "scene_07/rgb/CAM/1.jpg": None,
        "scene_07/rgb/CAM/2.jpg": cut(20),
        "scene_07/point_cloud/LIDAR/0.npz": b"PK\x03\x04 not an archive",
        "scene_07/ontology/ont.json": b"{",
    }), 1, 2, ("1.jpg: no such picture", "2.jpg: the picture is cut off", "0.npz: not a", "ont.json")),
    (damaged(write_nuscenes, {
        "samples/CAM_FRONT/scene-0061-1.jpg": None,
        "samples/LIDAR_TOP/scene-0061-2.pcd.bin": b"123",
        "v1.0-mini/sample_annotation.json": edited(lambda rows: rows[0].update(size=[0.0, 1.0, 1.0])),
        "v1.0-mini/sample_data.json": edited(lambda rows: rows[4].update(ego_pose_token="nowhere")),
    }), 1, 2, ("-1.jpg: no such picture", "not rows of 5", "a-scene-0061-0 left out", "ego pose")),
    (damaged(write_nuscenes, {"v1.0-mini/sample_annotation.json": None}), 3, 3, ("sample_annotation.json: this",)),
    (damaged(write_infos, {
        "samples/CAM_FRONT/1.jpg": None,
        "samples/LIDAR_TOP/0.pcd.bin": None,
        INFOS: edited(lambda values: values["data_list"][2].pop("ego2global"), pickle),
    }), 1, 1, ("'ego2global'", "CAM_FRONT of sample 1 left out: 1.jpg", "0.pcd.bin left")),
    (damaged(write_kitti, {
        f"{RAW}/oxts/data/0000000001.txt": b"90 8 100 0 0 0",  # the pole, which is not on the map
        f"{RAW}/velodyne_points/data/0000000002.bin": b"12345",
        f"{RAW}/image_02/data/0000000002.jpg": cut(20),
    }), 1, 1, ("0000000001.txt", "0000000002.bin", "the picture is cut off")),
    (tracklets(b'<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><x>&b;</x>'), 3, 3, ("defines entities",)),
    (damaged(write_kitti360, {
        f"data_2d_raw/{KITTI360_DRIVE}/image_01/data_rect/0000000003.jpg": cut(20),
        f"data_3d_raw/{KITTI360_DRIVE}/velodyne_points/data/0000000001.bin": b"12345",
        f"data_poses/{KITTI360_DRIVE}/poses.txt": lambda text: b"9 1 2 3\n" + text,
        f"data_3d_bboxes/train/{KITTI360_DRIVE}.xml": lambda text: text.replace(b"<cols>3<", b"<cols>4<"),
    }), 2, 2, ("poses.txt: line 1: a pose", "image_01/0000000003.jpg left out", "the picture is cut off",
               "0000000001.bin left out", "box object1 left out", "image_02 left out: fisheye")),
    (damaged(write_kitti360, {
        "calibration/calib_cam_to_velo.txt": b"1 2 3",
        f"data_3d_bboxes/train/{KITTI360_DRIVE}.xml": b"<x",
    }), 3, 0, ("calib_cam_to_velo.txt: a pose has 12", "boxes left out: ")),
    (tracklets(b"<x><tracklets><item><h>one</h></item></tracklets></x>"), 3, 3, ("boxes left out",)),
    (damaged(write_sequence, {
        "sequences/00/image_3/000001.jpg": b"",
        "sequences/00/velodyne/000000.bin": b"12",
        "poses/00.txt": lambda text: b"\n".join([*text.splitlines()[:2], b"1 2 3"]),
    }), 3, 1, ("image_3 has pictures of 1 moments, another camera of 2", "00.txt: line 3",
               "image_3/000001.jpg left out", "velodyne/000000.bin left out")),
    (damaged(write_records, {"some.tfrecord": cut(100)}), 2, 2, ("cut off",)),
    (records_with(without_calibration), 2, 3, ("FRONT of frame 1 left out: its calibration",)),
    (records_with(lambda frame: frame.pose.transform.__setitem__(0, 9.0)), 2, 2, ("frame 1 left out: a",)),
    (records_with(with_range_image(zlib.compress(bytes(40_000_000)))), 3, 2, ("TOP of frame 1 left out",)),
    (cell("camera_image", "[CameraImageComponent].image", cut(30)), 2, 3, ("0001_FRONT left out: the picture",)),
    (cell("lidar", "[LiDARComponent].range_image_return1.shape", lambda _: [3, 5, 4]), 3, 2, ("shape is (3, 5, 4)",)),
    (cell("lidar_box", "key.frame_timestamp_micros", lambda _: 5), 3, 3, ("box car left out",)),
    (tables_with(second_camera_mirrored), 3, 3, ("FRONT_LEFT left out: a pose must be a rotation",)),
    (tables_with(only_pictures), 3, 0, ("boxes left out",)),
]  # fmt: skip
"""Drive, number of views and of sweeps that are left, and the names of what is missing."""


@pytest.mark.parametrize(("write", "views", "sweeps", "named"), WITH_HOLES, ids=[row[3][0] for row in WITH_HOLES])
def test_what_is_missing_is_named_and_the_rest_is_used(
    write: Callable[[Path], Path], views: int, sweeps: int, named: tuple[str, ...], tmp_path: Path
) -> None:
    capture = open_capture(write(tmp_path))
    assert (len(capture), len(capture.sweeps)) == (views, sweeps)
    problems = "\n".join(capture.problems)
    assert [part for part in named if part not in problems] == []
    if "boxes left out" in problems or "sample_annotation.json" in problems:
        assert not capture.boxes
    if "ont.json" in problems:
        assert capture.boxes[0].class_name == "class 4"


NO_PROJECTION = b"P_rect_02:" + b" 0" * 12
REFUSED: list[tuple[Callable[[Path], Path], str]] = [
    (partial(write_dgp, camera_lens={"xi": 0.7}), "no picture that can be used.*xi in the calibration"),
    (damaged(write_nuscenes, {"v1.0-mini/sample.json": b"[]"}), "of none of its 1 scenes"),
    (damaged(write_nuscenes, {"v1.0-mini/ego_pose.json": edited(lambda rows: rows[1].update(rotation=[1, 0, 0]))}),
     r"ego_pose.json: .*rotation"),
    (damaged(write_kitti, {"calib_velo_to_cam.txt": lambda text: text.replace(b"T:", b"U:")}, RAW),
     "calib_velo_to_cam.txt: expected 3 finite numbers at T"),
    (damaged(write_kitti, {"calib_cam_to_cam.txt": lambda text: text.partition(b"P_rect")[0] + NO_PROJECTION}, RAW),
     "its projection matrix"),
    (damaged(write_kitti, {"calib_velo_to_cam.txt": None}, RAW), "calib_velo_to_cam.txt: no such file"),
    (unrectified, "not rectified"),
    (damaged(write_kitti360, {f"data_poses/{KITTI360_DRIVE}/poses.txt": None}), "no drive with pictures and poses"),
    (damaged(write_kitti360, {f"data_poses/{KITTI360_DRIVE}/poses.txt": None}, KITTI360_DRIVE), "poses.txt: no such"),
    (damaged(write_kitti360, {"calibration/calib_cam_to_pose.txt": b"image_00: 1 2"}), "expected 12 finite numbers"),
    (damaged(write_kitti360, {"calibration/perspective.txt": NO_PROJECTION}), "9 finite numbers at R_rect_00"),
    (damaged(write_kitti360, {f"data_2d_raw/{KITTI360_DRIVE}/image_01/timestamps.txt": None}), "no picture"),
    (damaged(write_sequence, {"poses/00.txt": None}, "sequences/00"), r"00\.txt: no poses of this sequence.*COLMAP"),
    (log_with({POSES: cut(50)}), rf"{POSES}: not a Feather file"),
    (log_with({POSES: without_column("timestamp_ns")}), f"{POSES}: has no column 'timestamp_ns'"),
    (log_with({MOUNTS: None}), f"{MOUNTS}: no such file"),
    (log_with({LENSES: without_column("sensor_name")}), "intrinsics.feather: has no column 'sensor_name'"),
    (log_with({LENSES: with_column("width_px", lambda rows: [65])}), "no picture that can be used.*expected 65x48"),
    (log_with({LENSES: with_column("fx_px", lambda rows: [0.0])}), "no picture that can be used"),
    (log_with({LENSES: with_column("sensor_name", lambda rows: ["other"])}), "it is not in calibration/intrinsics"),
    (log_with({FRONT: None}), "no picture that can be used"),
    (damaged(write_records, {"some.tfrecord": framed(b"\xff\xff no message")}), r"some\.tfrecord: .* Waymo Motion$"),
    (damaged(write_records, {"some.tfrecord": framed(b"")}), r"some\.tfrecord: no frame of .* Waymo Motion$"),
    (damaged(write_waymo_tables, {f"training/vehicle_pose/{SEGMENTS[0]}.parquet": cut(9)}), "vehicle_pose"),
    (tables_with(lambda tables: tables.update(vehicle_pose=[{"key.frame_timestamp_micros": 1}])),
     r"has no column '\[VehiclePoseComponent\]"),
]  # fmt: skip


@pytest.mark.parametrize(("write", "named"), REFUSED)
def test_drives_that_nothing_can_be_made_of_are_refused(
    write: Callable[[Path], Path], named: str, tmp_path: Path
) -> None:
    with pytest.raises(CaptureError, match=named):
        open_capture(write(tmp_path))


@pytest.mark.parametrize(
    ("write", "module", "package", "load"),
    [
        (write_records, "google.protobuf", "protobuf", message_kinds),
        (write_waymo_tables, "pyarrow", "pyarrow", parquet_module),
    ],
)
def test_a_missing_package_is_named(
    write: Callable[[Path, MiniDrive], None], module: str, package: str, load: Any, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    write(tmp_path, MiniDrive())
    load.cache_clear()
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(CaptureError, match=rf"needs {package}, which is not installed: .* 'gsrain\[waymo\]'"):
        open_capture(tmp_path)


def test_a_log_of_argoverse_names_the_extra_of_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_argoverse2(tmp_path)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(CaptureError, match=r"log of Argoverse 2 needs pyarrow, .* 'gsrain\[recordings\]'"):
        open_capture(log)


# Real drives


@pytest.fixture(scope="module")
def dgp(test_data: Path) -> Capture:
    return open_capture(test_data / "driving" / "dgp")


@pytest.fixture(scope="module")
def infos(test_data: Path) -> Capture:
    return open_capture(test_data / "driving" / "nuscenes_sample")


def assert_road_below(capture: Capture) -> None:
    """The road near the car is where the lidar sees it: the world is level, and the ego stands above."""
    near = [sweep.points_m[np.hypot(*(sweep.points_m - sweep.origin_m)[:, :2].T) < 8] for sweep in capture.sweeps]
    assert abs(np.median(np.concatenate(near)[:, 2]) + EGO_HEIGHT_M) < 0.15


def points_in_boxes(capture: Capture, boxes: list[tuple[int, float]]) -> list[int]:
    """Number of points of the sweep at a time in each box."""
    at = {sweep.time_s: sweep.points_m for sweep in capture.sweeps}
    return [points_inside(capture, at[time_s], box, time_s) for box, time_s in boxes]


def test_a_real_scene_of_dgp(dgp: Capture, test_data: Path) -> None:
    assert len(dgp) == 18
    assert dgp.sensors == tuple(f"CAMERA_{number:02d}" for number in (1, 5, 6, 7, 8, 9))
    assert [len(sweep.points_m) for sweep in dgp.sweeps] == [47230, 49469, 48620]
    assert dgp.problems == ("scene_dataset_v1.0.json: 1 of 2 scenes missing: scene_01",)
    assert dgp[0].image.shape == (1216, 1936, 3)
    assert dgp.ego is not None
    steps = np.linalg.norm(np.diff(dgp.ego.positions, axis=0), axis=1)
    np.testing.assert_allclose(steps, [1.26, 1.28], atol=0.01)
    assert_road_below(dgp)
    # Boxes hold the points that their annotation counted; the public cloud is one point of five.
    files = sorted((test_data / "driving" / "dgp" / "scene_02" / "bounding_box_3d" / "LIDAR").iterdir())
    ids = [box.id for box in dgp.boxes]
    rows = [
        (row["num_points"], ids.index(str(row["instance_id"])), sweep.time_s)
        for file, sweep in zip(files, dgp.sweeps, strict=True)
        for row in json.loads(file.read_text())["annotations"]
    ]
    counted, held = [row[0] for row in rows], points_in_boxes(dgp, [row[1:] for row in rows])
    assert np.mean(held) > 5 and np.corrcoef(counted, held)[0, 1] > 0.99
    assert sum(held) / sum(counted) == pytest.approx(0.2, abs=0.02)


def test_a_real_sample_of_nuscenes(infos: Capture, test_data: Path) -> None:
    assert (len(infos), infos.problems, len(infos.boxes)) == (6, (), 69)
    assert infos[0].image.shape == (900, 1600, 3)
    assert infos.sweeps[0].points_m.shape == (34688, 3)
    assert {box.class_name for box in infos.boxes} >= {"car", "pedestrian", "barrier", "unknown"}
    assert_road_below(infos)
    heights = [view.camera.position[2] + EGO_HEIGHT_M for view in infos]
    assert all(1.4 < height < 1.7 for height in heights), heights
    file = next((test_data / "driving" / "nuscenes_sample").glob("*.pkl"))
    counted = [int(row["num_lidar_pts"]) for row in read_pickle(file)["data_list"][0]["instances"]]
    held = points_in_boxes(infos, [(k, infos.sweeps[0].time_s) for k in range(len(infos.boxes))])
    assert np.mean(held) > 5 and np.mean(np.abs(np.subtract(held, counted)) <= 2) > 0.9
    assert sum(held) == pytest.approx(sum(counted), rel=0.03)


@pytest.mark.parametrize(("name", "degrees", "ratio"), [("dgp", 1.5, 1.4), ("infos", 4.0, 1.5)])
def test_real_lidar_falls_on_edges_of_the_pictures(
    name: str, degrees: float, ratio: float, request: pytest.FixtureRequest
) -> None:
    real: Capture = request.getfixturevalue(name)
    views = [view.held() for view in real.views if view.name[:4] == "0000" and view.sensor != "CAM_BACK"]
    found = {a: np.mean([agreement_when_turned(real, view, a) for view in views]) for a in (-degrees, 0.0, degrees)}
    assert found[0.0] > 0.05
    assert all(found[0.0] > ratio * found[angle] for angle in found if angle), found


def test_a_real_frame_of_waymo(test_data: Path) -> None:
    waymo = open_capture(test_data / "driving" / "waymo_frame")
    assert waymo.name == "1024360143612057520_3580_000_3600_000"
    assert waymo.sensors == ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
    assert [view.image.shape for view in waymo] == [(1280, 1920, 3)] * 3 + [(886, 1920, 3)] * 2
    assert [round(view.camera.exposure_s * 1000, 1) for view in waymo] == [2.6, 2.6, 2.7, 3.9, 3.1]
    assert len(waymo.boxes) == 75 and not waymo.sweeps and not waymo.problems
    heights = [view.camera.position[2] + EGO_HEIGHT_M for view in waymo]
    assert all(2.0 < height < 2.2 for height in heights), heights


def test_real_vehicle_poses_of_waymo(test_data: Path) -> None:
    log = DrivingLog("drive", road_m=0.0)
    poses = vehicle_poses(ParquetFile(test_data / "driving" / "waymo_frame" / "v2_vehicle_pose.parquet"), log)
    times = sorted(poses)
    assert not log.problems and len(times) == 199
    assert np.diff(times).mean() == pytest.approx(100_000, abs=100)
    assert np.linalg.norm(np.diff([poses[time][:3, 3] for time in times], axis=0), axis=1).max() < 0.2
    assert min(pose[2, 2] for pose in poses.values()) > 0.99  # it stays level
