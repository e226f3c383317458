from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, CaptureError
from gsrain_engine.datasets.driving_log import DrivingLog
from gsrain_engine.datasets.io.records import ParquetFile
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.datasets.waymo import vehicle_poses
from mini_drive import BOX_LWH, FOCAL, HEIGHT, WIDTH, MiniDrive, points_inside
from waymo_lidar import BEAMS, LIDAR_TO_VEHICLE, pixel_poses, range_image

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

OWN_AXES = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
SEGMENTS = ("10023947602400723454_1120_000_1140_000", "20023947602400723454_20_000_40_000")
Tables = dict[str, list[dict[str, Any]]]


def test_reads_the_real_vehicle_poses(test_data: Path) -> None:
    log = DrivingLog("drive", road_m=0.0)
    poses = vehicle_poses(ParquetFile(test_data / "driving" / "waymo_frame" / "v2_vehicle_pose.parquet"), log)
    assert not log.problems
    times = sorted(poses)
    assert len(times) == 199
    assert np.diff(times).mean() == pytest.approx(100_000, abs=100)
    steps = np.linalg.norm(np.diff([poses[time][:3, 3] for time in times], axis=0), axis=1)
    assert steps.max() < 0.2
    for time in times:
        np.testing.assert_allclose(poses[time][:3, :3] @ poses[time][:3, :3].T, np.eye(3), atol=1e-12)
        # It drives forwards along its own x, and stays level.
        assert poses[time][2, 2] > 0.99


def segment_tables(drive: MiniDrive, shift_m: float = 0.0) -> Tables:
    """The components of one segment, with columns named as by the data set."""
    tables: Tables = {name: [] for name in ("vehicle_pose", "camera_image", "lidar", "lidar_pose", "lidar_box")}
    camera = "[CameraCalibrationComponent]."
    numbers = dict(zip(("f_u", "f_v", "c_u", "c_v"), (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), strict=True))
    zeros = dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0)
    tables["camera_calibration"] = [
        {
            "key.camera_name": 1,
            **{f"{camera}intrinsic.{name}": value for name, value in {**numbers, **zeros}.items()},
            f"{camera}extrinsic.transform": (drive.camera_to_vehicle @ OWN_AXES).ravel().tolist(),
            f"{camera}width": WIDTH,
            f"{camera}height": HEIGHT,
        }
    ]
    lidar = "[LiDARCalibrationComponent]."
    tables["lidar_calibration"] = [
        {
            "key.laser_name": 1,
            f"{lidar}extrinsic.transform": LIDAR_TO_VEHICLE.ravel().tolist(),
            f"{lidar}beam_inclination.min": float(BEAMS[0]),
            f"{lidar}beam_inclination.max": float(BEAMS[-1]),
            f"{lidar}beam_inclination.values": BEAMS.tolist(),
        }
    ]
    for k in range(drive.samples):
        pose = drive.vehicle_to_world(k).ravel().tolist()
        key = {"key.frame_timestamp_micros": int(drive.time(k) * 1e6)}
        tables["vehicle_pose"].append({**key, "[VehiclePoseComponent].world_from_vehicle.transform": pose})
        image = "[CameraImageComponent]."
        tables["camera_image"].append(
            {
                **key,
                "key.camera_name": 1,
                f"{image}image": drive.jpeg(k),
                f"{image}pose.transform": pose,
                f"{image}pose_timestamp": drive.time(k),
                f"{image}rolling_shutter_params.shutter": 0.003,
            }
        )
        for component, column, values in (
            ("lidar", "[LiDARComponent].range_image_return1", range_image(drive, k, shift_m)),
            ("lidar_pose", "[LiDARPoseComponent].range_image_return1", pixel_poses(drive, k, shift_m)),
        ):
            row = {f"{column}.values": values.ravel().tolist(), f"{column}.shape": list(values.shape)}
            tables[component].append({**key, "key.laser_name": 1, **row})
        box, placed = "[LiDARBoxComponent].", drive.box_to_vehicle(k)
        tables["lidar_box"].append(
            {
                **key,
                "key.laser_object_id": "car",
                **{f"{box}box.center.{axis}": float(v) for axis, v in zip("xyz", placed[:3, 3], strict=True)},
                **{f"{box}box.size.{axis}": v for axis, v in zip("xyz", BOX_LWH, strict=True)},
                f"{box}box.heading": float(np.arctan2(placed[1, 0], placed[0, 0])),
                f"{box}type": 1,
            }
        )
    return tables


def write_segment(root: Path, tables: Tables, segment: str = SEGMENTS[0]) -> None:
    for component, rows in tables.items():
        (root / component).mkdir(parents=True, exist_ok=True)
        table = pa.Table.from_pylist([{"key.segment_context_name": segment, **row} for row in rows])
        parquet.write_table(table, root / component / f"{segment}.parquet", row_group_size=2)


