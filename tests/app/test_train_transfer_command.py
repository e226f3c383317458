"""`gsrain train-transfer` on pictures of a few pixels."""

from pathlib import Path

import pytest

from app.main import BAD_INPUT, run

from .picture_sets import write_pictures

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


def test_a_training_from_start_to_weights(tmp_path, reported, capsys, monkeypatch):
    pytest.importorskip("diffusers")
    from appearance.finetune.small_training import small
    from gsrain_engine.appearance.finetune import run as start

    monkeypatch.setattr(start, "tiny", small)
    monkeypatch.chdir(tmp_path)
    for seed, look in enumerate(("clear", "rainy")):
        write_pictures(Path(look), 2, seed)
    Path("own.yaml").write_text(_CONFIG)
    command = ["train-transfer", "own.yaml", "-o", "run", "--clear", "clear", "--rainy", "rainy"]
    numbers = reported(*command)
    printed = capsys.readouterr().out
    assert "run/weights.safetensors: 1 iterations" in printed and "cycle, clear" in printed
    assert numbers["steps"] == 1 and set(numbers["losses"]) >= {"cycle_clear", "gan_rainy", "identity_clear", "change"}
    assert [row["count"] for row in numbers["pictures"]] == [2, 2]
    assert Path("run/weights.safetensors").is_file() and Path("run/samples/step_000001.png").is_file()
    for options, words in (((), "holds a training already"), (("--resume",), "1 iterations are done")):
        assert run([*command, *options]) == BAD_INPUT
        assert words in capsys.readouterr().err
