"""Cars: lofted bodies on four wheels, their shadows, wheels for cars and trucks, and the outline of a truck.

The object frame has x forward, y left, z up, and its origin at the bottom center.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.labels import Label

from .layout import TRUCK_LENGTH_M, TRUCK_WIDTH_M, CarShape, Color, StreetLayout
from .mesh import Quads, broken_lines, patch, surface

_GLASS = (0.018, 0.02, 0.022)
_TRIM = (0.022, 0.022, 0.024)
_PAINT_GLOSS, _GLASS_GLOSS = 0.17, 0.36
_SMOOTH = 1.1  # gaussians of a car are this much wider than elsewhere: gaps are conspicuous in paint
_SHADOW_HEIGHT_M = 0.06  # high enough that shadows are sorted before the road below them


@dataclass(frozen=True, slots=True)
class CarForm:
    """The outline of a car, in meters; x counts from the center."""

    length: float
    width: float
    height: float
    hood: tuple[float, float]
    """Height of the body at its front and at the lower edge of the windshield."""
    tail: tuple[float, float]
    """Height of the body at its rear and at the lower edge of the rear window."""
    belt: tuple[float, float]
    """Rear and front end of the greenhouse (windows) at the belt line, x."""
    roof: tuple[float, float]
    """Rear and front end of the roof, x."""
    wheels: tuple[float, float]
    """Rear and front axle, x."""
    pillar: float
    """The pillar between front and rear doors, x."""
    wheel_radius: float = 0.32


CAR_FORMS: dict[CarShape, CarForm] = {
    "hatchback": CarForm(
        4.05, 1.76, 1.46, (0.70, 0.96), (0.86, 0.97), (-1.86, 1.02), (-1.48, 0.18), (-1.22, 1.30), -0.28
    ),
    "saloon": CarForm(4.66, 1.82, 1.43, (0.68, 0.94), (0.90, 0.98), (-1.62, 1.00), (-0.95, 0.12), (-1.35, 1.45), -0.30),
    "estate": CarForm(4.62, 1.80, 1.49, (0.69, 0.95), (0.88, 0.97), (-2.16, 1.02), (-1.88, 0.15), (-1.32, 1.42), -0.26),
    "van": CarForm(
        4.55, 1.84, 1.84, (0.80, 1.08), (1.02, 1.10), (-2.12, 1.35), (-1.98, 0.62), (-1.30, 1.45), -0.05, 0.33
    ),
}
"""Car shapes in the street."""


def build_parked_cars(layout: StreetLayout) -> Quads:
    """Build all parked cars, in the world; each shape is built once and recolored."""
    return Quads.joined(
        build_car(car.shape, car.paint, fine=1.35).shining(0.0).placed((car.x, car.y, 0.0), car.turn_deg)
        for car in layout.cars
    )


HEAD_LIGHT, TAIL_LIGHT = np.array([7.0, 7.2, 7.6]), np.array([1.9, 0.035, 0.02])
"""Light of the lamps of moving vehicles by night, linear; 1 is a camera's white."""


def build_car(shape: CarShape, paint: tuple[float, float, float], fine: float = 1.0) -> Quads:
    """Build one car in the object frame, its lamps on. `fine` scales its cells: 1 is for a car at close range."""
    form = CAR_FORMS[shape]
    outline = _outline(form, fine)
    body = [_skirt(form, outline, paint), _deck(form, outline, paint), _glass_house(form, paint, fine)]
    car = Quads.joined([*body, *_wheels(form, fine), *_details(form, paint, fine), _underside(form)])
    return replace(car, spread=_SMOOTH * car.spread)


def car_shadow(shape: CarShape) -> Quads:
    """Build the soft dark patch on the ground below a moving car."""
    return vehicle_shadow(CAR_FORMS[shape].length, CAR_FORMS[shape].width)


