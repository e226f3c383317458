"""Figures of detection in rain: confidence, IoU and mAP by rain rate with bands over seeds, and sheets of views."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from typing import Literal, TypeVar

import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from PIL import Image, ImageDraw, ImageFont

from ...report.charts import SeriesStyle, series_styles
from ...report.interval import Interval
from ...safe_io.text_files import figure_words
from .drawing import draw_boxes
from .ground_truth import BoxXYXY
from .run import EvaluatedImage, ObjectRow
from .summary import ScoreByIntensity, is_misclassified

MAX_OBJECTS = 8  # maximum number of drawn objects: those with the most frames, ties by distance
_WIDTH_IN, _HEIGHT_IN, _DPI = 5.4, 3.9, 150

_WORDS = {"confidence": "confidence of the match (missed: 0)", "iou": "IoU of the match (missed: 0)"}
_LINES_PER_IN = 5.4  # legend lines per inch at 8 points
_LEGEND_IN = 2.1  # width in inches of a legend column at 8 points
_MAX_PANELS = 4  # maximum number of panels per row; further detectors continue in the next row
_Line = TypeVar("_Line", ObjectRow, ScoreByIntensity)


def object_figure(rows: Sequence[ObjectRow], number: Literal["confidence", "iou"]) -> Figure:
    """Draw a metric against the rain rate, with a curve for each object and a panel for each detector.

    For several object classes, a second block of panels has a curve for each class. A point is the mean over frames and
    seeds, a band spans the lowest to the highest per-seed mean over frames. If both exist, a cross marks the original
    photograph, and the curve starts at its reconstruction. Triangles mark the confidence of another class than its own.
    """
    objects = plotted_objects(rows)
    classes = {
        name: f"{figure_words(name, 20)}, {_mean_label([row for row in rows if row.class_name == name])}"
        for name in sorted({row.class_name for row in rows})
    }
    blocks = [("object", objects), ("class_name", classes)] if len(classes) > 1 else [("object", objects)]
    detectors = list(dict.fromkeys(row.detector for row in rows))
    columns = min(len(detectors), _MAX_PANELS)
    lines = ceil(len(detectors) / columns)
    height = lines * _HEIGHT_IN
    legend_in = _LEGEND_IN * max(_legend_columns(len(names) + 1, height) for _, names in blocks)
    figure = Figure(figsize=(_WIDTH_IN * columns + legend_in, height * len(blocks)), layout="constrained")
    parts: list[SubFigure] = list(figure.subfigures(len(blocks), 1, squeeze=False).ravel())
    for part, (field, names) in zip(parts, blocks, strict=True):
        grid: list[Axes] = list(np.ravel(part.subplots(lines, columns, sharey=True)))
        styles = series_styles(len(names))
        for place, (panel, detector) in enumerate(zip(grid, detectors, strict=False)):
            own = [row for row in rows if row.detector == detector]
            for style, name in zip(styles, names, strict=True):
                curve = [row for row in own if getattr(row, field) == name]
                _band(panel, *_over_seeds(curve, number), style, names[name])
                if number == "confidence" and field == "object":
                    _draw_other_classes(panel, curve, style)
                originals = [getattr(row, number) for row in curve if row.picture == "original"]
                if originals and any(row.picture == "clear" for row in curve):
                    panel.plot([0], [float(np.mean(originals))], "x", color=style.color, markersize=7, clip_on=False)
            intensities, spreads = _over_seeds(own, number)
            means = [each.value for each in spreads]
            panel.plot(intensities, means, "--", color="black", linewidth=1.8, label=_mean_label(own))
            _dress(panel, figure_words(detector), _WORDS[number] if place % columns == 0 else "")
        for panel in grid[len(detectors) :]:
            panel.set_axis_off()
        _legend_at_right(part, grid[0], height)
    return figure


def _draw_other_classes(panel: Axes, rows: Sequence[ObjectRow], style: SeriesStyle) -> None:
    """Mark, by rain rate, the mean confidence with which an object was taken for another class, and that class."""
    found: dict[tuple[str, float], list[float]] = defaultdict(list)
    for row in rows:
        if row.picture != "original" and is_misclassified(row):
            found[str(row.class_seen), row.intensity_mm_h].append(row.confidence_any_class)
    for name in sorted({name for name, _ in found}):
        points = sorted(
            (intensity, float(np.mean(each))) for (other, intensity), each in found.items() if other == name
        )
        panel.plot(*zip(*points, strict=True), "v:", color=style.color, markersize=6, linewidth=1, clip_on=False)
        panel.annotate(
            f"as {figure_words(name, 16)}",
            points[-1],
            (0, 6),
            textcoords="offset points",
            ha="right",
            color=style.color,
        )


def precision_figure(scores: Sequence[ScoreByIntensity]) -> Figure:
    """Draw mAP and mAP50 of each detector against the rain rate, with the range over the seeds."""
    detectors = list(dict.fromkeys(each.detector for each in scores))
    entries = len(detectors) + len({each.detector for each in scores if each.picture == "original"})
    legend_in = _LEGEND_IN * _legend_columns(entries, _HEIGHT_IN)
    figure = Figure(figsize=(2 * _WIDTH_IN + legend_in, _HEIGHT_IN), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, 2, sharey=True))
    for panel, number in zip(panels, ("map", "map50"), strict=True):
        for style, detector in zip(series_styles(len(detectors)), detectors, strict=True):
            own = [each for each in scores if each.detector == detector]
            drawn = _one_without_rain(own)
            spreads: list[Interval] = [getattr(each, number) for each in drawn]
            _band(panel, [each.intensity_mm_h for each in drawn], spreads, style, figure_words(detector, 28))
            for each in own:
                if each not in drawn:
                    label = f"{figure_words(detector, 28)}, pictures as taken"
                    panel.plot([0], [getattr(each, number).value], "x", color=style.color, label=label)
        _dress(panel, "", {"map": "mAP", "map50": "mAP50"}[number])
    _legend_at_right(figure, panels[0], _HEIGHT_IN)
    return figure


def figure_pixels(figure: Figure) -> UInt8[np.ndarray, "h w 3"]:
    """Return a figure as an image, deterministically."""
    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def plotted_objects(rows: Sequence[ObjectRow]) -> dict[str, str]:
    """The objects to draw with their legend labels, those with the most frames first, ties by distance."""
    frames: dict[str, set[str]] = defaultdict(set)
    distances: dict[str, list[float]] = defaultdict(list)
    classes: dict[str, str] = {}
    for row in rows:
        frames[row.object].add(row.frame)
        classes[row.object] = row.class_name
        distances[row.object].append(np.inf if row.distance_m is None else row.distance_m)
    middle = {name: float(np.median(each)) for name, each in distances.items()}
    best = sorted(frames, key=lambda name: (-len(frames[name]), middle[name], name))[:MAX_OBJECTS]
    labels: dict[str, str] = {}
    for name in best:
        short = name if len(name) <= 14 else f"{name[:6]}..{name[-6:]}"
        distance = f", {middle[name]:.0f} m" if np.isfinite(middle[name]) else ""
        count = f"{len(frames[name])} frame{'s' if len(frames[name]) > 1 else ''}"
        labels[name] = f"{figure_words(short)}: {figure_words(classes[name], 20)}{distance}, {count}"
    return labels


def _one_without_rain(lines: Sequence[_Line]) -> list[_Line]:
    """Keep one kind of images at 0 mm/h: the one that differs from the others by rain alone."""
    has_clear = any(each.picture == "clear" for each in lines)
    return [each for each in lines if not (has_clear and each.picture == "original")]


def _over_seeds(rows: Sequence[ObjectRow], number: str) -> tuple[list[float], list[Interval]]:
    """Rain rates, and the spread over seeds of a number's mean at each; without rain, of one kind of images."""
    by_intensity: dict[float, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in _one_without_rain(rows):
        by_intensity[row.intensity_mm_h][row.seed].append(getattr(row, number))
    intensities = sorted(by_intensity)
    return intensities, [
        Interval.spread([float(np.mean(each)) for each in by_intensity[r].values()], "rain seeds") for r in intensities
    ]


def _mean_label(rows: Sequence[ObjectRow]) -> str:
    count = len({row.object for row in rows})
    return f"mean of {count} object{'' if count == 1 else 's'}"


def _legend_columns(entries: int, height_in: float) -> int:
    return max(1, ceil(entries / max(1, int(height_in * _LINES_PER_IN))))


def _legend_at_right(figure: Figure | SubFigure, panel: Axes, height_in: float) -> None:
    """Put a panel's legend in 8 points to the right of all panels, in as many columns as its entries need."""
    handles, labels = panel.get_legend_handles_labels()
    columns = _legend_columns(len(labels), height_in)
    figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=8, ncols=columns)


