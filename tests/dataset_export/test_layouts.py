"""Each layout read back by the rules of its public readers, and by ours."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from boxy_scene import FAR_M, NEAR_M, SIZE_LWH
from dataset_export.nuscenes_rules import box_corners_of, check_tables, pose_of, read_tables
from dataset_export.small_dataset import contents, small_source, write_dataset
from gsrain_engine.datasets.open_capture import open_capture
from oracles.run_lengths import unpacked
from simulation.small_drive import scene_with_box


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folder of each layout, in 0 and 50 mm/h, and what its job returned."""
    folder = tmp_path_factory.mktemp("layouts")
    return {name: (folder / name, write_dataset(folder / name, name)) for name in ("nuscenes", "kitti", "coco")}


def pixels(points, matrix):
    image = points @ np.asarray(matrix).T
    return image[:, :2] / image[:, 2:]


def read_picture(file):
    with Image.open(file) as image:
        return np.asarray(image)


def mask_of(folder, name, number):
    instances = read_picture(folder / "labels" / "instances" / "FRONT" / f"{name}.png")
    rows, columns = np.nonzero(instances == number)
    return rows, columns


def test_tables_of_nuscenes_keep_the_rules_of_its_development_kit(written):
    root = written["nuscenes"][0] / "rain_50"
    tables = check_tables(root)
    assert len(tables["sample"]) == 2 and len(tables["sample_data"]) == 4
    assert {each["name"] for each in tables["category"]} == {"vehicle.car"}
    calibrated = {each["token"]: each for each in tables["calibrated_sensor"]}
    vehicles = {each["token"]: each for each in tables["ego_pose"]}
    camera, lidar = (
        next(each for each in tables["sample_data"] if each["fileformat"] == form) for form in ("jpg", "pcd")
    )
    placed = calibrated[camera["calibrated_sensor_token"]]
    to_world = pose_of(vehicles[camera["ego_pose_token"]]) @ pose_of(placed)
    back = np.linalg.inv(to_world)
    near = min(tables["sample_annotation"], key=lambda each: abs(each["translation"][0] - NEAR_M))
    assert near["translation"] == pytest.approx([NEAR_M, 0, SIZE_LWH[2] / 2], abs=1e-6)
    assert near["size"] == [SIZE_LWH[1], SIZE_LWH[0], SIZE_LWH[2]]
    seen = pixels(box_corners_of(near) @ back[:3, :3].T + back[:3, 3], placed["camera_intrinsic"])
    rows, columns = mask_of(written["nuscenes"][0], "000000", 1)
    assert seen[:, 0].min() - 1 <= columns.min() and columns.max() <= seen[:, 0].max() + 1
    assert seen[:, 1].min() - 1 <= rows.min() and rows.max() <= seen[:, 1].max() + 1
    # Points, x right and y forward, are on the car's rear where its box says so.
    points = np.fromfile(root.parent / "rain_0" / lidar["filename"], np.float32).reshape(-1, 5)
    to_world = pose_of(vehicles[lidar["ego_pose_token"]]) @ pose_of(calibrated[lidar["calibrated_sensor_token"]])
    world = points[:, :3] @ to_world[:3, :3].T + to_world[:3, 3]
    inside = (np.abs(world - near["translation"]) <= np.array([2.1, 1.1, 0.85])).all(axis=1)
    assert inside.sum() == near["num_lidar_pts"] > 5
    assert points[:, 3].min() >= 0 and points[:, 3].max() <= 255 and len(np.unique(points[:, 4])) > 8


