"""Delivery trucks: box, cab and chassis.

The object frame has x forward, y left, z up, and its origin at the bottom center.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.labels import Label

from .cars import (
    AMBER,
    DARK,
    HEAD_LIGHT,
    PLATE,
    RED_TAPE,
    STEEL,
    TAIL_LIGHT,
    TRIM,
    TRUCK_FORM,
    TruckForm,
    build_wheel,
    wheel_wells,
)
from .layout import Color, ParkedTruck, StreetLayout
from .mesh import Quads, box, broken_lines, panel, patch, surface

_FRAME = (0.34, 0.345, 0.35)
_GLOSS = 0.10


def build_body(form: TruckForm, body: Color, sign: Color) -> Quads:
    """Build the box, without the wheels, in the object frame."""
    return Quads.joined([_flanks(form, body, sign), _doors(form, body, sign), _front_and_roof(form, body)])


def _flanks(form: TruckForm, body: Color, sign: Color) -> Quads:
    """Build both flanks of the box: panels between rails, with a colored field in the middle."""
    x0, x1 = form.body_back, form.body_front
    low, high = form.floor, form.height
    x = broken_lines([x0, x0 + 0.06, x0 + 1.6, x1 - 1.3, x1 - 0.06, x1], 0.6)
    z = broken_lines([low, low + 0.12, low + 0.78, low + 1.42, high - 0.07, high], 0.5)
    right = surface(x[:, None], -0.5 * form.width, z, body, Label.TRUCK, gloss=_GLOSS)
    at, up = right.centers[:, 0], right.centers[:, 2] - low
    rail = (up < 0.12) | (up > high - low - 0.07) | (at < x0 + 0.06) | (at > x1 - 0.06)
    logo = (at > x0 + 1.6) & (at < x1 - 1.3) & (up > 0.78) & (up < 1.42)
    albedo = np.where(logo[:, None], sign, np.asarray(body))
    albedo = np.where(rail[:, None], _FRAME, albedo)
    right = replace(right, albedo=albedo.astype(np.float32))
    return Quads.joined([right, right.mirrored()])


def _doors(form: TruckForm, body: Color, sign: Color) -> Quads:
    """Build the rear: two doors in a frame, four locking bars with handles, hinges, reflective tape, and two signs."""
    half, back = 0.5 * form.width, form.body_back
    low, high = form.floor, form.height
    y = broken_lines([-half, -half + 0.08, -0.66, -0.30, -0.012, 0.012, 0.30, 0.66, half - 0.08, half], 0.4)
    z = broken_lines([low, low + 0.10, low + 0.17, low + 1.30, low + 1.62, high - 0.16, high - 0.09, high], 0.5)
    rear = surface(back, y[::-1, None], z, body, Label.TRUCK, gloss=_GLOSS)
    at, up = rear.centers[:, 1], rear.centers[:, 2]
    frame = (np.abs(at) > half - 0.08) | (up < low + 0.10) | (up > high - 0.09)
    tape = ~frame & ((up < low + 0.17) | (up > high - 0.16))
    signs = (np.abs(np.abs(at) - 0.48) < 0.18) & (up > low + 1.30) & (up < low + 1.62)
    albedo = np.where(signs[:, None], sign, np.asarray(body))
    albedo = np.where(tape[:, None], RED_TAPE, albedo)
    albedo = np.where(frame[:, None], _FRAME, albedo)
    albedo = np.where((np.abs(at) < 0.013)[:, None] & ~frame[:, None], 0.02, albedo)
    parts = [replace(rear, albedo=albedo.astype(np.float32))]
    for bar in (-0.74, -0.22, 0.22, 0.74):
        parts.append(
            box((back - 0.03, bar, 0.5 * (low + high)), (0.04, 0.042, high - low - 0.22), (0.17, 0.175, 0.18),
                Label.TRUCK, coarse=0.45, faces="xyY", gloss=0.12)
        )  # fmt: skip
        parts.append(
            box((back - 0.05, bar + 0.12 * (-1) ** (bar > 0), low + 0.62), (0.03, 0.26, 0.05), STEEL, Label.TRUCK,
                coarse=0.1, faces="xZ", gloss=0.1)
        )  # fmt: skip
    for side in (-1, 1):
        for share in (0.12, 0.38, 0.64, 0.90):
            parts.append(
                box((back - 0.02, side * (half - 0.10), low + share * (high - low)), (0.03, 0.16, 0.07), STEEL,
                    Label.TRUCK, coarse=0.1, faces="x")
            )  # fmt: skip
    return Quads.joined(parts)


def _front_and_roof(form: TruckForm, body: Color) -> Quads:
    """Build the box's visible front above the cab, with the cooling unit, its roof and its floor."""
    half, x0, x1 = 0.5 * form.width, form.body_back, form.body_front
    y = broken_lines([-half, -half + 0.06, half - 0.06, half], 0.6)
    z = broken_lines([form.floor, 2.2, form.height - 0.07, form.height], 0.6)
    front = surface(x1, y[:, None], z, body, Label.TRUCK, gloss=_GLOSS)
    rail = (np.abs(front.centers[:, 1]) > half - 0.06) | (front.centers[:, 2] > form.height - 0.07)
    front = replace(front, albedo=np.where(rail[:, None], _FRAME, front.albedo).astype(np.float32))
    x = broken_lines([x0, x1], 0.9)
    top = surface(x[:, None], y, form.height, body, Label.TRUCK, gloss=_GLOSS)
    under = surface(x[:, None], y[::-1], form.floor, 0.03, Label.TRUCK, sky_access=0.2, sun_access=0.0)
    cooler = box((x1 + 0.22, 0.0, 2.78), (0.44, 1.5, 0.62), (0.56, 0.56, 0.55), Label.TRUCK, coarse=0.3,
                 faces="XyYZ", gloss=_GLOSS)  # fmt: skip
    at = cooler.centers
    grille = (at[:, 0] > x1 + 0.43) & (np.abs(at[:, 1]) < 0.58) & (np.abs(at[:, 2] - 2.76) < 0.20)
    cooler = replace(cooler, albedo=np.where(grille[:, None], STEEL, cooler.albedo).astype(np.float32))
    return Quads.joined([front, top, under, cooler])


