"""`gsrain evaluate transfers` on a tiny street and tiny models."""

import csv
import json
import re

import pytest
import yaml
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.appearance.cyclegan_turbo import weight_paths
from gsrain_engine.appearance.output_folder import read_transferred
from gsrain_engine.evaluation.fid import PLACE as CACHE
from gsrain_engine.scene.formats.scene_files import write_scene
from tests.training.small_street import small_street

from .picture_sets import write_pictures

METHODS = [{"name": "clear", "method": "clear"}, {"name": "wet", "method": "wet"}]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("transfers")
    write_scene(small_street(), folder / "scene")
    write_pictures(folder / "real", 6, 0, darker=0.6)
    return folder


@pytest.fixture(autouse=True)
def own_places(tmp_path, monkeypatch, files):
    monkeypatch.setenv(CACHE, str(tmp_path / "cache"))
    monkeypatch.setenv(weight_paths.WEIGHTS_VARIABLE, str(tmp_path / "no weights"))
    monkeypatch.setenv(weight_paths.BASE_VARIABLE, str(tmp_path / "no base"))
    monkeypatch.chdir(files)


def transfers(tmp_path, *options, **changes):
    values = {"source": "scene", "real": ["real"], "views": {"count": 4, "width_px": 64}, "extractor": "pixels16",
              "resamples": 20, "columns": 2, "methods": METHODS} | changes  # fmt: skip
    file = tmp_path / "comparison.yaml"
    file.write_text(yaml.safe_dump({key: value for key, value in values.items() if value is not None}))
    return run(["evaluate", "transfers", str(file), "-o", str(tmp_path / "out"), *map(str, options)])


def test_all_missing_inputs_are_named_before_any_work(tmp_path, capsys, monkeypatch):
    """Weights, folders and data in one error, each with the methods that need it; nothing is written."""
    pytest.importorskip("torch")
    for place in ("GSRAIN_DSINE", "GSRAIN_DSINE_WEIGHTS", "GSRAIN_INCEPTION_WEIGHTS"):
        monkeypatch.setenv(place, str(tmp_path / place))
    pictures = {"clear": [{"path": "no clear"}], "rainy": [{"path": "real"}, {"path": "no rainy"}]}
    methods = [
        *METHODS, {"name": "a", "method": "cyclegan-turbo", "weights": "no.pkl", "normals": "dsine"},
        {"name": "b", "method": "cyclegan-turbo"}, {"name": "c", "method": "images"},
        {"name": "d", "method": "images", "images": "no images"},
    ]  # fmt: skip
    changes = {"source": None, "real": None, "pictures": pictures, "methods": methods, "extractor": "inception"}
    assert transfers(tmp_path, **changes) == BAD_INPUT
    first, *lines = capsys.readouterr().err.strip().splitlines()
    assert first == "gsrain: 10 inputs are missing or do not fit:" and len(lines) == 10
    beginnings = [
        "method 'a': weights no.pkl: no such file or folder", "method 'a': no weights of DSINE",
        "method 'a': no program of DSINE", "methods 'a', 'b': no SD-Turbo", "method 'b': no transfer weights",
        "method 'c': method images needs images", "method 'd': images no images", "pictures.clear no clear",
        "pictures.rainy no rainy", "no weights of Inception",
    ]  # fmt: skip
    assert all(any(line.startswith(f"  {each}") for line in lines) for each in beginnings)
    words = "".join(lines)
    for field in (
        "normals_weights: FILE or",
        "normals_checkout: DIR or",
        "extractor: pixels16,",
        "by the field weights or",
    ):
        assert f" {field} " in words
    assert set(re.findall(r"--[a-z-]+", words)) == {"--include", "--local-dir"}  # those of hf, no options of ours
    assert not (tmp_path / "out").exists()


