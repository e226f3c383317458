"""What is to be fine-tuned, where everything goes, and what came of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from .settings import FinetuningSettings

_WARNING = ". Warning: "


def with_warning(message: str, warning: str | None) -> str:
    """What an iteration did, and what is wrong if anything is."""
    return message if warning is None else f"{message}{_WARNING}{warning}"


def warning_in(message: str) -> str | None:
    return message.partition(_WARNING)[2] or None


class FinetuneTask(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One order to fine-tune the transfer; it survives pickling, for a worker process."""

    settings: FinetuningSettings
    output: Path
    """Folder for weights, checkpoint, losses and samples."""
    resume: bool = False
    """Whether to go on from the folder's checkpoint."""
    code: dict[str, str] = {}
    """Digests of Python programs that the settings name, by path: a person has allowed these."""

    @property
    def weights(self) -> Path:
        """What `gsrain transfer --weights` takes; written with each checkpoint."""
        return self.output / "weights.safetensors"

    @property
    def checkpoint(self) -> Path:
        return self.output / "checkpoint.safetensors"

    @property
    def config(self) -> Path:
        """The settings, as they were used."""
        return self.output / "config.yaml"

    @property
    def losses(self) -> Path:
        """A row of losses an iteration; `loss_log.read_losses` reads it while the training runs."""
        return self.output / "losses.csv"

    @property
    def samples(self) -> Path:
        """Folder of sample grids, `step_000250.png` and so on."""
        return self.output / "samples"

    @property
    def images_cache(self) -> Path:
        """Where estimated normals are kept."""
        return self.output / "guides"


@dataclass(frozen=True, slots=True, eq=False)
class FinetuneResult:
    """What a fine-tuning brought."""

    weights: Path
    grid: Path
    """The last grid of samples."""
    steps: int
    seconds: float
    losses: dict[str, float]
    """Means over the last hundred iterations."""
    share: float
    """Change by the translation as a share of the distance between the looks."""
    warning: str | None
    perceptual: bool
    """Whether LPIPS was a part of the losses."""
    table: tuple[tuple[str, str, int, int], ...]
    """A row a source: path, clear or rainy, pictures in all, pictures for testing."""
    problems: tuple[str, ...]

    @property
    def numbers(self) -> dict[str, Any]:
        """For `--json`."""
        pictures = [
            {"path": path, "look": look, "count": count, "tested": tested} for path, look, count, tested in self.table
        ]
        return {
            "steps": self.steps, "seconds": self.seconds, "losses": self.losses, "share_of_distance": self.share,
            "warning": self.warning, "lpips": self.perceptual, "weights": str(self.weights),
            "pictures": pictures, "problems": list(self.problems),
        }  # fmt: skip