def _band(panel: Axes, x: Sequence[float], spreads: Sequence[Interval], style: SeriesStyle, label: str) -> None:
    lows, highs = [each.low for each in spreads], [each.high for each in spreads]
    panel.fill_between(x, lows, highs, color=style.color, alpha=style.band, linewidth=0)
    panel.plot(
        x, [each.value for each in spreads], linestyle=style.line, marker=style.marker, color=style.color,
        markersize=3.5, linewidth=1.4, label=label,
    )  # fmt: skip


def _dress(panel: Axes, title: str, words: str) -> None:
    panel.set_title(title, fontsize=10)
    panel.set_xlabel("rain intensity (mm/h)")
    panel.set_ylabel(words)
    panel.set_ylim(-0.02, 1.02)
    panel.grid(alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)


# Detection sheet

WIDEST_PX = 1920
_NARROWEST_PX = 240  # minimum width of an image; images that don't fit side by side continue below
MIN_DRAWN_CONFIDENCE = 0.25  # confidence from which a detection is drawn and counts as found
_GAP_PX, _LINE_PX, _TEXT_PX = 6, 26, 16
_PAPER, _INK, _FAINT = (24, 25, 28), (232, 232, 236), (160, 162, 170)
_SHEET_WORDS = {"original": "as taken", "clear": "without rain"}


