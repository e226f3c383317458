"""Occlusion of sun and sky in the street by houses, tree crowns and parked vehicles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64

from gsrain_engine.scene.noise import smooth_noise

from .buses import BUS_FORM
from .cars import CAR_FORMS, TRUCK_FORM
from .layout import CURB_HEIGHT_M, HOUSE_DEPTH_M, House, ParkedBus, ParkedCar, ParkedTruck, StreetLayout
from .people import Figure, people_of
from .vegetation import crown_lobes


def sun_visibility(
    layout: StreetLayout, sun: Float64[np.ndarray, "3"], points: Float[np.ndarray, "n 3"], leaf: Bool[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Fraction of the sun that reaches each point. Trees do not shade leaves again, as their own crown already does."""
    p = points.astype(np.float64)
    visible = np.ones(len(p))
    for row, side in ((layout.left, 1), (layout.right, -1)):
        if sun[1] * side > 0.02:
            visible *= _past_houses(row, side, layout.parameters.front_y_m, sun, p)
    ground = np.flatnonzero(~leaf & (visible > 0.01))
    visible[ground] *= _through_trees(layout, sun, p[ground])
    low = np.flatnonzero(~leaf & (visible > 0.01))
    visible[low] *= _past_vehicles(vehicle_occluders(layout), sun, p[low])
    return visible


def ground_occlusion(
    layout: StreetLayout, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], *, canyon: bool = True
) -> Float64[np.ndarray, " n"]:
    """Fraction of the sky's light in the street: less below cars, under trees, and at the foot of walls.

    `canyon` makes it less between houses, too.
    """
    p = points.astype(np.float64)
    a = layout.parameters
    inside = (p[:, 0] > a.start_x_m) & (p[:, 0] < a.end_x_m) & (np.abs(p[:, 1]) < a.front_y_m + 0.5)
    share = np.where(inside & canyon, 0.75 + 0.25 * np.clip(p[:, 2] / 16.0, 0, 1), 1.0)
    level = (p[:, 2] < CURB_HEIGHT_M + 0.05) & (normals[:, 2] > 0.5)
    at_wall = np.maximum(a.front_y_m - np.abs(p[:, 1]), 0)
    share = np.where(inside & level, share * (1 - 0.38 * np.exp(-at_wall / 0.6)), share)
    at_kerb = np.abs(np.abs(p[:, 1]) - a.curb_y_m)
    in_gutter = inside & level & (np.abs(p[:, 1]) < a.curb_y_m)
    share = np.where(in_gutter, share * (1 - 0.35 * np.exp(-at_kerb / 0.08)), share)
    low = np.flatnonzero(inside & (p[:, 2] < 0.6) & (normals[:, 2] > 0.3))
    share[low] *= _vehicle_occlusion(vehicle_occluders(layout), p[low])
    for tree in layout.trees:
        below = (np.abs(p[:, 0] - tree.x) < 4) & (np.abs(p[:, 1] - tree.y) < 4)
        near = np.flatnonzero(below & (p[:, 2] < tree.crown_base))
        away = np.hypot(p[near, 0] - tree.x, p[near, 1] - tree.y)
        share[near] *= 1 - 0.34 * np.exp(-((away / (1.1 * tree.radius)) ** 2)) - 0.3 * np.exp(-((away / 0.3) ** 2))
    return share


