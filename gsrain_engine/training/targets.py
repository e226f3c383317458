"""Training targets: the pixels of views as tensors, held on a GPU up to a bound on memory."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from ..render.gsplat_input import uploaded
from .data import PyramidLevel, TrainingView

torch: Any = import_module("torch")
Tensor = Any
_MAX_SHARE = 0.25  # share of the free GPU memory that targets may take; the rest is for Gaussians and renders


class TrainingTarget(NamedTuple):
    """One level of a view as tensors."""

    image: Tensor
    """(h, w, 3) of 0..1."""
    mask: Tensor | None
    """(h, w) bool: training pixels."""
    hits: Tensor
    """(m,) flat indices of pixels with measured depth."""
    depths: Tensor
    """(m,) along the view axis."""
    sky: Tensor | None
    """(h, w) bool."""
    pixels: int
    """Number of training pixels of the view."""

    @classmethod
    def of(cls, level: PyramidLevel, device: str) -> "TrainingTarget":
        """Upload one level, without waiting for the device."""
        return cls.uploaded(level, device).normalized()

    @classmethod
    def uploaded(cls, level: PyramidLevel, device: str) -> "TrainingTarget":
        """Upload one level with its image in 8 bits."""
        mask, sky = (None if each is None else uploaded(each, device) for each in (level.mask, level.sky))
        rows, depths = np.zeros(0, np.int64), np.zeros(0, np.float32)
        if level.depth is not None:
            measured = level.depth > 0 if level.mask is None else (level.depth > 0) & level.mask
            rows = measured.ravel().nonzero()[0]
            depths = level.depth.ravel()[rows]
        pixels = level.camera.width * level.camera.height if level.mask is None else int(np.count_nonzero(level.mask))
        return cls(uploaded(level.image, device), mask, uploaded(rows, device), uploaded(depths, device), sky, pixels)

    def normalized(self) -> "TrainingTarget":
        """Return the target with its 8-bit image as float32 of 0..1."""
        return self._replace(image=self.image / 255)

    @property
    def bytes(self) -> int:
        return sum(each.nelement() * each.element_size() for each in self[:-1] if each is not None)


class TargetCache:
    """Targets of all views by view and level.

    On a GPU each is uploaded at its first use and stays there, 8 bits a color, while all of them fit `max_bytes`; the
    others are uploaded at each use. An upload is queued behind the kernels of the step before, so that it takes none of
    the processor's time but that of one copy. The CPU uses the arrays themselves.
    """

    def __init__(self, views: Sequence[TrainingView], device: str, max_bytes: int | None = None) -> None:
        """Bound the memory to `max_bytes`; None takes a quarter of the free memory of the GPU at the first use."""
        self._views, self._device = views, device
        self._room = max_bytes
        self._held: dict[tuple[int, int], TrainingTarget] = {}

    def __len__(self) -> int:
        """Number of targets on the device."""
        return len(self._held)

    def target(self, view: int, level: int) -> TrainingTarget:
        """Return one level of a view, both by index."""
        pixels = self._views[view].levels[level]
        if self._device == "cpu":
            return TrainingTarget.of(pixels, self._device)
        found = self._held.get((view, level))
        if found is None:
            found = TrainingTarget.uploaded(pixels, self._device)
            if self._room is None:
                self._room = int(_MAX_SHARE * torch.cuda.mem_get_info(self._device)[0])
            if found.bytes <= self._room:
                self._room -= found.bytes
                self._held[view, level] = found
        return found.normalized()
