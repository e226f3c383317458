"""Intensity sheet: the same views in several rains, with what of each can be seen, in numbers."""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image, ImageDraw, ImageFont

from ..rain.simulation import RainSimulation
from ..rain.wetness import with_wet_choice
from ..scene.progress import Progress
from .images import write_image
from .provenance import PictureProvenance, provenance_of
from .renderer import Renderer
from .sequence import FrameSequence, common_sky
from .sky_color import SkyColor

VISIBLE_LEVELS = 4
"""A change of a pixel by more gray levels than this counts as seen."""

_CLOSE_UP = 5  # the close-up is a fifth of the image wide and high
_ENLARGED = 2
_TEXT_SHARE, _TEXT_PX = 1 / 40, 13  # height of the text: of the image's width, and at least
_PAPER, _INK, _FAINT, _MARK = (24, 25, 28), (232, 232, 236), (170, 172, 180), (228, 60, 48)


@dataclass(frozen=True, slots=True, eq=False)
class SheetCell:
    """One view in one rain, and its difference from the same view at 0 mm/h."""

    view: str
    intensity_mm_h: float
    image: UInt8[np.ndarray, "h w 3"]
    mean_change: float
    """Mean absolute difference, in gray levels of 255."""
    visible_share: float
    """Fraction of the pixels whose color changes by more than `VISIBLE_LEVELS`."""
    streaks_drawn: int
    visible_streaks: int
    """Connected regions that the streaks alone change by more than `VISIBLE_LEVELS`."""
    provenance: PictureProvenance | None = None

    @property
    def numbers(self) -> dict[str, str | float | int]:
        """Plain values of all but the image."""
        return {
            "view": self.view,
            "intensity_mm_h": self.intensity_mm_h,
            "mean_change_levels": self.mean_change,
            "visible_share": self.visible_share,
            "streaks_drawn": self.streaks_drawn,
            "visible_streaks": self.visible_streaks,
        }

    @property
    def caption(self) -> str:
        """Line that states what can be seen."""
        if self.intensity_mm_h == 0:
            return "no rain"
        streaks = f"{self.visible_streaks:,} of {self.streaks_drawn:,} streaks"
        return f"change {self.mean_change:.2f} of 255, seen in {self.visible_share:.1%} of pixels, {streaks}"


def write_sheet(
    renderer: Renderer,
    sequences: Mapping[str, FrameSequence],
    intensities_mm_h: Sequence[float],
    path: Path,
    *,
    wet: bool | None = None,
) -> Generator[Progress, None, list[SheetCell]]:
    """Render the first frame of each view (`sequences` by name) in each intensity, and write the sheet.

    Each image is the one that `export_frames` writes of the view in that rain. Apart from their intensity, whose
    keyframes do not count, all have the rain, keyframes and seed of the view. Changes are those from 0 mm/h, which has
    the fog and the glass of the others. `wet` is the choice of `with_wet_choice` for each intensity.

    Yields progress before each image, and returns the cells. Raises OSError if the sheet can't be written.
    """
    cells: list[SheetCell] = []
    count = len(sequences) * len(intensities_mm_h)
    skies: dict[float, SkyColor] = {}
    for view in sequences:
        clear = None
        for intensity in (0.0, *intensities_mm_h):
            yield Progress(len(cells) / count, f"{view} {intensity:g} mm/h".lstrip())
            rainy = {name: _at(each, intensity, wet) for name, each in sequences.items()}
            if intensity not in skies:
                skies[intensity] = common_sky(renderer, rainy)
            if clear is None:
                clear = rainy[view].image(renderer, 0, skies[intensity])
            else:
                cells.append(_cell(renderer, rainy[view], view, skies[intensity], clear))
    write_image(path, Image.fromarray(intensity_sheet(cells)))
    return cells


def _at(sequence: FrameSequence, intensity_mm_h: float, wet: bool | None) -> FrameSequence:
    rain = msgspec.structs.replace(sequence.rainfall.rain, intensity_mm_h=intensity_mm_h)
    return _in_rain(sequence, **msgspec.structs.asdict(with_wet_choice(rain, wet, intensity_mm_h)))


def _in_rain(sequence: FrameSequence, **changes: Any) -> FrameSequence:
    rainfall = sequence.rainfall
    rain = msgspec.structs.replace(rainfall.rain, **changes)
    weather = rainfall.weather.without("intensity_mm_h")
    return replace(sequence, rainfall=RainSimulation.start(rain, rainfall.calibration, weather))


