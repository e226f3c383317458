"""Traffic lights at crossings: masts with arms over the lanes, heads with backplates and visors, and their lamps."""

from typing import Literal, NamedTuple

import numpy as np

from gsrain_engine.scene.labels import Label

from .layout import CROSSING_LENGTH_M, CURB_HEIGHT_M, Color, StreetLayout
from .mesh import EDGE_SPREAD, Quads, box, patch, tube

Aspect = Literal["red", "amber", "green"]

_HOUSING: Color = (0.014, 0.015, 0.015)
_MAST: Color = (0.11, 0.12, 0.118)
_BORDER: Color = (0.62, 0.62, 0.60)
_LENS_M = 0.105  # radius
_PITCH_M = 0.30  # between lamps
_ARM_M, _UPRIGHT_M, _WALK_M = 5.35, 3.2, 2.15
"""Heights of the middle of the heads above the lane, on the mast, and for pedestrians, above the sidewalk."""

_UNLIT: dict[Aspect, Color] = {
    "red": (0.075, 0.006, 0.005),
    "amber": (0.085, 0.036, 0.003),
    "green": (0.003, 0.038, 0.024),
}
SIGNAL_COLOR: dict[Aspect, Color] = {"red": (1.0, 0.035, 0.015), "amber": (1.0, 0.46, 0.02), "green": (0.02, 1.0, 0.36)}
"""Hue of lit lenses, linear."""
_BY_DAY = 1.9  # what a lit lens returns of the light on it: with this it is about white in the shade
_BY_NIGHT = 6.0  # its own light, relative to a camera's white


class SignalHead(NamedTuple):
    """A head with three lamps for vehicles, or two for pedestrians."""

    x: float
    y: float
    z: float
    """Middle, above the road."""
    turn_deg: float
    """0 for a head that faces -x."""
    lit: Aspect
    lamps: int = 3

    @property
    def aspects(self) -> tuple[Aspect, ...]:
        """Lights that its lenses show, from above."""
        return ("red", "amber", "green") if self.lamps == 3 else ("red", "green")

    @property
    def lamp_position(self) -> tuple[float, float, float]:
        """Middle of the lit lens."""
        up = _PITCH_M * (0.5 * (self.lamps - 1) - self.aspects.index(self.lit))
        turn = np.radians(self.turn_deg)
        return self.x - 0.12 * float(np.cos(turn)), self.y - 0.12 * float(np.sin(turn)), self.z + up

    @property
    def size_lwh(self) -> tuple[float, float, float]:
        """Of the housing with its backplate, in meters."""
        tall = _PITCH_M * self.lamps
        return (0.36, 0.54, tall + 0.22) if self.lamps == 3 else (0.36, 0.31, tall)

    @property
    def foot(self) -> tuple[float, float, float]:
        """Middle of the lower side."""
        return self.x, self.y, self.z - 0.5 * self.size_lwh[2]

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector to where it faces."""
        turn = np.radians(self.turn_deg)
        return -float(np.cos(turn)), -float(np.sin(turn)), 0.0


def _masts(layout: StreetLayout) -> list[tuple[float, float, int]]:
    """Foot (x, y) of each mast, and its side of the street (-1: right)."""
    y = layout.parameters.curb_y_m + 0.42
    return [
        mast
        for c in layout.signals
        for mast in ((c - 1.7, -y, -1), (c + CROSSING_LENGTH_M + 1.7, y, 1))
    ]  # fmt: skip


def signal_heads(layout: StreetLayout) -> list[SignalHead]:
    """Heads of all masts: green for the street, red for those who wait to cross it."""
    heads: list[SignalHead] = []
    for x, y, side in _masts(layout):
        turn = 0.0 if side < 0 else 180.0
        lane = side * 0.5 * layout.parameters.lane_width_m
        heads.append(SignalHead(x, lane, CURB_HEIGHT_M + _ARM_M, turn, "green"))
        heads.append(SignalHead(x, y, CURB_HEIGHT_M + _UPRIGHT_M, turn, "green"))
        across = 90.0 if side < 0 else -90.0  # towards those who wait on the other side
        heads.append(SignalHead(x, y - side * 0.02, CURB_HEIGHT_M + _WALK_M, -across, "red", 2))
    return heads


def build_signals(layout: StreetLayout) -> Quads:
    return Quads.joined(build_head(head) for head in signal_heads(layout))


def build_masts(layout: StreetLayout) -> Quads:
    return Quads.joined(_mast(layout, *mast) for mast in _masts(layout))


def _mast(layout: StreetLayout, x: float, y: float, side: int) -> Quads:
    """A mast whose arm bends over the lane, with a controller's door at its foot."""
    up = -side  # from the mast to the road
    behind = 0.16 if side < 0 else -0.16  # the mast stands behind its heads
    lane = side * 0.5 * layout.parameters.lane_width_m
    turn = np.linspace(0, 0.5 * np.pi, 8)
    top, bend = CURB_HEIGHT_M + _ARM_M + 0.12, 0.9
    straight = np.concatenate([[0.0, 0.08, 0.18], np.arange(0.5, top - bend, 0.4)])
    arc_y, arc_z = y + up * bend * (1 - np.cos(turn)), top - bend + bend * np.sin(turn)
    along_y = np.linspace(arc_y[-1], lane - up * -0.25, 8)[1:]
    path_y = np.concatenate([np.full_like(straight, y), arc_y, along_y])
    path_z = np.concatenate([straight, arc_z, np.full_like(along_y, top)])
    path = np.stack([np.full_like(path_y, x + behind), path_y, path_z], axis=1)
    radii = np.interp(np.arange(len(path)), [0, 2, len(straight), len(path)], [0.11, 0.085, 0.07, 0.045])
    mast = tube(path, radii, _MAST, Label.POLE, sides=9, gloss=0.08)
    door = box((x + behind - 0.075 * np.sign(behind), y, CURB_HEIGHT_M + 0.75), (0.02, 0.09, 0.34),
               (0.07, 0.075, 0.075),
               Label.POLE, coarse=0.2, faces="xXyYZz")  # fmt: skip
    return Quads.joined([mast, door])


