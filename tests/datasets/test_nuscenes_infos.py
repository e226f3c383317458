import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, CaptureError
from gsrain_engine.datasets.io.safe_pickle import read_pickle
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from lidar_edges import agreement_when_turned
from mini_drive import BOX_LWH, FOCAL, HEIGHT, WIDTH, MiniDrive, points_inside, quaternion


@pytest.fixture(scope="module")
def real(test_data: Path) -> Capture:
    return open_capture(test_data / "driving" / "nuscenes_sample")


def test_reads_the_real_sample(real: Capture) -> None:
    assert len(real) == 6
    assert not real.problems
    assert real[0].image.shape == (900, 1600, 3)
    assert real.sweeps[0].points_m.shape == (34688, 3)
    assert len(real.boxes) == 69
    assert {box.class_name for box in real.boxes} >= {"car", "pedestrian", "barrier", "unknown"}
    near = real.sweeps[0].points_m[np.hypot(*real.sweeps[0].points_m[:, :2].T) < 10]
    assert abs(np.median(near[:, 2]) + EGO_HEIGHT_M) < 0.15
    heights = {view.sensor: view.camera.position[2] + EGO_HEIGHT_M for view in real}
    assert all(1.4 < height < 1.7 for height in heights.values()), heights


def test_real_boxes_hold_as_many_points_as_the_file_says(real: Capture, test_data: Path) -> None:
    file = next((test_data / "driving" / "nuscenes_sample").glob("*.pkl"))
    said = [int(row["num_lidar_pts"]) for row in read_pickle(file)["data_list"][0]["instances"]]
    sweep = real.sweeps[0]
    held = [points_inside(real, sweep.points_m, k, sweep.time_s) for k in range(len(real.boxes))]
    assert np.mean(held) > 5
    assert np.mean(np.abs(np.subtract(held, said)) <= 2) > 0.9
    assert sum(held) == pytest.approx(sum(said), rel=0.03)


def test_real_lidar_falls_on_edges_of_the_pictures(real: Capture) -> None:
    views = [view.held() for view in real.views if view.sensor != "CAM_BACK"]
    found = {a: np.mean([agreement_when_turned(real, view, a) for view in views]) for a in (-4.0, 0.0, 4.0)}
    assert found[0.0] > 0.08
    assert all(found[0.0] > 1.5 * found[angle] for angle in found if angle), found


def write_infos(folder: Path, drive: MiniDrive, layout: str, times: list[float] | None = None) -> Path:
    """An info file of version 1.x, or of one before with boxes as of then ("0.x") or of its last candidates ("rc")."""
    matrix = [[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]]
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
            camera = {
                "img_path": f"{k}.jpg",
                "cam2img": matrix,
                "lidar2cam": lidar_to_camera.tolist(),
                "timestamp": time,
            }
            rows.append(
                {
                    "timestamp": time,
                    "ego2global": vehicle.tolist(),
                    "images": {"CAM_FRONT": camera},
                    "lidar_points": {
                        "lidar_path": f"{k}.pcd.bin",
                        "num_pts_feats": 5,
                        "lidar2ego": drive.lidar_to_vehicle.tolist(),
                    },
                    "instances": [{"bbox_3d": [*box[:3, 3], length, width, height, yaw], "bbox_label_3d": 0}],
                }
            )
            continue
        sides, turn = ([width, length], -yaw - np.pi / 2) if layout == "0.x" else ([length, width], yaw)
        placed = {"ego2global_translation": vehicle[:3, 3], "ego2global_rotation": quaternion(vehicle)}
        seen = {
            "data_path": f"./data/nuscenes/samples/CAM_FRONT/{k}.jpg",
            "timestamp": time * 1e6,
            "cam_intrinsic": np.array(matrix),
            "sensor2ego_translation": drive.camera_to_vehicle[:3, 3],
            "sensor2ego_rotation": quaternion(drive.camera_to_vehicle),
        }
        rows.append(
            {
                "lidar_path": f"./data/nuscenes/samples/LIDAR_TOP/{k}.pcd.bin",
                "timestamp": time * 1e6,
                **placed,
                "lidar2ego_translation": drive.lidar_to_vehicle[:3, 3],
                "lidar2ego_rotation": quaternion(drive.lidar_to_vehicle),
                "cams": {"CAM_FRONT": {**seen, **placed}},
                "gt_boxes": np.array([[*box[:3, 3], *sides, height, turn]]),
                "gt_names": np.array(["Car"]),
            }
        )
    metainfo = {"categories": {"Car": 0}, "dataset": "nuscenes"}
    values = {"metainfo": metainfo, "data_list": rows} if layout == "1.x" else {"infos": rows, "metadata": {}}
    file = folder / "nuscenes_infos_train.pkl"
    file.write_bytes(pickle.dumps(values))
    return file


@pytest.mark.parametrize("layout", ["1.x", "rc", "0.x"])
def test_reads_a_miniature_of_each_layout(tmp_path: Path, layout: str) -> None:
    drive = MiniDrive()
    file = write_infos(tmp_path, drive, layout)
    assert getattr(capture_format(tmp_path), "name", "") == "nuScenes (MMDetection3D)"
    for path in (tmp_path, file):
        capture = open_capture(path)
        drive.check(capture, has_boxes=False)
        assert not capture.problems
        # Without identities there is a box for each sample, around its time.
        assert [box.id for box in capture.boxes] == ["0-0", "1-0", "2-0"]
        for number, sweep in enumerate(capture.sweeps):
            held = [points_inside(capture, sweep.points_m, k, sweep.time_s, slack_m=-0.008) for k in range(3)]
            assert held == [60 if k == number else 0 for k in range(3)]


def test_drives_are_split_where_time_jumps(tmp_path: Path) -> None:
    drive = MiniDrive()
    file = write_infos(tmp_path, drive, "1.x", [10.0, 10.5, 900.0])
    assert len(open_capture(file)) == 2
    assert f"open another as {file}/1" in open_capture(tmp_path).problems[0]
    second = open_capture(file / "1")
    assert [view.image[0, 0, 0] for view in second] == pytest.approx([80], abs=3)
    with pytest.raises(CaptureError, match="has drives 0 to 1, not 2"):
        open_capture(file / "2")


def test_names_what_is_missing_and_uses_the_rest(tmp_path: Path) -> None:
    file = write_infos(tmp_path, MiniDrive(), "1.x")
    (tmp_path / "samples/CAM_FRONT/1.jpg").unlink()
    (tmp_path / "samples/LIDAR_TOP/0.pcd.bin").unlink()
    values = pickle.loads(file.read_bytes())
    del values["data_list"][2]["ego2global"]
    file.write_bytes(pickle.dumps(values))
    capture = open_capture(file)
    assert [view.name for view in capture] == ["0000_CAM_FRONT"]
    said = "\n".join(capture.problems)
    for part in (
        "sample 2 left out: has no field 'ego2global'",
        "CAM_FRONT of sample 1 left out: 1.jpg",
        "0.pcd.bin left",
    ):
        assert part in said


@pytest.mark.parametrize(
    "values", [{}, [], {"infos": []}, {"data_list": []}, {"data_list": [{}]}, {"infos": [{"x": 1}]}, 7]
)
def test_refuses_what_is_no_info_file(tmp_path: Path, values: Any) -> None:
    file = tmp_path / "some.pkl"
    file.write_bytes(pickle.dumps(values))
    with pytest.raises(CaptureError, match=r"some\.pkl"):
        open_capture(file)
