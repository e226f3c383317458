"""Fine-tuning as work, for a worker process and the command line alike: the recipe with LPIPS, where it has weights."""

from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.trusted_code import expect

from ..jobs.torch_extra import HOW_TO_GET_DIFFUSION, require_torch

if TYPE_CHECKING:
    from gsrain_engine.appearance.finetuning.task import TrainingResult, TrainingTask


def train_transfer(task: "TrainingTask") -> "Generator[Progress, None, TrainingResult]":
    """Fine-tune as a task says. Yields and raises as `finetune` does, and ValueError where torch is missing."""
    require_torch("training the transfer", HOW_TO_GET_DIFFUSION)
    expect(task.code)
    from gsrain_engine.appearance.finetuning.finetune import finetune
    from gsrain_engine.appearance.finetuning.start import chosen_device
    from gsrain_engine.evaluate.lpips_loss import lpips_loss

    settings = task.settings
    wanted = settings.losses.cycle_lpips or settings.losses.identity_lpips
    file = None if settings.lpips is None else Path(settings.lpips)
    perceptual = lpips_loss(file, chosen_device(settings.device)) if wanted else None
    return (yield from finetune(task, perceptual))
