"""One view in all its weathers, with what each detector found there: a picture for reports and videos."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from .drawing import drawn
from .sweep import JudgedPicture
from .truth import BoxXYXY

WIDEST_PX = 1920
_NARROWEST_PX = 240
"""Of a picture; where so many don't fit side by side, they go on below."""
SHOWN_FROM = 0.25
"""Confidence from which a detection is drawn, and counts as found."""

_GAP_PX, _LINE_PX, _TEXT_PX = 6, 26, 16
_PAPER, _INK, _FAINT = (24, 25, 28), (232, 232, 236), (160, 162, 170)
_WORDS = {"original": "as taken", "clear": "without rain"}


def detection_sheet(pictures: Sequence[JudgedPicture]) -> UInt8[np.ndarray, "h w 3"]:
    """Lay the pictures of one view side by side, a row for each detector: what it found, what it missed.

    Pictures of many weathers go on below in as many blocks of rows. Width and height are even, as videos need them; at
    most 1920 px wide.
    """
    first = pictures[0]
    columns, detectors = min(len(pictures), (WIDEST_PX - _GAP_PX) // (_NARROWEST_PX + _GAP_PX)), list(first.judgements)
    wide = min(first.image.shape[1], (WIDEST_PX - (columns + 1) * _GAP_PX) // columns)
    tall = round(wide * first.image.shape[0] / first.image.shape[1])
    width = columns * (wide + _GAP_PX) + _GAP_PX
    block = _LINE_PX + len(detectors) * (_LINE_PX + tall + _GAP_PX)
    height = block * ceil(len(pictures) / columns)
    sheet = Image.new("RGB", (width + width % 2, height + height % 2), _PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(_TEXT_PX)
    for place, picture in enumerate(pictures):
        line, column = divmod(place, columns)
        left = _GAP_PX + column * (wide + _GAP_PX)
        draw.text((left, line * block + 4), _weather(picture), _INK, font)
        for row, detector in enumerate(detectors):
            top = line * block + _LINE_PX + row * (_LINE_PX + tall + _GAP_PX)
            judgement = picture.judgements[detector]
            found = sum(match.confidence >= SHOWN_FROM for match in judgement.matches)
            draw.text((left, top + 2), f"{detector}: {found} of {len(judgement.truths)} found", _FAINT, font)
            sheet.paste(Image.fromarray(_cell(picture, detector, (wide, tall))), (left, top + _LINE_PX))
    return np.asarray(sheet)


def _cell(picture: JudgedPicture, detector: str, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """Picture in its size on the sheet, and boxes drawn in that size, so that they can be read."""
    judgement, scale = picture.judgements[detector], size[0] / picture.image.shape[1]
    image = picture.image
    if scale != 1:
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    truths = [replace(each, box_xyxy=_scaled(each.box_xyxy, scale)) for each in judgement.truths]
    detections = [replace(each, box_xyxy=_scaled(each.box_xyxy, scale)) for each in judgement.detections]
    return drawn(image, truths, detections, SHOWN_FROM)


def _scaled(box: BoxXYXY, scale: float) -> BoxXYXY:
    left, top, right, bottom = box
    return scale * left, scale * top, scale * right, scale * bottom


def _weather(picture: JudgedPicture) -> str:
    trial = picture.trial
    return _WORDS.get(trial.kind) or f"{trial.intensity_mm_h:g} mm/h"
