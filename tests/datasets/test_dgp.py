import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, CaptureError
from gsrain_engine.datasets.dgp import read_dgp
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from lidar_edges import agreement_when_turned
from mini_drive import BOX_LWH, FOCAL, HEIGHT, WIDTH, MiniDrive, points_inside, quaternion


@pytest.fixture(scope="module")
def real(test_data: Path) -> Capture:
    return read_dgp(test_data / "driving" / "dgp")


def test_reads_the_real_scene(real: Capture) -> None:
    assert len(real) == 18
    assert real.sensors == tuple(f"CAMERA_{number:02d}" for number in (1, 5, 6, 7, 8, 9))
    assert [len(sweep.points_m) for sweep in real.sweeps] == [47230, 49469, 48620]
    assert real.problems == ("scene_dataset_v1.0.json: 1 of 2 scenes missing: scene_01",)
    assert real[0].image.shape == (1216, 1936, 3)
    assert real.ego is not None
    steps = np.linalg.norm(np.diff(real.ego.positions, axis=0), axis=1)
    np.testing.assert_allclose(steps, [1.26, 1.28], atol=0.01)
    # The road below the car is where the lidar sees it: the world is level, and the ego stands above.
    near = np.concatenate([s.points_m[np.hypot(*(s.points_m - s.origin_m)[:, :2].T) < 6] for s in real.sweeps])
    assert abs(np.median(near[:, 2]) + EGO_HEIGHT_M) < 0.1


def test_real_lidar_falls_on_edges_of_the_pictures(real: Capture) -> None:
    views = [view.held() for view in real.views if view.name[:4] == "0000"]
    found = {a: np.mean([agreement_when_turned(real, view, a) for view in views]) for a in (-1.5, 0.0, 1.5)}
    assert found[0.0] > 0.05
    assert all(found[0.0] > 1.4 * found[angle] for angle in found if angle), found


def test_real_boxes_hold_the_points_that_their_annotation_counted(real: Capture, test_data: Path) -> None:
    folder = test_data / "driving" / "dgp" / "scene_02" / "bounding_box_3d" / "LIDAR"
    ids = [box.id for box in real.boxes]
    counted: list[int] = []
    held: list[int] = []
    for file, sweep in zip(sorted(folder.iterdir()), real.sweeps, strict=True):
        for row in json.loads(file.read_text())["annotations"]:
            counted.append(row["num_points"])
            held.append(points_inside(real, sweep.points_m, ids.index(str(row["instance_id"])), sweep.time_s))
    assert np.mean(held) > 5
    assert np.corrcoef(counted, held)[0, 1] > 0.99
    # The public cloud is one point of five of what was annotated.
    assert sum(held) / sum(counted) == pytest.approx(0.2, abs=0.02)


def write_dgp(folder: Path, drive: MiniDrive, camera_lens: dict[str, float] | None = None) -> Path:
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


def test_reads_a_miniature_exactly(tmp_path: Path) -> None:
    drive = MiniDrive()
    file = write_dgp(tmp_path, drive)
    for path in (tmp_path, file.parent, file, tmp_path / "scene_dataset_v1.json"):
        assert getattr(capture_format(path), "name", "") == "DGP"
    capture = open_capture(tmp_path)
    drive.check(capture)
    assert capture.name == "mini"
    assert [view.name for view in capture] == ["0000_CAM", "0001_CAM", "0002_CAM"]
    assert [view.time_s for view in capture] == [0.0, 0.5, 1.0]
    assert capture.sweeps[0].intensities is not None
    assert set(capture.sweeps[0].intensities) == {0.5}
    assert "scene_09" in capture.problems[0]


@pytest.mark.parametrize(
    ("extra", "lens"),
    [
        ({}, None),
        ({"k1": -0.3, "p1": 0.01}, ("opencv", (-0.3, 0.0, 0.01, 0.0, 0.0))),
        ({"k1": 0.1, "k6": 0.2}, ("opencv", (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2))),
        ({"fisheye": 1, "k1": 0.1, "k4": 0.4}, ("fisheye", (0.1, 0.0, 0.0, 0.4))),
    ],
)
def test_takes_the_lens_of_the_calibration(tmp_path: Path, extra: dict[str, float], lens: Any) -> None:
    write_dgp(tmp_path, MiniDrive(), extra)
    found = open_capture(tmp_path)[0].lens
    assert (found and (found.model, found.coefficients)) == lens


def test_names_a_camera_whose_lens_is_not_known(tmp_path: Path) -> None:
    write_dgp(tmp_path, MiniDrive(), {"xi": 0.7})
    with pytest.raises(CaptureError, match="no picture that can be used.*xi in the calibration"):
        open_capture(tmp_path)


def test_names_what_is_missing_and_uses_the_rest(tmp_path: Path) -> None:
    drive = MiniDrive()
    scene = write_dgp(tmp_path, drive).parent
    (scene / "rgb/CAM/1.jpg").unlink()
    (scene / "rgb/CAM/2.jpg").write_bytes(drive.jpeg(2)[:-20])
    (scene / "point_cloud/LIDAR/0.npz").write_bytes(b"PK\x03\x04 not an archive")
    (scene / "ontology/ont.json").write_text("{")
    capture = open_capture(scene)
    assert [view.name for view in capture] == ["0000_CAM"]
    assert len(capture.sweeps) == 2
    assert capture.boxes[0].class_name == "class 4"
    said = "\n".join(capture.problems)
    for name in ("1.jpg: no such picture", "2.jpg: the picture is cut off", "0.npz: not a readable .npz", "ont.json"):
        assert name in said


def test_a_scene_without_a_lidar_takes_the_vehicle_from_its_camera(tmp_path: Path) -> None:
    file = write_dgp(tmp_path, MiniDrive())
    values = json.loads(file.read_text())
    for sample in values["samples"]:
        sample["datum_keys"] = [key for key in sample["datum_keys"] if key.startswith("c")]
    file.write_text(json.dumps(values))
    capture = open_capture(file)
    assert not capture.sweeps
    assert capture.ego is not None
    np.testing.assert_allclose(capture[0].camera.position[2], 1.6 - EGO_HEIGHT_M, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(capture.ego.positions[-1]), 3.0, atol=1e-6)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"data": 3, "samples": []}', '{"data": [], "samples": []}'])
def test_refuses_a_broken_scene(tmp_path: Path, text: str) -> None:
    file = write_dgp(tmp_path, MiniDrive())
    file.write_text(text)
    with pytest.raises(CaptureError):
        open_capture(file)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dgp(tmp_path_factory.mktemp("dgp"), MiniDrive(samples=2))


@given(data=st.data(), junk=st.sampled_from([None, -1, 1e400, "x", [], {}, [1, 2], {"x": 1}, True]))
@settings(max_examples=60)
def test_nothing_but_a_capture_error_comes_out(whole: Path, data: st.DataObject, junk: Any) -> None:
    values = json.loads(whole.read_text())
    place: Any = values
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
        below = place[key]
        if not isinstance(below, dict | list) or not below or data.draw(st.integers(0, 3)) == 0:
            place[key] = junk
            break
        place = below
    mangled = whole.parent / "scene_mangled.json"
    mangled.write_text(json.dumps(values))
    try:
        capture = open_capture(mangled)
    except CaptureError as error:
        assert str(error)
    else:
        assert all(np.isfinite(view.camera.world_to_camera).all() for view in capture)
