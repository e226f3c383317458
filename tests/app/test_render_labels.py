"""`gsrain render --labels`: files that train and test detectors."""

import json

import numpy as np
import pytest
from PIL import Image

from app.main import run
from boxy_scene import SIZE_LWH, boxy_scene
from gsrain_engine.scene.formats.scene_files import write_scene
from oracles.run_lengths import unpacked


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labels") / "boxy"
    write_scene(boxy_scene(), folder)
    return folder


def render(project, out, *options):
    size = ("--size", "144x96", "--cameras", "FRONT", "--fps", "2", "--to", "1", "--backend", "cpu")
    return run(["render", str(project), "-o", str(out), *size, *options])


def test_coco_labels_are_one_file_with_boxes_masks_and_depth(project, tmp_path, capsys):
    out = tmp_path / "frames"
    assert render(project, out, "--rain", "12", "--clear-pair", "sunny", "--labels", "coco") == 0
    assert str(out / "labels.coco.json") in capsys.readouterr().out
    document = json.loads((out / "labels.coco.json").read_text())
    assert [each["file_name"] for each in document["images"]] == ["000000.png", "000001.png"]
    for image in document["images"]:
        for kind in ("file_name", "depth_file_name", "clear_file_name"):
            assert (out / image[kind]).is_file()
    first = [each for each in document["annotations"] if each["image_id"] == 1]
    assert [each["object"] for each in first] == ["near", "far"]
    for each in first:
        rows, columns = np.nonzero(unpacked(each["segmentation"]))
        left, top, width, height = each["bbox"]
        assert (columns.min(), columns.max() + 1) == (left, left + width)
        assert (rows.min(), rows.max() + 1) == (top, top + height)
        assert each["area"] == len(rows)
        assert each["category_id"] == 3
    assert first[1]["visibility"] == pytest.approx(0.5, abs=0.12)
    # Pixels of the near car are as far away as its 3D box says.
    depth = np.asarray(Image.open(out / "000000.depth.png"), np.float64) / 100
    mask = unpacked(first[0]["segmentation"])
    assert np.median(depth[mask]) == pytest.approx(first[0]["box_3d"]["object_to_camera"][2][3], abs=0.1)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_pycocotools_reads_labels_that_do_not_depend_on_the_rain(project, tmp_path):
    coco = pytest.importorskip("pycocotools.coco")
    file, texts = tmp_path / "still.coco.json", []
    for rain in ("0", "50"):
        assert render(project, tmp_path / "still.png", "--frame", "0", "--rain", rain, "--labels", "coco") == 0
        texts.append(file.read_bytes())
    assert texts[0] == texts[1]
    labels = coco.COCO(str(file))
    assert labels.imgs[1]["file_name"] == "still.png"
    for annotation in labels.loadAnns(labels.getAnnIds(catIds=labels.getCatIds(["car"]))):
        assert labels.annToMask(annotation).sum() == annotation["area"] > 0


def test_kitti_boxes_reproject_onto_their_objects(project, tmp_path):
    out = tmp_path / "kitti"
    assert render(project, out, "--labels", "kitti") == 0
    lines = [line.split() for line in (out / "label_2" / "000000.txt").read_text().splitlines()]
    calib = dict(line.split(": ") for line in (out / "calib" / "000000.txt").read_text().splitlines())
    projection = np.array(calib["P2"].split(), float).reshape(3, 4)
    numbers = np.asarray(Image.open(out / "instance_2" / "000000.png"))
    assert [line[0] for line in lines] == ["Car", "Car"]
    assert [line[2] for line in lines] == ["0", "1"]  # the far one is partly occluded
    for row, line in enumerate(lines, start=1):
        assert len(line) == 15
        left, top, _, bottom = (float(each) for each in line[4:8])
        height, width, length, x, y, z, turn = (float(each) for each in line[8:])
        assert (length, width, height) == SIZE_LWH
        _, v, w = projection @ [x, y, z, 1]
        assert bottom == pytest.approx(v / w, abs=2.0)  # its feet
        upper = projection @ [x, y - height, z, 1]
        assert top == pytest.approx(upper[1] / upper[2], abs=2.0)
        assert turn == pytest.approx(-np.pi / 2, abs=0.01)  # it drives away
        assert float(line[3]) == pytest.approx(turn - np.arctan2(x, z), abs=0.02)
        rows, columns = np.nonzero(numbers == row)
        assert (columns.min() - 0.5, rows.max() + 0.5) == (left, bottom)
    assert numbers.shape == (96, 144)
    lidar = np.array(calib["Tr_velo_to_cam"].split(), float).reshape(3, 4)
    np.testing.assert_allclose(lidar @ [1, 0, 0, 1], [0, 0, 1])  # ahead of the car is ahead of the camera