def vehicle_shadow(length: float, width: float) -> Quads:
    """Build the soft dark patch on the ground around a vehicle of a size, in meters."""
    x = np.linspace(-0.5 * length - 0.5, 0.5 * length + 0.4, 30)
    y = np.linspace(-0.5 * width - 0.75, 0.5 * width + 0.35, 18)
    shadow = surface(x[:, None], y, _SHADOW_HEIGHT_M, 0.012, Label.ROAD, spread=0.8)
    center = shadow.centers
    outside = np.maximum(np.abs(center[:, 0]) - 0.5 * length + 0.12, 0)
    left = np.maximum(center[:, 1] - 0.5 * width + 0.15, 0)
    right = np.maximum(-center[:, 1] - 0.5 * width - 0.15, 0)
    fade = np.exp(-((np.hypot(outside, np.maximum(left, right)) / 0.28) ** 2))
    return replace(shadow, opacity=(0.75 * fade).astype(np.float32)).take(fade > 0.02)


def _outline(form: CarForm, fine: float) -> Float64[np.ndarray, "n 2"]:
    """Outline of the body from above, counter-clockwise from the middle of the tail: a superellipse, evenly stepped."""
    angle = np.linspace(-np.pi, np.pi, 4001)
    cosine, sine = np.cos(angle), np.sin(angle)
    x = 0.5 * form.length * np.sign(cosine) * np.abs(cosine) ** (2 / 6.5)
    y = 0.5 * form.width * np.sign(sine) * np.abs(sine) ** (2 / 4.2)
    step = np.hypot(np.diff(x), np.diff(y))
    weight = np.diff(x) / np.maximum(step, 1e-9)
    near = np.min(np.abs(0.5 * (x[1:] + x[:-1])[:, None] - np.array(form.wheels)), axis=1) < form.wheel_radius + 0.1
    density = np.where(near & (np.abs(weight) > 0.9), 1 / 0.055, 1 / 0.13) / fine
    reached = np.concatenate([[0], np.cumsum(step * density)])
    count = 2 * round(reached[-1] / 2)
    at = np.interp(np.linspace(0, reached[-1], count + 1), reached, np.arange(len(angle)))
    flank = np.abs(y[:-1]) > 0.4 * form.width
    for line in (door + e for door in _shut_lines(form) for e in (-0.008, 0.008)):  # their own columns
        crossed = np.flatnonzero(flank & ((x[:-1] - line) * (x[1:] - line) <= 0))
        at = np.concatenate([at[np.min(np.abs(at[:, None] - crossed), axis=1) > 6], crossed + 0.5])
    at = np.sort(at)
    return np.stack([np.interp(at, np.arange(len(angle)), x), np.interp(at, np.arange(len(angle)), y)], axis=1)


def _shut_lines(form: CarForm) -> tuple[float, float, float]:
    return form.pillar, form.belt[1] - 0.32, max(form.belt[0] + 0.75, form.wheels[0] + form.wheel_radius + 0.12)


def _top(form: CarForm, x: Any) -> Any:
    """Height of the body's shoulder: rising hood, level doors, tail."""
    half = 0.5 * form.length
    xs = [-half, form.belt[0] - 0.05, form.belt[0] + 0.35, form.belt[1] - 0.3, form.belt[1], half - 0.35, half]
    zs = [form.tail[0], form.tail[1], 0.5 * (form.tail[1] + form.hood[1]), form.hood[1] - 0.01, form.hood[1] - 0.03,
          form.hood[0] + 0.12, form.hood[0]]  # fmt: skip
    return np.interp(x, xs, zs)


def _foot(form: CarForm, x: Any, y: Any) -> Any:
    """Lower edge of the body: the sill, raised over the wheels on the body's flanks."""
    foot = np.full_like(x, 0.23) + 0.04 * (np.abs(x) > 0.5 * form.length - 0.3)
    arch = form.wheel_radius + 0.055
    for axle in form.wheels:
        over = np.sqrt(np.maximum(arch**2 - (x - axle) ** 2, 0)) + form.wheel_radius
        foot = np.where((np.abs(x - axle) < arch) & (np.abs(y) > 0.3 * form.width), np.maximum(foot, over), foot)
    return foot


