"""City buses: a shell with a band of windows, doors, a destination display, lamps, wheels and a lit interior.

The object frame has x forward, y left, z up, and its origin at the bottom center. Doors are on the right (y < 0).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.labels import Label

from .cars import HEAD_LIGHT, TAIL_LIGHT, build_wheel, wheel_wells
from .layout import BUS_LENGTH_M, BUS_WIDTH_M, Color, StreetLayout
from .mesh import Quads, box, broken_lines, patch, surface
from .signs import lettering
from .solids import mesh_solids, round_box

_GLASS: Color = (0.016, 0.018, 0.020)
_TRIM: Color = (0.020, 0.020, 0.022)
_ROOF: Color = (0.58, 0.58, 0.56)
_LAMP: Color = (0.80, 0.80, 0.78)
_RED_LAMP: Color = (0.34, 0.005, 0.005)
_AMBER: Color = (0.60, 0.19, 0.01)
_PLATE: Color = (0.78, 0.78, 0.74)
_PAINT_GLOSS, _GLASS_GLOSS = 0.15, 0.24
_ROOM_LIGHT = np.array([0.92, 0.84, 0.66])
"""Light of the interior through the windows by night."""
_DISPLAY_LIGHT = np.array([2.2, 0.95, 0.10])
_SMOOTH = 1.06


@dataclass(frozen=True, slots=True)
class BusForm:
    """The outline of a 12 m low-floor bus, in meters; x counts from the center."""

    length: float = BUS_LENGTH_M
    width: float = BUS_WIDTH_M
    height: float = 3.02
    sill: float = 0.30
    belt: float = 1.06
    """Lower edge of the windows."""
    top: float = 2.36
    """Upper edge of the windows."""
    wheels: tuple[float, float] = (-2.72, 3.18)
    wheel_radius: float = 0.48
    corner: float = 0.30
    doors: tuple[tuple[float, float], ...] = ((4.22, 5.42), (0.10, 1.40), (-4.60, -3.40))
    """Rear and front end of each door, on the right."""


BUS_FORM = BusForm()
BUS_SIZE_M = BUS_LENGTH_M + 0.1, BUS_WIDTH_M, 3.22
"""Length with bumpers, width, and height with the unit on the roof."""
DESTINATION = "100 ZOO"


def build_parked_buses(layout: StreetLayout) -> Quads:
    return Quads.joined(build_bus(each.paint).placed((each.x, each.y, 0.0), each.turn_deg) for each in layout.buses)


def build_bus(paint: Color) -> Quads:
    """Build a bus in the object frame, its lamps on."""
    form = BUS_FORM
    parts = [_shell(form, paint), _roof(form), *_wheels(form), *_details(form, paint)]
    whole = Quads.joined(parts)
    return replace(whole, labels=np.full(len(whole), Label.BUS, np.uint8), spread=_SMOOTH * whole.spread)


def headlight_places(form: BusForm = BUS_FORM) -> tuple[tuple[float, float, float], ...]:
    """Middle of the headlights: left, right."""
    return tuple((0.5 * form.length, side * 0.80, 0.70) for side in (1, -1))


# Shell

_LEVELS = (
    0.30, 0.40, 0.50, 0.56, 0.62, 0.78, 0.86, 0.98, 1.06, 1.12, 1.35, 1.62, 1.90, 2.14, 2.20, 2.30, 2.36, 2.42, 2.50,
    2.60, 2.70, 2.80, 2.90, 2.96, 3.00,
)  # fmt: skip
"""Heights of the rows of cells: narrow at color edges."""


def _plan(form: BusForm) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Outline from above, counter-clockwise from the middle of the rear, and the side of each point.

    Sides: 0 the rear, 1 the right flank, 2 the front, 3 the left flank; corners have values between.
    """
    half, long, r = 0.5 * form.width, 0.5 * form.length, form.corner
    breaks = {-long + r, long - r}
    for low, high in form.doors:
        breaks |= {low - 0.05, low, low + 0.06, 0.5 * (low + high) - 0.03, 0.5 * (low + high) + 0.03, high - 0.06, high,
                   high + 0.05}  # fmt: skip
    for axle in form.wheels:
        breaks |= set((axle + np.linspace(-0.56, 0.56, 13)).tolist())
    for at in _PILLARS:
        breaks |= {at - 0.035, at + 0.035}
    x = broken_lines(sorted(breaks), 0.34)
    x = x[np.concatenate([[True], np.diff(x) > 0.012])]
    turn = np.linspace(0, 0.5 * np.pi, 6)[1:-1]
    inner = half - r
    across = np.array([-inner, -0.78, -0.62, -0.54, -0.30, -0.26, 0.0, 0.26, 0.30, 0.54, 0.62, 0.78, inner])
    bow = 0.06 * (1 - (across / inner) ** 2)
    right = np.stack([x, np.full_like(x, -half)], axis=1)
    ahead_right = np.stack([long - r + r * np.sin(turn), -inner - r * np.cos(turn)], axis=1)
    front = np.stack([long + bow, across], axis=1)
    rear = np.stack([np.full_like(across, -long), across], axis=1)[::-1]
    flip = np.array([1.0, -1.0])
    behind_right = np.stack([-long + r - r * np.sin(turn[::-1]), -inner - r * np.cos(turn[::-1])], axis=1)
    loops = [behind_right, right, ahead_right, front, (ahead_right * flip)[::-1], (right * flip)[::-1],
             (behind_right * flip)[::-1], rear]  # fmt: skip
    sides = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]
    loop = np.concatenate([*loops, behind_right[:1]])
    return loop, np.concatenate([*(np.full(len(a), s) for a, s in zip(loops, sides, strict=True)), [4.5]])