# Heads


def build_head(head: SignalHead) -> Quads:
    """Build a head: housing, backplate with a light border, and lenses under visors."""
    tall = _PITCH_M * head.lamps
    parts = [_housing(tall)]
    if head.lamps == 3:
        parts.append(_backplate(tall + 0.22, 0.54))
    for k, aspect in enumerate(head.aspects):
        z = _PITCH_M * (0.5 * (head.lamps - 1) - k)
        parts += [_lens(aspect, aspect == head.lit).placed((-0.115, 0, z)), _visor().placed((-0.11, 0, z))]
    whole = Quads.joined(parts).placed((0, 0, 0), head.turn_deg)
    return whole.placed((head.x, head.y, head.z))


def _housing(tall: float) -> Quads:
    """A shell with round corners, open towards the lenses' plane, seen from all sides."""
    turn = np.linspace(0, 2 * np.pi, 29)
    y = 0.155 * np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** 0.45
    z = 0.5 * tall * np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** 0.22
    rows = [(0.10, 0.55), (0.095, 0.92), (0.06, 1.0), (-0.08, 1.0), (-0.105, 0.96)]
    rings = [
        np.stack([np.full_like(y, x), share * y, z - (1 - share) * 0.09 * np.sign(z)], axis=1) for x, share in rows
    ]
    points = np.stack(rings, axis=1)
    shell = patch(points[::-1], _HOUSING, Label.TRAFFIC_LIGHT, closed=True, gloss=0.05)
    lines_y, lines_z = np.linspace(-0.145, 0.145, 4), np.linspace(-0.485 * tall, 0.485 * tall, 10)
    face = np.stack(np.broadcast_arrays(-0.105, -lines_y[:, None], lines_z), axis=2)
    front = patch(face, (0.010, 0.0105, 0.0105), Label.TRAFFIC_LIGHT, sky_access=0.6)
    rear = patch(face[::-1] + [0.205, 0, 0], _HOUSING, Label.TRAFFIC_LIGHT, gloss=0.05)
    return Quads.joined([shell, front, rear])