def _past_houses(
    row: tuple[House, ...], side: int, front: float, sun: Float64[np.ndarray, "3"], p: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Compare the ray's height with the eaves and the ridge of the house below it."""
    starts = np.array([house.origin[0] - (house.width if side < 0 else 0) for house in row])
    stop = starts[-1] + row[-1].width
    visible = np.ones(len(p))
    for depth, heights in ((0.0, [h.eaves for h in row]), (0.5 * HOUSE_DEPTH_M, [h.ridge for h in row])):
        t = (side * (front + depth) - p[:, 1]) / sun[1]
        x, z = p[:, 0] + t * sun[0], p[:, 2] + t * sun[2]
        index = np.searchsorted(starts, x, side="right") - 1
        height = np.where((index >= 0) & (x < stop), np.array(heights)[np.clip(index, 0, None)] + CURB_HEIGHT_M, -1.0)
        soft = 0.04 + 0.012 * np.abs(t)
        clear = np.clip((z - height) / soft * 0.5 + 0.5, 0, 1)
        visible *= np.where(t > 0.02, clear * clear * (3 - 2 * clear), 1.0)
    return visible


def _through_trees(
    layout: StreetLayout, sun: Float64[np.ndarray, "3"], p: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Transmit light through the crowns in flecks."""
    passed = np.ones(len(p))
    for tree in layout.trees:
        middle = np.array([tree.x, tree.y, CURB_HEIGHT_M + 0.5 * (tree.crown_base + tree.height)])
        away = p - middle
        along = away @ sun
        aside = np.linalg.norm(away - along[:, None] * sun, axis=1)
        near = np.flatnonzero((aside < tree.radius + 1.5) & (along < tree.radius))
        if not len(near):
            continue
        path = np.zeros(len(near))
        for lobe in crown_lobes(tree):
            to = p[near] - lobe[:3]
            on = to @ sun
            root = np.sqrt(np.maximum(on**2 - np.sum(to**2, axis=1) + lobe[3] ** 2, 0))
            path += np.where(on < 0, 2 * root, 0)
        plane = np.cross(sun, [0.0, 1.0, 0.0])
        other = np.cross(sun, plane)
        flat = np.stack([p[near] @ plane, p[near] @ other], axis=1)
        flecks = smooth_noise(flat, 0.42, tree.seed % 4093) * 0.6 + smooth_noise(flat, 0.9, tree.seed % 4091) * 0.4
        cover = np.clip(path / 0.9, 0, 1)
        hole = np.clip((flecks - 0.56) / 0.14, 0, 1)
        passed[near] *= 1 - cover * (0.94 - 0.75 * hole)
        stem = p[near, :2] - [tree.x, tree.y]
        t = np.clip(-(stem @ sun[:2]) / (sun[:2] @ sun[:2]), 0, tree.crown_base / sun[2])
        miss = np.linalg.norm(stem + t[:, None] * sun[:2], axis=1)
        on_ground = (p[near, 2] < 0.3) & (np.linalg.norm(stem, axis=1) > 0.12)
        passed[near] *= np.where(on_ground, np.clip((miss - 0.08) / 0.08, 0, 1), 1.0)
    return passed


class PointsAlong(NamedTuple):
    """Points in the order of x, to find those near a place on the street."""

    order: Int64[np.ndarray, " n"]
    x: Float64[np.ndarray, " n"]

    @classmethod
    def of(cls, points: Float64[np.ndarray, "n 3"]) -> "PointsAlong":
        order = np.argsort(points[:, 0], kind="stable")
        return cls(order, points[order, 0])

    def within(self, x: float, reach: float) -> Int64[np.ndarray, " m"]:
        """Rows of the points less than `reach` from x."""
        return self.order[slice(*self.span(x, reach))]

    def span(self, x: float, reach: float) -> tuple[int, int]:
        """First and past-the-last of these points in `order`."""
        return int(np.searchsorted(self.x, x - reach, "right")), int(np.searchsorted(self.x, x + reach, "left"))


# Vehicle occluders

Corner = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class VehicleOccluder:
    """Boxes of a vehicle at (x, y), in meters."""

    x: float
    y: float
    way: float
    """1 for heading +x, -1 for -x."""
    length: float
    width: float
    height: float
    """Maximum height of its shade on other objects."""
    reach: float
    """Maximum distance of its shadows to the sides."""
    boxes: tuple[tuple[Corner, Corner], ...]
    """Lowest and highest corners, in its own frame."""
    shades_itself: bool
    """True if its boxes are exact enough to shade its own surfaces; otherwise only their normals light those."""

    def is_lit_by_itself(self, local: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Mask of positions (own frame) on its own surfaces that no box may shade."""
        if self.shades_itself:
            return np.zeros(len(local), np.bool_)
        half, w = 0.5 * self.length, 0.5 * self.width
        return np.asarray((np.abs(local[:, 0]) <= half) & (np.abs(local[:, 1]) <= w) & (local[:, 2] >= 0.16))


def _past_vehicles(
    vehicles: Sequence[VehicleOccluder], sun: Float64[np.ndarray, "3"], p: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Cast shadows of a few boxes per vehicle, softened at grazing angles of the sun."""
    passed = np.ones(len(p))
    along = PointsAlong.of(p)
    for each in vehicles:
        half, w = 0.5 * each.length, 0.5 * each.width
        rows = along.within(each.x, half + 1.4 * each.height)
        near = rows[(np.abs(p[rows, 1] - each.y) < w + each.reach) & (p[rows, 2] < each.height)]
        if not len(near):
            continue
        local = (p[near] - [each.x, each.y, 0.0]) * [each.way, each.way, 1.0]
        towards = sun * [each.way, each.way, 1.0]
        for low, high in each.boxes:
            low_t, high_t = (np.array(low) - local) / towards, (np.array(high) - local) / towards
            enter, leave = np.minimum(low_t, high_t).max(axis=1), np.maximum(low_t, high_t).min(axis=1)
            path = leave - np.maximum(enter, 0)
            shaded = 1 - np.clip(path / 0.22, 0, 1)
            passed[near] *= np.where(each.is_lit_by_itself(local), 1.0, shaded)
    return passed


def _vehicle_occlusion(vehicles: Sequence[VehicleOccluder], p: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    share = np.ones(len(p))
    along = PointsAlong.of(p)
    for each in vehicles:
        rows = along.within(each.x, 0.5 * each.length + 1.1)
        away_x = np.abs(p[rows, 0] - each.x) - 0.5 * each.length + 0.1
        away_y = np.abs(p[rows, 1] - each.y) - 0.5 * each.width + 0.1
        near = (away_y < 1.2) & (p[rows, 2] < 0.16)
        away = np.hypot(np.maximum(away_x[near], 0), np.maximum(away_y[near], 0))
        share[rows[near]] *= 1 - 0.88 * np.exp(-away / 0.32)
    return share


def vehicle_occluders(layout: StreetLayout) -> tuple[VehicleOccluder, ...]:
    """Boxes of vehicles and people that shade what is around them."""
    return (
        *(_car(each) for each in layout.cars),
        *(_truck(each) for each in layout.trucks),
        *(_bus(each) for each in layout.buses),
        *(_person(place, turn, figure) for figure, place, turn in people_of(layout)),
    )


def _car(car: ParkedCar) -> VehicleOccluder:
    form = CAR_FORMS[car.shape]
    half, w = 0.5 * form.length, 0.5 * form.width
    body = (-half, -w, 0.16), (half, w, form.hood[1] - 0.02)
    rear, front = 0.5 * (form.belt[0] + form.roof[0]), 0.5 * (form.belt[1] + form.roof[1])
    cabin = (rear, -w + 0.2, 0.8), (front, w - 0.2, form.height)
    return VehicleOccluder(car.x, car.y, _direction(car), form.length, form.width, 1.2, 2.7, (body, cabin), False)


def _truck(truck: ParkedTruck) -> VehicleOccluder:
    """A truck: its box, its cab behind the windshield, and the parts below the box."""
    form = TRUCK_FORM
    w, cab_w = 0.5 * form.width, 0.5 * form.cab_width - 0.1
    body = (form.body_back + 0.02, -w + 0.02, form.floor), (form.body_front - 0.02, w - 0.02, form.height - 0.02)
    cab = (form.cab_back + 0.05, -cab_w, 0.45), (0.5 * form.length - 0.5, cab_w, form.cab_height - 0.1)
    below = (form.body_back + 0.1, -0.45, 0.5), (form.cab_back, 0.45, form.floor)
    boxes = (body, cab, below)
    return VehicleOccluder(truck.x, truck.y, _direction(truck), form.length, form.width, form.height, 4.6, boxes, True)


def _bus(bus: ParkedBus) -> VehicleOccluder:
    form = BUS_FORM
    half, w = 0.5 * form.length - 0.08, 0.5 * form.width - 0.06
    body = (-half, -w, form.sill), (half, w, form.height - 0.12)
    return VehicleOccluder(
        bus.x, bus.y, _direction(bus), form.length, form.width, form.height, 4.4, (body,), False
    )  # fmt: skip


def _person(place: Corner, turn_deg: float, figure: Figure) -> VehicleOccluder:
    """A person: legs, trunk and head, in axes of the street."""
    x, y, foot = place
    across = abs(np.sin(np.radians(turn_deg))) > 0.7  # whether shoulders are along x
    tall, wide, deep = figure.height_m, 0.22, 0.13
    a, b = (wide, deep) if across else (deep, wide)
    legs = (-0.75 * a, -0.75 * b, foot), (0.75 * a, 0.75 * b, foot + 0.52 * tall)
    trunk = (-a, -b, foot + 0.48 * tall), (a, b, foot + 0.83 * tall)
    head = (-0.09, -0.09, foot + 0.82 * tall), (0.09, 0.09, foot + 0.99 * tall)
    size = 2 * a + 0.1, 2 * b + 0.1, foot + tall
    return VehicleOccluder(x, y, 1.0, *size, 2.6, (legs, trunk, head), False)


def _direction(vehicle: ParkedCar | ParkedTruck | ParkedBus) -> float:
    return -1.0 if abs(vehicle.turn_deg) > 90 else 1.0