_PILLARS = (-5.55, -1.62, 1.62, 2.9, 3.95)


def _at(form: BusForm, loop: Any, rise: Any) -> Float64[np.ndarray, "n k 3"]:
    """Points of the shell: flanks lean in a little, the roof's edges are round, the front is arched."""
    up = np.clip((rise - form.belt) / (form.height - form.belt), 0, 1)
    crown = np.clip((rise - form.height + 0.42) / 0.42, 0, 1)
    round_off = 1 - np.sqrt(np.maximum(1 - crown**2.4, 0))
    low = np.clip((0.62 - rise) / 0.32, 0, 1) ** 1.5
    inwards = 0.03 * up + 0.30 * round_off + 0.03 * low
    front = np.clip(loop[:, 0] / (0.5 * form.length), 0, 1.02)[:, None] ** 5
    rear = np.clip(-loop[:, 0] / (0.5 * form.length), 0, 1)[:, None] ** 5
    x = loop[:, :1] - front * (0.10 * up**2 + 0.22 * round_off + 0.05 * low) + rear * (0.04 * up + 0.18 * round_off)
    y = loop[:, 1:] * (1 - inwards / (0.5 * form.width))
    return np.stack(np.broadcast_arrays(x, y, rise[None]), axis=2)


def _shell(form: BusForm, paint: Color) -> Quads:
    loop, side = _plan(form)
    rise = np.array(_LEVELS)
    points = _at(form, loop, rise)
    arch = form.wheel_radius + 0.08
    for axle in form.wheels:
        over = np.sqrt(np.maximum(arch**2 - (points[..., 0] - axle) ** 2, 0)) + form.wheel_radius
        cut = (np.abs(points[..., 0] - axle) < arch) & (np.abs(points[..., 1]) > 0.4 * form.width)
        points[..., 2] = np.where(cut, np.maximum(points[..., 2], over), points[..., 2])
    i, j = len(loop) - 1, len(rise) - 1
    cells = patch(points, paint, Label.BUS, closed=True)
    flat = (side[1:] == side[:-1]) & (side[1:] % 1 == 0)
    column = np.repeat(np.where(flat, side[1:], -1.0), j)
    x, y = (np.repeat(0.5 * (loop[1:, k] + loop[:-1, k]), j) for k in (0, 1))
    z = np.tile(0.5 * (rise[1:] + rise[:-1]), i)
    albedo, gloss, emission = _colors(form, column, x, y, z, paint)
    lower = np.clip((z - 0.2) / 0.5, 0, 1)
    shell = Quads.of(cells.corners, albedo, Label.BUS, spread=cells.spread, gloss=gloss, emission=emission,
                     sky_access=0.4 + 0.6 * lower)  # fmt: skip
    diagonals = shell.corners[:, 2] - shell.corners[:, 0], shell.corners[:, 3] - shell.corners[:, 1]
    area = 0.5 * np.linalg.norm(np.cross(*diagonals), axis=1)
    return shell.take(area > 0.012 * np.linalg.norm(diagonals[0], axis=1))  # slivers over the wheels


