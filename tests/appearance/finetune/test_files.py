"""Files of a fine-tuning: settings, checkpoints, losses; and the order of pictures that needs no file."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gsrain_engine.appearance.finetune.loss_log import LossLog, read_losses
from gsrain_engine.appearance.finetune.settings import (
    FinetuningSettings,
    finetuning_names,
    load_finetuning,
)


def test_shipped_settings_are_whole() -> None:
    assert finetuning_names() == ["paper", "tiny"]
    paper = load_finetuning("paper")
    assert (paper.steps, paper.pictures.width_px, paper.pictures.height_px, paper.pictures.test_share) == (
        20_000, 512, 512, 0.2,
    )  # fmt: skip
    assert (paper.losses.cycle, paper.losses.identity, paper.losses.gan) == (1.0, 1.0, 0.5)
    assert paper.precision == "float32"
    for name in ("losses", "optimizer", "lora", "steps"):
        assert getattr(paper, name) == {f.name: f.default for f in msgspec.structs.fields(FinetuningSettings)}[name]


def test_settings_come_back_from_their_file(tmp_path: Path) -> None:
    settings = load_finetuning("tiny", steps=7, clear=[{"path": "a"}, {"path": "b", "count": 3}])
    (tmp_path / "own.yaml").write_bytes(msgspec.yaml.encode(settings))
    assert load_finetuning(tmp_path / "own.yaml") == settings
    assert [source.path for source in settings.pictures.clear] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("pictures: {clear: [{path: a}], rainy: [{path: b}]}\nstep: 4", "unknown field `step`"),
        ("pictures: {clear: [{path: a}], rainy: [{path: b}]}\nsteps: 0", r"`int` >= 1 - at `\$\.steps`"),
        (
            "pictures: {clear: [{path: a}], rainy: [{path: b}]}\nlosses: {gam: 1}",
            r"`gam`; .* `gan`\? valid: .* - at `\$\.losses`",
        ),
        ("steps: 4", r"`clear` - at `\$\.pictures`"),
        ("[1, 2]", "YAML mapping"),
    ],
)
def test_wrong_settings_are_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "own.yaml").write_text(text)
    with pytest.raises(ValueError, match=said) as refused:
        load_finetuning(tmp_path / "own.yaml")
    assert "own.yaml" in str(refused.value)


def test_a_missing_file_is_told_with_what_is_shipped() -> None:
    with pytest.raises(ValueError, match=r"nothing\.yaml: no such file.*paper, tiny"):
        load_finetuning("nothing.yaml")


def test_losses_after_a_checkpoint_are_forgotten(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    with LossLog(tmp_path) as log:
        for step in (1, 2, 3):
            log.add(step, {"cycle_clear": step / 3, "change": 0.5})
    with LossLog(tmp_path, begins_at=2) as log:
        assert [row["step"] for row in log.earlier_rows] == [1, 2]
        log.add(3, {"cycle_clear": 9.0, "change": 0.5})
        log.show(3, np.zeros((8, 8, 3), np.uint8))
    rows = read_losses(tmp_path / "losses.csv")
    assert [row["cycle_clear"] for row in rows] == pytest.approx([1 / 3, 2 / 3, 9.0])


def test_losses_are_read_while_they_are_written(tmp_path: Path) -> None:
    (tmp_path / "losses.csv").write_text("step,change\n1,0.5\n2,0.4\n3")
    assert [row["step"] for row in read_losses(tmp_path / "losses.csv")] == [1, 2]
    assert read_losses(tmp_path / "nothing.csv") == []


def test_pictures_go_round_in_ever_new_orders(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from gsrain_engine.appearance.finetune.dataset import open_images
    from gsrain_engine.appearance.finetune.step import PairSampler, fingerprint

    from .small_training import small_settings

    pictures = open_images(small_settings(tmp_path).pictures).train
    order = PairSampler(pictures, seed=3, guided=True, device="cpu")
    count = len(pictures.source)
    means = [float(order.pair(i).clear.mean()) for i in range(3 * count)]
    turns = [tuple(means[i : i + count]) for i in range(0, len(means), count)]
    assert all(sorted(turn) == sorted(turns[0]) and len(set(turn)) == count for turn in turns)
    assert len(set(turns)) > 1
    again = PairSampler(pictures, seed=3, guided=True, device="cpu")
    assert float(again.pair(count + 1).clear.mean()) == means[count + 1]

    pair = order.pair(0)
    assert pair.clear.shape == (1, 3, 16, 16) and -1 <= float(pair.clear.min()) < float(pair.clear.max()) <= 1
    assert pair.clear_guide is not None and not pair.clear_guide.any()
    assert PairSampler(pictures, 3, guided=False, device="cpu").pair(0).clear_guide is None
    fewer = replace(pictures, source=pictures.source[:-1])
    assert fingerprint(fewer) != fingerprint(pictures)


def test_damaged_checkpoints_are_refused(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from gsrain_engine.appearance.finetune.checkpoint import (
        FinetuneCheckpoint,
        FinetuningCheckpointError,
        read_finetune_checkpoint,
        write_finetune_checkpoint,
    )

    settings = load_finetuning("tiny")
    file = tmp_path / "checkpoint.safetensors"
    write_finetune_checkpoint(
        file, FinetuneCheckpoint(3, 1.5, {"a": torch.arange(4.0)}, False), settings, "two pictures"
    )
    read = read_finetune_checkpoint(file, msgspec.structs.replace(settings, steps=9), "two pictures", False)
    assert (read.step, read.seconds) == (3, 1.5) and torch.equal(read.tensors["a"], torch.arange(4.0))
    with pytest.raises(FinetuningCheckpointError, match="seed 0, now it is 1"):
        read_finetune_checkpoint(file, msgspec.structs.replace(settings, seed=1), "two pictures", False)
    with pytest.raises(FinetuningCheckpointError, match="without LPIPS"):
        read_finetune_checkpoint(file, settings, "two pictures", True)
    whole = file.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", b"\0" * 64, whole.replace(b'"gsrain"', b'"gsrein"')):
        file.write_bytes(damaged)
        with pytest.raises(FinetuningCheckpointError, match="damaged"):
            read_finetune_checkpoint(file, settings, "two pictures", False)