def detection_sheet(
    pictures: Sequence[EvaluatedImage], titles: Sequence[str] = (), max_columns: int = 100
) -> UInt8[np.ndarray, "h w 3"]:
    """Lay the images of one view side by side, with a row of detections and misses for each detector.

    Further conditions continue below in blocks of rows. Width and height are even, as videos require; at most 1920 px
    wide. Without `titles`, images are titled by their weather.
    """
    first, detectors = pictures[0], list(pictures[0].judgements)
    columns = min(len(pictures), (WIDEST_PX - _GAP_PX) // (_NARROWEST_PX + _GAP_PX), max_columns)
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
        weather = _SHEET_WORDS.get(picture.trial.kind) or f"{picture.trial.intensity_mm_h:g} mm/h"
        draw.text((left, line * block + 4), titles[place] if titles else weather, _INK, font)
        for row, detector in enumerate(detectors):
            top = line * block + _LINE_PX + row * (_LINE_PX + tall + _GAP_PX)
            judgement = picture.judgements[detector]
            found = sum(match.confidence >= MIN_DRAWN_CONFIDENCE for match in judgement.matches)
            draw.text((left, top + 2), f"{detector}: {found} of {len(judgement.truths)} found", _FAINT, font)
            sheet.paste(Image.fromarray(_cell(picture, detector, (wide, tall))), (left, top + _LINE_PX))
    return np.asarray(sheet)


def _cell(picture: EvaluatedImage, detector: str, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """Image resized for the sheet, with boxes drawn at that size for legibility."""
    image, judgement = picture.image, picture.judgements[detector]
    scale = size[0] / image.shape[1]
    if scale != 1:
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    truths = [replace(each, box_xyxy=_scaled(each.box_xyxy, scale)) for each in judgement.truths]
    detections = [replace(each, box_xyxy=_scaled(each.box_xyxy, scale)) for each in judgement.detections]
    return draw_boxes(image, truths, detections, MIN_DRAWN_CONFIDENCE)


def _scaled(box: BoxXYXY, scale: float) -> BoxXYXY:
    left, top, right, bottom = box
    return scale * left, scale * top, scale * right, scale * bottom