def _colors(form: BusForm, side: Any, x: Any, y: Any, z: Any, paint: Color) -> tuple[Any, Any, Any]:
    """Albedo, gloss and light of cells; `side` is -1 in corners."""
    right, front, left, rear, corner = side == 1, side == 2, side == 3, side == 4, side < 0
    flank = right | left
    band = (z > form.belt) & (z < form.top)
    ahead = corner & (x > 0)
    door = np.zeros(len(z), np.bool_)
    leaf = door.copy()
    for low, high in form.doors:
        within = right & (x > low) & (x < high) & (z > 0.40) & (z < 2.30)
        door |= within
        middle = np.abs(x - 0.5 * (low + high))
        leaf |= within & (x > low + 0.06) & (x < high - 0.06) & (middle > 0.03) & (z > 0.50) & (z < 2.20)
    pillar = np.zeros(len(z), np.bool_)
    for at in _PILLARS:
        pillar |= flank & band & (np.abs(x - at) < 0.035)
    window = flank & band & ~door & (np.abs(x) < 0.5 * form.length - form.corner)
    screen = (front | ahead) & (z > 0.98) & (z < 2.50)
    sign = front & (z > 2.50) & (z < 2.80) & (np.abs(y) < 0.78)
    mask = (front & (z > 0.86) & (z < 2.90)) | (ahead & (z > 0.86) & (z < 2.90))
    back_window = rear & (z > 1.62) & (z < 2.36) & (np.abs(y) < 0.78)
    engine = rear & (z > 0.62) & (z < 1.35) & (np.abs(y) < 0.62)
    glass = (window & ~pillar) | leaf | screen | back_window | sign
    bumper = z < 0.50
    albedo = np.broadcast_to(np.asarray(paint), (len(z), 3))
    roof = (z > 2.60) & ~mask
    stripe = (z > 0.56) & (z < 0.62) & (flank | corner)
    slats = engine & (np.floor(z / 0.09) % 2 == 0)
    for where, color in ((roof, _ROOF), (stripe, (0.05, 0.05, 0.052)), (mask | pillar | (window & pillar), _TRIM),
                         (door, _TRIM), (engine, _TRIM), (slats, (0.05, 0.05, 0.052)), (glass, _GLASS),
                         (bumper, _TRIM)):  # fmt: skip
        albedo = np.where(where[:, None], color, albedo)
    gloss = np.where(
        glass, _GLASS_GLOSS, np.where(bumper | engine | door | pillar, 0.03, np.where(mask, 0.10, _PAINT_GLOSS))
    )
    # Seats, and the driver's cabin, hide the lower part of the lit interior.
    lit = glass & ~sign & ~back_window
    rows = 0.4 + 0.6 * (np.sin(7.0 * x) > -0.2)
    inside = np.where(z < 1.35, 0.16 * rows, np.where(z > 2.1, 1.0, np.where(z > 1.62, 0.55, 0.42 * rows)))
    inside = np.where(screen, 0.03 + 0.12 * (z > 1.9), inside)
    return albedo, gloss, np.where(lit[:, None], inside[:, None] * 0.36 * _ROOM_LIGHT, 0.0)


def _roof(form: BusForm) -> Quads:
    """Close the roof, and put the cooling unit and hatches on it."""
    loop, _ = _plan(form)
    rim = _at(form, loop, np.array([_LEVELS[-1]]))[:, 0]
    rows = np.array([0.0, 0.3, 0.7, 1.0])
    y = rim[:, 1:2] * (1 - rows)
    z = rim[:, 2:] + (form.height - rim[:, 2:]) * (1 - (1 - rows) ** 2)
    x = np.broadcast_to(np.clip(rim[:, :1], -5.6, 5.55), y.shape) * rows + rim[:, :1] * (1 - rows)
    top = patch(np.stack([x, y, z], axis=2), _ROOF, Label.BUS, closed=True, gloss=0.08)
    units = mesh_solids([round_box((-1.2, 0.0, 3.06), (2.4, 1.7, 0.34), 0.09, 0),
                         round_box((3.6, 0.0, 3.03), (1.5, 1.5, 0.24), 0.08, 0)], 0.085)  # fmt: skip
    above = units.corners[..., 2].max(axis=1) > form.height - 0.05
    boxes = Quads.of(units.corners[above], (0.50, 0.50, 0.485), Label.BUS, normals=units.normals[above], gloss=0.05,
                     sky_access=units.sky_access[above])  # fmt: skip
    return Quads.joined([top, boxes])


def _wheels(form: BusForm) -> list[Quads]:
    half, r = 0.5 * form.width, form.wheel_radius
    parts: list[Quads] = []
    arch, angle = r + 0.08, np.linspace(0.03 * np.pi, 0.97 * np.pi, 11)
    for axle, dish in zip(form.wheels, (0.06, 0.0), strict=True):
        wheel = build_wheel(r, 24, dish)
        parts.append(wheel.placed((axle, -half + 0.05, r)))
        parts.append(wheel.placed((0, 0, 0), 180.0).placed((axle, half - 0.05, r)))
        backs = np.linspace(-arch, arch, 7), np.linspace(0.3, r + arch, 5)
        parts += wheel_wells(axle, r, arch, angle, half, (0.05, 0.40, 0.36), backs, Label.BUS)
    x = np.linspace(-0.5 * form.length + 0.2, 0.5 * form.length - 0.2, 22)
    y = np.linspace(-half + 0.15, half - 0.15, 5)
    parts.append(surface(x[:, None], y, form.sill, 0.01, Label.BUS, flipped=True, sky_access=0.1, sun_access=0.0))
    return parts