def _skirt(form: CarForm, outline: Float64[np.ndarray, "n 2"], paint: Any) -> Quads:
    """Build flanks, front and rear: the outline extruded upwards, bulging at its middle."""
    x, y = outline.T
    foot, top = _foot(form, x, y), _top(form, x)
    rows = np.array([0.0, 0.12, 0.26, 0.42, 0.56, 0.70, 0.84, 0.94, 1.0])
    # Rows at the heights of an uncut body; over the wheels they are raised to the arch.
    z = np.maximum(0.23 + rows * (top - 0.23)[:, None], foot[:, None])
    absolute = (z - 0.23) / (top[:, None] - 0.23)
    inset = 0.055 * np.maximum(0.32 - absolute, 0) / 0.32 + 0.075 * np.maximum(absolute - 0.62, 0) ** 2 / 0.1444
    inset = inset - 0.012 * np.exp(-(((absolute - 0.60) / 0.05) ** 2))
    shrink = 1 - inset / (0.5 * form.width)
    lengthwise = 1 - inset * 0.9 / (0.5 * form.length)
    points = np.stack([x[:, None] * lengthwise, y[:, None] * shrink, z], axis=2)
    quads = patch(points, paint, Label.CAR, closed=True, gloss=_PAINT_GLOSS)
    quads = quads.take(np.linalg.norm(quads.corners[:, 2] - quads.corners[:, 0], axis=1) > 0.02)
    quads = quads.take(_cell_area(quads) > 0.012 * np.linalg.norm(quads.corners[:, 2] - quads.corners[:, 0], axis=1))
    center = quads.centers
    black = center[:, 2] < 0.30
    lower = np.clip((center[:, 2] - 0.2) / 0.5, 0, 1)
    albedo = np.where(black[:, None], _TRIM, quads.albedo)
    for door in _shut_lines(form):
        line = (np.abs(center[:, 0] - door) < 0.009) & (np.abs(center[:, 1]) > 0.4 * form.width)
        albedo = np.where((line & (center[:, 2] > 0.33))[:, None], 0.3 * albedo, albedo)
    return Quads.of(
        quads.corners, albedo, Label.CAR, spread=quads.spread, gloss=np.where(black, 0.04, _PAINT_GLOSS),
        sky_access=0.35 + 0.65 * lower,
    )  # fmt: skip


def _cell_area(quads: Quads) -> Any:
    diagonals = quads.corners[:, 2] - quads.corners[:, 0], quads.corners[:, 3] - quads.corners[:, 1]
    return 0.5 * np.linalg.norm(np.cross(*diagonals), axis=1)


def _deck(form: CarForm, outline: Float64[np.ndarray, "n 2"], paint: Any) -> Quads:
    """Build hood and tail: from the shoulder to the middle of the car, slightly domed."""
    x, y = outline.T
    top = _top(form, x)
    rows = np.array([0.0, 0.08, 0.22, 0.45, 0.72, 1.0])
    in_x = x * (1 - 0.075 * 0.9 / (0.5 * form.length))
    in_y = y * (1 - 0.075 / (0.5 * form.width))
    to_end = np.clip((0.5 * form.length - np.abs(x)) / 0.3, 0.1, 1)[:, None]
    level = top[:, None] + 0.055 * (1 - (1 - rows) ** 2.2) * to_end
    middle = 0.5 * (x[1:] + x[:-1])
    open_to_sky = (middle > form.belt[1] - 0.25) | (middle < form.belt[0] + 0.2)
    # Front and rear rows of the outline run across the car: there the deck would be a sliver.
    keep = np.repeat(open_to_sky[:, None], len(rows) - 1, axis=1)
    keep[:, 0] = True  # the shoulder next to the windows
    y_rows, gloss = in_y[:, None] * (1 - rows), _PAINT_GLOSS + 0.06
    return surface(in_x[:, None], y_rows, level, paint, Label.CAR, keep=keep, closed=True, gloss=gloss)


