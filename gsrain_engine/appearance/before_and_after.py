"""Some views before and after a transfer, side by side in one picture."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image, ImageDraw

from .transfer import RainyView

_MARGIN_PX, _LINE_PX = 8, 16
_PAPER, _INK = (24, 26, 28), (220, 222, 224)


class BeforeAndAfter:
    """Collects views, evenly over all that come by, and draws them: a row each, clear on the left."""

    def __init__(self, count: int, at_most: int = 6, width_px: int = 640) -> None:
        """Take how many views will come, how many of them are shown, and how wide each picture is."""
        self._wanted = set(np.linspace(0, count - 1, min(at_most, count)).round().astype(int).tolist())
        self._width = width_px
        self._seen = 0
        self._rows: list[tuple[str, list[UInt8[np.ndarray, "_ _ 3"]]]] = []

    def add(self, view: RainyView) -> None:
        if self._seen in self._wanted:
            self._rows.append((view.clear.name, [self._sized(view.clear.image), self._sized(view.image)]))
        self._seen += 1

    def picture(self) -> Image.Image:
        heights = [_LINE_PX + max(each.shape[0] for each in pictures) + _MARGIN_PX for _, pictures in self._rows]
        sheet = Image.new("RGB", (2 * self._width + 3 * _MARGIN_PX, sum(heights) + _MARGIN_PX), _PAPER)
        pen, top = ImageDraw.Draw(sheet), _MARGIN_PX
        for (name, pictures), height in zip(self._rows, heights, strict=True):
            pen.text((_MARGIN_PX, top), name, fill=_INK)
            for i, pixels in enumerate(pictures):
                sheet.paste(Image.fromarray(pixels), (_MARGIN_PX + i * (self._width + _MARGIN_PX), top + _LINE_PX))
            top += height
        return sheet

    def _sized(self, picture: Float32[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "_ _ 3"]:
        scale = self._width / picture.shape[1]
        size = (self._width, max(round(picture.shape[0] * scale), 1))
        resized = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
        return np.rint(np.clip(resized, 0, 1) * np.float32(255)).astype(np.uint8)
