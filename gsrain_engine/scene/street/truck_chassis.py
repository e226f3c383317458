"""What carries a delivery lorry: girders, wheels, guards, tank, and its rear end with lamps and underrun bar."""

from collections.abc import Sequence

import numpy as np

from .grids import box, graded_lines, panel, patch
from .labels import Label
from .parking import Color
from .quads import Quads
from .truck_form import AMBER, DARK, PLATE, RED_TAPE, STEEL, TruckForm
from .wheels import build_wheel

_RED_LAMP, _WHITE_LAMP = (0.42, 0.006, 0.006), (0.72, 0.72, 0.70)
_WHITE_TAPE = (0.74, 0.74, 0.72)


def build_chassis(form: TruckForm) -> Quads:
    """Build everything below cab and box, in the object frame."""
    return Quads.joined([_frame(form), _rear_end(form), _guards(form), _undercarriage(form), _wheels(form)])


def _frame(form: TruckForm) -> Quads:
    """Build the two girders that carry cab and box, with a cross member behind the cab."""
    x0, x1 = form.body_back + 0.05, form.cab_back + 0.4
    parts = [
        box((0.5 * (x0 + x1), side * 0.40, 0.82), (x1 - x0, 0.10, 0.30), STEEL, Label.TRUCK, edge=0.15, coarse=1.0,
            faces="yY", sky_access=0.35, sun_access=0.1)
        for side in (-1, 1)
    ]  # fmt: skip
    dark = panel((x1, 0.9, 0.55), (-1, 0, 0), (0, 0, 1), np.linspace(0, 0.5, 4), np.linspace(0, 0.45, 4), DARK,
                 Label.TRUCK, sky_access=0.2)  # fmt: skip
    return Quads.joined([*parts, dark])


def _rear_end(form: TruckForm) -> Quads:
    """Build lamps, number plate, underrun bar with its signd ends, buffers and mud flaps."""
    back, half = form.body_back, 0.5 * form.width
    parts = [
        box((back + 0.09, 0, 0.79), (0.12, 2.0, 0.22), STEEL, Label.TRUCK, edge=0.08, coarse=0.25, faces="xyYzZ"),
        box((back + 0.06, 0, 0.50), (0.10, 2.1, 0.12), (0.14, 0.145, 0.15), Label.TRUCK, edge=0.06, coarse=0.25,
            faces="xyYzZ", gloss=0.06),
        _rear_panel(back - 0.005, 0.0, 0.79, 0.52, 0.12, PLATE),
        _rear_panel(back - 0.02, 0.0, form.floor + 0.05, 0.30, 0.06, DARK),
    ]  # fmt: skip
    for side in (-1, 1):
        for k, color in enumerate((RED_TAPE, _WHITE_TAPE, RED_TAPE, _WHITE_TAPE)):
            parts.append(_rear_panel(back - 0.002, side * (0.60 + 0.125 * k), 0.50, 0.125, 0.11, color))
        lamps = ((0.88, 0.16, _RED_LAMP), (0.73, 0.13, AMBER), (0.61, 0.10, _WHITE_LAMP))
        for y, width, color in lamps:
            parts.append(_rear_panel(back - 0.012, side * y, 0.80, width, 0.16, color, gloss=0.08))
        parts.append(
            box((back + 0.10, side * 0.5, 0.64), (0.07, 0.09, 0.20), STEEL, Label.TRUCK, edge=0.08, faces="xyY")
        )
        parts.append(_rear_panel(back - 0.008, side * (half - 0.055), form.height - 0.05, 0.09, 0.05, _RED_LAMP))
        flap = panel((form.wheels[0] - 0.60, side * 0.78 + 0.27, 0.16), (0, -1, 0), (0, 0, 1), np.linspace(0, 0.54, 4),
                     np.linspace(0, 0.62, 5), DARK, Label.TRUCK, sky_access=0.6)  # fmt: skip
        parts.append(flap)
    return Quads.joined(parts)


def _rear_panel(x: float, y: float, z: float, width: float, height: float, albedo: Color, gloss: float = 0.03) -> Quads:
    """A rectangle that looks backwards, centred at (y, z)."""
    across = np.linspace(0.0, width, max(3, round(width / 0.06) + 1))
    up = np.linspace(0.0, height, 3)
    origin = (x, y + 0.5 * width, z - 0.5 * height)
    return panel(origin, (0, -1, 0), (0, 0, 1), across, up, albedo, Label.TRUCK, gloss=gloss)


