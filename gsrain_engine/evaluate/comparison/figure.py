"""The figure of a comparison: a row each method, a column each view, as papers show their methods."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from gsrain_engine.appearance.transferred_folder import read_transferred
from gsrain_engine.appearance.views.choice import evenly

from .method_folders import MethodFolder

_CELL_PX, _GAP_PX, _TEXT_PX = 360, 8, 18
_PAPER, _INK, _FAINT, _EMPTY = (255, 255, 255), (20, 20, 22), (110, 112, 118), (236, 236, 238)

_Pixels = UInt8[np.ndarray, "_ _ 3"]


def shown_views(folders: Sequence[MethodFolder], names: Sequence[str], columns: int) -> list[str]:
    """Choose the figure's views: those named, or `columns` evenly out of those of the method that has the most.

    Raises ValueError for a name that there is not.
    """
    there = max(([view.clear.name for view in read_transferred(each.folder)] for each in folders), key=len)
    if not names:
        return [there[i] for i in evenly(len(there), columns)]
    for name in names:
        if name not in there:
            raise ValueError(f"shown: no view {name!r}, for one {there[0]!r}")
    return list(names)


def comparison_figure(folders: Sequence[MethodFolder], names: Sequence[str]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the views of these names as each method made them; a view that a method lacks stays empty."""
    rows = [(each.method.name, _pictures(each, names)) for each in folders]
    ratios = [one.shape[0] / one.shape[1] for _, pictures in rows for one in pictures if one is not None]
    tall = round(_CELL_PX * max(ratios, default=0.5))
    line, step = _TEXT_PX + _GAP_PX, tall + _TEXT_PX + 3 * _GAP_PX
    head = line + _GAP_PX
    size = (len(names) * (_CELL_PX + _GAP_PX) + _GAP_PX, head + len(rows) * step)
    sheet = Image.new("RGB", size, _PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(_TEXT_PX)
    lefts = [_GAP_PX + column * (_CELL_PX + _GAP_PX) for column in range(len(names))]
    for left, name in zip(lefts, names, strict=True):
        draw.text((left, _GAP_PX // 2), _fitting(draw, font, name), _FAINT, font)
    for row, (method, pictures) in enumerate(rows):
        top = head + row * step
        draw.text((_GAP_PX, top), method, _INK, font)
        for left, picture in zip(lefts, pictures, strict=True):
            box = (left, top + line, left + _CELL_PX, top + line + tall)
            if picture is None:
                draw.rectangle(box, _EMPTY)
                draw.text((left + _GAP_PX, box[1] + _GAP_PX), "no picture", _FAINT, font)
            else:
                sheet.paste(Image.fromarray(_sized(picture)), box[:2])
    return np.asarray(sheet)


def _pictures(folder: MethodFolder, names: Sequence[str]) -> list[_Pixels | None]:
    views = read_transferred(folder.folder)
    found: dict[str, _Pixels] = {}
    for view in views:
        if view.clear.name in names:
            found[view.clear.name] = np.rint(255 * view.image).astype(np.uint8)
    return [found.get(name) for name in names]


def _sized(picture: _Pixels) -> _Pixels:
    scale = _CELL_PX / picture.shape[1]
    size = (_CELL_PX, max(round(picture.shape[0] * scale), 1))
    return np.asarray(
        cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC), np.uint8
    )


def _fitting(draw: ImageDraw.ImageDraw, font: ImageFont.ImageFont | ImageFont.FreeTypeFont, name: str) -> str:
    """Cut the front off a name that is wider than its column: names of a drive differ at their ends."""
    cut = name
    while draw.textlength(cut, font) > _CELL_PX and len(cut) > 2:
        cut = f"…{cut[2:]}"
    return cut
