import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.nuscenes import read_nuscenes
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from mini_drive import BOX_LWH, FOCAL, HEIGHT, WIDTH, MiniDrive, quaternion

Rows = dict[str, list[dict[str, Any]]]


def write_nuscenes(root: Path, drive: MiniDrive, scenes: tuple[str, ...] = ("scene-0061",)) -> Rows:
    """The tables of the devkit's schema; the drive happens in each scene, 100 s apart."""
    length, width, height = BOX_LWH
    matrix = [[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]]
    tables: Rows = {
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
        "instance": [],
        "scene": [],
        "sample": [],
        "sample_data": [],
        "ego_pose": [],
        "sample_annotation": [],
    }
    for channel in ("CAM_FRONT", "LIDAR_TOP", "RADAR_FRONT"):
        (root / "samples" / channel).mkdir(parents=True, exist_ok=True)
    for number, scene in enumerate(scenes):
        tables["scene"].append({"token": f"t-{scene}", "name": scene, "nbr_samples": drive.samples, "description": ""})
        tables["instance"].append({"token": f"i-{scene}", "category_token": "car", "nbr_annotations": drive.samples})
        for k in range(drive.samples):
            key, time = f"{scene}-{k}", int(drive.time(k) * 1e6) + number * 100_000_000
            tables["sample"].append(
                {"token": key, "timestamp": time, "scene_token": f"t-{scene}", "prev": "", "next": ""}
            )
            tables["ego_pose"].append({"token": f"e-{key}", "timestamp": time, **_placed(drive.vehicle_to_world(k))})
            box = _placed(drive.box_to_world())
            row = {
                "token": f"a-{key}",
                "sample_token": key,
                "instance_token": f"i-{scene}",
                "size": [width, length, height],
            }
            tables["sample_annotation"].append({**row, **box, "num_lidar_pts": 60})
            for channel, sensor, suffix in (("CAM_FRONT", "c-cam", "jpg"), ("LIDAR_TOP", "c-top", "pcd.bin")):
                file = f"samples/{channel}/{key}.{suffix}"
                tables["sample_data"].append(
                    {
                        "token": f"d-{channel}-{key}",
                        "sample_token": key,
                        "ego_pose_token": f"e-{key}",
                        "calibrated_sensor_token": sensor,
                        "filename": file,
                        "timestamp": time,
                        "is_key_frame": True,
                    }
                )
                points = drive.lidar_points(k)
                rows = np.column_stack([points, np.full(len(points), 9.0), np.zeros(len(points))]).astype(np.float32)
                (root / file).write_bytes(drive.jpeg(k) if suffix == "jpg" else rows.tobytes())
    # A picture between two samples, and a radar, which is nothing for us.
    between = {**tables["sample_data"][0], "token": "between", "is_key_frame": False}
    tables["sample_data"].append({**between, "timestamp": between["timestamp"] + 83_000})
    tables["sample_data"].append(
        {**between, "token": "radar", "calibrated_sensor_token": "c-radar", "is_key_frame": True}
    )
    write_tables(root, tables)
    return tables


def write_tables(root: Path, tables: Rows) -> None:
    (root / "v1.0-mini").mkdir(exist_ok=True)
    for name, rows in tables.items():
        (root / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows))


def _placed(pose: np.ndarray) -> dict[str, Any]:
    return {"translation": pose[:3, 3].tolist(), "rotation": quaternion(pose)}


def test_reads_a_miniature_exactly(tmp_path: Path) -> None:
    drive = MiniDrive()
    write_nuscenes(tmp_path, drive)
    assert getattr(capture_format(tmp_path), "name", "") == "nuScenes"
    capture = open_capture(tmp_path)
    drive.check(capture, has_boxes=False)
    drive.check_boxes(capture, "vehicle.car")
    assert capture.sensors == ("CAM_FRONT",)
    assert [view.name for view in capture] == ["0000_CAM_FRONT", "0001_CAM_FRONT", "0002_CAM_FRONT"]
    assert not capture.problems
    # OpenCV counts pixels from their centres, we from their edges.
    assert (capture[0].camera.cx, capture[0].camera.cy) == (WIDTH / 2, HEIGHT / 2)
    assert [int(view.image[0, 0, 0]) for view in capture] == pytest.approx([40, 60, 80], abs=3)
    drive.check(open_capture(tmp_path / "v1.0-mini"), has_boxes=False)


def test_takes_the_pictures_between_samples_when_asked(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, MiniDrive())
    assert [view.time_s for view in read_nuscenes(tmp_path, key_frames_only=False)] == [0.0, 0.083, 0.5, 1.0]


def test_a_scene_is_chosen_by_its_name(tmp_path: Path) -> None:
    drive = MiniDrive()
    write_nuscenes(tmp_path, drive, ("scene-0061", "scene-0103"))
    first = open_capture(tmp_path)
    assert first.name == "scene-0061"
    assert str(tmp_path / "scene-0103") in first.problems[0]
    chosen = open_capture(tmp_path / "scene-0103")
    assert (chosen.name, chosen.problems) == ("scene-0103", ())
    drive.check(chosen, has_boxes=False)
    with pytest.raises(CaptureError, match="no scene 'scene-7'; it has scene-0061, scene-0103"):
        open_capture(tmp_path / "scene-7")


def test_of_a_part_of_the_data_set_it_reads_a_scene_that_is_there(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, MiniDrive(), ("scene-0061", "scene-0103"))
    for file in tmp_path.glob("samples/*/scene-0061*"):
        file.unlink()
    assert open_capture(tmp_path).name == "scene-0103"


def test_names_what_is_missing_and_uses_the_rest(tmp_path: Path) -> None:
    tables = write_nuscenes(tmp_path, MiniDrive())
    (tmp_path / "samples/CAM_FRONT/scene-0061-1.jpg").unlink()
    (tmp_path / "samples/LIDAR_TOP/scene-0061-2.pcd.bin").write_bytes(b"123")
    tables["sample_annotation"][0]["size"] = [0.0, 1.0, 1.0]
    tables["sample_data"][4]["ego_pose_token"] = "nowhere"
    write_tables(tmp_path, tables)
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["0000_CAM_FRONT"]
    assert len(capture.sweeps) == 2
    said = "\n".join(capture.problems)
    for part in ("-1.jpg: no such picture", "not rows of 5", "a-scene-0061-0 left out", "its ego pose is not"):
        assert part in said


def test_without_annotations_there_are_no_boxes(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, MiniDrive())
    (tmp_path / "v1.0-mini/sample_annotation.json").unlink()
    capture = open_capture(tmp_path)
    assert not capture.boxes
    assert "sample_annotation.json: this table of nuScenes is missing" in capture.problems[0]


def _without_samples(tables: Rows) -> None:
    tables["sample"].clear()


def _of_another_type(tables: Rows) -> None:
    tables["ego_pose"][1]["rotation"] = [1, 0, 0]


def _zero_turn(tables: Rows) -> None:
    for row in tables["ego_pose"]:
        row["rotation"] = [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (_without_samples, "of none of its 1 scenes"),
        (_of_another_type, r"ego_pose.json: Expected `array` of length 4 - at `\$\[1\].rotation`"),
        (_zero_turn, "its quaternion not zero"),
    ],
)
def test_refuses_broken_tables(tmp_path: Path, spoil: Callable[[Rows], None], said: str) -> None:
    tables = write_nuscenes(tmp_path, MiniDrive())
    spoil(tables)
    write_tables(tmp_path, tables)
    with pytest.raises(CaptureError, match=said):
        open_capture(tmp_path)
