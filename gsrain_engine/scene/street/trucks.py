"""Delivery lorries in the object frame (x forward, y left, z up, origin at the bottom centre): a cab before a box."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .grids import box, graded_lines, panel, patch
from .labels import Label
from .layout import StreetLayout
from .parking import TRUCK_LENGTH_M, TRUCK_WIDTH_M, Color, ParkedTruck
from .quads import Quads
from .truck_cab import build_cab
from .wheels import build_wheel

_FRAME = (0.34, 0.345, 0.35)
_STEEL = (0.10, 0.105, 0.11)
_DARK = (0.016, 0.016, 0.018)
_RED_LAMP, _AMBER_LAMP, _WHITE_LAMP = (0.42, 0.006, 0.006), (0.60, 0.19, 0.01), (0.72, 0.72, 0.70)
_RED_TAPE, _WHITE_TAPE = (0.45, 0.012, 0.014), (0.74, 0.74, 0.72)
_PLATE = (0.78, 0.78, 0.74)
_PAINT_GLOSS, _BODY_GLOSS = 0.15, 0.10
_SMOOTH = 1.08
"""Gaussians of a truck are this much wider than elsewhere: paint shows every gap."""


@dataclass(frozen=True, slots=True)
class TruckForm:
    """The outline of a box lorry of 7.5 t, in metres; x counts from the middle."""

    length: float = TRUCK_LENGTH_M
    width: float = TRUCK_WIDTH_M
    height: float = 3.2
    floor: float = 0.98
    """Lower edge of the box body."""
    cab_width: float = 2.04
    cab_height: float = 2.32
    cab_back: float = 1.92
    body_front: float = 1.72
    wheels: tuple[float, float] = (-1.95, 2.55)
    """Rear and front axle, x."""
    wheel_radius: float = 0.41

    @property
    def body_back(self) -> float:
        """Where the doors of the box are, x."""
        return -0.5 * self.length + 0.06


TRUCK_FORM = TruckForm()
"""The lorries that stand in the street."""


def build_parked_trucks(layout: StreetLayout) -> list[Quads]:
    """Build all parked trucks, in the world."""
    return [build_truck(each).placed((each.x, each.y, 0.0), each.turn_deg) for each in layout.trucks]


def build_truck(truck: ParkedTruck) -> Quads:
    """Build one truck in the object frame."""
    form = TRUCK_FORM
    parts = [
        build_cab(form, truck.cab),
        _sides(form, truck.body, truck.stripe),
        _doors(form, truck.body, truck.stripe),
        _front_and_roof(form, truck.body),
        _frame(form),
        _rear_end(form),
        _guards(form),
        _undercarriage(form),
        _wheels(form),
    ]
    built = Quads.joined(parts)
    return replace(built, labels=np.full_like(built.labels, Label.TRUCK), spread=_SMOOTH * built.spread)


def _sides(form: TruckForm, body: Color, stripe: Color) -> Quads:
    """Build both flanks of the box: panels with a broad band of colour that rises towards the cab."""
    x0, x1 = form.body_back, form.body_front
    x = graded_lines([x0, x0 + 0.06, x1 - 0.06, x1], 0.06, 0.3)
    z = graded_lines([form.floor, form.floor + 0.12, form.height - 0.07, form.height], 0.05, 0.17)
    points = np.stack(np.broadcast_arrays(x[:, None], -0.5 * form.width, z[None]), axis=2)
    right = patch(points, body, Label.TRUCK, gloss=_BODY_GLOSS)
    at, up = right.centers[:, 0], right.centers[:, 2]
    rail = (up < form.floor + 0.12) | (up > form.height - 0.07) | (at < x0 + 0.06) | (at > x1 - 0.06)
    along, high = (at - x0) / (x1 - x0), (up - form.floor) / (form.height - form.floor)
    band = np.abs(high - (0.30 + 0.25 * along)) < 0.105
    thin = np.abs(high - (0.47 + 0.25 * along)) < 0.035
    albedo = np.where((band | thin)[:, None], stripe, np.asarray(body))
    albedo = np.where(rail[:, None], _FRAME, albedo)
    right = replace(right, albedo=albedo.astype(np.float32))
    return Quads.joined([right, _mirrored(right)])


def _mirrored(right: Quads) -> Quads:
    """The same on the other side: y is negated, and corners run the other way round."""
    flip = np.array([1, -1, 1], np.float32)
    return replace(
        right, corners=right.corners[:, [1, 0, 3, 2]] * flip, normals=right.normals * flip, labels=right.labels
    )


def _doors(form: TruckForm, body: Color, stripe: Color) -> Quads:
    """Build the rear: two doors in a frame, four locking bars with handles, hinges, a conspicuity tape."""
    half, back = 0.5 * form.width, form.body_back
    low, high = form.floor, form.height
    y = graded_lines([-half, -half + 0.08, -0.012, 0.012, half - 0.08, half], 0.05, 0.2)
    z = graded_lines([low, low + 0.10, low + 0.17, high - 0.16, high - 0.09, high], 0.05, 0.2)
    points = np.stack(np.broadcast_arrays(back, y[::-1, None], z[None]), axis=2)
    rear = patch(points, body, Label.TRUCK, gloss=_BODY_GLOSS)
    at, up = rear.centers[:, 1], rear.centers[:, 2]
    frame = (np.abs(at) > half - 0.08) | (up < low + 0.10) | (up > high - 0.09)
    tape = ~frame & ((up < low + 0.17) | (up > high - 0.16))
    albedo = np.where(tape[:, None], _RED_TAPE, np.asarray(body))
    albedo = np.where(frame[:, None], _FRAME, albedo)
    albedo = np.where((np.abs(at) < 0.013)[:, None] & ~frame[:, None], 0.02, albedo)
    parts = [replace(rear, albedo=albedo.astype(np.float32))]
    for bar in (-0.74, -0.22, 0.22, 0.74):
        parts.append(
            box((back - 0.03, bar, 0.5 * (low + high)), (0.04, 0.042, high - low - 0.10), (0.17, 0.175, 0.18),
                Label.TRUCK, edge=0.045, coarse=0.3, faces="xyY", gloss=0.12)
        )  # fmt: skip
        parts.append(
            box((back - 0.05, bar + 0.12 * (-1) ** (bar > 0), low + 0.62), (0.03, 0.26, 0.05), _STEEL, Label.TRUCK,
                edge=0.05, coarse=0.1, faces="xZ", gloss=0.1)
        )  # fmt: skip
    for side in (-1, 1):
        for share in (0.12, 0.38, 0.64, 0.90):
            parts.append(
                box((back - 0.02, side * (half - 0.10), low + share * (high - low)), (0.03, 0.16, 0.07), _STEEL,
                    Label.TRUCK, edge=0.06, coarse=0.1, faces="x")
            )  # fmt: skip
    sign = panel((back - 0.012, 0.68, low + 1.28), (0, -1, 0), (0, 0, 1), np.linspace(0, 0.42, 5),
                 np.linspace(0, 0.36, 5), stripe, Label.TRUCK, gloss=_BODY_GLOSS)  # fmt: skip
    return Quads.joined([*parts, sign, sign.placed((0, -0.94, 0))])


def _front_and_roof(form: TruckForm, body: Color) -> Quads:
    """Build what shows of the box above the cab, its roof and its floor, and the cooling unit on its forehead."""
    half, x0, x1 = 0.5 * form.width, form.body_back, form.body_front
    y = graded_lines([-half, -half + 0.06, half - 0.06, half], 0.06, 0.3)
    z = graded_lines([form.floor, form.height - 0.07, form.height], 0.07, 0.3)
    front = patch(
        np.stack(np.broadcast_arrays(x1, y[:, None], z[None]), axis=2), body, Label.TRUCK, gloss=_BODY_GLOSS
    )
    rail = (np.abs(front.centers[:, 1]) > half - 0.06) | (front.centers[:, 2] > form.height - 0.07)
    front = replace(front, albedo=np.where(rail[:, None], _FRAME, front.albedo).astype(np.float32))
    x = graded_lines([x0, x1], 0.08, 0.4)
    top = np.stack(np.broadcast_arrays(x[:, None], y[None], form.height), axis=2)
    under = np.stack(np.broadcast_arrays(x[:, None], y[None, ::-1], form.floor), axis=2)
    cooler = box((x1 + 0.22, 0.0, 2.78), (0.44, 1.5, 0.62), (0.56, 0.56, 0.55), Label.TRUCK, edge=0.05, coarse=0.16,
                 faces="XyYzZ", gloss=_BODY_GLOSS)  # fmt: skip
    at = cooler.centers
    grille = (at[:, 0] > x1 + 0.43) & (np.abs(at[:, 1]) < 0.58) & (np.abs(at[:, 2] - 2.76) < 0.20)
    cooler = replace(cooler, albedo=np.where(grille[:, None], _STEEL, cooler.albedo).astype(np.float32))
    return Quads.joined(
        [
            front,
            patch(top, body, Label.TRUCK, gloss=_BODY_GLOSS),
            patch(under, 0.03, Label.TRUCK, sky_access=0.2, sun_access=0.0),
            cooler,
        ]
    )


def _frame(form: TruckForm) -> Quads:
    """Build the two girders that carry cab and box, with a cross member behind the cab."""
    x0, x1 = form.body_back + 0.05, form.cab_back + 0.4
    parts = [
        box((0.5 * (x0 + x1), side * 0.40, 0.82), (x1 - x0, 0.10, 0.30), _STEEL, Label.TRUCK, edge=0.12, coarse=0.5,
            faces="xyY", sky_access=0.35, sun_access=0.1)
        for side in (-1, 1)
    ]  # fmt: skip
    dark = panel((x1, 0.9, 0.55), (-1, 0, 0), (0, 0, 1), np.linspace(0, 0.5, 4), np.linspace(0, 0.45, 4), _DARK,
                 Label.TRUCK, sky_access=0.2)  # fmt: skip
    return Quads.joined([*parts, dark])


def _rear_end(form: TruckForm) -> Quads:
    """Build lamps, number plate, underrun bar with its striped ends, buffers and mud flaps."""
    back, half = form.body_back, 0.5 * form.width
    parts = [
        box((back + 0.09, 0, 0.79), (0.12, 2.0, 0.22), _STEEL, Label.TRUCK, edge=0.08, coarse=0.25, faces="xyYzZ"),
        box((back + 0.06, 0, 0.50), (0.10, 2.1, 0.12), (0.14, 0.145, 0.15), Label.TRUCK, edge=0.06, coarse=0.25,
            faces="xyYzZ", gloss=0.06),
        _rear_panel(back - 0.005, 0.0, 0.79, 0.52, 0.12, _PLATE),
        _rear_panel(back - 0.02, 0.0, form.floor + 0.05, 0.30, 0.06, _DARK),
    ]  # fmt: skip
    for side in (-1, 1):
        for k, color in enumerate((_RED_TAPE, _WHITE_TAPE, _RED_TAPE, _WHITE_TAPE)):
            parts.append(_rear_panel(back - 0.002, side * (0.60 + 0.125 * k), 0.50, 0.125, 0.11, color))
        lamps = ((0.88, 0.16, _RED_LAMP), (0.73, 0.13, _AMBER_LAMP), (0.61, 0.10, _WHITE_LAMP))
        for y, width, color in lamps:
            parts.append(_rear_panel(back - 0.012, side * y, 0.80, width, 0.16, color, gloss=0.08))
        parts.append(
            box((back + 0.10, side * 0.5, 0.64), (0.07, 0.09, 0.20), _STEEL, Label.TRUCK, edge=0.08, faces="xyY")
        )
        parts.append(_rear_panel(back - 0.008, side * (half - 0.055), form.height - 0.05, 0.09, 0.05, _RED_LAMP))
        flap = panel((form.wheels[0] - 0.60, side * 0.78 + 0.27, 0.16), (0, -1, 0), (0, 0, 1), np.linspace(0, 0.54, 4),
                     np.linspace(0, 0.62, 5), _DARK, Label.TRUCK, sky_access=0.6)  # fmt: skip
        parts.append(flap)
    return Quads.joined(parts)


def _rear_panel(
    x: float, y: float, z: float, width: float, height: float, albedo: Color, gloss: float = 0.03
) -> Quads:
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
        parts.append(_both(lambda z=z: _flank_panel(x0, x1, z - 0.075, z + 0.075, half - 0.02, (0.45, 0.455, 0.46))))
    for x in (x0 + 0.25, 0.5 * (x0 + x1), x1 - 0.25):
        parts.append(_both(lambda x=x: _flank_panel(x - 0.03, x + 0.03, 0.48, 0.97, half - 0.04, _STEEL)))
    for x in (form.body_back + 0.9, x0 + 0.6, x1 - 0.5):
        parts.append(_both(lambda x=x: _flank_panel(x - 0.06, x + 0.06, 1.02, 1.075, half + 0.006, _AMBER_LAMP)))
    tank = box((x1 - 0.65, -0.76, 0.70), (0.9, 0.5, 0.48), (0.26, 0.265, 0.27), Label.TRUCK, edge=0.08, coarse=0.25,
               faces="xXy", gloss=0.1, sky_access=0.6)  # fmt: skip
    battery = box((x1 - 0.55, 0.74, 0.70), (0.7, 0.5, 0.42), _DARK, Label.TRUCK, edge=0.1, coarse=0.25, faces="xXY",
                  sky_access=0.6)  # fmt: skip
    angle = np.linspace(0.12 * np.pi, 0.88 * np.pi, 9)
    radius = form.wheel_radius + 0.09
    arc = np.stack([rear + radius * np.cos(angle), form.wheel_radius + radius * np.sin(angle)], axis=1)
    for side in (-1, 1):
        y = side * np.linspace(half - 0.03, half - 0.58, 4)
        wing = np.stack(np.broadcast_arrays(arc[:, None, 0], y[None], arc[:, None, 1]), axis=2)
        parts.append(patch(wing if side < 0 else wing[::-1], _DARK, Label.TRUCK, sky_access=0.4))
    return Quads.joined([*parts, tank, battery])


def _both(right: Any) -> Quads:
    made = right()
    return Quads.joined([made, _mirrored(made)])


def _flank_panel(x0: float, x1: float, z0: float, z1: float, half: float, albedo: Color) -> Quads:
    """A rectangle on the right flank, looking to -y."""
    x = graded_lines([x0, x1], min(0.07, x1 - x0), 0.4)
    z = np.linspace(z0, z1, 3)
    points = np.stack(np.broadcast_arrays(x[:, None], -half, z[None]), axis=2)
    return patch(points, albedo, Label.TRUCK, gloss=0.06)


def _undercarriage(form: TruckForm) -> Quads:
    """Build axles, engine and what else is dark below: nobody sees through under a lorry."""
    rear, front = form.wheels
    engine = box((front - 0.1, 0, 0.62), (1.3, 1.1, 0.5), _DARK, Label.TRUCK, edge=0.2, coarse=0.4, faces="xXyYz",
                 sky_access=0.2, sun_access=0.0)  # fmt: skip
    axle = box((rear, 0, 0.42), (0.24, 1.2, 0.22), _DARK, Label.TRUCK, edge=0.15, coarse=0.4, faces="xXzZ",
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
        wheel = build_wheel(radius, 18, dish)
        parts.append(wheel.placed((x, -outside, radius)))
        parts.append(wheel.placed((0, 0, 0), 180.0).placed((x, outside, radius)))
    angle = np.linspace(0, 2 * np.pi, 15)
    ring = np.stack([rear + radius * np.sin(angle), radius + radius * np.cos(angle)], axis=1)
    for low, high in ((half - 0.50, half - 0.28), (half - 0.26, half - 0.05)):  # treads of the twins
        for side in (-1, 1):
            y = np.linspace(low, high, 3) if side > 0 else -np.linspace(high, low, 3)
            tread = np.stack(np.broadcast_arrays(ring[:, None, 0], y[None], ring[:, None, 1]), axis=2)
            parts.append(patch(tread[::-1], (0.017, 0.017, 0.018), Label.TRUCK, closed=True, sky_access=0.5))
    return Quads.joined(parts)