# Cab

_GLASS = (0.018, 0.02, 0.022)
_LAMP = (0.88, 0.88, 0.86)
_PAINT_GLOSS, _GLASS_GLOSS = 0.16, 0.36
_CORNER_M = 0.20
_BELT_M, _SCREEN_TOP_M = 1.36, 2.06
_SILL_M = 0.36

_LEVELS = (_SILL_M, 0.46, 0.56, 0.66, 0.70, 0.80, 0.84, 0.92, 0.97, 1.13, 1.18, 1.27, 1.32, _BELT_M, 1.41, 1.52,
           1.72, 1.92, 2.01, _SCREEN_TOP_M, 2.11)  # fmt: skip
"""Heights of the rows of cells: narrow at color edges: the sill, the lamps, the grille, and the windows."""


def build_cab(form: TruckForm, paint: Color) -> Quads:
    loop, face = _plan(form)
    rise = np.array([*_LEVELS, form.cab_height - 0.10, form.cab_height - 0.06, form.cab_height - 0.03])
    shell = _shell(form, loop, face, rise, paint)
    rim = _at(form, loop, rise[-1:])[:, 0]
    return Quads.joined([shell, _roof(rim, form, paint), *_mirrors(form), *_trim(form), _visor(form)])


def _plan(form: TruckForm) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Outline from above, counter-clockwise from the rear right corner, and the side of each point.

    Sides: 0 the right flank, 1 the front, 2 the left flank; corners have values between.
    """
    half, front, back = 0.5 * form.cab_width, 0.5 * form.length - 0.03, form.cab_back
    flank = np.array([back, back + 0.18, back + 0.20, back + 0.26, back + 0.32, back + 0.60,
                      front - 0.60, front - 0.48, front - 0.42, front - 0.32, front - _CORNER_M])  # fmt: skip
    turn = np.linspace(-0.5 * np.pi, 0, 6)[1:-1]
    inner = half - _CORNER_M
    half_ahead = np.array([inner, inner - 0.05, inner - 0.10, 0.62, 0.56, 0.50, 0.33, 0.27, 0.21, 0.08])
    ahead = np.concatenate([-half_ahead, half_ahead[::-1]])
    right = np.stack([flank, np.full_like(flank, -half)], axis=1)
    corner = np.stack([front - _CORNER_M + _CORNER_M * np.cos(turn), -inner + _CORNER_M * np.sin(turn)], axis=1)
    bow = 0.05 * (1 - (ahead / inner) ** 2)
    straight = np.stack([front + bow, ahead], axis=1)
    flip = np.array([1.0, -1.0])
    loop = np.concatenate([right, corner, straight, corner[::-1] * flip, right[::-1] * flip])
    face = np.concatenate(
        [np.zeros(len(right)), np.full(4, 0.5), np.ones(len(straight)), np.full(4, 1.5), np.full(len(right), 2.0)]
    )
    return loop, face


def _at(form: TruckForm, loop: Any, rise: Any) -> Float64[np.ndarray, "n k 3"]:
    """Points of the shell: the front leans back over the belt line, flanks lean in, edges of the roof are round."""
    up = np.clip((rise - _BELT_M) / (form.cab_height - _BELT_M), 0, 1)
    crown = np.clip((rise - form.cab_height + 0.10) / 0.10, 0, 1) ** 2
    low = np.clip((0.75 - rise) / 0.4, 0, 1)
    lean = 0.24 * up + 0.16 * crown + 0.03 * low
    inwards = 0.06 * up + 0.07 * crown + 0.02 * low
    front, half = 0.5 * form.length - 0.03, 0.5 * form.cab_width
    share = np.clip((loop[:, 0] - form.cab_back) / (front - form.cab_back), 0, 1.03)
    x = loop[:, :1] - (share**3)[:, None] * lean
    y = loop[:, 1:] * (1 - inwards / half)
    return np.stack(np.broadcast_arrays(x, y, rise[None]), axis=2)


def _shell(form: TruckForm, loop: Any, face: Any, rise: Any, paint: Color) -> Quads:
    points = _at(form, loop, rise)
    arch = form.wheel_radius + 0.07
    axle = form.wheels[1]
    over = np.sqrt(np.maximum(arch**2 - (points[..., 0] - axle) ** 2, 0)) + form.wheel_radius
    cut = (np.abs(points[..., 0] - axle) < arch) & (np.abs(points[..., 1]) > 0.4 * form.cab_width)
    points[..., 2] = np.where(cut, np.maximum(points[..., 2], over), points[..., 2])
    shell = patch(points, paint, Label.TRUCK, gloss=_PAINT_GLOSS)
    i, j = len(loop) - 1, len(rise) - 1
    column = np.repeat(0.5 * (face[1:] + face[:-1]), j)
    x = np.repeat(0.5 * (loop[1:, 0] + loop[:-1, 0]), j)
    y = np.repeat(np.abs(0.5 * (loop[1:, 1] + loop[:-1, 1])), j)
    z = np.tile(0.5 * (rise[1:] + rise[:-1]), i)
    colors, gloss = _colors(form, column, x, y, z, paint)
    lower = np.clip((z - 0.2) / 0.6, 0, 1)
    lamps = (colors == np.array(_LAMP)).all(axis=1)
    shell = Quads.of(shell.corners, colors, Label.TRUCK, spread=shell.spread, gloss=gloss,
                     sky_access=0.35 + 0.65 * lower, emission=lamps[:, None] * HEAD_LIGHT)  # fmt: skip
    tall = np.linalg.norm(shell.corners[:, 3] - shell.corners[:, 0], axis=1)
    other = np.linalg.norm(shell.corners[:, 2] - shell.corners[:, 1], axis=1)
    return shell.take(np.maximum(tall, other) > 0.012)


def _colors(form: TruckForm, column: Any, x: Any, y: Any, z: Any, paint: Color) -> tuple[Any, Any]:
    front = 0.5 * form.length - 0.03
    inner = 0.5 * form.cab_width - _CORNER_M
    ahead = np.abs(column - 1) < 0.3
    flank = np.abs(column - 1) > 0.7
    window = (z > _BELT_M) & (z < _SCREEN_TOP_M)
    screen = (ahead | (np.abs(column - 1) < 0.6) & (x > front - 0.06)) & window
    side = flank & window & (x > form.cab_back + 0.26) & (x < front - 0.42)
    glass = screen | side
    grille = ahead & (y < inner - 0.05) & (z > 0.92) & (z < 1.18)
    slats = grille & (z > 0.97) & (z < 1.13) & (y < 0.56)
    housing = ahead & (y > 0.50) & (z > 0.66) & (z < 0.84)
    lamps = housing & (y > 0.56) & (y < inner - 0.05) & (z > 0.70) & (z < 0.80)
    bumper = (z < 0.66) | (ahead & (z < 0.92) & (y < 0.56) & (z > 0.84))
    plate = ahead & (y < 0.27) & (z > 0.56) & (z < 0.66)
    amber = (np.abs(np.abs(column - 1) - 0.5) < 0.3) & (z > 0.66) & (z < 0.84)
    shut = flank & (z > 0.56) & (((x > form.cab_back + 0.18) & (x < form.cab_back + 0.2)) | (
        (x > front - 0.46) & (x < front - 0.43))) & (z < 2.14)  # fmt: skip
    albedo = np.broadcast_to(np.asarray(paint), (len(z), 3))
    for where, color in ((bumper, TRIM), (grille, TRIM), (slats, (0.06, 0.06, 0.065)), (housing, TRIM),
                         (amber, AMBER), (lamps, _LAMP), (plate, PLATE), (glass, _GLASS)):  # fmt: skip
        albedo = np.where(where[:, None], color, albedo)
    albedo = np.where((shut & ~glass)[:, None], 0.35 * albedo, albedo)
    gloss = np.where(
        glass, _GLASS_GLOSS, np.where(bumper | grille | (housing & ~lamps), 0.05, np.where(lamps, 0.42, _PAINT_GLOSS))
    )
    return albedo, gloss


def _roof(rim: Float64[np.ndarray, "n 3"], form: TruckForm, paint: Color) -> Quads:
    """Close the roof from its rim to the center line, and the back wall below it."""
    rows = np.array([0.0, 0.25, 0.6, 1.0])
    y = rim[:, 1:2] * (1 - rows)
    middle = np.clip(rim[:, 0], form.cab_back, rim[:, 0].max() - 0.1)
    x = rim[:, :1] + rows * (middle - rim[:, 0])[:, None]
    z = rim[:, 2:] + (form.cab_height - rim[:, 2:]) * (1 - (1 - rows) ** 2)
    top = patch(np.stack([x, y, z], axis=2), paint, Label.TRUCK, gloss=_PAINT_GLOSS + 0.06)
    across = np.linspace(-0.5 * form.cab_width, 0.5 * form.cab_width, 5)[::-1]
    up = np.linspace(0.6, form.cab_height - 0.04, 5)
    back = surface(form.cab_back, across[:, None], up, paint, Label.TRUCK, gloss=_PAINT_GLOSS, sky_access=0.5)
    return Quads.joined([top, back])


def _mirrors(form: TruckForm) -> list[Quads]:
    """Two tall mirrors on their arms, next to the windshield."""
    x, parts = 0.5 * form.length - 0.22, list[Quads]()
    for side in (-1, 1):
        y = side * (0.5 * form.cab_width + 0.15)
        parts.append(box((x, y, 1.80), (0.11, 0.20, 0.40), TRIM, Label.TRUCK, coarse=0.2, faces="xXyY",
                         gloss=0.1))  # fmt: skip
        parts.append(box((x, side * (0.5 * form.cab_width + 0.02), 1.97), (0.035, 0.16, 0.035), TRIM, Label.TRUCK,
                         faces="xXzZ"))  # fmt: skip
    return parts


def _trim(form: TruckForm) -> list[Quads]:
    """Wipers, a badge, door handles, steps, and dark wheel wells."""
    front, half = 0.5 * form.length - 0.03, 0.5 * form.cab_width
    badge = box((front + 0.055, 0, 1.22), (0.02, 0.34, 0.09), (0.5, 0.5, 0.5), Label.TRUCK, coarse=0.1,
                faces="X", gloss=0.2)  # fmt: skip
    axle, arch = form.wheels[1], form.wheel_radius + 0.06
    angle = np.linspace(0.02 * np.pi, 0.98 * np.pi, 9)
    handles = [
        box((form.cab_back + 0.34, side * (half - 0.01), 1.20), (0.16, 0.03, 0.04), TRIM, Label.TRUCK,
            faces="yY")
        for side in (-1, 1)
    ]  # fmt: skip
    backs = np.linspace(-arch, arch, 6), np.linspace(0.3, 0.95, 5)
    wells = wheel_wells(axle, form.wheel_radius, arch, angle, half, (0.05, 0.36, 0.32), backs, Label.TRUCK)
    return [badge, handles[0], *wells[:2], handles[1], *wells[2:]]


def _visor(form: TruckForm) -> Quads:
    """The sun visor over the windshield."""
    return box((0.5 * form.length - 0.20, 0, 2.11), (0.16, 1.62, 0.10), TRIM, Label.TRUCK, coarse=0.25,
               faces="XyYzZ", gloss=0.1)  # fmt: skip


# Chassis

_RED_LAMP, _WHITE_LAMP = (0.42, 0.006, 0.006), (0.72, 0.72, 0.70)
TAIL_LAMP, HEAD_LAMP = (0.88, 0.80), (0.69, 0.75)
"""Distance from the middle, and height, in meters."""
_WHITE_TAPE = (0.74, 0.74, 0.72)


def build_chassis(form: TruckForm) -> Quads:
    return Quads.joined([_frame(form), _rear_end(form), _guards(form), _undercarriage(form), _wheels(form)])


def _frame(form: TruckForm) -> Quads:
    """Build the two girders below cab and box, with a cross member behind the cab."""
    x0, x1 = form.body_back + 0.05, form.cab_back + 0.4
    parts = [
        box((0.5 * (x0 + x1), side * 0.40, 0.82), (x1 - x0, 0.10, 0.30), STEEL, Label.TRUCK, coarse=1.0,
            faces="yY", sky_access=0.35, sun_access=0.1)
        for side in (-1, 1)
    ]  # fmt: skip
    dark = panel((x1, 0.9, 0.55), (-1, 0, 0), (0, 0, 1), np.linspace(0, 0.5, 4), np.linspace(0, 0.45, 4), DARK,
                 Label.TRUCK, sky_access=0.2)  # fmt: skip
    return Quads.joined([*parts, dark])


def _rear_end(form: TruckForm) -> Quads:
    """Build lamps, number plate, underrun bar with striped ends, buffers and mud flaps."""
    back, half = form.body_back, 0.5 * form.width
    parts = [
        box((back + 0.09, 0, 0.79), (0.12, 2.0, 0.22), STEEL, Label.TRUCK, coarse=0.25, faces="xyYzZ"),
        box((back + 0.06, 0, 0.50), (0.10, 2.1, 0.12), (0.14, 0.145, 0.15), Label.TRUCK, coarse=0.25,
            faces="xyYzZ", gloss=0.06),
        _rear_panel(back - 0.005, 0.0, 0.79, 0.52, 0.12, PLATE),
        _rear_panel(back - 0.02, 0.0, form.floor + 0.05, 0.30, 0.06, DARK),
    ]  # fmt: skip
    for side in (-1, 1):
        for k, color in enumerate((RED_TAPE, _WHITE_TAPE, RED_TAPE, _WHITE_TAPE)):
            parts.append(_rear_panel(back - 0.002, side * (0.60 + 0.125 * k), 0.50, 0.125, 0.11, color))
        lamps = ((TAIL_LAMP[0], 0.16, _RED_LAMP), (0.73, 0.13, AMBER), (0.61, 0.10, _WHITE_LAMP))
        for y, width, color in lamps:
            lamp = _rear_panel(back - 0.012, side * y, TAIL_LAMP[1], width, 0.16, color, gloss=0.08)
            parts.append(_lit(lamp, TAIL_LIGHT if color is _RED_LAMP else 0.0))
        parts.append(box((back + 0.10, side * 0.5, 0.64), (0.07, 0.09, 0.20), STEEL, Label.TRUCK, faces="xyY"))
        marker = _rear_panel(back - 0.008, side * (half - 0.055), form.height - 0.05, 0.09, 0.05, _RED_LAMP)
        parts.append(_lit(marker, 0.6 * TAIL_LIGHT))
        flap = panel((form.wheels[0] - 0.60, side * 0.78 + 0.27, 0.16), (0, -1, 0), (0, 0, 1), np.linspace(0, 0.54, 4),
                     np.linspace(0, 0.62, 5), DARK, Label.TRUCK, sky_access=0.6)  # fmt: skip
        parts.append(flap)
    return Quads.joined(parts)


def _lit(quads: Quads, light: Any) -> Quads:
    return replace(quads, emission=np.broadcast_to(np.float32(light), (len(quads), 3)).copy())


def _rear_panel(x: float, y: float, z: float, width: float, height: float, albedo: Color, gloss: float = 0.03) -> Quads:
    """A rectangle that faces backwards, centered at (y, z)."""
    across = np.linspace(0.0, width, max(3, round(width / 0.06) + 1))
    up = np.linspace(0.0, height, 3)
    origin = (x, y + 0.5 * width, z - 0.5 * height)
    return panel(origin, (0, -1, 0), (0, 0, 1), across, up, albedo, Label.TRUCK, gloss=gloss)


def _guards(form: TruckForm) -> Quads:
    """Build the side guard rails between the axles, the fuel tank, and the fenders over the rear wheels."""
    rear, front = form.wheels
    x0, x1 = rear + 0.55, front - 0.75
    half = 0.5 * form.width
    parts: list[Quads] = []
    for z in (0.55, 0.80):
        parts += _flank_panels(x0, x1, z - 0.075, z + 0.075, half - 0.02, (0.45, 0.455, 0.46))
    for x in (x0 + 0.25, 0.5 * (x0 + x1), x1 - 0.25):
        parts += _flank_panels(x - 0.03, x + 0.03, 0.48, 0.97, half - 0.04, STEEL)
    for x in (form.body_back + 0.9, x0 + 0.6, x1 - 0.5):
        parts += _flank_panels(x - 0.06, x + 0.06, 1.02, 1.075, half + 0.006, AMBER)
    tank = box((x1 - 0.65, -0.76, 0.70), (0.9, 0.5, 0.48), (0.26, 0.265, 0.27), Label.TRUCK, coarse=0.25,
               faces="xXy", gloss=0.1, sky_access=0.6)  # fmt: skip
    battery = box((x1 - 0.55, 0.74, 0.70), (0.7, 0.5, 0.42), DARK, Label.TRUCK, coarse=0.25, faces="xXY",
                  sky_access=0.6)  # fmt: skip
    angle = np.linspace(0.12 * np.pi, 0.88 * np.pi, 9)
    radius = form.wheel_radius + 0.09
    arc = np.stack([rear + radius * np.cos(angle), form.wheel_radius + radius * np.sin(angle)], axis=1)
    for side in (-1, 1):
        y = side * np.linspace(half - 0.03, half - 0.58, 4)
        parts.append(surface(arc[:, :1], y, arc[:, 1:], DARK, Label.TRUCK, flipped=side > 0, sky_access=0.4))
    return Quads.joined([*parts, tank, battery])


def _flank_panels(x0: float, x1: float, z0: float, z1: float, half: float, albedo: Color) -> list[Quads]:
    """Make the same rectangle on the right and on the left flank."""
    x = broken_lines([x0, x1], 0.6)
    z = np.linspace(z0, z1, 3)
    right = surface(x[:, None], -half, z, albedo, Label.TRUCK, gloss=0.06)
    return [right, right.mirrored()]


def _undercarriage(form: TruckForm) -> Quads:
    """Build axles, engine and other dark parts below, which block the view under the truck."""
    rear, front = form.wheels
    engine = box((front - 0.1, 0, 0.62), (1.3, 1.1, 0.5), DARK, Label.TRUCK, coarse=0.4, faces="xXyYz",
                 sky_access=0.2, sun_access=0.0)  # fmt: skip
    axle = box((rear, 0, 0.42), (0.24, 1.2, 0.22), DARK, Label.TRUCK, coarse=0.4, faces="xXzZ",
               sky_access=0.25, sun_access=0.0)  # fmt: skip
    return Quads.joined([engine, axle])


def _wheels(form: TruckForm) -> Quads:
    """Two wheels in front; behind, hollow twin wheels, of which the inner ones are visible from behind."""
    radius, half = form.wheel_radius, 0.5 * form.width
    rear, front = form.wheels
    parts: list[Quads] = []
    for x, outside, dish in ((front, 0.5 * form.cab_width - 0.02, 0.0), (rear, half - 0.03, 0.07)):
        wheel = build_wheel(radius, 16, dish)
        parts.append(wheel.placed((x, -outside, radius)))
        parts.append(wheel.placed((0, 0, 0), 180.0).placed((x, outside, radius)))
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = np.stack([rear + radius * np.sin(angle), radius + radius * np.cos(angle)], axis=1)
    for low, high in ((half - 0.50, half - 0.28), (half - 0.26, half - 0.05)):  # treads of the twins
        for side in (-1, 1):
            y = np.linspace(low, high, 3) if side > 0 else -np.linspace(high, low, 3)
            parts.append(surface(ring[:, :1], y, ring[:, 1:], (0.017, 0.017, 0.018), Label.TRUCK, flipped=True,
                                 closed=True, sky_access=0.5))  # fmt: skip
    return Quads.joined(parts)


# Whole trucks

_SMOOTH = 1.08  # gaussians of a truck are this much wider than elsewhere: gaps are conspicuous in paint


def build_parked_trucks(layout: StreetLayout) -> Quads:
    return Quads.joined(
        build_truck(each).shining(0.0).placed((each.x, each.y, 0.0), each.turn_deg) for each in layout.trucks
    )


def build_truck(truck: ParkedTruck) -> Quads:
    """Build a truck in the object frame, its lamps on."""
    form = TRUCK_FORM
    built = Quads.joined([build_cab(form, truck.cab), build_body(form, truck.body, truck.sign), build_chassis(form)])
    return replace(built, labels=np.full_like(built.labels, Label.TRUCK), spread=_SMOOTH * built.spread)
