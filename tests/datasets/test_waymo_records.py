import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, CaptureError
from gsrain_engine.datasets.geometry import project_points
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from mini_drive import BOX_LWH, FOCAL, HEIGHT, WIDTH, MiniDrive, points_inside, turned
from tfrecord_framing import framed
from waymo_lidar import BEAMS, LIDAR_TO_VEHICLE, pixel_poses, range_image

pytest.importorskip("google.protobuf")
from gsrain_engine.datasets.waymo import WaymoLaser, parsed

OWN_AXES = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Waymo's camera axes (x forward, y left, z up) to OpenCV's."""


@pytest.fixture(scope="module")
def real(test_data: Path) -> Capture:
    return open_capture(test_data / "driving" / "waymo_frame")


def test_reads_the_real_frame(real: Capture) -> None:
    assert real.name == "1024360143612057520_3580_000_3600_000"
    assert real.sensors == ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
    assert [view.image.shape for view in real] == [(1280, 1920, 3)] * 3 + [(886, 1920, 3)] * 2
    assert [round(view.camera.exposure_s * 1000, 1) for view in real] == [2.6, 2.6, 2.7, 3.9, 3.1]
    assert len(real.boxes) == 75
    assert {box.class_name for box in real.boxes} == {"vehicle", "pedestrian", "sign", "cyclist"}
    assert not real.sweeps
    assert not real.problems
    heights = [view.camera.position[2] + EGO_HEIGHT_M for view in real]
    assert all(2.0 < height < 2.2 for height in heights), heights


def test_real_boxes_fall_where_things_are_seen(real: Capture) -> None:
    """The front camera's pedestrians cross the street: dark clothes before a light road, left of the middle."""
    front = real[0]
    seen: list[tuple[float, float, float]] = []
    for box in real.boxes:
        pose = box.track.pose(front.time_s)
        assert pose is not None
        pixels, depths = project_points((pose[:3, 3] + [0, 0, box.size_lwh[2] / 2])[None], front.camera, front.lens)
        if box.class_name == "pedestrian" and 0 < depths[0] < 14 and 0 < pixels[0, 0] < 1920:
            seen.append((*pixels[0], depths[0]))
    assert len(seen) == 2
    grey = front.image.mean(axis=2)
    for column, row, _ in seen:
        body = grey[int(row) - 120 : int(row) + 120, int(column) - 40 : int(column) + 40].min(axis=1).mean()
        beside = grey[int(row) - 120 : int(row) + 120, int(column) + 260 : int(column) + 340].min(axis=1).mean()
        assert body < 0.6 * beside


