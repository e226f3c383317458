"""Commands that count the Gaussians of scenes in which some are deleted or hidden."""

import json
from dataclasses import replace

import numpy as np
import pytest

from app.main import run
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from small_scene import small_scene


@pytest.fixture
def marked(tmp_path):
    """944 Gaussians: of the road's 400, 100 are deleted, and 50 of those and 30 others hidden."""
    scene = small_scene()
    numbers = np.arange(400)
    marks = SelectionFlags(deleted=BitMask.of(numbers < 100), hidden=BitMask.of((numbers >= 50) & (numbers < 130)))
    write_scene(replace(scene, layers=(replace(scene.layers[0], marks=marks), *scene.layers[1:])), tmp_path / "marked")
    return tmp_path / "marked"


def test_info_says_what_is_marked(marked, tmp_path, capsys):
    assert run(["info", str(marked), "--json", str(tmp_path / "info.json")]) == 0
    numbers = json.loads((tmp_path / "info.json").read_text())
    assert (numbers["gaussians"], numbers["deleted"], numbers["hidden"]) == (844, 100, 30)
    assert (numbers["members"][0]["gaussians"], numbers["members"][1]["deleted"]) == (300, 0)
    assert "small: 844 Gaussians (100 deleted, 30 hidden)" in capsys.readouterr().out


def test_a_single_file_gets_what_can_be_seen(marked, tmp_path, capsys):
    assert run(["convert", str(marked), str(tmp_path / "seen.ply")]) == 0
    assert "814 Gaussians; 130 deleted or hidden ones are left out" in capsys.readouterr().out
    assert len(read_scene(tmp_path / "seen.ply").layers[0].gaussians) == 814


def test_a_scene_folder_gets_everything_with_its_marks(marked, tmp_path, capsys):
    assert run(["convert", str(marked), str(tmp_path / "copy")]) == 0
    assert "844 Gaussians (100 deleted, 30 hidden)" in capsys.readouterr().out
    assert read_scene(tmp_path / "copy").layers[0].marks.deleted.size == 100
