"""Parked vehicles as boxes that keep light away: what shadows need to know of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from .cars import CAR_FORMS
from .layout import StreetLayout
from .parking import ParkedCar, ParkedTruck
from .truck_form import TRUCK_FORM

Corner = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Standing:
    """A vehicle that stands at (x, y), in metres."""

    x: float
    y: float
    way: float
    """1 where it heads +x, -1 where it heads -x."""
    length: float
    width: float
    height: float
    """Up to where it shades other things."""
    reach: float
    """How far beside it shadows are looked for."""
    boxes: tuple[tuple[Corner, Corner], ...]
    """Lowest and highest corners, in its own frame."""
    shades_itself: bool
    """Whether its boxes are exact enough to shade its own surfaces; else those are lit by their normals alone."""

    def is_lit_by_itself(self, local: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which places in its own frame are its own surfaces, that no box may shade."""
        if self.shades_itself:
            return np.zeros(len(local), np.bool_)
        half, w = 0.5 * self.length, 0.5 * self.width
        return np.asarray((np.abs(local[:, 0]) <= half) & (np.abs(local[:, 1]) <= w) & (local[:, 2] >= 0.16))


def standing_vehicles(layout: StreetLayout) -> tuple[Standing, ...]:
    return *(_car(each) for each in layout.cars), *(_truck(each) for each in layout.trucks)


def _car(car: ParkedCar) -> Standing:
    form = CAR_FORMS[car.shape]
    half, w = 0.5 * form.length, 0.5 * form.width
    body = (-half, -w, 0.16), (half, w, form.hood[1] - 0.02)
    rear, front = 0.5 * (form.belt[0] + form.roof[0]), 0.5 * (form.belt[1] + form.roof[1])
    cabin = (rear, -w + 0.2, 0.8), (front, w - 0.2, form.height)
    return Standing(car.x, car.y, _way(car), form.length, form.width, 1.2, 2.7, (body, cabin), False)


def _truck(truck: ParkedTruck) -> Standing:
    """A truck: its box, its cab behind the windscreen, and what is below the box."""
    form = TRUCK_FORM
    w, cab_w = 0.5 * form.width, 0.5 * form.cab_width - 0.1
    body = (form.body_back + 0.02, -w + 0.02, form.floor), (form.body_front - 0.02, w - 0.02, form.height - 0.02)
    cab = (form.cab_back + 0.05, -cab_w, 0.45), (0.5 * form.length - 0.5, cab_w, form.cab_height - 0.1)
    below = (form.body_back + 0.1, -0.45, 0.5), (form.cab_back, 0.45, form.floor)
    boxes = (body, cab, below)
    return Standing(truck.x, truck.y, _way(truck), form.length, form.width, form.height, 4.6, boxes, True)


def _way(vehicle: ParkedCar | ParkedTruck) -> float:
    return -1.0 if abs(vehicle.turn_deg) > 90 else 1.0