def _glass_house(form: CarForm, paint: Any, fine: float) -> Quads:
    """Build windows, pillars and roof: a loft from the belt line to the roof, then the roof's shell."""
    corner = 0.16
    rear, front = form.belt
    belt_y, roof_y = 0.5 * form.width - 0.105, 0.5 * form.width - 0.27
    across = np.array([-1.0, -0.86, -0.5, 0.0, 0.5, 0.86, 1.0])
    span = front - rear
    pillar = (form.pillar - rear) / span
    thin = 0.05 / span * 1.4
    stops = [0.0, corner / span * 1.2, pillar - thin, pillar + thin, 1 - corner / span * 1.5, 1.0]
    along = broken_lines(stops, 0.17 * fine / span)
    # Counter-clockwise from the rear right: right side forwards, windshield, left side back, rear window.
    right = np.stack([along, -np.ones_like(along)], axis=1)
    ahead = np.stack([np.ones_like(across), across], axis=1)
    left, behind = -right * [-1, 1], ahead * [0, -1]
    loop = np.concatenate([right, ahead[1:], left[::-1][1:], behind[1:]])
    side = np.concatenate([np.zeros(len(along) - 1), np.ones(6), np.full(len(along) - 1, 2), np.full(6, 3)])
    rows = np.array([0.0, 0.10, 0.32, 0.58, 0.80, 0.92, 1.0, 1.0])
    lean = np.array([0.0, 0.10, 0.32, 0.58, 0.80, 0.93, 1.06, 1.14])
    base = np.minimum(_top(form, rear + loop[:, 0] * span), form.hood[1] + 0.02) - 0.01
    crown = form.height - 0.035
    z = base[:, None] + rows * (crown - base)[:, None]
    z[:, -1] += 0.018
    belt_x, roof_x = rear + loop[:, 0] * span, form.roof[0] + loop[:, 0] * (form.roof[1] - form.roof[0])
    bow = 1 - 0.10 * np.abs(loop[:, 1]) ** 3 * np.abs(2 * loop[:, 0] - 1) ** 6
    px = belt_x[:, None] + lean * (roof_x - belt_x)[:, None]
    curve = 0.06 * (1 - loop[:, 1] ** 2) * np.where(loop[:, 0] > 0.5, 1, -0.6) * (np.abs(2 * loop[:, 0] - 1) > 0.99)
    px = px + curve[:, None]
    py = (loop[:, 1] * bow)[:, None] * (belt_y + lean * (roof_y - belt_y))
    points = np.stack([px, py, z], axis=2)
    i, j = len(loop) - 1, len(rows) - 1
    part = 0.5 * (loop[1:, 0] + loop[:-1, 0])
    wide = 0.5 * np.abs(loop[1:, 1] + loop[:-1, 1])
    on_side = (side == 0) | (side == 2)
    post = (part < stops[1]) | (part > stops[4]) | ((part > stops[2]) & (part < stops[3]))
    window = np.where(on_side, ~post, wide < 0.86)[:, None] & (np.arange(j) >= 1) & (np.arange(j) < 4)
    window |= (~on_side & (wide < 0.86))[:, None] & (np.arange(j) < 5)
    middle_post = on_side & (part > stops[2]) & (part < stops[3])
    glass = window.reshape(-1)
    albedo = np.where(window[..., None], _GLASS, np.where(middle_post[:, None, None], _TRIM, np.asarray(paint)))
    walls = patch(points, albedo.reshape(i * j, 3), Label.CAR, closed=True,
                  gloss=np.where(glass, _GLASS_GLOSS, _PAINT_GLOSS))  # fmt: skip
    return Quads.joined([walls, _roof(points[:, -1], form, paint)])


def _roof(rim: Float64[np.ndarray, "n 3"], form: CarForm, paint: Any) -> Quads:
    rows = np.array([0.0, 0.2, 0.5, 0.8, 1.0])
    middle_x = np.clip(rim[:, 0], form.roof[0] + 0.3, form.roof[1] - 0.25)
    x = rim[:, :1] + rows * (middle_x - rim[:, 0])[:, None]
    y = rim[:, 1:2] * (1 - rows)
    z = rim[:, 2:] + (form.height - rim[:, 2:]) * (1 - (1 - rows) ** 2)
    return patch(np.stack([x, y, z], axis=2), paint, Label.CAR, closed=True, gloss=_PAINT_GLOSS + 0.08)


