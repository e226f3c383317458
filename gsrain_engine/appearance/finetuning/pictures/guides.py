"""Guides of pictures: from the capture's own normals or depth, else estimated once and kept on the disk."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float32

from gsrain_engine.appearance.normals.estimators import NormalEstimator
from gsrain_engine.appearance.normals.from_depth import normals_from_depth
from gsrain_engine.appearance.normals.grey_guide import grey_guide
from gsrain_engine.datasets.capture import View
from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.limits import open_file


@dataclass(frozen=True, slots=True, eq=False)
class Guides:
    """Works out guides; a call with a view gives its guide, or None where nothing tells its surfaces."""

    kind: Literal["up", "luma"]
    estimator: NormalEstimator | None = None
    estimator_name: str = "none"
    """Tells the kept files of one estimator from those of another."""
    folder: Path | None = None
    """Where estimated guides are kept; None keeps none."""

    def __call__(self, view: View) -> Float32[np.ndarray, "_ _"] | None:
        """Return -1..1 per pixel of a view without lens."""
        normals = self._known(view)
        if normals is not None:
            return grey_guide(normals, view.camera, self.kind)
        if self.estimator is None:
            return None
        return self._estimated(view, self.estimator)

    def _known(self, view: View) -> Float32[np.ndarray, "_ _ 3"] | None:
        if (normals := view.normals) is not None:
            return normals.astype(np.float32)
        depth = view.depth
        return None if depth is None else normals_from_depth(depth, view.camera)

    def _estimated(self, view: View, estimator: NormalEstimator) -> Float32[np.ndarray, "_ _"]:
        image, camera = view.image, view.camera
        asked = f"{self.estimator_name} {self.kind} {camera.fx} {camera.fy} {camera.cx} {camera.cy} {image.shape}"
        file = None
        if self.folder is not None:
            key = hashlib.sha256(asked.encode() + image.tobytes()).hexdigest()[:24]
            file = self.folder / f"{key}.npy"
            if (kept := _read(file, image.shape[:2])) is not None:
                return kept
        guide = grey_guide(estimator.normals(image.astype(np.float32) / np.float32(255), camera), camera, self.kind)
        # Kept and used with the same 8 bits: the first time a picture is seen is like every other.
        steps = np.round(guide * 127).astype(np.int8)
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(file) as beside, beside.open("wb") as stream:
                np.save(stream, steps, allow_pickle=False)
        return steps.astype(np.float32) / np.float32(127)


def _read(file: Path, shape: tuple[int, ...]) -> Float32[np.ndarray, "_ _"] | None:
    """Return a kept guide; None where there is none that is whole."""
    try:
        with open_file(file) as stream:
            steps = np.load(stream, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    if steps.shape != shape or steps.dtype != np.int8:
        return None
    return steps.astype(np.float32) / np.float32(127)
