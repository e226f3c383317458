"""Files that settings name are relative to the folder of the settings; shipped names stay what they are."""

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
def load(tmp_path, monkeypatch):
    """Load settings from a folder with all that they name, below the working folder."""
    folder = tmp_path / "mine"
    for name in ("near.yaml", "mine.py", "nets/a.onnx", "town/scene.json", "rainy/a.png"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    for shipped in ("street", "cut-in", "yolox", "oracle-idm", "published"):
        (folder / shipped).mkdir()
    monkeypatch.chdir(tmp_path)

    def load(read, text):
        (folder / "settings.yaml").write_text(text)
        return read("mine/settings.yaml")

    return load


def test_files_are_found_next_to_the_settings(load):
    sweep = load(load_sweep, DRIVES)
    assert (sweep.scenarios, sweep.scenes) == (("mine/near.yaml", "cut-in"), ("mine/town", "street", "elsewhere"))
    assert sweep.agents[:2] == ("mine/mine.py:Mine", "oracle-idm")
    assert (sweep.agents[2].detector, sweep.agents[2].description) == ("mine/nets/a.onnx", "yolox")
    clips = load(load_sweep, RENDERS)
    assert (clips.scenes, clips.rain.calibration) == (("mine/town",), "mine/near.yaml")
    assert clips.recording.output == "frames"
    assert load(load_preset, "calibration: near.yaml").calibration == "mine/near.yaml"
    assert load(load_preset, "calibration: published").calibration == "published"
    compared = load(load_comparison, COMPARED)
    found = compared.source, str(compared.real[0]), str(compared.methods[1].images)
    assert found == ("mine/town", "mine/rainy", "mine/nets")
    trained = msgspec.to_builtins(load(load_finetuning, TRAINED))
    assert trained["base"] == "mine/nets" and trained["pictures"]["clear"][0]["path"] == "mine/town"
    assert [each["path"] for each in trained["pictures"]["rainy"]] == ["mine/rainy", "elsewhere"]


def test_other_names_are_unchanged(tmp_path):
    (tmp_path / "near.yaml").touch()
    names = ["", "a.yaml", "other.py:Mine", "x" * 300, str(tmp_path / "near.yaml")]
    assert [resolve_from_folder(tmp_path, name) for name in names] == names
