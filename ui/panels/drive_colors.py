"""Colours of roll-outs in plots and lists: by their rain, from amber (dry) to violet (12 mm/h and more)."""

from collections.abc import Sequence
from itertools import pairwise

from imgui_bundle import ImVec4

from gsrain_engine.session.drive.opened_rollout import OpenedRollout

_STOPS = ((0.0, (0.98, 0.74, 0.25)), (1.2, (0.45, 0.82, 0.45)), (8.5, (0.35, 0.68, 1.0)), (12.0, (0.78, 0.52, 1.0)))
_DARKER = 0.72
"""Each further one of the same rain."""
_FEW = 3


def curve_colors(opened: Sequence[OpenedRollout]) -> list[ImVec4]:
    """A colour for each, in their order."""
    colors: list[ImVec4] = []
    for number, each in enumerate(opened):
        alike = sum(other.intensity_mm_h == each.intensity_mm_h for other in opened[:number])
        red, green, blue = (part * _DARKER ** (alike % _FEW) for part in _rain_color(each.intensity_mm_h))
        colors.append(ImVec4(red, green, blue, 1.0))
    return colors


def _rain_color(intensity_mm_h: float) -> tuple[float, ...]:
    for (low, first), (high, second) in pairwise(_STOPS):
        if intensity_mm_h <= high:
            part = max(intensity_mm_h - low, 0.0) / (high - low)
            return tuple((1 - part) * a + part * b for a, b in zip(first, second, strict=True))
    return _STOPS[-1][1]
