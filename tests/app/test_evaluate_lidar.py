"""`gsrain evaluate lidar` on real sweeps, on a small scene, and on bad input."""

import csv
import json

import numpy as np
import pytest

from app.main import run
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


def lidar(*arguments):
    return run(["evaluate", "lidar", *map(str, arguments)])


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "scene"
    write_scene(small_scene(), folder)
    return folder


SENSOR = """
name: four rings
elevations_deg: [-20, -8, 0, 8]
azimuth_step_deg: 1
range_m: 40
least_reflectance: 0.0001
"""


def test_a_scene_is_scanned_and_rained_on(scene, tmp_path, capsys):
    sensor, out = tmp_path / "sensor.yaml", tmp_path / "out"
    sensor.write_text(SENSOR)
    options = ("--sensor", sensor, "--rain", "0,50", "--seeds", 2, "--sweeps", 1, "--json", tmp_path / "n.json")
    assert lidar(scene, "-o", out, *options) == 0
    report = json.loads((tmp_path / "n.json").read_text())
    assert report["sensor"]["name"] == "four rings"
    rows = report["rows"]
    assert len(rows) == 2 * 2
    dry, heavy = ([row for row in rows if row["intensity_mm_h"] == rain] for rain in (0, 50))
    assert all(row["kept"] == row["clear"] > 100 and row["false"] == row["dropped"] == 0 for row in dry)
    assert sum(row["dropped"] for row in heavy) > 0 and sum(row["false"] for row in heavy) > 0
    assert all(row["clear"] == row["kept"] + row["dropped"] + row["masked"] for row in rows)
    with (out / "lidar.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert sum(int(line["false"]) for line in lines) == sum(row["false"] for row in rows)
    for row in heavy:
        sweep = np.load(out / "sweeps" / f"{row['turn']}_rain50_seed{row['seed']}.npz")
        assert len(sweep["points_m"]) == row["kept"] + row["false"]
        assert sweep["is_false"].sum() == row["false"]
    assert (out / "lidar.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "report.html").read_text()
    kept = 100 * sum(row["kept"] for row in heavy) / sum(row["clear"] for row in heavy)
    assert "four rings" in page and f">{kept:.2f}<" in page
    assert "kept" in capsys.readouterr().out
    assert json.loads((out / "lidar.json").read_text()) == report
    assert report["seeds"] == [0, 1]
    assert report["versions"]["gsrain"]
    assert set(report["inputs"]) == {str(scene), str(sensor)}
    assert all(each in page for each in (report["command"], *report["inputs"].values()))


def test_a_real_sweep_is_rained_on(test_data, tmp_path, capsys):
    capture = test_data / "weather/rainsense/clear/scene_0/case_000"
    options = ("--rain", "0,9.245", "--seeds", "1", "--no-write-sweeps", "--json", "-")
    assert lidar(capture, "-o", tmp_path, *options) == 0
    dry, wet = json.loads(capsys.readouterr().out)["rows"]
    assert dry["clear"] == wet["clear"] == 16_562
    assert dry["untouched"] == 1138  # the data set writes beams without an echo as points at the origin
    assert 200 < dry["range_10_m"] < 350
    assert 0.9 < wet["kept"] / wet["clear"] < 0.999
    assert not (tmp_path / "sweeps").exists()
