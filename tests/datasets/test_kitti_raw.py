from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.geometry import rigid_pose
from gsrain_engine.datasets.kitti import IMU_HEIGHT_M, KittiCamera, oxts_poses
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from mini_drive import BOX_LWH, FOCAL, HEIGHT, WIDTH, YAW, MiniDrive, turned

EARTH_M = 6378137.0
LATITUDE, LONGITUDE, ALTITUDE = 49.011, 8.417, 112.8
BASELINE_M = 0.06


def drive_on_the_road() -> MiniDrive:
    return MiniDrive(road_m=-IMU_HEIGHT_M, offset=(0.0, 0.0, 0.0))


def write_kitti(day: Path, drive: MiniDrive, name: str = "2011_09_26_drive_0005_sync") -> Path:
    """A drive as the raw data has it; the lidar's frame here is turned a little, and rectification turns too."""
    folder = day / name
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
    matrix = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    projection = matrix @ baseline[:3]
    lines = [
        "calib_time: 09-Jan-2012 13:57:47",
        f"R_rect_00: {_row(rectify[:3, :3])}",
        f"P_rect_02: {_row(projection)}",
    ]
    (day / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    for file, pose in (("velo_to_cam", to_camera), ("imu_to_velo", np.linalg.inv(lidar_to_imu))):
        text = f"calib_time: 15-Mar-2012 11:37:16\nR: {_row(pose[:3, :3])}\nT: {_row(pose[:3, 3])}\ndelta_f: 0 0\n"
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


def _row(values: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in values.ravel())


def test_reads_a_miniature_exactly(tmp_path: Path) -> None:
    drive = drive_on_the_road()
    folder = write_kitti(tmp_path, drive)
    for path in (folder, tmp_path):
        assert getattr(capture_format(path), "name", "") == "KITTI raw"
        capture = open_capture(path)
        drive.check(capture)
        assert not capture.problems
    assert capture.name == "2011_09_26_drive_0005_sync"
    assert [view.name for view in capture] == ["0000_image_02", "0001_image_02", "0002_image_02"]
    assert capture[0].lens is None
    assert (capture[0].camera.cx, capture[0].camera.cy) == (WIDTH / 2, HEIGHT / 2)
    assert capture.sweeps[0].intensities is not None
    assert set(capture.sweeps[0].intensities) == {0.25}


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


def test_names_what_is_missing_and_uses_the_rest(tmp_path: Path) -> None:
    drive = drive_on_the_road()
    folder = write_kitti(tmp_path, drive)
    (folder / "oxts/data/0000000001.txt").write_text("not numbers")
    (folder / "velodyne_points/data/0000000002.bin").write_bytes(b"12345")
    (folder / "image_02/data/0000000002.jpg").write_bytes(drive.jpeg(2)[:-20])
    (folder / "image_03/data").mkdir(parents=True)
    capture = open_capture(folder)
    assert [view.name for view in capture] == ["0000_image_02"]
    assert len(capture.sweeps) == 1
    said = "\n".join(capture.problems)
    for part in ("0000000001.txt", "0000000002.bin", "the picture is cut off", "image_03 left out"):
        assert part in said


@pytest.mark.parametrize(
    "text",
    [
        '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><x>&b;</x>',
        "<boost_serialization><tracklets>",
        "<x><tracklets><item><h>1</h></item></tracklets></x>",
        "<x><tracklets><item><h>one</h><w>1</w><l>1</l></item></tracklets></x>",
    ],
)
def test_broken_tracklets_are_left_out(tmp_path: Path, text: str) -> None:
    folder = write_kitti(tmp_path, drive_on_the_road())
    (folder / "tracklet_labels.xml").write_text(text)
    capture = open_capture(folder)
    assert not capture.boxes
    assert len(capture) == 3
    assert "boxes left out" in capture.problems[0]
    assert ("defines entities" in capture.problems[0]) == ("ENTITY" in text)


def test_refuses_what_it_can_not_place(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path, drive_on_the_road())
    file = tmp_path / "calib_velo_to_cam.txt"
    content = file.read_text()
    file.write_text(content.replace("T:", "U:"))
    with pytest.raises(
        CaptureError, match="calib_velo_to_cam.txt: expected 3 finite numbers at T, it has no such line"
    ):
        open_capture(folder)
    file.unlink()
    with pytest.raises(CaptureError, match="calib_velo_to_cam.txt: no such file"):
        open_capture(folder)
    file.write_text(content)
    raw = folder.rename(tmp_path / "2011_09_26_drive_0005_extract")
    with pytest.raises(CaptureError, match="not rectified"):
        open_capture(raw)


def test_the_published_calibration_puts_the_camera_where_the_paper_has_it() -> None:
    """The numbers of 2011_09_26: the left color camera is 27 cm before, 6 cm left of and 8 cm below the lidar."""
    turn = "7.533745e-03 -9.999714e-01 -6.166020e-04 1.480249e-02 7.280733e-04 -9.998902e-01 9.998621e-01 7.523790e-03"
    rectify = (
        "9.999239e-01 9.837760e-03 -7.445048e-03 -9.869795e-03 9.999421e-01 -4.278459e-03 7.402527e-03 4.351614e-03"
    )
    projection = "721.5377 0 609.5593 44.85728 0 721.5377 172.8540 0.2163791 0 0 1 0.002745884"
    to_first = rigid_pose(_numbers(turn + " 1.480755e-02", 3), np.array([-4.069766e-03, -7.631618e-02, -2.717806e-01]))
    lidar_to_first = rigid_pose(_numbers(rectify + " 0.9999631", 3), np.zeros(3)) @ to_first
    camera = KittiCamera("image_02", _numbers(projection, 4))
    in_lidar = np.linalg.inv(camera.from_first @ lidar_to_first)
    np.testing.assert_allclose(in_lidar[:3, 3], [0.27, 0.06, -0.08], atol=0.02)
    np.testing.assert_allclose(in_lidar[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=0.02)


def _numbers(text: str, columns: int) -> np.ndarray:
    return np.array([float(word) for word in text.split()]).reshape(3, columns)