# Details


def _details(form: BusForm, paint: Color) -> list[Quads]:
    front, rear = 0.5 * form.length + 0.045, -0.5 * form.length
    parts = [_destination(front - 0.035)]
    for side in (-1, 1):
        lamp = _plate(front - 0.005, side * 0.80, 0.70, 0.30, 0.15, _LAMP, 1, gloss=0.4)
        parts.append(replace(lamp, emission=np.full((len(lamp), 3), HEAD_LIGHT, np.float32)))
        parts.append(_plate(front - 0.010, side * 0.80, 0.70, 0.40, 0.21, _TRIM, 1, gloss=0.2))
        parts.append(_plate(front + 0.004, side * 0.54, 0.68, 0.08, 0.06, _AMBER, 1))
        tail = _plate(rear - 0.012, side * 0.98, 1.04, 0.15, 0.34, _RED_LAMP, -1, gloss=0.06)
        parts.append(replace(tail, emission=np.full((len(tail), 3), TAIL_LIGHT, np.float32)))
        parts.append(_plate(rear - 0.012, side * 0.98, 0.77, 0.15, 0.13, _AMBER, -1, gloss=0.06))
        # Mirrors hang from the roof's corner, before the windshield.
        y = side * (0.5 * form.width - 0.14)
        parts.append(box((front + 0.10, y, 2.08), (0.12, 0.20, 0.44), _TRIM, Label.BUS, coarse=0.2, faces="xXyYzZ",
                         gloss=0.1))  # fmt: skip
        parts.append(box((front - 0.05, y, 2.42), (0.34, 0.045, 0.26), _TRIM, Label.BUS, coarse=0.2, faces="xXyYzZ"))
        for z in (1.12, 1.18):  # wipers
            parts.append(box((front + 0.012, side * 0.34, z), (0.02, 0.62, 0.022), _TRIM, Label.BUS, faces="XzZ"))
    parts.append(_plate(front + 0.03, 0.0, 0.44, 0.52, 0.11, _PLATE, 1))
    parts.append(_plate(rear - 0.012, 0.0, 0.50, 0.52, 0.11, _PLATE, -1))
    parts.append(_plate(rear - 0.014, 0.0, 2.48, 0.56, 0.20, _TRIM, -1))
    badge = _plate(front + 0.03, 0.0, 0.82, 0.20, 0.09, (0.42, 0.42, 0.43), 1, gloss=0.3)
    return [*parts, badge, _strip(form, paint)]


def _strip(form: BusForm, paint: Color) -> Quads:
    """A black strip of rubber along both flanks."""
    x = broken_lines([-4.6, form.wheels[0] - 0.6], 0.5)
    right = surface(x[:, None], -0.5 * form.width - 0.012, np.array([0.78, 0.815, 0.85]), _TRIM, Label.BUS)
    return Quads.joined([right, right.mirrored()])


def _destination(x: float) -> Quads:
    """The display over the windshield: amber dots in lines."""
    y, z = np.linspace(-0.74, 0.74, 75), np.linspace(2.53, 2.77, 13)
    face = surface(x - 0.05 * (y[:, None] / 0.74) ** 2 - 0.04 * (z - 2.53), y[:, None], z, _TRIM, Label.BUS)
    at = face.centers.astype(np.float64)
    text = lettering(at[:, 1], at[:, 2] - 2.65, DESTINATION, 0.20, 0.16) < 0.004
    albedo = np.where(text[:, None], (0.95, 0.46, 0.03), (0.010, 0.010, 0.010))
    emission = np.where(text[:, None], _DISPLAY_LIGHT, 0.0)
    return Quads.of(face.corners, albedo, Label.BUS, spread=face.spread, gloss=0.03, emission=emission)


def _plate(
    x: float, y: float, z: float, width: float, height: float, albedo: Color, facing: int, gloss: float = 0.03
) -> Quads:
    """A rectangle at the front (facing 1) or rear (-1), centered at (y, z)."""
    yy = np.linspace(y - 0.5 * width, y + 0.5 * width, max(3, round(width / 0.08) + 1))
    zz = np.linspace(z - 0.5 * height, z + 0.5 * height, max(3, round(height / 0.06) + 1))
    return surface(x, yy[:, None], zz, albedo, Label.BUS, flipped=facing < 0, gloss=gloss)