def write_frames(
    file: Path, drive: MiniDrive, *, shift_m: float = 0.0, change: Callable[[int, Any], None] | None = None
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
        camera.extrinsic.transform.extend((drive.camera_to_vehicle @ OWN_AXES).ravel())
        image = frame.images.add(name=1, image=drive.jpeg(k), pose_timestamp=drive.time(k), shutter=0.003)
        image.pose.transform.extend(drive.vehicle_to_world(k).ravel())
        laser = frame.context.laser_calibrations.add(name=1)
        laser.beam_inclinations.extend(BEAMS)
        laser.extrinsic.transform.extend(LIDAR_TO_VEHICLE.ravel())
        returned = frame.lasers.add(name=1).ri_return1
        returned.range_image_compressed = _matrix(range_image(drive, k, shift_m))
        returned.range_image_pose_compressed = _matrix(pixel_poses(drive, k, shift_m))
        pose = drive.box_to_vehicle(k)
        label = frame.laser_labels.add(id="car", type=1)
        label.box.center_x, label.box.center_y, label.box.center_z = pose[:3, 3]
        label.box.length, label.box.width, label.box.height = BOX_LWH
        label.box.heading = np.arctan2(pose[1, 0], pose[0, 0])
        if change:
            change(k, frame)
        records.append(framed(frame.SerializeToString()))
    file.write_bytes(b"".join(records))


def _matrix(values: np.ndarray) -> bytes:
    message = parsed("MatrixFloat", b"")
    message.data = values.astype("<f4").tobytes()
    message.shape.dims.extend(values.shape)
    return zlib.compress(message.SerializeToString())


@pytest.mark.parametrize("shift_m", [0.0, 0.8])
def test_reads_a_miniature_exactly(tmp_path: Path, shift_m: float) -> None:
    drive = MiniDrive()
    write_frames(tmp_path / "some.tfrecord", drive, shift_m=shift_m)
    assert getattr(capture_format(tmp_path), "name", "") == "Waymo Perception v1"
    capture = open_capture(tmp_path)
    check_capture(capture, drive)
    assert not capture.problems


def check_capture(capture: Capture, drive: MiniDrive) -> None:
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
        assert held == np.count_nonzero(~on_road)
        assert held >= 10
        assert np.count_nonzero(on_road) > 500
        assert sweep.intensities is not None
        assert set(sweep.intensities) == {0.5}
    assert [int(view.image[0, 0, 0]) for view in capture] == pytest.approx([40, 60, 80], abs=3)


def _without_calibration(k: int, frame: Any) -> None:
    if k == 1:
        del frame.context.camera_calibrations[:]


def _cut_picture(k: int, frame: Any) -> None:
    if k == 1:
        frame.images[0].image = frame.images[0].image[:-30]


def _mirrored_pose(k: int, frame: Any) -> None:
    if k == 1:
        frame.pose.transform[0] *= -1


def _lying_range_image(k: int, frame: Any) -> None:
    if k == 1:
        frame.lasers[0].ri_return1.range_image_compressed = zlib.compress(bytes(40_000_000))


def _other_shape(k: int, frame: Any) -> None:
    if k == 1:
        frame.lasers[0].ri_return1.range_image_compressed = _matrix(np.ones((3, 5, 4), np.float32))


@pytest.mark.parametrize(
    ("change", "said", "views", "sweeps"),
    [
        (_without_calibration, "FRONT of frame 1 left out: its calibration is missing", 2, 3),
        (_cut_picture, "FRONT of frame 1 left out: the picture is cut off", 2, 3),
        (_mirrored_pose, "frame 1 left out: a pose must be a rotation", 2, 2),
        (_lying_range_image, "lidar TOP of frame 1 left out: a range image larger", 3, 2),
        (_other_shape, "lidar TOP of frame 1 left out: ", 3, 2),
    ],
)
def test_names_what_is_broken_and_uses_the_rest(
    tmp_path: Path, change: Callable[[int, Any], None], said: str, views: int, sweeps: int
) -> None:
    file = tmp_path / "some.tfrecord"
    write_frames(file, MiniDrive(), change=change)
    capture = open_capture(file)
    assert said in "\n".join(capture.problems)
    assert (len(capture), len(capture.sweeps)) == (views, sweeps)


def test_frames_before_a_cut_are_used(tmp_path: Path) -> None:
    file = tmp_path / "some.tfrecord"
    write_frames(file, MiniDrive())
    content = file.read_bytes()
    file.write_bytes(content[:-100])
    capture = open_capture(file)
    assert len(capture) == 2
    assert "cut off" in capture.problems[0]
    file.write_bytes(content[:100])
    with pytest.raises(CaptureError, match=r"some\.tfrecord: cut off"):
        open_capture(file)
    file.write_bytes(framed(b"\xff\xff no message"))
    with pytest.raises(CaptureError, match=r"some\.tfrecord: not a message"):
        open_capture(file)


def test_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gsrain_engine.datasets import waymo as waymo_messages

    write_frames(tmp_path / "some.tfrecord", MiniDrive())

    def absent(_: str) -> Any:
        raise ImportError

    waymo_messages._kinds.cache_clear()
    monkeypatch.setattr(waymo_messages, "import_module", absent)
    with pytest.raises(CaptureError, match=r"need the package protobuf: pip install 'gsrain\[waymo\]'"):
        open_capture(tmp_path)


def test_a_pixel_is_moved_by_its_own_pose() -> None:
    """Against rotation matrices that are multiplied out: yaw after pitch after roll, as dataset.proto defines them."""
    random = np.random.default_rng(4)
    ranges, poses = random.uniform(1, 50, (3, 4, 2)), random.uniform(-1, 1, (3, 4, 6))
    vehicle_to_world, to_vehicle = turned(0.7, (3.0, -2.0, 1.0)), turned(-0.4, (1.4, 0.2, 2.0))
    laser = WaymoLaser(to_vehicle, np.array([-0.3, 0.1]), is_even=True)
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
