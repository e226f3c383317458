"""Features that were worked out before, kept by what is in the picture and what looked at it."""

import hashlib
import os
from pathlib import Path

import numpy as np
import platformdirs
from jaxtyping import Float32, UInt8

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.limits import open_file

from .extractor import Extractor

PLACE = "GSRAIN_FEATURE_CACHE"
"""Environment variable with the folder in which features are kept."""


def picture_hash(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """Return a hash of the pixels (SHA-256): the same for the same picture under any name and in any lossless file."""
    found = hashlib.sha256(np.array(image.shape, np.int64).tobytes())
    found.update(image.tobytes())
    return found.hexdigest()


class FeatureCache:
    """A folder with one small file a picture and extractor; it may be removed at any time."""

    def __init__(self, folder: Path | None = None) -> None:
        own = os.environ.get(PLACE)
        default = platformdirs.user_cache_path("gsrain", appauthor=False) / "features"
        self._folder = folder or (Path(own) if own else default)

    def features(
        self, extractor: Extractor, image: UInt8[np.ndarray, "h w 3"], digest: str
    ) -> Float32[np.ndarray, " d"]:
        """Return what an extractor says of a picture with that `picture_hash`, from the folder where it is there."""
        if extractor.key is None:
            return extractor(image)
        file = self._folder / extractor.key / digest[:2] / f"{digest}.npy"
        kept = _read(file, extractor.features)
        if kept is not None:
            return kept
        found = extractor(image)
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as beside, beside.open("wb") as opened:
            np.save(opened, found)
        return found


def _read(file: Path, features: int) -> Float32[np.ndarray, " d"] | None:
    """Read kept features; None where there are none, or the file is damaged."""
    try:
        with open_file(file) as stream:
            kept = np.load(stream, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return kept if kept.shape == (features,) and kept.dtype == np.float32 else None
