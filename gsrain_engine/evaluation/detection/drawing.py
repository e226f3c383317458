"""Ground-truth objects and detections drawn over an image, for figures and videos."""

from collections.abc import Callable, Sequence
from typing import NamedTuple
from zlib import crc32

import cv2
import numpy as np
from jaxtyping import UInt8

from .detector import Detection
from .metrics import LabeledBox, match_detections

Color = tuple[int, int, int]
Plate = tuple[int, int, int, int]  # left, top, right, bottom of a label's background, in pixels
_COLORS: dict[str, Color] = {
    "car": (86, 180, 233),
    "truck": (230, 159, 0),
    "bus": (240, 228, 66),
    "person": (0, 200, 140),
    "bicycle": (204, 121, 167),
    "motorcycle": (213, 94, 0),
    "traffic light": (190, 190, 190),
}
"""By class, distinguishable with any color vision (Okabe and Ito 2008)."""

_MISSED, _FOUND = (255, 60, 60), (255, 255, 255)
_SUBPIXEL_BITS = 4
_MIN_UNIT = 0.8  # minimum label scale, for legibility in small images


def draw_boxes(
    image: UInt8[np.ndarray, "h w 3"],
    truths: Sequence[LabeledBox],
    detections: Sequence[Detection],
    min_confidence: float = 0.25,
) -> UInt8[np.ndarray, "h w 3"]:
    """Return a copy with boxes and labels, which scale with the image.

    Detections of at least `min_confidence` are solid lines in their class color; ground-truth objects are dashed,
    white if detected with the right class, red if not.
    """
    picture = np.ascontiguousarray(image).copy()
    unit = max(_MIN_UNIT, picture.shape[0] / 720, picture.shape[1] / 1280)
    drawn = sorted((each for each in detections if each.confidence >= min_confidence), key=lambda d: -d.confidence)
    looked_for = list(zip(truths, match_detections(truths, drawn), strict=True))
    for truth, match in looked_for:
        _dashed(picture, truth.box_xyxy, _FOUND if match.confidence > 0 else _MISSED, unit)
    for each in reversed(drawn):
        corners = (each.box_xyxy[:2], each.box_xyxy[2:])
        _outlined(cv2.rectangle, picture, corners, class_color(each.class_name), unit)
    labels = [
        _Label(f"{each.class_name} {each.confidence:.2f}", each.box_xyxy, class_color(each.class_name))
        for each in drawn
    ]
    for truth, match in looked_for:
        if match.confidence == 0:
            text = f"{truth.class_name} " + (f"taken for {match.flipped_to}" if match.flipped_to else "missed")
            labels.append(_Label(text, truth.box_xyxy, _MISSED))
    _draw_labels(picture, labels, unit)
    return picture


def draw_truths(image: UInt8[np.ndarray, "h w 3"], truths: Sequence[LabeledBox]) -> UInt8[np.ndarray, "h w 3"]:
    """Return a copy with the boxes and classes of ground-truth objects, as full lines in their class colors."""
    picture = np.ascontiguousarray(image).copy()
    unit = max(_MIN_UNIT, picture.shape[0] / 720, picture.shape[1] / 1280)
    for each in truths:
        corners = (each.box_xyxy[:2], each.box_xyxy[2:])
        _outlined(cv2.rectangle, picture, corners, class_color(each.class_name), unit)
    labels = [_Label(each.class_name, each.box_xyxy, class_color(each.class_name)) for each in truths]
    _draw_labels(picture, labels, unit)
    return picture


def class_color(class_name: str) -> Color:
    """Fixed color of a class (RGB)."""
    known = tuple(_COLORS.values())
    return _COLORS.get(class_name) or known[crc32(class_name.encode()) % len(known)]


def _dashed(picture: np.ndarray, box: Sequence[float], color: Color, unit: float) -> None:
    left, top, right, bottom = box
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        length = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
        count = max(1, round(length / (2 * 8 * unit)))
        for number in range(count):
            first, last = (number + 0.25) / count, (number + 0.75) / count
            pieces = [[a + (b - a) * share for a, b in zip(start, end, strict=True)] for share in (first, last)]
            _outlined(cv2.line, picture, pieces, color, unit)


