"""Fine-tuning as a whole: it learns, it can be taken up again bit for bit, and what it writes is what was trained."""

import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from appearance.cyclegan_turbo.loaded_weights import load_weights  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model  # noqa: E402
from gsrain_engine.appearance.finetune.checkpoint import FinetuningCheckpointError  # noqa: E402
from gsrain_engine.appearance.finetune.loss_log import read_losses  # noqa: E402
from gsrain_engine.appearance.finetune.run import finetune  # noqa: E402
from gsrain_engine.appearance.finetune.settings import (  # noqa: E402
    FinetuneTask,
    load_finetuning,
)
from gsrain_engine.appearance.finetune.step import FinetuneTrainer  # noqa: E402

from .small_training import run, small, small_settings, small_start  # noqa: E402

pytestmark = pytest.mark.usefixtures("small_networks")


def _bare(file: Path) -> dict[str, str]:
    """Rows of a file of losses by their numbers."""
    return {line.split(",")[0]: line for line in file.read_text().splitlines()}


def test_a_training_taken_up_again_ends_in_the_same_bytes(tmp_path: Path) -> None:
    whole, half = tmp_path / "whole", tmp_path / "half"
    settings = small_settings(tmp_path, steps=4)
    run(FinetuneTask(settings=settings, output=whole))

    run(FinetuneTask(settings=small_settings(tmp_path, steps=2), output=half))
    stopped = (half / "weights.safetensors").read_bytes()
    result, _ = run(FinetuneTask(settings=settings, output=half, resume=True))

    assert result.weights.read_bytes() == (whole / "weights.safetensors").read_bytes() != stopped
    assert _bare(half / "losses.csv") == _bare(whole / "losses.csv")
    assert len(read_losses(half / "losses.csv")) == 4


def test_what_was_trained_is_what_was_written(tmp_path: Path) -> None:
    settings = small_settings(tmp_path, steps=1)
    result, _ = run(FinetuneTask(settings=settings, output=tmp_path / "run"))

    training = small_start(settings)
    training.iterate(0)
    used = build_random_model(small(), normals=True, seed=settings.seed)
    untrained = used.unet.conv_in.weight.detach().clone()
    load_weights(used, result.weights)

    clear, _ = training.order.read(training.order.pictures.source[0])
    guide = torch.linspace(-1, 1, clear[0, 0].numel()).view_as(clear[:, :1])
    expected = training.translated(clear, guide, "a2b")
    with torch.no_grad():
        assert torch.allclose(used.translate(clear, guide, "a2b"), expected, atol=2e-5)
        assert not torch.allclose(used.translate(clear, None, "a2b"), expected, atol=2e-5)  # the guide's columns
    base = training.model.unet.conv_in.base_layer.weight
    assert not torch.equal(base, untrained)  # the base beneath the LoRA, which the original loses


def test_losses_fall_and_the_look_changes(tmp_path: Path) -> None:
    settings = small_settings(tmp_path, steps=12, sampled_every=6, optimizer={"rate": 4e-3})
    result, steps = run(FinetuneTask(settings=settings, output=tmp_path / "run"))

    rows = read_losses(tmp_path / "run" / "losses.csv")
    first, last = rows[:4], rows[-4:]  # each is one turn: all pictures once
    for kind in ("cycle", "identity"):
        before, after = (
            np.mean([row[f"{kind}_{look}"] for row in turn for look in ("clear", "rainy")]) for turn in (first, last)
        )
        assert after < 0.95 * before, kind
    grids = sorted((tmp_path / "run" / "samples").iterdir())
    assert [file.name for file in grids] == ["step_000006.png", "step_000012.png"]
    assert result.grid == grids[-1]
    assert any((tmp_path / "run" / "tensorboard").iterdir())
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions) and fractions[-1] == 1
    assert any(step.preview is not None for step in steps)
    assert load_finetuning(tmp_path / "run" / "config.yaml") == settings


def test_gradient_checkpointing_changes_no_number(tmp_path: Path) -> None:
    plain = small_start(small_settings(tmp_path)).iterate(0).losses
    lean = small_start(small_settings(tmp_path, gradient_checkpointing=True)).iterate(0).losses
    assert plain == lean


def test_a_training_can_start_from_weights(tmp_path: Path) -> None:
    first, _ = run(FinetuneTask(settings=small_settings(tmp_path, steps=1), output=tmp_path / "first"))
    trained = small_start(small_settings(tmp_path, start=str(first.weights)))
    fresh = small_start(small_settings(tmp_path, steps=1))
    clear, guide = fresh.order.read(fresh.order.pictures.source[0])
    before = fresh.translated(clear, guide, "a2b")
    fresh.iterate(0)
    after = fresh.translated(clear, guide, "a2b")
    assert torch.allclose(trained.translated(clear, guide, "a2b"), after, atol=1e-6)
    assert not torch.allclose(after, before, atol=1e-3)


def test_without_guides_the_encoder_keeps_three_channels(tmp_path: Path) -> None:
    pictures = {look: [{"path": str(tmp_path / look)}] for look in ("clear", "rainy")}
    small_settings(tmp_path)
    settings = small_settings(tmp_path, pictures=pictures | {"guide": "none", "width_px": 16, "height_px": 16})
    training = small_start(settings)
    assert not training.model.takes_guides
    assert training.iterate(0).losses["cycle_clear"] > 0


def test_a_stopped_training_leaves_its_checkpoint(tmp_path: Path) -> None:
    task = FinetuneTask(settings=small_settings(tmp_path, steps=50, saved_every=1), output=tmp_path / "run")
    work = finetune(task)
    next(step for step in work if "Saved" in step.message)
    work.close()
    assert task.checkpoint.is_file() and task.weights.is_file()
    assert len(read_losses(task.losses)) == 1

    with pytest.raises(ValueError, match="holds a training already"):
        run(task)
    with pytest.raises(FinetuningCheckpointError, match="lora"):
        settings = small_settings(tmp_path, steps=50, lora={"unet": 5, "vae": 4})
        run(FinetuneTask(settings=settings, output=task.output, resume=True))
    shutil.copy(tmp_path / "clear" / "0.png", tmp_path / "clear" / "another.png")
    with pytest.raises(FinetuningCheckpointError, match="other pictures"):
        run(FinetuneTask(settings=task.settings, output=task.output, resume=True))
    with pytest.raises(FinetuningCheckpointError, match="no checkpoint"):
        run(FinetuneTask(settings=task.settings, output=tmp_path / "elsewhere", resume=True))


def test_too_little_memory_is_told_with_what_helps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def iterate(training: FinetuneTrainer, number: int) -> None:
        raise RuntimeError("CUDA out of memory. Tried to allocate 2 GiB")

    monkeypatch.setattr(FinetuneTrainer, "iterate", iterate)
    with pytest.raises(MemoryError, match="gradient_checkpointing: true"):
        run(FinetuneTask(settings=small_settings(tmp_path, steps=1), output=tmp_path / "run"))


def test_what_is_missing_is_said_before_anything_is_trained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GSRAIN_SD_TURBO", str(tmp_path / "nowhere"))
    settings = small_settings(tmp_path, architecture="sd-turbo")
    with pytest.raises(FileNotFoundError, match="SD-Turbo"):
        run(FinetuneTask(settings=settings, output=tmp_path / "run"))
