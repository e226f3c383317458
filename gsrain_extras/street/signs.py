"""Traffic signs with pictures that are drawn from strokes and shapes: stop, speed limits, crossings, bus stops.

A picture is a function of points on the sign's face, u to the right and v up, from -0.5 to 0.5 of its size.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.labels import Label

from .layout import CURB_HEIGHT_M, Color
from .mesh import Quads, patch, tube

Picture = Callable[[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]], Float64[np.ndarray, "n 3"]]

RED: Color = (0.50, 0.012, 0.016)
WHITE: Color = (0.76, 0.76, 0.75)
BLACK: Color = (0.022, 0.022, 0.023)
BLUE: Color = (0.010, 0.075, 0.36)
YELLOW: Color = (0.72, 0.47, 0.02)
GREEN: Color = (0.010, 0.19, 0.06)
_STEEL: Color = (0.24, 0.245, 0.25)
_BACK: Color = (0.30, 0.30, 0.31)
_BEFORE_POLE_M = 0.065
_CELL_M, _BACK_CELLS = 0.019, 8

# Letters
# Strokes through points of a box that is 1 high; arcs are (center u, center v, radius u, radius v, from, to) in turns.

Stroke = Sequence[tuple[float, float]]


def _arc(u: float, v: float, ru: float, rv: float, start: float, stop: float) -> Stroke:
    angle = 2 * np.pi * np.linspace(start, stop, 13)
    return [(u + ru * float(np.cos(a)), v + rv * float(np.sin(a))) for a in angle]


_LETTERS: dict[str, tuple[float, Sequence[Stroke]]] = {
    "S": (0.58, [[*_arc(0.29, 0.735, 0.22, 0.20, 0.08, 0.5), *_arc(0.29, 0.735, 0.22, 0.235, 0.5, 0.75),
                  *_arc(0.29, 0.265, 0.23, 0.235, 0.25, 0.0), *_arc(0.29, 0.265, 0.23, 0.20, 0.0, -0.42)]]),
    "T": (0.56, [[(0.05, 0.935), (0.51, 0.935)], [(0.28, 0.935), (0.28, 0.065)]]),
    "O": (0.62, [_arc(0.31, 0.5, 0.22, 0.435, 0.0, 1.0)]),
    "P": (0.58, [[(0.10, 0.065), (0.10, 0.935), (0.30, 0.935), *_arc(0.30, 0.715, 0.20, 0.22, 0.25, -0.25),
                  (0.10, 0.495)]]),
    "H": (0.62, [[(0.10, 0.065), (0.10, 0.935)], [(0.52, 0.065), (0.52, 0.935)], [(0.10, 0.5), (0.52, 0.5)]]),
    "0": (0.60, [_arc(0.30, 0.5, 0.21, 0.435, 0.0, 1.0)]),
    "1": (0.40, [[(0.08, 0.74), (0.26, 0.935), (0.26, 0.065)]]),
    "3": (0.58, [[*_arc(0.27, 0.725, 0.21, 0.21, 0.42, -0.25), *_arc(0.27, 0.275, 0.23, 0.225, 0.25, -0.42)]]),
    "4": (0.62, [[(0.42, 0.065), (0.42, 0.935), (0.08, 0.30), (0.56, 0.30)]]),
    "5": (0.58, [[(0.48, 0.935), (0.14, 0.935), (0.11, 0.53), *_arc(0.28, 0.33, 0.22, 0.265, 0.30, -0.42)]]),
    "Z": (0.58, [[(0.08, 0.935), (0.50, 0.935), (0.08, 0.065), (0.50, 0.065)]]),
    " ": (0.30, []),
}  # fmt: skip
"""Advance in heights, and strokes."""


def lettering(
    u: Float64[np.ndarray, " n"], v: Float64[np.ndarray, " n"], text: str, height: float, weight: float = 0.13
) -> Float64[np.ndarray, " n"]:
    """Signed distance to centered letters, in sign sizes; `weight` is the strokes' width in heights of letters."""
    advances = [_LETTERS[each][0] for each in text]
    distance = np.full(len(u), 9.0)
    start = -0.5 * sum(advances)
    for each, advance in zip(text, advances, strict=True):
        for stroke in _LETTERS[each][1]:
            points = (np.array(stroke) + [start, -0.5]) * height
            distance = np.minimum(distance, _to_path(u, v, points))
        start += advance
    return distance - 0.5 * weight * height


def _to_path(
    u: Float64[np.ndarray, " n"], v: Float64[np.ndarray, " n"], path: Float64[np.ndarray, "m 2"]
) -> Float64[np.ndarray, " n"]:
    """Distance to a line through points."""
    p, a, along = np.stack([u, v], axis=1)[:, None], path[:-1], np.diff(path, axis=0)
    t = np.clip(np.sum((p - a) * along, axis=2) / np.maximum(np.sum(along**2, axis=1), 1e-12), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * along, axis=2).min(axis=1)


# Pictures


def _inked(
    ground: Float64[np.ndarray, "n 3"], distance: Float64[np.ndarray, " n"], color: Color, soft: float
) -> Float64[np.ndarray, "n 3"]:
    """Cover a ground with a color where a signed distance is negative, with smooth edges."""
    share = np.clip(0.5 - distance / soft, 0, 1)[:, None]
    return ground + share * (np.array(color) - ground)