def test_our_reader_of_nuscenes_finds_the_same_drive(tmp_path):
    scene = scene_with_box()
    write_dataset(tmp_path / "set", "nuscenes", 0, 50, source=small_source(scene, rate_hz=1, moments=3))
    tables = check_tables(tmp_path / "set" / "rain_50")
    assert "vehicle.moving" in {each["name"] for each in tables["attribute"]}
    clear, rainy = (open_capture(tmp_path / "set" / name) for name in ("rain_0", "rain_50"))
    assert clear.problems == rainy.problems == () and len(rainy) == 3 and clear.sensors == ("CAM_FRONT",)
    for number, view in enumerate(clear):
        expected = scene.ego.pose(float(number))[:3, 3] - scene.ego.pose(0.0)[:3, 3]
        np.testing.assert_allclose(view.camera.position, expected, atol=0.05)
        assert view.camera.fx == pytest.approx(160 / 960 * 800) and view.time_s == number
    (box,) = clear.boxes
    assert box.size_lwh == (4.0, 2.0, 1.5)
    place = box.track.pose(1.0)[:3, 3] - clear.ego.pose(1.0)[:3, 3]
    np.testing.assert_allclose(place, [7.0 - 2.0, 3.0, -1.5], atol=0.05)
    assert len(clear.sweeps) == len(rainy.sweeps) == 3
    for dry, wet in zip(clear.sweeps, rainy.sweeps, strict=True):
        assert len(wet.points_m) > 0 and len(wet.points_m) != len(dry.points_m)
        assert dry.intensities.max() <= 100
    difference = np.abs(clear[0].image.astype(float) - rainy[0].image)
    assert difference.mean() > 1


def test_frames_of_kitti_project_their_boxes_onto_their_pixels(written):
    folder = written["kitti"][0]
    root = folder / "rain_0" / "training"
    numbers = (folder / "rain_0" / "ImageSets" / "train.txt").read_text().split()
    assert numbers == ["000000", "000001"]
    frames = (folder / "rain_50" / "frames.csv").read_text().splitlines()
    assert frames[1] == "000000,0,0.000000,FRONT"
    for number in numbers:
        assert read_picture(root / "image_2" / f"{number}.png").shape == (106, 160, 3)
        calib = dict(line.split(": ") for line in (root / "calib" / f"{number}.txt").read_text().splitlines())
        p2 = np.array(calib["P2"].split(), float).reshape(3, 4)
        to_camera = np.array(calib["Tr_velo_to_cam"].split(), float).reshape(3, 4)
        points = np.fromfile(root / "velodyne" / f"{number}.bin", np.float32).reshape(-1, 4)
        seen = points[:, :3] @ to_camera[:, :3].T + to_camera[:, 3]
        assert points[:, 3].min() >= 0 and points[:, 3].max() <= 1
        lines = [line.split() for line in (root / "label_2" / f"{number}.txt").read_text().splitlines()]
        assert [line[0] for line in lines] == ["Car", "Car"]
        for row, line in enumerate(lines, 1):
            assert len(line) == 15 and line[1] == "0.00" and line[2] in ("0" if row == 1 else "12")
            left, top, right, bottom = (float(each) for each in line[4:8])
            height, width, length, x, y, z, turn = (float(each) for each in line[8:])
            assert (length, width, height) == SIZE_LWH and z == pytest.approx(NEAR_M if row == 1 else FAR_M)
            sides = np.stack(np.meshgrid([-length / 2, length / 2], [-height, 0], [-width / 2, width / 2]), -1)
            rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
            corners = sides.reshape(-1, 3) @ rotation.T + [x, y, z]
            hull = pixels(np.column_stack([corners, np.ones(8)]), p2)
            assert (hull.min(axis=0) <= [left + 2, top + 2]).all()
            assert (hull.max(axis=0) >= [right - 2, bottom - 2]).all()
            rows, columns = mask_of(folder, number, row)
            assert left - 0.5 <= columns.min() and columns.max() <= right + 0.5
            assert top - 0.5 <= rows.min() and rows.max() <= bottom + 0.5
            local = (seen - [x, y, z]) @ rotation
            inside = (np.abs(local - [0, -height / 2, 0]) <= [length / 2 + 0.1, height / 2 + 0.1, width / 2 + 0.1]).all(
                1
            )
            assert row > 1 or inside.sum() > 5  # few beams get past the near car