def _guards(form: TruckForm) -> Quads:
    """Build the rails between the axles that keep cyclists out, the fuel tank, wings over the rear wheels."""
    rear, front = form.wheels
    x0, x1 = rear + 0.55, front - 0.75
    half = 0.5 * form.width
    parts: list[Quads] = []
    for z in (0.55, 0.80):
        parts.append(_both(_flank_panel(x0, x1, z - 0.075, z + 0.075, half - 0.02, (0.45, 0.455, 0.46))))
    for x in (x0 + 0.25, 0.5 * (x0 + x1), x1 - 0.25):
        parts.append(_both(_flank_panel(x - 0.03, x + 0.03, 0.48, 0.97, half - 0.04, STEEL)))
    for x in (form.body_back + 0.9, x0 + 0.6, x1 - 0.5):
        parts.append(_both(_flank_panel(x - 0.06, x + 0.06, 1.02, 1.075, half + 0.006, AMBER)))
    tank = box((x1 - 0.65, -0.76, 0.70), (0.9, 0.5, 0.48), (0.26, 0.265, 0.27), Label.TRUCK, edge=0.08, coarse=0.25,
               faces="xXy", gloss=0.1, sky_access=0.6)  # fmt: skip
    battery = box((x1 - 0.55, 0.74, 0.70), (0.7, 0.5, 0.42), DARK, Label.TRUCK, edge=0.1, coarse=0.25, faces="xXY",
                  sky_access=0.6)  # fmt: skip
    angle = np.linspace(0.12 * np.pi, 0.88 * np.pi, 9)
    radius = form.wheel_radius + 0.09
    arc = np.stack([rear + radius * np.cos(angle), form.wheel_radius + radius * np.sin(angle)], axis=1)
    for side in (-1, 1):
        y = side * np.linspace(half - 0.03, half - 0.58, 4)
        wing = np.stack(np.broadcast_arrays(arc[:, None, 0], y[None], arc[:, None, 1]), axis=2)
        parts.append(patch(wing if side < 0 else wing[::-1], DARK, Label.TRUCK, sky_access=0.4))
    return Quads.joined([*parts, tank, battery])


def _both(right: Quads) -> Quads:
    return Quads.joined([right, right.mirrored()])


def _flank_panel(x0: float, x1: float, z0: float, z1: float, half: float, albedo: Color) -> Quads:
    """A rectangle on the right flank, looking to -y."""
    x = graded_lines([x0, x1], min(0.08, x1 - x0), 0.6)
    z = np.linspace(z0, z1, 3)
    points = np.stack(np.broadcast_arrays(x[:, None], -half, z[None]), axis=2)
    return patch(points, albedo, Label.TRUCK, gloss=0.06)


def _undercarriage(form: TruckForm) -> Quads:
    """Build axles, engine and what else is dark below: nobody sees through under a lorry."""
    rear, front = form.wheels
    engine = box((front - 0.1, 0, 0.62), (1.3, 1.1, 0.5), DARK, Label.TRUCK, edge=0.2, coarse=0.4, faces="xXyYz",
                 sky_access=0.2, sun_access=0.0)  # fmt: skip
    axle = box((rear, 0, 0.42), (0.24, 1.2, 0.22), DARK, Label.TRUCK, edge=0.15, coarse=0.4, faces="xXzZ",
               sky_access=0.25, sun_access=0.0)  # fmt: skip
    return Quads.joined([engine, axle])


def _wheels(form: TruckForm) -> Quads:
    """Two wheels in front; behind, hollow twin wheels, of which the inner ones show from behind."""
    radius, half = form.wheel_radius, 0.5 * form.width
    rear, front = form.wheels
    places: Sequence[tuple[float, float, float]] = (
        (front, 0.5 * form.cab_width - 0.02, 0.0),
        (rear, half - 0.03, 0.07),
    )
    parts: list[Quads] = []
    for x, outside, dish in places:
        wheel = build_wheel(radius, 16, dish)
        parts.append(wheel.placed((x, -outside, radius)))
        parts.append(wheel.placed((0, 0, 0), 180.0).placed((x, outside, radius)))
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = np.stack([rear + radius * np.sin(angle), radius + radius * np.cos(angle)], axis=1)
    for low, high in ((half - 0.50, half - 0.28), (half - 0.26, half - 0.05)):  # treads of the twins
        for side in (-1, 1):
            y = np.linspace(low, high, 3) if side > 0 else -np.linspace(high, low, 3)
            tread = np.stack(np.broadcast_arrays(ring[:, None, 0], y[None], ring[:, None, 1]), axis=2)
            parts.append(patch(tread[::-1], (0.017, 0.017, 0.018), Label.TRUCK, closed=True, sky_access=0.5))
    return Quads.joined(parts)
