"""Fine-tuning as a whole: it learns, it resumes bit for bit, and what it writes is what was trained."""

import re
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from appearance.cyclegan_turbo.published_checkpoints import load_weights  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model  # noqa: E402
from gsrain_engine.appearance.finetune.loss_log import (  # noqa: E402
    CHANCE,
    CollapseMonitor,
    LossLog,
    color_distance,
    read_losses,
)
from gsrain_engine.appearance.finetune.run import finetune  # noqa: E402
from gsrain_engine.appearance.finetune.settings import (  # noqa: E402
    FinetuneResult,
    FinetuneTask,
    load_finetuning,
)
from gsrain_engine.appearance.finetune.step import FinetuneTrainer  # noqa: E402
from gsrain_engine.scene.progress import run_to_end  # noqa: E402
from gsrain_engine.training_run import CheckpointError  # noqa: E402

from .small_training import small, small_settings, small_start  # noqa: E402

pytestmark = pytest.mark.usefixtures("small_networks")


def run(task: FinetuneTask) -> FinetuneResult:
    return run_to_end(finetune(task))


def test_a_training_resumed_after_a_kill_ends_in_the_same_bytes(tmp_path: Path) -> None:
    whole = FinetuneTask(settings=small_settings(tmp_path, steps=4), output=tmp_path / "whole")
    half = FinetuneTask(settings=small_settings(tmp_path, steps=4, saved_every=2), output=tmp_path / "half")
    run(whole)
    work = finetune(half)
    next(step for step in work if step.message.startswith("3 of 4"))  # one more than the checkpoint has
    work.close()
    stopped = half.weights.read_bytes()
    run(msgspec.structs.replace(half, resume=True))
    assert half.weights.read_bytes() == whole.weights.read_bytes() != stopped
    assert half.losses.read_text() == whole.losses.read_text() and len(read_losses(half.losses)) == 4


def test_what_was_trained_is_what_was_written(tmp_path: Path) -> None:
    settings = small_settings(tmp_path, steps=1)
    result = run(FinetuneTask(settings=settings, output=tmp_path / "run"))

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
    task, steps = FinetuneTask(settings=settings, output=tmp_path / "run"), []
    result = run_to_end(finetune(task), steps.append)

    rows = read_losses(task.losses)
    assert [step.metrics for step in steps if step.metrics][5] == pytest.approx(rows[5])
    first, last = rows[:4], rows[-4:]  # each is one turn: all pictures once
    for kind in ("cycle", "identity"):
        before, after = (
            np.mean([row[f"{kind}_{look}"] for row in turn for look in ("clear", "rainy")]) for turn in (first, last)
        )
        assert after < 0.95 * before, kind
    grids = sorted(task.samples.iterdir())
    assert [file.name for file in grids] == ["step_000006.png", "step_000012.png"] and result.grid == grids[-1]
    assert any((tmp_path / "run" / "tensorboard").iterdir())
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions) and fractions[-1] == 1
    assert any(step.preview is not None for step in steps)
    assert load_finetuning(task.config) == settings


def test_a_training_can_start_from_weights_and_without_guides(tmp_path: Path) -> None:
    first = run(FinetuneTask(settings=small_settings(tmp_path, steps=1), output=tmp_path / "first"))
    trained = small_start(small_settings(tmp_path, start=str(first.weights)))
    fresh = small_start(small_settings(tmp_path, steps=1))
    clear, guide = fresh.order.read(fresh.order.pictures.source[0])
    before = fresh.translated(clear, guide, "a2b")
    fresh.iterate(0)
    after = fresh.translated(clear, guide, "a2b")
    assert torch.allclose(trained.translated(clear, guide, "a2b"), after, atol=1e-6)
    assert not torch.allclose(after, before, atol=1e-3)
    settings = small_settings(tmp_path)
    narrow = small_start(
        msgspec.structs.replace(settings, pictures=msgspec.structs.replace(settings.pictures, guide="none"))
    )
    assert not narrow.model.takes_guides and narrow.iterate(0).losses["cycle_clear"] > 0