def _cell(
    renderer: Renderer, sequence: FrameSequence, view: str, sky: SkyColor, clear: UInt8[np.ndarray, "h w 3"]
) -> SheetCell:
    intensity = sequence.rainfall.rain.intensity_mm_h
    image = sequence.image(renderer, 0, sky)
    streaks_drawn = streaks = 0
    if intensity > 0:
        streaks_drawn = renderer.statistics.drops_drawn
        changed = _visible_change(image, _in_rain(sequence, streaks=False).image(renderer, 0, sky))
        streaks = cv2.connectedComponents(changed.astype(np.uint8), connectivity=8)[0] - 1
    return SheetCell(
        view,
        intensity,
        image,
        float(np.abs(image.astype(np.int16) - clear).mean()),
        float(_visible_change(image, clear).mean()),
        streaks_drawn,
        streaks,
        provenance_of(sequence.frame_input(sequence.shot(0), sky)),
    )


def _visible_change(image: UInt8[np.ndarray, "h w 3"], other: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    return np.abs(image.astype(np.int16) - other).max(axis=2) > VISIBLE_LEVELS


# Drawing


def intensity_sheet(cells: Sequence[SheetCell]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw cells as a table: a row for each intensity, a column for each view, the numbers below each image.

    The lower right corner of each image enlarges a marked region: where the view's heaviest rain changes it most.
    """
    views = list(dict.fromkeys(cell.view for cell in cells))
    lines = max(len(_caption_lines(cell)) for cell in cells)  # the same in all columns, whose rows are side by side
    columns = [_column([cell for cell in cells if cell.view == view], lines) for view in views]
    sheet = Image.new("RGB", (sum(each.width for each in columns), max(each.height for each in columns)), _PAPER)
    left = 0
    for column in columns:
        sheet.paste(column, (left, 0))
        left += column.width
    return np.asarray(sheet)


def _caption_lines(cell: SheetCell) -> list[str]:
    """Wrap the words below an image to its width; the first line begins with the title."""
    width, font = cell.image.shape[1], ImageFont.load_default(_text_px(cell))
    lines = [_title(cell)]
    for word in cell.caption.split():
        longer = f"{lines[-1]} {word}".lstrip() if len(lines) > 1 or lines[0] != _title(cell) else lines[0] + word
        if font.getlength(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _title(cell: SheetCell) -> str:
    return f"{f'{cell.view}, ' if cell.view else ''}{cell.intensity_mm_h:g} mm/h  "


def _text_px(cell: SheetCell) -> int:
    return max(round(_TEXT_SHARE * cell.image.shape[1]), _TEXT_PX)


def _column(cells: Sequence[SheetCell], lines: int) -> Image.Image:
    """Draw the cells of one view below each other, with room for so many lines of text below each."""
    height, width = cells[0].image.shape[:2]
    text = _text_px(cells[0])
    line = text + text // 4
    gap, row = text // 2, height + 3 * text + (lines - 1) * line
    font = ImageFont.load_default(text)
    column = Image.new("RGB", (width + 2 * gap, len(cells) * row + gap), _PAPER)
    draw = ImageDraw.Draw(column)
    region = _changed_region(cells)
    for place, cell in enumerate(cells):
        top = gap + place * row
        column.paste(Image.fromarray(_with_close_up(cell.image, region)), (gap, top))
        title, below = _title(cell), top + height + gap
        first, *others = _caption_lines(cell)
        draw.text((gap, below), title, _INK, font)
        draw.text((gap + font.getlength(title), below), first.removeprefix(title), _FAINT, font)
        for number, words in enumerate(others, start=1):
            draw.text((gap, below + number * line), words, _FAINT, font)
    return column


def _changed_region(cells: Sequence[SheetCell]) -> tuple[slice, slice]:
    """Rows and columns of the region that differs most between the lightest and the heaviest rain.

    Regions that the enlargement would cover are left out.
    """
    lightest, heaviest = (
        pick(cells, key=lambda cell: cell.intensity_mm_h).image.astype(np.float32) for pick in (min, max)
    )
    height, width = lightest.shape[:2]
    tall, wide = height // _CLOSE_UP, width // _CLOSE_UP
    change = np.abs(heaviest - lightest).mean(axis=2)
    sums = cv2.boxFilter(change, -1, (wide, tall), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
    sums = sums[: height - tall + 1, : width - wide + 1]
    sums[height - (_ENLARGED + 1) * tall :, width - (_ENLARGED + 1) * wide :] = -1
    top, left = np.unravel_index(int(sums.argmax()), sums.shape)
    return slice(int(top), int(top) + tall), slice(int(left), int(left) + wide)


def _with_close_up(image: UInt8[np.ndarray, "h w 3"], region: tuple[slice, slice]) -> UInt8[np.ndarray, "h w 3"]:
    enlarged = image[region].repeat(_ENLARGED, axis=0).repeat(_ENLARGED, axis=1)
    marked = image.copy()
    height, width = enlarged.shape[:2]
    marked[-height:, -width:] = enlarged
    rows, columns = region
    line = max(image.shape[1] // 480, 1)
    right, bottom = image.shape[1] - 1, image.shape[0] - 1
    cv2.rectangle(marked, (columns.start, rows.start), (columns.stop, rows.stop), _MARK, line)
    cv2.rectangle(marked, (right - width, bottom - height), (right, bottom), _MARK, line)
    return marked
