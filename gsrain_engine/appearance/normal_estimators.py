"""Protocol and table of normal estimators, for images without depth."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from ..scene.camera import Camera


@runtime_checkable
class NormalEstimator(Protocol):
    """Model that estimates surface normals from an image."""

    def normals(self, image: Float32[np.ndarray, "h w 3"], camera: Camera) -> Float32[np.ndarray, "h w 3"]:
        """Return unit world normals (z up) towards the eye, from a display image (0..1); results are deterministic.

        `camera` has no lens distortion and the image's size.
        """
        ...


def _dsine(weights: Path, checkout: Path | None, device: str) -> NormalEstimator:
    from .normal_models import open_dsine

    if checkout is None:
        raise ValueError("dsine needs a folder with its program: git clone https://github.com/baegwangbin/DSINE")
    return open_dsine(checkout, weights, device)


def _marigold(weights: Path, checkout: Path | None, device: str) -> NormalEstimator:
    from .normal_models import open_marigold

    return open_marigold(weights, device)


ESTIMATORS: dict[str, Callable[[Path, Path | None, str], NormalEstimator]] = {"dsine": _dsine, "marigold": _marigold}

WEIGHTS = {
    "dsine": "dsine.pt (https://huggingface.co/camenduru/DSINE), for non-commercial use only",
    "marigold": "a folder with the model (hf download prs-eth/marigold-normals-v1-1 --local-dir FOLDER)",
}
"""Weights of each estimator, and their source."""


def open_estimator(
    name: str, weights: Path | str | None, checkout: Path | str | None = None, device: str = "cpu"
) -> NormalEstimator:
    """Open an estimator by its name in `ESTIMATORS`, with weights from disk.

    Raises ValueError for an unknown name, a missing path or a file that the estimator can't read.
    """
    if name not in ESTIMATORS:
        raise ValueError(f"no normal estimator {name!r}; there are {', '.join(ESTIMATORS)}")
    if weights is None:
        raise ValueError(f"{name} needs weights: {WEIGHTS[name]}")
    for path in (weights, checkout):
        if path is not None and not Path(path).exists():
            raise ValueError(f"{path}: no such file or folder; {name} needs {WEIGHTS[name]}")
    return ESTIMATORS[name](Path(weights), None if checkout is None else Path(checkout), device)
