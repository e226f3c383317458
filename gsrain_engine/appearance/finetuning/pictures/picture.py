"""A picture as training takes it: framed, in floats, with its guide."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float32
from PIL import Image

from gsrain_engine.datasets.capture import View
from gsrain_engine.datasets.prepared import prepared

Framing = Literal["stretch", "crop"]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture of a data set, read when it is asked for."""

    name: str
    view: View
    width: int
    height: int
    framing: Framing = "stretch"
    guide: Callable[[View], Float32[np.ndarray, "_ _"] | None] | None = None
    """Works out the guide of a straightened view; None trains without one."""

    def read(self) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"] | None]:
        """Display colour 0..1, and the guide -1..1 or None. Raises `CaptureError` where the file is broken."""
        view = prepared(self.view)
        pixels = Image.fromarray(self._cut(view.image)).resize((self.width, self.height), Image.Resampling.LANCZOS)
        guide = None if self.guide is None else self.guide(view)
        if guide is not None:
            shrunk = cv2.resize(self._cut(guide), (self.width, self.height), interpolation=cv2.INTER_AREA)
            guide = np.clip(shrunk, -1, 1).astype(np.float32)
        return np.asarray(pixels, np.float32) / np.float32(255), guide

    def _cut(self, pixels: np.ndarray) -> np.ndarray:
        """Return the middle that has the proportions asked for, or everything."""
        if self.framing == "stretch":
            return pixels
        height, width = pixels.shape[:2]
        inner_width = min(width, round(height * self.width / self.height))
        inner_height = min(height, round(width * self.height / self.width))
        left, top = (width - inner_width) // 2, (height - inner_height) // 2
        return np.ascontiguousarray(pixels[top : top + inner_height, left : left + inner_width])


@dataclass(frozen=True, slots=True, eq=False)
class UnpairedPictures:
    """Pictures of two looks; none belongs to one of the other look."""

    source: tuple[Picture, ...]
    target: tuple[Picture, ...]
