"""What turns a picture into features, under the name that its distance may carry: only Inception's is FID."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8


@dataclass(frozen=True, slots=True, kw_only=True)
class Extractor:
    """Features of one picture at a time, so that they don't depend on what else is looked at."""

    metric: str
    """What the Frechet distance of these features is called: FID, or "FD-" and a name."""
    described: str
    """Network, weights with their hash, and size of its input."""
    features: int
    """Numbers a picture."""
    key: str | None
    """Tells features of this extractor from those of others; None where they are not worth keeping."""
    function: Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, " d"]]

    @property
    def kernel_metric(self) -> str:
        """What the kernel distance of these features is called: KID of Inception's alone, else "KD-" and the name."""
        return "KID" if self.metric == "FID" else self.metric.replace("FD-", "KD-", 1)

    def __call__(self, image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
        """Return the features of a picture in display values."""
        return self.function(image)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractorChoice:
    """Which extractor, and where its weights come from."""

    name: str = "inception"
    weights: Path | None = None
    """A file; None looks where this machine keeps weights."""
    device: str = "cpu"
    """As torch calls it: cpu, cuda."""
    allows_torchscript: bool = False
    """Whether a TorchScript file of Inception may be run: it is a program, not only numbers."""
