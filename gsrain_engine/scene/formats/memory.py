"""Whether a scene fits into memory, said before any of it is taken."""

import logging
from pathlib import Path

import psutil

from ..errors import SceneFormatError

logger = logging.getLogger("gsrain")

DRAWING_FACTOR = 1.6
"""Opening and drawing a scene takes at most so many times the bytes of its Gaussians."""

_WORTH_SAYING_BYTES = 200e6


def check_room(path: Path, count: int, coefficients: int) -> None:
    """Say what so many Gaussians with so many harmonics a colour will take, and refuse what can't fit.

    Raises `SceneFormatError`.
    """
    wanted = gaussian_bytes(count, coefficients)
    available = psutil.virtual_memory().available
    if DRAWING_FACTOR * wanted > available:
        raise SceneFormatError(
            path,
            f"{count:,} Gaussians need {DRAWING_FACTOR * wanted / 1e9:.1f} GB of memory to be opened and drawn, "
            f"{available / 1e9:.1f} GB are free",
        )
    if wanted > _WORTH_SAYING_BYTES:
        logger.info("%s: %s Gaussians, %.1f GB", path.name, f"{count:,}", wanted / 1e9)


def gaussian_bytes(count: int, coefficients: int) -> int:
    """Bytes of `Gaussians`: means, scales, quaternions, opacities, harmonics, all float32."""
    return 4 * count * (3 + 3 + 4 + 1 + 3 * coefficients)