def _wheels(form: CarForm, fine: float) -> list[Quads]:
    sides = 20 if fine < 1.2 else 14
    r = form.wheel_radius
    wheel = build_wheel(r, sides)
    tread = wheel.placed((0, -0.5 * form.width + 0.035, r))
    mirrored = wheel.placed((0, 0, 0), 180.0).placed((0, 0.5 * form.width - 0.035, r))
    parts = [each.placed((axle, 0, 0)) for axle in form.wheels for each in (tread, mirrored)]
    arch = r + 0.05
    angle = np.linspace(0.04 * np.pi, 0.96 * np.pi, 9)
    backs = np.linspace(-0.94 * arch, 0.94 * arch, 6), np.linspace(0.3, r + 0.7 * arch, 5)
    for axle in form.wheels:
        parts += wheel_wells(axle, r, arch, angle, 0.5 * form.width, (0.06, 0.34, 0.30), backs, Label.CAR)
    return parts


def _details(form: CarForm, paint: Any, fine: float) -> list[Quads]:
    """Lamps, grille, number plates, dark inserts of the bumpers, mirrors."""
    half = 0.5 * form.width
    z = form.hood[0]
    parts: list[Quads] = []
    for side in (-1, 1):
        headlight = _badge(form, 1, side * 0.62 * half, z - 0.09, 0.46 * half, 0.115, (0.72, 0.74, 0.76), 0.3, fine)
        parts.append(replace(headlight, emission=np.full((len(headlight), 3), HEAD_LIGHT, np.float32)))
        tall = 0.17 if form.height < 1.7 else 0.42
        red = (0.30, 0.004, 0.004)
        tail_light = _badge(form, -1, side * 0.73 * half, form.tail[0] - 0.10, 0.36 * half, tall, red, 0.06, fine)
        parts.append(replace(tail_light, emission=np.full((len(tail_light), 3), TAIL_LIGHT, np.float32)))
        parts.append(_mirror(form.belt[1] - 0.40, side * (half + 0.035), form.hood[1] + 0.045, paint))
    parts.append(_badge(form, 1, 0.0, z - 0.12, 0.62 * half, 0.10, _TRIM, 0.1, fine))
    parts.append(_badge(form, 1, 0.0, 0.36, 1.05 * half, 0.15, _TRIM, 0.05, fine))
    parts.append(_badge(form, -1, 0.0, 0.34, 1.2 * half, 0.13, _TRIM, 0.05, fine))
    parts.append(_badge(form, 1, 0.0, 0.47, 0.52, 0.11, (0.78, 0.78, 0.74), 0.05, fine, out=0.05))
    rear_plate = form.tail[0] - 0.24 if form.height < 1.7 else 0.75
    parts.append(_badge(form, -1, 0.0, rear_plate, 0.52, 0.11, (0.78, 0.78, 0.74), 0.05, fine, out=0.05))
    return parts


def _mirror(x: float, y: float, z: float, paint: Any) -> Quads:
    """A side mirror: an ellipsoid with its glass at the back."""
    turn = np.linspace(0, 2 * np.pi, 10)[:, None]
    along = np.cos(np.linspace(0, np.pi, 6))[None]
    wide = np.sqrt(np.maximum(1 - along**2, 0.0009))
    ys, zs = y + 0.095 * wide * np.cos(turn), z + 0.062 * wide * np.sin(turn)
    egg = surface(x + 0.06 * along, ys, zs, paint, Label.CAR, flipped=True, closed=True, gloss=_PAINT_GLOSS)
    return egg.tinted(np.where(egg.centers[:, 0] < x - 0.045, 0.2, 1.0)[:, None])


def _badge(
    form: CarForm, end: int, y: float, z: float, width: float, height: float, albedo: Any, gloss: float, fine: float,
    out: float = 0.045,
) -> Quads:  # fmt: skip
    """Lay a colored rectangle on the curved front (end 1) or rear (-1), centered at (y, z)."""
    yy = broken_lines([y - 0.5 * width, y + 0.5 * width], 0.12 * fine)
    zz = np.linspace(z - 0.5 * height, z + 0.5 * height, max(3, round(height / 0.06) + 1))
    part = np.clip(np.abs(yy) / (0.5 * form.width * 0.975), 0, 0.995)
    reach = 0.5 * form.length * (1 - part**4.2) ** (1 / 6.5)
    up = (zz - 0.23) / (float(_top(form, end * 0.5 * form.length)) - 0.23)
    inset = 0.055 * np.maximum(0.32 - up, 0) / 0.32 + 0.075 * np.maximum(up - 0.62, 0) ** 2 / 0.1444
    inset = np.minimum(inset - 0.012 * np.exp(-(((up - 0.60) / 0.05) ** 2)), 0.09)
    x = end * (reach[:, None] * (1 - inset * 0.9 / (0.5 * form.length)) + out)
    return surface(x, yy[:, None], zz, albedo, Label.CAR, flipped=end < 0, gloss=gloss)


