"""The box of a delivery lorry: flanks, two doors behind, roof, and the cooling unit on its forehead."""

from dataclasses import replace

import numpy as np

from .grids import box, graded_lines, patch
from .labels import Label
from .parking import Color
from .quads import Quads
from .truck_form import RED_TAPE, STEEL, TruckForm

_FRAME = (0.34, 0.345, 0.35)
_GLOSS = 0.10


def build_body(form: TruckForm, body: Color, sign: Color) -> Quads:
    """Build the box, without its wheels, in the object frame."""
    return Quads.joined([_sides(form, body, sign), _doors(form, body, sign), _front_and_roof(form, body)])


def _sides(form: TruckForm, body: Color, sign: Color) -> Quads:
    """Build both flanks of the box: panels between rails, with a coloured field in the middle."""
    x0, x1 = form.body_back, form.body_front
    low, high = form.floor, form.height
    x = graded_lines([x0, x0 + 0.06, x0 + 1.6, x1 - 1.3, x1 - 0.06, x1], 0.08, 0.6)
    z = graded_lines([low, low + 0.12, low + 0.78, low + 1.42, high - 0.07, high], 0.08, 0.5)
    points = np.stack(np.broadcast_arrays(x[:, None], -0.5 * form.width, z[None]), axis=2)
    right = patch(points, body, Label.TRUCK, gloss=_GLOSS)
    at, up = right.centers[:, 0], right.centers[:, 2] - low
    rail = (up < 0.12) | (up > high - low - 0.07) | (at < x0 + 0.06) | (at > x1 - 0.06)
    logo = (at > x0 + 1.6) & (at < x1 - 1.3) & (up > 0.78) & (up < 1.42)
    albedo = np.where(logo[:, None], sign, np.asarray(body))
    albedo = np.where(rail[:, None], _FRAME, albedo)
    right = replace(right, albedo=albedo.astype(np.float32))
    return Quads.joined([right, right.mirrored()])


def _doors(form: TruckForm, body: Color, sign: Color) -> Quads:
    """Build the rear: two doors in a frame, four locking bars with handles, hinges, tape that shines, and two signs."""
    half, back = 0.5 * form.width, form.body_back
    low, high = form.floor, form.height
    y = graded_lines([-half, -half + 0.08, -0.66, -0.30, -0.012, 0.012, 0.30, 0.66, half - 0.08, half], 0.08, 0.4)
    z = graded_lines([low, low + 0.10, low + 0.17, low + 1.30, low + 1.62, high - 0.16, high - 0.09, high], 0.08, 0.5)
    points = np.stack(np.broadcast_arrays(back, y[::-1, None], z[None]), axis=2)
    rear = patch(points, body, Label.TRUCK, gloss=_GLOSS)
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
                Label.TRUCK, edge=0.045, coarse=0.45, faces="xyY", gloss=0.12)
        )  # fmt: skip
        parts.append(
            box((back - 0.05, bar + 0.12 * (-1) ** (bar > 0), low + 0.62), (0.03, 0.26, 0.05), STEEL, Label.TRUCK,
                edge=0.05, coarse=0.1, faces="xZ", gloss=0.1)
        )  # fmt: skip
    for side in (-1, 1):
        for share in (0.12, 0.38, 0.64, 0.90):
            parts.append(
                box((back - 0.02, side * (half - 0.10), low + share * (high - low)), (0.03, 0.16, 0.07), STEEL,
                    Label.TRUCK, edge=0.06, coarse=0.1, faces="x")
            )  # fmt: skip
    return Quads.joined(parts)


def _front_and_roof(form: TruckForm, body: Color) -> Quads:
    """Build what shows of the box above the cab, its roof and its floor, and the cooling unit on its forehead."""
    half, x0, x1 = 0.5 * form.width, form.body_back, form.body_front
    y = graded_lines([-half, -half + 0.06, half - 0.06, half], 0.08, 0.6)
    z = graded_lines([form.floor, 2.2, form.height - 0.07, form.height], 0.1, 0.6)
    front = patch(np.stack(np.broadcast_arrays(x1, y[:, None], z[None]), axis=2), body, Label.TRUCK, gloss=_GLOSS)
    rail = (np.abs(front.centers[:, 1]) > half - 0.06) | (front.centers[:, 2] > form.height - 0.07)
    front = replace(front, albedo=np.where(rail[:, None], _FRAME, front.albedo).astype(np.float32))
    x = graded_lines([x0, x1], 0.09, 0.9)
    top = np.stack(np.broadcast_arrays(x[:, None], y[None], form.height), axis=2)
    under = np.stack(np.broadcast_arrays(x[:, None], y[None, ::-1], form.floor), axis=2)
    cooler = box((x1 + 0.22, 0.0, 2.78), (0.44, 1.5, 0.62), (0.56, 0.56, 0.55), Label.TRUCK, edge=0.07, coarse=0.3,
                 faces="XyYZ", gloss=_GLOSS)  # fmt: skip
    at = cooler.centers
    grille = (at[:, 0] > x1 + 0.43) & (np.abs(at[:, 1]) < 0.58) & (np.abs(at[:, 2] - 2.76) < 0.20)
    cooler = replace(cooler, albedo=np.where(grille[:, None], STEEL, cooler.albedo).astype(np.float32))
    return Quads.joined(
        [
            front,
            patch(top, body, Label.TRUCK, gloss=_GLOSS),
            patch(under, 0.03, Label.TRUCK, sky_access=0.2, sun_access=0.0),
            cooler,
        ]
    )
