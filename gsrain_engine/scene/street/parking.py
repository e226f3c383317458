"""Who stands at the kerbs of the street: cars in their bays, and lorries where the crowns of the trees leave room."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .parameters import StreetParameters

CROSSING_LENGTH_M = 3.0
TRUCK_LENGTH_M, TRUCK_WIDTH_M = 7.2, 2.2

CarShape = Literal["hatchback", "saloon", "estate", "van"]
Color = tuple[float, float, float]
"""Linear albedo."""

_PAINTS: tuple[Color, ...] = (
    (0.45, 0.45, 0.46),  # silver
    (0.03, 0.03, 0.034),  # black
    (0.62, 0.62, 0.61),  # white
    (0.025, 0.05, 0.12),  # blue
    (0.20, 0.014, 0.014),  # red
    (0.13, 0.14, 0.15),  # graphite
    (0.03, 0.07, 0.05),  # green
    (0.36, 0.33, 0.27),  # sand
)
_LORRIES: tuple[tuple[int, float, Color, Color, Color], ...] = (
    (1, 58.0, (0.60, 0.60, 0.59), (0.62, 0.62, 0.60), (0.03, 0.10, 0.30)),
    (1, 86.5, (0.42, 0.025, 0.02), (0.62, 0.62, 0.60), (0.42, 0.025, 0.02)),
    (-1, 67.0, (0.03, 0.09, 0.27), (0.64, 0.64, 0.63), (0.03, 0.09, 0.27)),
    (-1, 97.5, (0.62, 0.62, 0.61), (0.035, 0.11, 0.26), (0.62, 0.62, 0.60)),
)
"""Side of the street (1: left), where about (x, m), colours of cab, box and sign."""
_CAR_LENGTH_M, _GAP_M = 4.7, 0.5
_MOST_SHIFT_M = 5.0
"""A lorry that finds no room so near to where it would like to stand has not come."""


@dataclass(frozen=True, slots=True)
class ParkedCar:
    """A car at the kerb; heading +x or -x."""

    x: float
    y: float
    turn_deg: float
    shape: CarShape
    paint: Color


@dataclass(frozen=True, slots=True)
class ParkedTruck:
    """A box lorry at the kerb; heading +x or -x."""

    x: float
    y: float
    turn_deg: float
    cab: Color
    body: Color
    sign: Color


def plan_cars(p: StreetParameters, crossings: Sequence[float], rng: np.random.Generator) -> tuple[ParkedCar, ...]:
    """Draw which bays are taken, and by what."""
    cars: list[ParkedCar] = []
    shapes: tuple[CarShape, ...] = ("hatchback", "saloon", "estate", "hatchback", "van", "saloon")
    for side in (1, -1):
        for x in np.arange(p.start_x_m + 6, p.end_x_m - 5, 6.1):
            draws = rng.uniform(size=4)
            x = float(x) + 1.0 * (draws[0] - 0.5)
            near_crossing = any(c - 6.5 < x < c + CROSSING_LENGTH_M + 6.5 for c in crossings)
            if draws[1] > p.parked_share or near_crossing:
                continue
            y = side * (p.kerb_y_m - 0.5 * p.parking_width_m - 0.05 + 0.16 * (draws[2] - 0.5))
            shape = shapes[int(rng.integers(len(shapes)))]
            paint = _PAINTS[int(rng.integers(len(_PAINTS)))]
            cars.append(ParkedCar(x, y, (180.0 if side > 0 else 0.0) + 1.6 * (draws[3] - 0.5), shape, paint))
    return tuple(cars)


def plan_trucks(
    p: StreetParameters,
    crossings: Sequence[float],
    crowns: Sequence[tuple[float, float, float]],
    cars: Sequence[ParkedCar],
) -> tuple[ParkedTruck, ...]:
    """Place lorries close to the kerb, clear of crowns (x, y, radius) and crossings; none where nobody may park."""
    trucks: list[ParkedTruck] = []
    for side, x, cab, body, sign in _LORRIES if cars else ():
        taken = [(at - radius, at + radius) for at, y, radius in crowns if y * side > 0]
        taken += [(c - 5.0, c + CROSSING_LENGTH_M + 5.0) for c in crossings]
        taken += [(-np.inf, p.start_x_m + 2.0), (p.end_x_m - 2.0, np.inf)]
        shifts = sorted(np.arange(-_MOST_SHIFT_M, _MOST_SHIFT_M + 0.1, 0.25), key=abs)
        reach = 0.5 * TRUCK_LENGTH_M
        free = [x + s for s in shifts if all(x + s + reach < low or x + s - reach > high for low, high in taken)]
        if free:
            y = side * (p.kerb_y_m - 0.03 - 0.5 * TRUCK_WIDTH_M)
            trucks.append(ParkedTruck(float(free[0]), y, 180.0 if side > 0 else 0.0, cab, body, sign))
    return tuple(trucks)


def beside_trucks(cars: Sequence[ParkedCar], trucks: Sequence[ParkedTruck]) -> tuple[ParkedCar, ...]:
    """The cars that find room where the trucks stand already."""
    least = 0.5 * (TRUCK_LENGTH_M + _CAR_LENGTH_M) + _GAP_M
    return tuple(car for car in cars if all(car.y * t.y < 0 or abs(car.x - t.x) > least for t in trucks))