def _underside(form: CarForm) -> Quads:
    x = np.linspace(-0.5 * form.length + 0.12, 0.5 * form.length - 0.12, 10)
    y = np.linspace(-0.5 * form.width + 0.12, 0.5 * form.width - 0.12, 5)
    return surface(x[:, None], y, 0.21, 0.01, Label.CAR, flipped=True, sky_access=0.1, sun_access=0.0)


# Wheels


def wheel_wells(
    axle: float, radius: float, arch: float, angle: Any, half_width: float, insets: tuple[float, float, float],
    backs: tuple[Any, Any], label: Label,
) -> list[Quads]:  # fmt: skip
    """Build the two dark wheel wells of an axle: arcs of radius `arch` around the hubs, and walls behind the wheels.

    `insets` count from the flanks: the arc's outer and inner edge, and the wall. `backs` is the wall's grid (x, z).
    """
    outer, inner, wall = insets
    x, z = axle + arch * np.cos(angle)[:, None], radius + arch * np.sin(angle)[:, None]
    parts: list[Quads] = []
    for side in (-1, 1):
        y = side * np.array([half_width - outer, half_width - inner])
        parts.append(surface(x, y, z, 0.008, label, flipped=side > 0, sky_access=0.15, sun_access=0.0))
        parts.append(surface(axle + backs[0][:, None], side * (half_width - wall), backs[1], 0.006, label,
                             flipped=side > 0, sky_access=0.1, sun_access=0.0))  # fmt: skip
    return parts


TIRE = (0.018, 0.018, 0.019)
RIM = (0.36, 0.36, 0.37)


def build_wheel(radius: float, sides: int, dish: float = 0.0) -> Quads:
    """Build the right-hand side of a wheel around its hub: the outside faces -y, the tread runs inwards to +0.19 m.

    `dish` is the depth of the rim inside the tire, in meters: trucks' twin wheels are hollow.
    """
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    radii = np.array([0.0, 0.06, 0.13, 0.205, 0.225, 0.275, 0.315, 0.32]) * radius / 0.32
    depth = np.array([0.035, 0.035, 0.03, 0.02, 0.0, 0.0, 0.012, 0.19])
    depth = depth + dish * np.array([0.8, 1.0, 1.0, 1.0, 0, 0, 0, 0])
    ring = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    points = radii[None, :, None] * ring[:, None] - depth[None, :, None] * np.array([0, -1.0, 0])
    spokes = (np.arange(sides) % 4 < 2)[:, None]
    ringed = np.arange(len(radii) - 1)[None]
    metal = np.where(ringed == 0, 0.9, np.where(spokes & (ringed < 3), 1.0, np.where(ringed == 3, 0.95, 0.16)))
    albedo = np.where((ringed < 4)[..., None], metal[..., None] * np.asarray(RIM), TIRE)
    albedo = np.broadcast_to(albedo, (sides, len(radii) - 1, 3)).reshape(-1, 3)
    return patch(points, albedo, Label.CAR, closed=True, sky_access=0.6, gloss=0.04)


# Truck outline and colors

STEEL: Color = (0.10, 0.105, 0.11)
DARK: Color = (0.016, 0.016, 0.018)
TRIM: Color = (0.022, 0.022, 0.024)
PLATE: Color = (0.78, 0.78, 0.74)
AMBER: Color = (0.60, 0.19, 0.01)
RED_TAPE: Color = (0.45, 0.012, 0.014)


@dataclass(frozen=True, slots=True)
class TruckForm:
    """The outline of a 7.5 t box truck, in meters; x counts from the center."""

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
        """Rear doors of the box, x."""
        return -0.5 * self.length + 0.06


TRUCK_FORM = TruckForm()
