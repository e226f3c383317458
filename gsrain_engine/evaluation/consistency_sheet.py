"""Consistency sheet: images of a view, its warped neighbor and their difference."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import matplotlib
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from PIL import Image, ImageDraw, ImageFont

from ..report.charts import LARGEST_ERROR
from .consistency import WarpedPair

_CELL_PX = 400
_GAP_PX, _TEXT_PX = 8, 17
_PAPER, _INK, _FAINT = (24, 25, 28), (232, 232, 236), (150, 152, 160)
_LEFT_OUT = (52, 54, 60)
_WET = np.array([0.15, 0.42, 0.75], np.float32)
_DIMMED = 0.25
_SHADES = 256


class SheetPair(NamedTuple):
    """One transfer's version of a pair."""

    title: str
    pair: WarpedPair
    has_clear: bool


class _SheetRow(NamedTuple):
    title: str
    view: Float32[np.ndarray, "h w 3"]
    other: Float32[np.ndarray, "h w 3"]
    valid: Bool[np.ndarray, "h w"]
    dry: Bool[np.ndarray, "h w"] | None


def consistency_sheet(pairs: Sequence[Sequence[SheetPair]]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw pairs below each other: first the clear images, then the same pair for each transfer.

    Next to each view are the neighbor warped onto it, dark without a match, and the error, from none (black) to a
    quarter of full scale (white); unmatched pixels are gray, those of the water film blue.
    """
    blocks: list[Image.Image] = []
    for of_pair in pairs:
        first = of_pair[0].pair
        rows = [_SheetRow(title, pair.of.image, pair.after, pair.found.valid, pair.dry) for title, pair, _ in of_pair]
        if of_pair[0].has_clear:
            rows.insert(0, _SheetRow("before", first.of.clear.image, first.before, first.found.valid, None))
        blocks.append(_block(first, rows))
    width = max(block.width for block in blocks)
    legend = _legend(width)
    sheet = Image.new("RGB", (width, sum(block.height for block in blocks) + legend.height), _PAPER)
    top = 0
    for block in [*blocks, legend]:
        sheet.paste(block, (0, top))
        top += block.height
    return np.asarray(sheet)


def _block(pair: WarpedPair, rows: Sequence[_SheetRow]) -> Image.Image:
    """One pair: a line of text, then a captioned row of three images for each variant."""
    height, width = pair.of.image.shape[:2]
    tall = max(round(_CELL_PX * height / width), 1)
    line = _TEXT_PX + _GAP_PX
    block = Image.new(
        "RGB", (3 * _CELL_PX + 4 * _GAP_PX, line + len(rows) * (tall + line + _GAP_PX) + 2 * _GAP_PX), _PAPER
    )
    draw, font = ImageDraw.Draw(block), ImageFont.load_default(_TEXT_PX)
    names = f"{pair.of.clear.name}, and {pair.to.clear.name} warped onto it: {pair.found.valid.mean():.0%} matched"
    draw.text((_GAP_PX, _GAP_PX), names, _INK, font)
    top = _GAP_PX + line
    for row in rows:
        error = f"{row.title}: error {_levels(row, row.valid)} of 255"
        outside = "" if row.dry is None else f", outside the water film {_levels(row, row.dry)}"
        draw.text((_GAP_PX, top), error + outside, _FAINT, font)
        top += _TEXT_PX + _GAP_PX // 2
        for column, picture in enumerate(_images(row)):
            resized = cv2.resize(picture, (_CELL_PX, tall), interpolation=cv2.INTER_AREA)
            block.paste(Image.fromarray(resized), (_GAP_PX + column * (_CELL_PX + _GAP_PX), top))
        top += tall + _GAP_PX + _GAP_PX // 2
    return block


def _levels(row: _SheetRow, mask: Bool[np.ndarray, "h w"]) -> str:
    if not mask.any():
        return "-"
    return f"{255 * float(np.sqrt(np.mean((row.other[mask] - row.view[mask]) ** 2))):.2f}"


def _images(row: _SheetRow) -> list[UInt8[np.ndarray, "h w 3"]]:
    other = np.where(row.valid[..., None], row.other, _DIMMED * row.view)
    error = np.abs(row.other - row.view).mean(axis=2)
    shades = np.asarray(matplotlib.colormaps["magma"](np.linspace(0, 1, _SHADES)), np.float32)[:, :3]
    colors = shades[np.rint(np.clip(error / LARGEST_ERROR, 0, 1) * (_SHADES - 1)).astype(int)]
    if row.dry is not None:
        colors = np.where((row.valid & ~row.dry)[..., None], 0.45 * colors + 0.55 * _WET, colors)
    colors = np.where(row.valid[..., None], colors, np.array(_LEFT_OUT, np.float32) / 255)
    return [np.rint(255 * np.clip(each, 0, 1)).astype(np.uint8) for each in (row.view, other, colors)]


def _legend(width: int) -> Image.Image:
    legend = Image.new("RGB", (width, _TEXT_PX + 3 * _GAP_PX), _PAPER)
    draw, font = ImageDraw.Draw(legend), ImageFont.load_default(_TEXT_PX)
    shades = np.asarray(matplotlib.colormaps["magma"](np.linspace(0, 1, 120)))[:, :3]
    bar = np.repeat(np.rint(255 * shades).astype(np.uint8)[None], _TEXT_PX, axis=0)
    x = _GAP_PX
    gray, blue = (
        np.tile(np.array(color, np.uint8), (_TEXT_PX, _TEXT_PX, 1)) for color in (_LEFT_OUT, np.rint(255 * _WET))
    )
    for swatch, words in (
        (bar, f"error 0 to {255 * LARGEST_ERROR:.0f} of 255"),
        (gray, "no match"),
        (blue, "water film, which mirrors and may differ"),
    ):
        legend.paste(Image.fromarray(swatch), (int(x), _GAP_PX))
        x += swatch.shape[1] + _GAP_PX
        draw.text((x, _GAP_PX), words, _FAINT, font)
        x += draw.textlength(words, font) + 4 * _GAP_PX
    return legend