def test_annotations_of_coco_are_those_of_the_pixels(written):
    folder, result = written["coco"]
    root = folder / "rain_50"
    document = json.loads((root / "annotations.json").read_text())
    images = {each["id"]: each for each in document["images"]}
    categories = {each["id"]: each["name"] for each in document["categories"]}
    assert len(images) == 2 and len(document["annotations"]) == 4 == result.numbers["objects_in_pictures"]
    assert len({each["id"] for each in document["annotations"]}) == 4
    for image in images.values():
        assert read_picture(root / image["file_name"]).shape[:2] == (image["height"], image["width"])
    for each in document["annotations"]:
        assert categories[each["category_id"]] == "car"
        mask = unpacked(each["segmentation"])
        rows, columns = np.nonzero(mask)
        left, top, width, height = each["bbox"]
        assert mask.shape == (images[each["image_id"]]["height"], images[each["image_id"]]["width"])
        assert len(rows) == each["area"] and (columns.min(), rows.min()) == (left, top)
        assert (columns.max() + 1, rows.max() + 1) == (left + width, top + height)
        depth = read_picture(folder / "labels" / "depth" / "FRONT" / "000000.png") / 100
        assert np.median(depth[mask]) == pytest.approx(each["box_3d"]["object_to_camera"][2][3], abs=0.2)
    assert any("coco has none" in each for each in result.numbers["left_out"])


def test_depth_is_that_of_the_surfaces(written):
    depth_m = read_picture(written["coco"][0] / "labels" / "depth" / "FRONT" / "000000.png") / 100
    focal, middle, height = 160 / 960 * 800, 160 / 960 * 320, depth_m.shape[0]
    rows = np.arange(height * 5 // 8, height)  # the road, 1.5 m below the camera, up to 15 m ahead
    expected = focal * 1.5 / (rows + 0.5 - middle)
    np.testing.assert_allclose(np.median(depth_m[rows, 30:60], axis=1), expected, rtol=0.01)
    assert (depth_m[:10] == 0).mean() > 0.5  # the sky


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_pycocotools_reads_the_annotations(written):
    coco = pytest.importorskip("pycocotools.coco")
    labels = coco.COCO(str(written["coco"][0] / "rain_0" / "annotations.json"))
    for annotation in labels.loadAnns(labels.getAnnIds(catIds=labels.getCatIds(["car"]))):
        assert labels.annToMask(annotation).sum() == annotation["area"] > 0


@pytest.mark.parametrize("layout", ["nuscenes", "kitti", "coco"])
def test_rains_share_their_labels_and_differ_in_their_pictures(written, layout):
    folder = written[layout][0]
    dry, wet, shared = (contents(folder / name) for name in ("rain_0", "rain_50", f"labels/{layout}"))
    assert shared and all(dry[name] == wet[name] == data for name, data in shared.items())
    for name in shared:  # one file on the disk
        assert (folder / "rain_0" / name).samefile(folder / "labels" / layout / name)
    own = {name for name in dry if name not in shared}
    assert {name for name in wet if name not in shared} == own
    assert all(dry[name] != wet[name] for name in own)
    held = json.loads((folder / "rain_50" / "provenance" / "FRONT" / "000001.json").read_text())
    assert held["intensity_mm_h"] == 50 and held["time_s"] == 1 and "streaks" in held["passes"]


def test_tokens_depend_on_the_source_only(written, tmp_path):
    write_dataset(tmp_path / "again", "nuscenes", 8.5)
    assert read_tables(tmp_path / "again" / "rain_8.5") == read_tables(written["nuscenes"][0] / "rain_50")


def test_a_rig_of_several_cameras_has_a_frame_of_kitti_each(tmp_path):
    scene = scene_with_box()
    front = scene.rigs["one"][0]
    scene = replace(scene, rigs={"one": (front, replace(front, name="left/2"))})
    write_dataset(tmp_path / "set", "kitti", 8.5, source=small_source(scene, moments=2))
    root = tmp_path / "set" / "rain_8.5"
    lines = (root / "frames.csv").read_text().splitlines()[1:]
    assert [line.split(",")[1::2] for line in lines] == [
        ["0", "FRONT"],
        ["0", "left/2"],
        ["1", "FRONT"],
        ["1", "left/2"],
    ]
    for kind, suffix in (("image_2", "png"), ("velodyne", "bin"), ("label_2", "txt"), ("calib", "txt")):
        names = [each.name for each in sorted((root / "training" / kind).iterdir())]
        assert names == [f"{number:06d}.{suffix}" for number in range(4)]
    assert (root / "training/velodyne/000000.bin").samefile(root / "training/velodyne/000001.bin")
