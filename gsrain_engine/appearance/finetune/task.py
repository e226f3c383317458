"""Task and result of a fine-tuning, as plain values."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from .settings import FinetuningSettings


class FinetuneTask(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fine-tuning job; picklable for a worker process."""

    settings: FinetuningSettings
    output: Path
    resume: bool = False
    """Continue from the folder's checkpoint."""
    code: dict[str, str] = {}
    """Digests of Python code that the settings name and the user has allowed, by path."""

    @property
    def weights(self) -> Path:
        """Path of the weights for `gsrain transfer --weights`; written with each checkpoint."""
        return self.output / "weights.safetensors"

    @property
    def checkpoint(self) -> Path:
        return self.output / "checkpoint.safetensors"

    @property
    def config(self) -> Path:
        return self.output / "config.yaml"

    @property
    def losses(self) -> Path:
        """Path of the loss log; `loss_log.read_losses` can read it during training."""
        return self.output / "losses.csv"

    @property
    def samples(self) -> Path:
        """Folder of sample grids, `step_000250.png` and so on."""
        return self.output / "samples"

    @property
    def images_cache(self) -> Path:
        """Cache folder for estimated guides."""
        return self.output / "guides"


@dataclass(frozen=True, slots=True, eq=False)
class FinetuneResult:
    """Files and statistics of a finished fine-tuning."""

    weights: Path
    grid: Path
    steps: int
    seconds: float
    losses: dict[str, float]
    """Means over the last hundred iterations."""
    share: float
    """Change by the translation as a share of the distance between the looks."""
    warning: str | None
    perceptual: bool
    """True if LPIPS was one of the losses."""
    table: tuple[tuple[str, str, int, int], ...]
    """One row per source: path, clear or rainy, number of images, number of test images."""
    problems: tuple[str, ...]

    @property
    def numbers(self) -> dict[str, Any]:
        pictures = [
            {"path": path, "look": look, "count": count, "tested": tested} for path, look, count, tested in self.table
        ]
        return {
            "steps": self.steps, "seconds": self.seconds, "losses": self.losses, "share_of_distance": self.share,
            "warning": self.warning, "lpips": self.perceptual, "weights": str(self.weights),
            "pictures": pictures, "problems": list(self.problems),
        }  # fmt: skip
