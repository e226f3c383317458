"""`gsrain evaluate lidar` on a small scene."""

import csv
import json

import numpy as np

from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene

SENSOR = """
name: four rings
elevations_deg: [-20, -8, 0, 8]
azimuth_step_deg: 1
range_m: 40
least_reflectance: 0.0001
"""


def test_a_scene_is_scanned_and_rained_on(tmp_path, reported, capsys):
    scene, sensor, out = tmp_path / "scene", tmp_path / "sensor.yaml", tmp_path / "out"
    write_scene(small_scene(), scene)
    sensor.write_text(SENSOR)
    options = ("-o", out, "--sensor", sensor, "--rain", "0,50", "--seeds", 2, "--sweeps", 1)
    report = reported("evaluate", "lidar", scene, *options)
    rows = report["rows"]
    dry, heavy = ([row for row in rows if row["intensity_mm_h"] == rain] for rain in (0, 50))
    assert len(dry) == len(heavy) == 2 and report["sensor"]["name"] == "four rings"
    assert all(row["kept"] == row["clear"] > 100 and row["false"] == row["dropped"] == 0 for row in dry)
    assert sum(row["dropped"] for row in heavy) > 0 and sum(row["false"] for row in heavy) > 0
    assert all(row["clear"] == row["kept"] + row["dropped"] + row["masked"] for row in rows)
    with (out / "lidar.csv").open() as file:
        assert sum(int(line["false"]) for line in csv.DictReader(file)) == sum(row["false"] for row in rows)
    for row in heavy:
        sweep = np.load(out / "sweeps" / f"{row['turn']}_rain50_seed{row['seed']}.npz")
        assert len(sweep["points_m"]) == row["kept"] + row["false"]
        assert sweep["is_false"].sum() == row["false"]
    assert (out / "lidar.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "report.html").read_text()
    share = 100 * sum(row["kept"] for row in heavy) / sum(row["clear"] for row in heavy)
    assert "four rings" in page and f">{share:.2f}%<" in page
    assert "kept" in capsys.readouterr().out
    assert json.loads((out / "lidar.json").read_text()) == report
    assert report["seeds"] == [0, 1] and report["versions"]["gsrain"]
    assert set(report["inputs"]) == {str(scene), str(sensor)}
    assert all(each in page for each in (report["command"], *report["inputs"].values()))