def _backplate(tall: float, wide: float) -> Quads:
    border = 0.045
    y = np.concatenate([[-0.5 * wide], np.linspace(-0.5 * wide + border, 0.5 * wide - border, 5), [0.5 * wide]])
    z = np.concatenate([[-0.5 * tall], np.linspace(-0.5 * tall + border, 0.5 * tall - border, 9), [0.5 * tall]])
    points = np.stack(np.broadcast_arrays(0.02, -y[:, None], z), axis=2)
    front = patch(points, _HOUSING, Label.TRAFFIC_LIGHT, gloss=0.03)
    at = front.centers
    edge = (np.abs(at[:, 1]) > 0.5 * wide - border) | (np.abs(at[:, 2]) > 0.5 * tall - border)
    albedo = np.where(edge[:, None], _BORDER, front.albedo)
    front = Quads.of(front.corners, albedo, Label.TRAFFIC_LIGHT, spread=front.spread, gloss=0.03)
    back = patch(points[::-3, ::5] + [0.012, 0, 0], (0.03, 0.031, 0.031), Label.TRAFFIC_LIGHT)
    return Quads.joined([front, back])


def _lens(aspect: Aspect, lit: bool) -> Quads:
    """A convex disc; lit, it shines a little less at its rim."""
    turn = np.linspace(0, -2 * np.pi, 25)
    radii = _LENS_M * np.array([0.0, 0.3, 0.58, 0.82, 1.0])
    y, z = radii * np.sin(turn)[:, None], radii * np.cos(turn)[:, None]
    x = -0.02 * (1 - (radii / _LENS_M) ** 2)
    points = np.stack(np.broadcast_arrays(x[None], y, z), axis=2)
    lens = patch(points, 0.0, Label.TRAFFIC_LIGHT, closed=True)
    if not lit:
        return Quads.of(
            lens.corners, _UNLIT[aspect], Label.TRAFFIC_LIGHT, spread=lens.spread, gloss=0.07, sky_access=0.5
        )
    away = np.hypot(*lens.centers[:, 1:].T) / _LENS_M
    light = np.array(SIGNAL_COLOR[aspect]) + 0.10 * (1 - away[:, None])
    up = np.tile([0.0, 0.0, 1.0], (len(lens), 1))  # it shines by itself, in the shade as well
    return Quads.of(
        lens.corners, _BY_DAY * light * (1 - 0.3 * away**2)[:, None], Label.TRAFFIC_LIGHT, normals=up,
        spread=lens.spread, sun_access=0.0, emission=_BY_NIGHT * light * (1 - 0.4 * away**2)[:, None],
    )  # fmt: skip


def _visor() -> Quads:
    """A hood over a lens: the upper two thirds of a tube that is longer at its top."""
    turn = np.pi * np.linspace(-0.12, 1.12, 15)
    reach = 0.09 + 0.13 * np.clip(np.sin(turn), 0, 1) ** 0.7
    rows = np.linspace(0, 1, 4)
    radius = _LENS_M + 0.018
    x = -reach[:, None] * rows
    y, z = radius * np.cos(turn)[:, None], radius * np.sin(turn)[:, None]
    points = np.stack(np.broadcast_arrays(x, y, z), axis=2)
    spread = (0.6, EDGE_SPREAD)
    outside = patch(points, _HOUSING, Label.TRAFFIC_LIGHT, gloss=0.05, spread=spread)
    inside = patch((points * [1, 0.985, 0.985])[::-1], (0.008, 0.008, 0.008), Label.TRAFFIC_LIGHT, spread=spread,
                   sky_access=0.3)  # fmt: skip
    return Quads.joined([outside, inside])