def test_normals_of_the_training_need_their_estimator(tmp_path, capsys, monkeypatch):
    """A row that names no normals takes those of its weights' record."""
    pytest.importorskip("diffusers")
    from gsrain_engine.appearance.base import TrainingRecord
    from gsrain_engine.appearance.cyclegan_turbo.lora import LoraRanks
    from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny
    from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights

    monkeypatch.setenv("GSRAIN_DSINE", str(tmp_path / "no program"))
    record = TrainingRecord(conditioning="up", normals="dsine", framing="stretch", width_px=64, height_px=64)
    save_weights(build_random_model(tiny(), True, LoraRanks(2, 2)), tmp_path / "tiny.safetensors", record)
    (tmp_path / "dsine.pt").touch()
    row = {"name": "ours", "method": "cyclegan-turbo", "weights": "tiny.safetensors", "normals_weights": "dsine.pt"}
    assert transfers(tmp_path, methods=[row]) == BAD_INPUT
    (error,) = capsys.readouterr().err.strip().splitlines()
    assert error.startswith("gsrain: method 'ours': no program of DSINE") and "no program" in error
    assert transfers(tmp_path, methods=[row | {"normals": "depth"}]) == BAD_INPUT
    assert "trained with normals dsine, not depth; --override" in capsys.readouterr().err


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
    assert transfers(tmp_path, methods=[*METHODS, *ablations]) == 0
    printed = capsys.readouterr().out
    rows = json.loads((out / "table.json").read_text())["rows"]
    names = ["clear", "wet", "ours", "without normals", "without mutual attention"]
    assert [row["name"] for row in rows] == names and all(name in printed for name in names)
    assert [(row["real_pictures"], row["fake_pictures"], row["metric"]) for row in rows] == [(6, 4, "FD-pixels16")] * 5
    assert "FID" not in printed  # only Inception's features give it
    assert f"since their water film is unknown: {', '.join(names[2:])};" in printed
    assert all(row["frechet_interval"][0] <= row["frechet"] <= row["frechet_interval"][1] for row in rows)
    assert all(row["seconds"] > 0 for row in rows)
    clear, wet, ours, flat, alone = rows
    assert (clear["ratio"], clear["contrast_ratio"]) == (pytest.approx(1), pytest.approx(1)) and clear["pairs"] >= 4
    assert len({row["frechet"] for row in (clear, wet, ours, alone)}) == 4
    assert flat["frechet"] == ours["frechet"]  # an untrained fourth channel changes nothing
    assert read_transferred(out / "without normals").record.settings["normals"] == "none"
    assert read_transferred(out / "without mutual attention").record.settings["mutual_attention"] is False
    with (out / "table.csv").open(newline="") as opened:
        assert [float(row["FD-pixels16"]) for row in csv.DictReader(opened)] == [row["frechet"] for row in rows]
    lines = (out / "table.md").read_text().splitlines()[2:7]
    assert [line.split("|")[1].strip() for line in lines] == names
    with Image.open(out / "figure.png") as figure:
        assert figure.width > 2 * 360 and figure.height > 5 * 240
    page = (out / "report.html").read_text()
    assert "without mutual attention" in page and "data:image/jpeg" in page


def test_only_changed_methods_run_again(tmp_path, capsys):
    numbers = tmp_path / "n.json"

    def compared(**changes):
        assert transfers(tmp_path, "--json", numbers, **changes) == 0
        return json.loads(numbers.read_text())

    first = compared()
    assert first["kept"] == [] and set(first["inputs"]) == {"clear views", "real pictures real"}
    page = (tmp_path / "out" / "report.html").read_text()
    assert all(each in page for each in (first["command"], first["versions"]["gsrain"], *first["inputs"].values()))
    again = compared()
    assert "clear, wet." in capsys.readouterr().out and again["kept"] == ["clear", "wet"]
    assert again["rows"] == first["rows"]  # with the seconds of the run that took them
    assert transfers(tmp_path, "--only", "wet,clear") == 0
    table = (tmp_path / "out" / "table.md").read_text()
    assert 0 < table.index("| wet |") < table.index("| clear |")  # in the order of the names
    assert compared(methods=[METHODS[0], METHODS[1] | {"seed": 5}])["kept"] == ["clear"]


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"source": "nowhere"}, "nowhere"),
        ({"real": []}, "$.real"),
        ({"methods": [{"name": "a", "method": "wet"}, {"name": "A", "method": "wet"}]}, "'A'"),
        ({"methods": [{"name": "../a", "method": "wet"}]}, "$.methods[0].name"),
        ({"methods": [{"name": "a", "method": "wet"}, {"name": "b", "method": "images"}]}, "method 'b'"),
    ],
)
def test_bad_input_is_refused_before_anything_starts(tmp_path, capsys, changes, place):
    pytest.importorskip("torch")
    assert transfers(tmp_path, **changes) == BAD_INPUT
    (error,) = capsys.readouterr().err.strip().splitlines()
    assert place in error and not (tmp_path / "out").exists()