def _outlined(
    draw: Callable[..., object], picture: np.ndarray, ends: Sequence[Sequence[float]], color: Color, unit: float
) -> None:
    """Draw a rectangle or a line with a dark outline. OpenCV's (0, 0) is the center of the first pixel."""
    fixed = [[round((value - 0.5) * 2**_SUBPIXEL_BITS) for value in point] for point in ends]
    for shade, extra in (((0, 0, 0), 2), (color, 0)):
        draw(picture, *fixed, shade, max(1, round(2 * unit)) + extra, cv2.LINE_AA, _SUBPIXEL_BITS)


# Labels


class _Label(NamedTuple):
    """Words about a box."""

    text: str
    box_xyxy: Sequence[float]
    color: Color


def _draw_labels(picture: np.ndarray, labels: Sequence[_Label], unit: float) -> None:
    """Write labels near their boxes, none over another; a line leads from a distant one to its box.

    If the image has no free place left, a label is left out.
    """
    scale, thickness, pad = 0.5 * unit, max(1, round(unit)), max(2, round(4 * unit))
    placed: list[tuple[_Label, Plate, int]] = []
    for label in labels:
        (width, height), base = cv2.getTextSize(label.text, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
        size = width + 2 * pad, height + base // 2 + 2 * pad
        plate = free_plate(label.box_xyxy, size, [each for _, each, _ in placed], picture.shape)
        if plate is not None:
            placed.append((label, plate, plate[1] + pad + height))
    for label, plate, _ in placed:
        if not _overlap(plate, [round(each) for each in label.box_xyxy], margin=1):
            _outlined(cv2.line, picture, _shortest(plate, label.box_xyxy), label.color, unit / 2)
    for label, plate, bottom in placed:
        cv2.rectangle(picture, plate[:2], (plate[2] - 1, plate[3] - 1), label.color, cv2.FILLED)
        ink = (0, 0, 0) if np.dot(label.color, (0.299, 0.587, 0.114)) > 110 else (255, 255, 255)
        place = plate[0] + pad, bottom
        cv2.putText(picture, label.text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, thickness, cv2.LINE_AA)


def free_plate(
    box: Sequence[float], size: tuple[int, int], others: Sequence[Plate], shape: Sequence[int]
) -> Plate | None:
    """Return the place of a label of a size: above its box, else below or inside, else the nearest free one.

    `size` is width and height, `others` are places of labels, `shape` is that of the image. None if nothing is free.
    """
    width, height = size
    last_left, last_top = shape[1] - width, shape[0] - height
    left = int(np.clip(round(box[0]), 0, max(0, last_left)))
    tops = [round(box[1]) - height, round(box[3]), round(box[1])]
    places = [(left, top) for top in tops if 0 <= top <= last_top] or [(left, max(0, round(box[1])))]
    first = places[0]
    steps = range(0, last_top + 1, max(1, height // 4)), range(0, last_left + 1, max(1, height))
    grid = [(column, top) for top in steps[0] for column in (*steps[1], left)]
    grid.sort(key=lambda place: np.hypot(place[0] - first[0], place[1] - first[1]))
    for at in (*places, *grid):
        plate = at[0], at[1], at[0] + width, at[1] + height
        if not any(_overlap(plate, other) for other in others):
            return plate
    return None


def _overlap(first: Sequence[int], second: Sequence[int], margin: int = 0) -> bool:
    return (
        first[0] < second[2] + margin and second[0] < first[2] + margin
        and first[1] < second[3] + margin and second[1] < first[3] + margin
    )  # fmt: skip


def _shortest(plate: Plate, box: Sequence[float]) -> list[tuple[float, float]]:
    """Ends of the shortest line from a plate to a box."""
    ends: list[tuple[float, float]] = []
    for low, high, other_low, other_high in (
        (plate[0], plate[2], box[0], box[2]),
        (plate[1], plate[3], box[1], box[3]),
    ):
        middle = (max(low, other_low) + min(high, other_high)) / 2
        ends.append((float(np.clip(middle, low, high)), float(np.clip(middle, other_low, other_high))))
    (x, other_x), (y, other_y) = ends
    return [(x, y), (other_x, other_y)]
