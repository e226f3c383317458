"""The cab of a delivery lorry, lofted upwards from its bumper: windscreen, doors, grille, lamps, mirrors."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from .grids import box, patch
from .labels import Label
from .parking import Color
from .quads import Quads
from .truck_form import AMBER, PLATE, TRIM, TruckForm

_GLASS = (0.018, 0.02, 0.022)
_LAMP = (0.88, 0.88, 0.86)
_PAINT_GLOSS, _GLASS_GLOSS = 0.16, 0.36
_CORNER_M = 0.20
_BELT_M, _SCREEN_TOP_M = 1.36, 2.06
_SILL_M = 0.36
_LEVELS = (_SILL_M, 0.46, 0.56, 0.66, 0.70, 0.80, 0.84, 0.92, 0.97, 1.13, 1.18, 1.27, 1.32, _BELT_M, 1.41, 1.52,
           1.72, 1.92, 2.01, _SCREEN_TOP_M, 2.11)  # fmt: skip
"""Heights of the rows of cells: narrow where a colour ends, at the sill, the lamps, the grille, and the windows."""


def build_cab(form: TruckForm, paint: Color) -> Quads:
    loop, face = _plan(form)
    rise = np.array([*_LEVELS, form.cab_height - 0.10, form.cab_height - 0.06, form.cab_height - 0.03])
    shell = _shell(form, loop, face, rise, paint)
    rim = _at(form, loop, rise[-1:])[:, 0]
    return Quads.joined([shell, _roof(rim, form, paint), *_mirrors(form), *_trim(form), _visor(form)])


def _plan(form: TruckForm) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Outline from above, counter-clockwise from the rear right corner, and what each point is on.

    What a point is on: 0 the right flank, 1 the front, 2 the left flank; corners lie in between.
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
    shell = _recolored(shell, colors, gloss, 0.35 + 0.65 * lower)
    tall = np.linalg.norm(shell.corners[:, 3] - shell.corners[:, 0], axis=1)
    other = np.linalg.norm(shell.corners[:, 2] - shell.corners[:, 1], axis=1)
    return shell.take(np.maximum(tall, other) > 0.012)


def _colors(form: TruckForm, column: Any, x: Any, y: Any, z: Any, paint: Color) -> tuple[Any, Any]:
    """Albedo and gloss of the shell's cells."""
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


def _recolored(quads: Quads, albedo: Any, gloss: Any, sky_access: Any) -> Quads:
    """The same surfaces in other colours."""
    return Quads.of(quads.corners, albedo, Label.TRUCK, spread=quads.spread, gloss=gloss, sky_access=sky_access)


def _roof(rim: Float64[np.ndarray, "n 3"], form: TruckForm, paint: Color) -> Quads:
    """Close the roof from its rim to the middle line, and the back wall below it."""
    rows = np.array([0.0, 0.25, 0.6, 1.0])
    y = rim[:, 1:2] * (1 - rows)
    middle = np.clip(rim[:, 0], form.cab_back, rim[:, 0].max() - 0.1)
    x = rim[:, :1] + rows * (middle - rim[:, 0])[:, None]
    z = rim[:, 2:] + (form.cab_height - rim[:, 2:]) * (1 - (1 - rows) ** 2)
    top = patch(np.stack([x, y, z], axis=2), paint, Label.TRUCK, gloss=_PAINT_GLOSS + 0.06)
    across = np.linspace(-0.5 * form.cab_width, 0.5 * form.cab_width, 5)[::-1]
    up = np.linspace(0.6, form.cab_height - 0.04, 5)
    back = np.stack(np.broadcast_arrays(form.cab_back, across[:, None], up[None]), axis=2)
    return Quads.joined([top, patch(back, paint, Label.TRUCK, gloss=_PAINT_GLOSS, sky_access=0.5)])


def _mirrors(form: TruckForm) -> list[Quads]:
    """Two tall mirrors on their arms, beside the windscreen."""
    x, parts = 0.5 * form.length - 0.22, list[Quads]()
    for side in (-1, 1):
        y = side * (0.5 * form.cab_width + 0.15)
        parts.append(box((x, y, 1.80), (0.11, 0.20, 0.40), TRIM, Label.TRUCK, edge=0.07, coarse=0.2, faces="xXyY",
                         gloss=0.1))  # fmt: skip
        parts.append(box((x, side * (0.5 * form.cab_width + 0.02), 1.97), (0.035, 0.16, 0.035), TRIM, Label.TRUCK,
                         edge=0.04, faces="xXzZ"))  # fmt: skip
    return parts


def _trim(form: TruckForm) -> list[Quads]:
    """Wipers, a badge, door handles, steps, and the dark of the wheel wells."""
    front, half = 0.5 * form.length - 0.03, 0.5 * form.cab_width
    badge = box((front + 0.055, 0, 1.22), (0.02, 0.34, 0.09), (0.5, 0.5, 0.5), Label.TRUCK, edge=0.05, coarse=0.1,
                faces="X", gloss=0.2)  # fmt: skip
    parts = [badge]
    axle, arch = form.wheels[1], form.wheel_radius + 0.06
    angle = np.linspace(0.02 * np.pi, 0.98 * np.pi, 9)
    for side in (-1, 1):
        parts.append(box((form.cab_back + 0.34, side * (half - 0.01), 1.20), (0.16, 0.03, 0.04), TRIM, Label.TRUCK,
                         edge=0.05, faces="yY"))  # fmt: skip
        y = side * np.array([half - 0.05, half - 0.36])
        well = np.stack(
            np.broadcast_arrays(
                axle + arch * np.cos(angle)[:, None], y, form.wheel_radius + arch * np.sin(angle)[:, None]
            ), axis=2,
        )  # fmt: skip
        parts.append(patch(well if side < 0 else well[::-1], 0.008, Label.TRUCK, sky_access=0.15, sun_access=0.0))
        back = np.stack(
            np.broadcast_arrays(
                axle + np.linspace(-arch, arch, 6)[:, None], side * (half - 0.32), np.linspace(0.3, 0.95, 5)[None]
            ), axis=2,
        )  # fmt: skip
        parts.append(patch(back if side < 0 else back[::-1], 0.006, Label.TRUCK, sky_access=0.1, sun_access=0.0))
    return parts


def _visor(form: TruckForm) -> Quads:
    """The sun visor over the windscreen, with its two marker lamps."""
    front = 0.5 * form.length - 0.20
    visor = box((front, 0, 2.11), (0.16, 1.62, 0.10), TRIM, Label.TRUCK, edge=0.06, coarse=0.25, faces="XyYzZ",
                gloss=0.1)  # fmt: skip
    return visor