def octagon(u: Float64[np.ndarray, " n"], v: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Signed distance to a regular octagon of size 1."""
    diagonal = (np.abs(u) + np.abs(v)) / np.sqrt(2)
    return np.maximum(np.maximum(np.abs(u), np.abs(v)), diagonal) - 0.5


def stop_sign(u: Float64[np.ndarray, " n"], v: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
    color = _inked(np.full((len(u), 3), WHITE), octagon(u, v) + 0.030, RED, 0.02)
    return _inked(color, lettering(u, v, "STOP", 0.345), WHITE, 0.02)


def speed_limit(text: str) -> Picture:
    def picture(u: Float64[np.ndarray, " n"], v: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        color = _inked(np.full((len(u), 3), WHITE), np.abs(np.hypot(u, v) - 0.425) - 0.062, RED, 0.02)
        return _inked(color, lettering(u, v, text, 0.46, 0.15), BLACK, 0.02)

    return picture


def crossing_sign(u: Float64[np.ndarray, " n"], v: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
    """A person who walks on stripes, in a white triangle on blue."""
    color = _inked(np.full((len(u), 3), WHITE), np.maximum(np.abs(u), np.abs(v)) - 0.475, BLUE, 0.02)
    slope = np.array([np.cos(np.radians(30)), np.sin(np.radians(30))])
    triangle = np.maximum(np.abs(u) * slope[0] + (v - 0.06) * slope[1] - 0.19, -v - 0.335)
    color = _inked(color, triangle, WHITE, 0.02)
    figure = np.hypot(u - 0.005, v - 0.235) - 0.042
    for path, width in (
        ([(0.0, 0.17), (0.01, -0.02)], 0.042), ([(0.01, -0.02), (0.085, -0.12), (0.075, -0.22)], 0.026),
        ([(0.01, -0.02), (-0.04, -0.12), (-0.12, -0.20)], 0.026), ([(-0.01, 0.15), (0.09, 0.05)], 0.018),
        ([(0.0, 0.15), (-0.09, 0.06), (-0.10, -0.01)], 0.018),
    ):  # fmt: skip
        figure = np.minimum(figure, _to_path(u, v, np.array(path)) - width)
    for k in range(4):
        bar = np.maximum(np.abs(u - 0.13 * (k - 1.5)) - 0.036, np.abs(v + 0.275) - 0.030)
        figure = np.minimum(figure, bar)
    return _inked(color, figure, BLACK, 0.018)


def bus_stop_sign(u: Float64[np.ndarray, " n"], v: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
    """A green H in a green ring on yellow."""
    color = _inked(np.full((len(u), 3), YELLOW), np.abs(np.hypot(u, v) - 0.43) - 0.055, GREEN, 0.02)
    return _inked(color, lettering(u, v, "H", 0.44, 0.17), GREEN, 0.02)


# Faces


def sign_on_pole(
    x: float, y: float, z: float, size: float, picture: Picture, facing: int, outline: str = "square"
) -> Quads:
    """Build a sign with its middle at z above the sidewalk, on its own pole, that faces along +x (1) or -x (-1).

    The outline is square, round or octagon.
    """
    height = z + 0.30 * size
    levels = np.concatenate([[0.0, 0.06, 0.14], np.arange(0.3, height - 0.1, 0.32), [height]])
    path = np.stack([np.full_like(levels, x), np.full_like(levels, y), CURB_HEIGHT_M + levels], axis=1)
    pole = tube(path, np.full(len(levels), 0.033), _STEEL, Label.POLE, sides=7, gloss=0.06)
    face = sign_face(size, picture, outline)
    front = face.placed((-_BEFORE_POLE_M, 0, 0), 0.0) if facing < 0 else face.placed((0, 0, 0), 180.0).placed(
        (_BEFORE_POLE_M, 0, 0))  # fmt: skip
    return Quads.joined([pole, front.placed((x, y, CURB_HEIGHT_M + z))])


def sign_face(size: float, picture: Picture, outline: str) -> Quads:
    """Build a sign's face with its gray back, around the origin; it faces along -x, with u along -y."""
    face = _grid(size, outline, max(8, round(size / _CELL_M / 2) * 2))
    middle = face.centers.astype(np.float64) / size
    colors = np.clip(picture(-middle[:, 1], middle[:, 2]), 0, 0.95)
    face = Quads.of(face.corners, colors, Label.SIGN, spread=face.spread, gloss=0.03)
    rear = _grid(size, outline, _BACK_CELLS)
    corners = rear.corners[:, ::-1] + np.array([0.012, 0, 0], np.float32)
    return Quads.joined([face, Quads.of(corners, _BACK, Label.SIGN, spread=rear.spread)])


def _grid(size: float, outline: str, count: int) -> Quads:
    """Cells of a face, about `count` across."""
    if outline == "square":
        lines = np.linspace(-0.5, 0.5, count + 1)
        u, v = np.broadcast_arrays(lines[:, None], lines)
    else:
        # Rings of cells, narrow enough for strokes.
        turn = 2 * np.pi * np.linspace(0, 1, 8 * round(np.pi * count / 8) + 1)
        reach = np.full_like(turn, 0.5)
        if outline == "octagon":
            reach = 0.5 / np.cos((turn + np.pi / 8) % (np.pi / 4) - np.pi / 8)
        radii = np.linspace(0, 1, count // 2 + 1)
        u, v = reach[:, None] * np.cos(turn)[:, None] * radii, reach[:, None] * np.sin(turn)[:, None] * radii
        u, v = u[::-1], v[::-1]
    points = size * np.stack([np.zeros_like(u), -u, v], axis=2)
    return patch(points, 0.0, Label.SIGN, closed=outline != "square")
