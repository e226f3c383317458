"""Files that a person's settings name count from the folder of these settings; shipped names stay what they are."""

import msgspec
import pytest

from gsrain_engine.appearance.finetune.settings import load_finetuning
from gsrain_engine.evaluation.compare_results import load_comparison
from gsrain_engine.presets import resolve_from_folder
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.sweep.settings import load_sweep

DRIVES = """
kind: drive
scenarios: [near.yaml, cut-in]
scenes: [town, street, elsewhere]
agents: [mine.py:Mine, oracle-idm, {name: camera-idm, detector: nets/a.onnx, description: yolox}]
"""
RENDERS = "{kind: render, scenes: [town], recording: {output: frames}, rain: {calibration: near.yaml}}"
COMPARED = "{source: town, real: [rainy], methods: [{name: wet, method: wet}, {name: i, method: images, images: nets}]}"
TRAINED = "{base: nets, pictures: {clear: [{path: town}], rainy: [{path: rainy}, {path: elsewhere}]}}"


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """A folder with settings and all that they name, below the working one."""
    for name in ("near.yaml", "mine.py", "nets/a.onnx", "town/scene.json", "rainy/a.png"):
        (tmp_path / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mine" / name).touch()
    for taken in ("street", "cut-in", "yolox", "oracle-idm", "published"):
        (tmp_path / "mine" / taken).mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path / "mine"


def _written(folder, text):
    (folder / "settings.yaml").write_text(text)
    return "mine/settings.yaml"


def test_a_sweep_finds_what_lies_beside_it(beside):
    sweep = load_sweep(_written(beside, DRIVES))
    assert sweep.scenarios == ("mine/near.yaml", "cut-in")
    assert sweep.scenes == ("mine/town", "street", "elsewhere")
    assert sweep.agents[:2] == ("mine/mine.py:Mine", "oracle-idm")
    assert (sweep.agents[2].detector, sweep.agents[2].description) == ("mine/nets/a.onnx", "yolox")
    clips = load_sweep(_written(beside, RENDERS))
    assert (clips.scenes, clips.rain.calibration) == (("mine/town",), "mine/near.yaml")
    assert clips.recording.output == "frames"


def test_a_preset_a_comparison_and_a_training_find_what_lies_beside_them(beside):
    assert load_preset(_written(beside, "calibration: near.yaml")).calibration == "mine/near.yaml"
    assert load_preset(_written(beside, "calibration: published")).calibration == "published"
    compared = load_comparison(_written(beside, COMPARED))
    assert (compared.source, str(compared.real[0]), str(compared.methods[1].images)) == (
        "mine/town", "mine/rainy", "mine/nets")  # fmt: skip
    trained = msgspec.to_builtins(load_finetuning(_written(beside, TRAINED)))
    assert trained["base"] == "mine/nets" and trained["pictures"]["clear"][0]["path"] == "mine/town"
    assert [each["path"] for each in trained["pictures"]["rainy"]] == ["mine/rainy", "elsewhere"]


def test_what_does_not_stand_there_stays_what_it_is(beside):
    assert [resolve_from_folder(beside, name) for name in ("", "a.yaml", "other.py:Mine", "x" * 300)] == [
        "", "a.yaml", "other.py:Mine", "x" * 300]  # fmt: skip
    assert resolve_from_folder(beside, str(beside / "near.yaml")) == str(beside / "near.yaml")
