"""`gsrain train-transfer` as a person runs it, on pictures of a few pixels."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run

_CONFIG = """
architecture: tiny
steps: 1
pictures:
  clear: [{path: nothing}]
  rainy: [{path: nothing}]
  width_px: 16
  height_px: 16
lora: {unet: 2, vae: 2}
samples: 1
"""


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(3)
    for look in ("clear", "rainy"):
        Path(look).mkdir()
        for i in range(2):
            Image.fromarray(random.integers(0, 256, (16, 24, 3), np.uint8)).save(f"{look}/{i}.png")
    Path("own.yaml").write_text(_CONFIG)
    return tmp_path


def test_a_training_from_start_to_weights(
    work: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("diffusers")
    from appearance.finetune.small_training import small
    from gsrain_engine.appearance.finetune import run as start

    monkeypatch.setattr(start, "tiny", small)
    command = ["train-transfer", "own.yaml", "-o", "run", "--clear", "clear", "--rainy", "rainy", "--json", "run.json"]
    assert run(command) == 0
    said = capsys.readouterr().out
    assert "run/weights.safetensors: 1 iterations" in said and "cycle, clear" in said
    numbers = json.loads(Path("run.json").read_text())
    assert numbers["steps"] == 1 and set(numbers["losses"]) >= {"cycle_clear", "gan_rainy", "identity_clear", "change"}
    assert [row["count"] for row in numbers["pictures"]] == [2, 2]
    assert Path("run/weights.safetensors").is_file() and Path("run/samples/step_000001.png").is_file()

    assert run(command) == BAD_INPUT
    assert "holds a training already" in capsys.readouterr().err
    assert run([*command, "--resume"]) == BAD_INPUT
    assert "1 iterations are done" in capsys.readouterr().err
