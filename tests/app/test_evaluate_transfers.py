"""`gsrain evaluate transfers`, as a user runs it: on a tiny street and tiny models."""

import csv
import json
import shutil

import pytest
import yaml
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.appearance.cyclegan_turbo import weight_paths
from gsrain_engine.appearance.output_folder import read_transferred
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.evaluation.fid import PLACE as CACHE
from gsrain_engine.scene.formats.scene_files import write_scene
from tests.training.drive_capture import drive_capture
from tests.training.small_street import small_street

from .picture_sets import write_pictures


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("transfers")
    write_scene(small_street(), folder / "scene")
    write_pictures(folder / "real", 6, 0, darker=0.6)
    list(write_views(folder / "drive", drive_capture(4)))
    return folder


@pytest.fixture(autouse=True)
def own_places(tmp_path, monkeypatch, files):
    monkeypatch.setenv(CACHE, str(tmp_path / "cache"))
    monkeypatch.setenv(weight_paths.WEIGHTS_VARIABLE, str(tmp_path / "no weights"))
    monkeypatch.setenv(weight_paths.BASE_VARIABLE, str(tmp_path / "no base"))
    monkeypatch.chdir(files)


def settings(**changes):
    return {
        "source": "scene", "real": ["real"], "views": {"count": 4, "width_px": 64}, "extractor": "pixels16",
        "resamples": 20, "columns": 2,
        "methods": [{"name": "clear", "method": "clear"}, {"name": "wet", "method": "wet"}],
    } | changes  # fmt: skip


def transfers(tmp_path, told, *options):
    file = tmp_path / "comparison.yaml"
    file.write_text(yaml.safe_dump(told))
    return run(["evaluate", "transfers", str(file), "-o", str(tmp_path / "out"), *map(str, options)])


def test_ablations_of_a_tiny_model_become_table_and_figure(tmp_path, capsys):
    pytest.importorskip("diffusers")
    from gsrain_engine.appearance.cyclegan_turbo.lora import LoraRanks
    from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny
    from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights

    weights, out = tmp_path / "tiny.safetensors", tmp_path / "out"
    save_weights(build_random_model(tiny(), True, LoraRanks(2, 2)), weights)
    learned = {"method": "cyclegan-turbo", "weights": str(weights), "side_px": 64}
    ablations = [
        {"name": "ours", **learned},
        {"name": "without normals", **learned, "normals": "none"},
        {"name": "without mutual attention", **learned, "mutual_attention": False},
    ]
    told = settings(methods=[*settings()["methods"], *ablations])
    assert transfers(tmp_path, told) == 0
    shown = capsys.readouterr().out
    rows = json.loads((out / "table.json").read_text())["rows"]
    names = ["clear", "wet", "ours", "without normals", "without mutual attention"]
    assert [row["name"] for row in rows] == names
    assert [(row["real_pictures"], row["fake_pictures"], row["metric"]) for row in rows] == [(6, 4, "FD-pixels16")] * 5
    assert all(name in shown for name in names)
    assert "FID" not in shown  # only Inception's features give it
    assert all(row["frechet_interval"][0] <= row["frechet"] <= row["frechet_interval"][1] for row in rows)
    clear, wet, ours, flat, alone = rows
    assert (clear["ratio"], clear["contrast_ratio"]) == (pytest.approx(1), pytest.approx(1))
    assert clear["pairs"] >= 4
    assert len({row["frechet"] for row in (clear, wet, ours, alone)}) == 4
    assert flat["frechet"] == ours["frechet"]  # an untrained fourth channel changes nothing
    assert all(row["seconds"] > 0 for row in rows)
    assert read_transferred(out / "without normals").record.settings["normals"] == "none"
    assert read_transferred(out / "without mutual attention").record.settings["mutual_attention"] is False
    with (out / "table.csv").open(newline="") as opened:
        told_rows = list(csv.DictReader(opened))
    assert [float(row["FD-pixels16"]) for row in told_rows] == [row["frechet"] for row in rows]
    lines = (out / "table.md").read_text().splitlines()
    assert [line.split("|")[1].strip() for line in lines[2:7]] == names
    best = min(row["frechet"] for row in rows)
    assert ["**" in line for line in lines[2:7]] == [row["frechet"] == best for row in rows]
    with Image.open(out / "figure.png") as figure:
        assert figure.width > 2 * 360
        assert figure.height > 5 * 240
    page = (out / "report.html").read_text()
    assert "without mutual attention" in page
    assert "data:image/jpeg" in page


def test_what_stands_is_kept_and_only_what_changed_runs_again(tmp_path, capsys):
    numbers, out = tmp_path / "n.json", tmp_path / "out"
    assert transfers(tmp_path, settings(), "--json", numbers) == 0
    first = json.loads(numbers.read_text())
    assert first["kept"] == []
    assert set(first["inputs"]) == {"clear views", "real pictures real"}
    page = (out / "report.html").read_text()
    assert all(each in page for each in (first["command"], first["versions"]["gsrain"], *first["inputs"].values()))
    times = {name: (out / name / "transfer.json").stat().st_mtime_ns for name in ("clear", "wet")}
    assert transfers(tmp_path, settings(), "--json", numbers) == 0
    again = json.loads(numbers.read_text())
    assert "Not run again, for their pictures stand: clear, wet." in capsys.readouterr().out
    assert again["kept"] == ["clear", "wet"]
    assert again["rows"] == first["rows"]  # seconds too, of the run that took them
    assert times == {name: (out / name / "transfer.json").stat().st_mtime_ns for name in times}
    methods = [{"name": "clear", "method": "clear"}, {"name": "wet", "method": "wet", "seed": 5}]
    assert transfers(tmp_path, settings(methods=methods), "--json", numbers) == 0
    assert json.loads(numbers.read_text())["kept"] == ["clear"]
    shutil.rmtree(out / "clear")  # as after a kill: a folder stands whole or not at all
    assert transfers(tmp_path, settings(methods=methods), "--json", numbers) == 0
    assert json.loads(numbers.read_text())["kept"] == ["wet"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"source": "nowhere"}, "nowhere: no such file or folder"),
        ({"real": []}, "expected folders of real rainy pictures - at `$.real`"),
        ({"source": None}, "either source or pictures"),
        ({"methods": [{"name": "a", "method": "dry"}]}, "no method 'dry', only clear, wet"),
        ({"methods": [{"name": "a", "method": "wet"}, {"name": "A", "method": "wet"}]}, "'A' is there twice"),
        ({"methods": [{"name": "../a", "method": "wet"}]}, "$.methods[0].name"),
        ({"methods": [{"name": "a", "method": "images", "images": "no"}]}, "method 'a': images no: no such file"),
        ({"methods": [{"name": "a", "method": "wet"}, {"name": "b", "method": "cyclegan-turbo"}]},
         "method 'b': no transfer weights at"),
    ],
)  # fmt: skip
def test_bad_input_ends_in_one_line_before_anything_starts(tmp_path, capsys, changes, expected):
    pytest.importorskip("torch")
    told = {key: value for key, value in (settings() | changes).items() if value is not None}
    assert transfers(tmp_path, told) == BAD_INPUT
    said = capsys.readouterr().err
    assert expected in said
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