def test_other_trainings_and_damaged_checkpoints_are_refused(tmp_path: Path) -> None:
    task = FinetuneTask(settings=small_settings(tmp_path, steps=1), output=tmp_path / "run")
    run(task)
    with pytest.raises(ValueError, match="holds a training already"):
        run(task)
    more = msgspec.structs.replace(task, settings=msgspec.structs.replace(task.settings, steps=2), resume=True)
    for change in ({"lora": {"unet": 5, "vae": 4}}, {"seed": 1}):
        settings = small_settings(tmp_path, steps=2, **change)
        with pytest.raises(CheckpointError, match=next(iter(change))):
            run(msgspec.structs.replace(more, settings=settings))
    with pytest.raises(CheckpointError, match="perceptual"):
        run_to_end(finetune(more, lambda a, b: (a - b).square().mean()))
    with pytest.raises(CheckpointError, match="no checkpoint"):
        run(msgspec.structs.replace(more, output=tmp_path / "elsewhere"))
    whole = task.checkpoint.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", b"\0" * 64, whole.replace(b'"gsrain"', b'"gsrein"')):
        task.checkpoint.write_bytes(damaged)
        with pytest.raises(CheckpointError, match="damaged"):
            run(more)
    task.checkpoint.write_bytes(whole)
    shutil.copy(tmp_path / "clear" / "0.png", tmp_path / "clear" / "another.png")
    with pytest.raises(CheckpointError, match="pictures"):
        run(more)


def test_missing_memory_and_missing_weights_are_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def iterate(training: FinetuneTrainer, number: int) -> None:
        raise RuntimeError("CUDA out of memory. Tried to allocate 2 GiB")

    monkeypatch.setenv("GSRAIN_SD_TURBO", str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match="SD-Turbo"):
        run(FinetuneTask(settings=small_settings(tmp_path, architecture="sd-turbo"), output=tmp_path / "run"))
    monkeypatch.setattr(FinetuneTrainer, "iterate", iterate)
    with pytest.raises(MemoryError, match="gradient_checkpointing: true"):
        run(FinetuneTask(settings=small_settings(tmp_path, steps=1), output=tmp_path / "run"))


# Settings


# Losses and early warning


def test_losses_after_a_checkpoint_are_forgotten_and_readable_while_written(tmp_path: Path) -> None:
    with LossLog(tmp_path) as log:
        for step in (1, 2, 3):
            log.add(step, {"cycle_clear": step / 3, "change": 0.5})
    with LossLog(tmp_path, begins_at=2) as log:
        assert [row["step"] for row in log.earlier_rows] == [1, 2]
        log.add(3, {"cycle_clear": 9.0, "change": 0.5})
        log.show(3, np.zeros((8, 8, 3), np.uint8))
        rows = read_losses(tmp_path / "losses.csv")
    assert [row["cycle_clear"] for row in rows] == pytest.approx([1 / 3, 2 / 3, 9.0])
    (tmp_path / "losses.csv").write_text("step,change\n1,0.5\n2,0.4\n3")
    assert [row["step"] for row in read_losses(tmp_path / "losses.csv")] == [1, 2]
    assert read_losses(tmp_path / "nothing.csv") == []


_GAN = 0.5


def _losses(change: float, judged: float = 1.0) -> dict[str, float]:
    """Losses of an iteration; `judged` is the discriminators' loss as a share of chance."""
    return {"change": change} | {
        f"judge_{look}_{kind}": 0.5 * _GAN * CHANCE * judged for look in ("rainy", "clear") for kind in ("made", "real")
    }


@pytest.mark.parametrize(
    ("change", "judged", "step", "warning"),
    [
        (0.01, 1.0, 500, "only reconstructs.*1.0%.*5%.*losses.gan"),
        (0.01, 0.02, 500, "only reconstructs.*discriminators"),
        (0.15, 0.05, 500, "discriminator's.*5%"),
        (0.01, 1.0, 499, None),  # too early
        (0.15, 1.0, 500, None),
    ],
)
def test_a_collapsed_training_is_warned_of(change: float, judged: float, step: int, warning: str | None) -> None:
    monitor = CollapseMonitor(0.2, _GAN, warned_after=500)
    assert monitor.verdict(step).warning is None  # nothing yet
    for _ in range(10):
        monitor.add(_losses(change, judged))
    found = monitor.verdict(step).warning
    assert found is None if warning is None else found is not None and re.search(warning, found)


def test_the_distance_is_what_any_translation_must_change() -> None:
    """Of a shift it is the shift, whatever the pictures show; no change of pictures into the others is smaller."""
    random = np.random.default_rng(1)
    clear = [random.uniform(0.3, 0.9, (8, 9, 3)).astype(np.float32) for _ in range(20)]
    shifted = [(each - np.float32(0.2)) for each in clear]
    assert color_distance(clear, shifted[::-1]) == pytest.approx(0.2, abs=2e-3)
    assert color_distance(clear, clear) == 0
    other = [random.uniform(0, 1, (8, 9, 3)).astype(np.float32) ** 2 for _ in range(20)]
    change = float(np.mean([np.abs(a - b).mean() for a, b in zip(clear, other, strict=True)]))
    assert 0.05 < color_distance(clear, other) < change
