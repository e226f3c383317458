"""Fine-tuning as a whole: it learns, on the CPU it resumes bit for bit, and what it writes is what was trained."""

import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from appearance.cyclegan_turbo.published_checkpoints import load_weights  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model  # noqa: E402
from gsrain_engine.appearance.cyclegan_turbo.weight_paths import read_record  # noqa: E402
from gsrain_engine.appearance.finetune import run as training_run  # noqa: E402
from gsrain_engine.appearance.finetune.dataset import identity_of, open_images  # noqa: E402
from gsrain_engine.appearance.finetune.loss_log import (  # noqa: E402
    CHANCE,
    CollapseMonitor,
    LossLog,
    color_distance,
    read_losses,
)
from gsrain_engine.appearance.finetune.run import finetune  # noqa: E402
from gsrain_engine.appearance.finetune.settings import FinetuneResult, FinetuneTask, load_finetuning  # noqa: E402
from gsrain_engine.appearance.finetune.step import FinetuneTrainer  # noqa: E402
from gsrain_engine.scene.progress import run_to_end  # noqa: E402
from gsrain_engine.training_run import CheckpointError  # noqa: E402

from .small_training import SIDE_PX, small, small_settings, small_start  # noqa: E402

pytestmark = pytest.mark.usefixtures("small_networks")


def run(task: FinetuneTask) -> FinetuneResult:
    return run_to_end(finetune(task))


def test_a_training_resumed_after_a_kill_ends_in_the_same_bytes_on_the_cpu(tmp_path: Path) -> None:
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


def test_the_weights_that_are_written_are_those_that_were_trained_and_can_be_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def model_with_base(*arguments):
        model = build(*arguments)
        model.base = "0123456789abcdef"
        return model

    build = training_run.model_to_train
    settings = small_settings(tmp_path, steps=1)
    with monkeypatch.context() as patch:
        patch.setattr(training_run, "model_to_train", model_with_base)
        result = run(FinetuneTask(settings=settings, output=tmp_path / "run"))
    record = read_record(result.weights)
    split = open_images(settings.pictures)
    assert record is not None and record.held_out == identity_of(split.test)
    assert record.base == "0123456789abcdef"
    assert (record.conditioning, record.framing, record.width_px, record.steps) == ("up", "stretch", SIDE_PX, 1)
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
    # The base beneath the LoRA, which the original loses.
    assert not torch.equal(training.model.unet.conv_in.base_layer.weight, untrained)
    further = small_start(small_settings(tmp_path, start=str(result.weights)))
    assert torch.allclose(further.translated(clear, guide, "a2b"), expected, atol=1e-6)
    pictures = msgspec.structs.replace(settings.pictures, guide="none")
    assert not small_start(msgspec.structs.replace(settings, pictures=pictures)).model.takes_guides


def test_losses_fall_and_are_written_with_samples(tmp_path: Path) -> None:
    settings = small_settings(tmp_path, steps=12, sampled_every=6, optimizer={"rate": 4e-3})
    task, steps = FinetuneTask(settings=settings, output=tmp_path / "run"), []
    result = run_to_end(finetune(task), steps.append)

    rows = read_losses(task.losses)
    assert [step.metrics for step in steps if step.metrics][5] == pytest.approx(rows[5])
    for kind in ("cycle", "identity"):
        sums = [row[f"{kind}_clear"] + row[f"{kind}_rainy"] for row in rows]
        assert np.mean(sums[-4:]) < 0.95 * np.mean(sums[:4]), kind  # each is one turn: all pictures once
    grids = sorted(task.samples.iterdir())
    assert [file.name for file in grids] == ["step_000006.png", "step_000012.png"] and result.grid == grids[-1]
    assert any((tmp_path / "run" / "tensorboard").iterdir())
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions) and fractions[-1] == 1
    assert any(step.preview is not None for step in steps)
    assert load_finetuning(task.config) == settings
    assert result.numbers["steps"] == 12 and [each["count"] for each in result.numbers["pictures"]] == [5, 5]


def test_other_trainings_and_damaged_checkpoints_are_refused(tmp_path: Path) -> None:
    task = FinetuneTask(settings=small_settings(tmp_path, steps=1), output=tmp_path / "run")
    run(task)
    with pytest.raises(ValueError, match="training already"):
        run(task)

    def refused(name: str, output: Path = task.output, perceptual=None, **changes: object) -> None:
        settings = small_settings(tmp_path, **({"steps": 2} | changes))
        with pytest.raises(CheckpointError, match=name):
            run_to_end(finetune(FinetuneTask(settings=settings, output=output, resume=True), perceptual))

    refused("lora", lora={"unet": 5, "vae": 4})
    refused("seed", seed=1)
    refused("steps", steps=1)
    refused("perceptual", perceptual=lambda a, b: (a - b).square().mean())
    refused("checkpoint", tmp_path / "elsewhere")
    whole = task.checkpoint.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"\0" * 64, whole.replace(b'"gsrain"', b'"gsrein"')):
        task.checkpoint.write_bytes(damaged)
        refused("damaged")
    task.checkpoint.write_bytes(whole)
    shutil.copy(tmp_path / "clear" / "0.png", tmp_path / "clear" / "another.png")
    refused("pictures")


def test_missing_memory_and_missing_weights_are_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def iterate(training: FinetuneTrainer, number: int) -> None:
        raise RuntimeError("CUDA out of memory. Tried to allocate 2 GiB")

    monkeypatch.setenv("GSRAIN_SD_TURBO", str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match="SD-Turbo"):
        run(FinetuneTask(settings=small_settings(tmp_path, architecture="sd-turbo"), output=tmp_path / "run"))
    monkeypatch.setattr(FinetuneTrainer, "iterate", iterate)
    with pytest.raises(MemoryError, match="gradient_checkpointing: true"):
        run(FinetuneTask(settings=small_settings(tmp_path, steps=1), output=tmp_path / "run"))


# Losses and early warning


def test_losses_are_readable_while_written(tmp_path: Path) -> None:
    file = tmp_path / "losses.csv"
    with LossLog(tmp_path) as log:
        log.add(1, {"change": 0.5})
        assert read_losses(file) == [{"step": 1, "change": 0.5}]
    file.write_text("step,change\n1,0.5\n2,0.4\n3")
    assert [row["step"] for row in read_losses(file)] == [1, 2]
    assert read_losses(tmp_path / "nothing.csv") == []


@pytest.mark.parametrize(
    ("change", "judged", "step", "gan", "warning"),
    [
        (0.01, 1.0, 500, 0.5, "losses.gan or the rate"),
        (0.01, 0.02, 500, 0.5, "discriminators tell everything apart"),
        (0.01, 0.02, 500, 0.0, "no adversarial loss"),
        (0.15, 0.05, 500, 0.5, "discriminator's loss"),
        (0.01, 1.0, 499, 0.5, None),  # too early
        (0.15, 1.0, 500, 0.5, None),
    ],
)
def test_a_collapsed_training_is_warned_of(
    change: float, judged: float, step: int, gan: float, warning: str | None
) -> None:
    """`judged` is the discriminators' loss as a share of chance."""
    monitor = CollapseMonitor(0.2, gan, warned_after=500)
    assert monitor.warning(step) is None  # nothing yet
    names = [f"judge_{look}_{kind}" for look in ("rainy", "clear") for kind in ("made", "real")]
    for _ in range(10):
        monitor.add({"change": change, **dict.fromkeys(names, 0.5 * gan * CHANCE * judged)})
    assert monitor.share == pytest.approx(change / 0.2)
    found = monitor.warning(step)
    assert found is None if warning is None else found is not None and warning in found


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