@pytest.mark.parametrize("shift_m", [0.0, 0.8])
def test_reads_a_miniature_exactly(tmp_path: Path, shift_m: float) -> None:
    drive = MiniDrive()
    write_segment(tmp_path / "training", segment_tables(drive, shift_m))
    assert getattr(capture_format(tmp_path), "name", "") == "Waymo Perception v2"
    capture = open_capture(tmp_path)
    assert not capture.problems
    assert capture.name == SEGMENTS[0]
    assert [view.name for view in capture] == ["0000_FRONT", "0001_FRONT", "0002_FRONT"]
    assert [int(view.image[0, 0, 0]) for view in capture] == pytest.approx([40, 60, 80], abs=3)
    assert capture[0].camera.exposure_s == pytest.approx(0.003)
    np.testing.assert_allclose(capture[0].camera.position[2], 1.6 - EGO_HEIGHT_M, atol=2e-3)
    (box,) = capture.boxes
    assert (box.id, box.class_name) == ("car", "vehicle")
    for sweep in capture.sweeps:
        on_road = np.abs(sweep.points_m[:, 2] + EGO_HEIGHT_M) < 5e-3
        held = points_inside(capture, sweep.points_m[~on_road], 0, sweep.time_s, slack_m=5e-3)
        assert held == np.count_nonzero(~on_road)
        assert held >= 10
        assert np.count_nonzero(on_road) > 500


def test_a_segment_is_chosen_by_its_name_or_a_file(tmp_path: Path) -> None:
    for segment, samples in zip(SEGMENTS, (3, 2), strict=True):
        write_segment(tmp_path, segment_tables(MiniDrive(samples=samples)), segment)
    first = open_capture(tmp_path)
    assert len(first) == 3
    assert str(tmp_path / SEGMENTS[1]) in first.problems[0]
    for path in (tmp_path / SEGMENTS[1], tmp_path / "lidar" / f"{SEGMENTS[1]}.parquet"):
        assert len(open_capture(path)) == 2


def test_without_lidar_and_boxes_the_pictures_remain(tmp_path: Path) -> None:
    tables = segment_tables(MiniDrive())
    write_segment(tmp_path, {name: tables[name] for name in ("vehicle_pose", "camera_image", "camera_calibration")})
    capture = open_capture(tmp_path)
    assert len(capture) == 3
    assert not capture.sweeps
    assert "boxes left out" in capture.problems[0]


def _cut_picture(tables: Tables) -> None:
    row = tables["camera_image"][1]
    row["[CameraImageComponent].image"] = row["[CameraImageComponent].image"][:-30]


def _shape(tables: Tables) -> None:
    tables["lidar"][1]["[LiDARComponent].range_image_return1.shape"] = [3, 5, 4]


def _other_box_time(tables: Tables) -> None:
    tables["lidar_box"][1]["key.frame_timestamp_micros"] = 5


def _mirrored(tables: Tables) -> None:
    tables["camera_calibration"].append({**tables["camera_calibration"][0], "key.camera_name": 2})
    tables["camera_calibration"][1]["[CameraCalibrationComponent].extrinsic.transform"] = (-np.eye(4)).ravel().tolist()


@pytest.mark.parametrize(
    ("spoil", "said", "views", "sweeps"),
    [
        (_cut_picture, "0001_FRONT left out: the picture is cut off", 2, 3),
        (_shape, "says that its shape is (3, 5, 4)", 3, 2),
        (_other_box_time, "box car left out: the vehicle's pose of its frame", 3, 3),
        (_mirrored, "FRONT_LEFT left out: a pose must be a rotation", 3, 3),
    ],
)
def test_names_what_is_broken_and_uses_the_rest(
    tmp_path: Path, spoil: Callable[[Tables], None], said: str, views: int, sweeps: int
) -> None:
    tables = segment_tables(MiniDrive())
    spoil(tables)
    write_segment(tmp_path, tables)
    capture = open_capture(tmp_path)
    assert said in "\n".join(capture.problems)
    assert (len(capture), len(capture.sweeps)) == (views, sweeps)


def test_names_the_file_that_can_not_be_read(tmp_path: Path) -> None:
    tables = segment_tables(MiniDrive())
    write_segment(tmp_path, tables)
    file = tmp_path / "vehicle_pose" / f"{SEGMENTS[0]}.parquet"
    content = file.read_bytes()
    for spoiled in (b"", content[: len(content) // 2], content[:-9] + b"x" + content[-8:]):
        file.write_bytes(spoiled)
        with pytest.raises(CaptureError, match="vehicle_pose"):
            open_capture(tmp_path)
    tables["vehicle_pose"] = [{"key.frame_timestamp_micros": 1}]
    write_segment(tmp_path, tables)
    with pytest.raises(CaptureError, match=r"has no column '\[VehiclePoseComponent\]"):
        open_capture(tmp_path)


def test_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gsrain_engine.datasets.io import records as parquet_file

    write_segment(tmp_path, segment_tables(MiniDrive()))

    def absent(_: str) -> Any:
        raise ImportError

    parquet_file._parquet.cache_clear()
    monkeypatch.setattr(parquet_file, "import_module", absent)
    with pytest.raises(CaptureError, match=r"need the package pyarrow: pip install 'gsrain\[waymo\]'"):
        open_capture(tmp_path)
