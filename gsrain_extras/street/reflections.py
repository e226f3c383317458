"""Light around points of wet ground, which reflects it: sky, walls, crowns and vehicles, by azimuth and elevation."""

from collections.abc import Iterator
from dataclasses import replace
from math import atan2, floor, radians, sqrt
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.kernels import kernel, range_of
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.skies import OVERCAST_ZENITH, overcast_luminance
from gsrain_engine.scene.water_surface import wet_albedo

from .buses import BUS_FORM
from .cars import CAR_FORMS, TRUCK_FORM
from .layout import Color, House, StreetLayout
from .lighting import Illumination
from .mesh import panel
from .vegetation import crown_middle

_WALL_LIGHT, _VEHICLE_LIGHT, _LEAF_LIGHT = 0.30, 0.34, 0.30
"""Light on walls, vehicles and leaves in the street, relative to the open sky on level ground."""
_GLASS = 0.10  # light of the sky that the windows of a wall reflect, relative to the zenith
_LEAF: Color = (0.05, 0.11, 0.018)
_NEAR_M = 45.0  # maximum distance along the street of trees and vehicles that are reflected
_END_M, _END_HEIGHT_M = 13.0, 13.0  # distance of the houses across both ends of the street, and their height
_CROWN_COVER, _VEHICLE_COVER = 0.85, 0.95
_SOFT_WALL, _SOFT_CROWN, _SOFT_VEHICLE = radians(1.5), 0.05, 0.03  # elevations over which their upper edges fade
_FRONT_CELL_M = 0.75
_FRONT_ROWS = 18
_END_LIGHT = 0.022, 0.016, 0.010  # by night, of the houses across both ends, with their windows


class Surroundings(NamedTuple):
    """Surroundings of a street and their light, as arrays for a compiled kernel; lengths in meters."""

    sky: Float64[np.ndarray, "e 3"]
    ends: Float64[np.ndarray, "6"]
    """x of the houses across both ends, y of the fronts, and the light of the ends' houses."""
    left: Float64[np.ndarray, "m 6"]
    """Start and end along x of each house in the order of x, height that ends the view, and light of the wall."""
    right: Float64[np.ndarray, "n 6"]
    crowns: Float64[np.ndarray, "t 8"]
    """x, y, radius, height of the middle, half height, light."""
    vehicles: Float64[np.ndarray, "v 8"]
    """x, y of the middle, half length and width, height, light."""
    start_x_m: float
    fronts: Float32[np.ndarray, "side nx nz 3"]
    """By night: light of the fronts on the left and on the right, in cells from `start_x_m`. Empty by day."""

    @classmethod
    def of(cls, light: Illumination, rises: Float32[np.ndarray, " e"]) -> "Surroundings":
        """Surroundings in a light, with the sky at elevations in radians."""
        layout, lighting = light.layout, light.lighting
        assert layout is not None
        a = layout.parameters
        if lighting.lamps:
            assert lighting.reflected_sky is not None and lighting.reflected_dim is not None
            sky, dim, fronts = lighting.reflected_sky, lighting.reflected_dim, _front_light(light)
        else:
            sky = OVERCAST_ZENITH * overcast_luminance(np.sin(rises))[:, None]
            dim, fronts = np.ones(3), np.zeros((2, 0, 0, 3), np.float32)
        leaf = dim * _lit(_LEAF, _LEAF_LIGHT)
        crowns = [(tree.x, tree.y, tree.radius, *crown_middle(tree), *leaf) for tree in layout.trees]
        mirrored = 0.04 * OVERCAST_ZENITH
        vehicles = [(*box, *(dim * (_lit(paint, _VEHICLE_LIGHT) + mirrored))) for *box, paint in _vehicles(layout)]
        return cls(
            np.broadcast_to(sky, (len(rises), 3)).astype(np.float64),
            np.array([a.start_x_m - _END_M, a.end_x_m + _END_M, a.front_y_m, *_wall_light(layout.ends)]),
            _walls(layout.left, 1),
            _walls(layout.right, -1),
            np.array(crowns).reshape(-1, 8),
            np.array(vehicles).reshape(-1, 8),
            a.start_x_m,
            fronts,
        )

    def light_around(
        self,
        points: Float64[np.ndarray, "n 3"],
        azimuths: Float32[np.ndarray, " a"],
        rises: Float32[np.ndarray, " e"],
    ) -> Float32[np.ndarray, "n 3 a e"]:
        """Light that arrives at points of the ground, by channel, azimuth and elevation (radians)."""
        light = np.empty((len(points), 3, len(azimuths), len(rises)), np.float32)
        ways = np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1).astype(np.float64)
        elevations = np.stack([rises, np.tan(rises)], axis=1).astype(np.float64)
        _look_around(points, ways, elevations, self, light)
        return light


def _starts(row: tuple[House, ...], side: int) -> Float64[np.ndarray, " n"]:
    """Start of each house along x; on the right (-1) its origin is at its end."""
    return np.array([house.origin[0] - (house.width if side < 0 else 0) for house in row])


def _walls(row: tuple[House, ...], side: int) -> Float64[np.ndarray, "n 6"]:
    """Houses of a row as in `Surroundings`."""
    starts = _starts(row, side)
    stops = np.append(starts[1:], starts[-1] + row[-1].width)
    heights = np.array([house.eaves + 0.3 * (house.ridge - house.eaves) for house in row])
    return np.column_stack([starts, stops, heights, [_wall_light((house,)) for house in row]])


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _look_around(portion, points, ways, elevations, around, light):
    reach = np.empty(len(ways))
    for i in range_of(portion, len(points)):
        x, y, lit = points[i, 0], points[i, 1], light[i]
        for a in range(len(ways)):
            reach[a] = _fill_walls(x, y, ways[a, 0], ways[a, 1], elevations, around, lit[:, a])
        for k in range(len(around.crowns)):
            if abs(x - around.crowns[k, 0]) < _NEAR_M:
                _cover_by_crown(x, y, ways, reach, elevations, around.crowns[k], lit)
        for k in range(len(around.vehicles)):
            if abs(x - around.vehicles[k, 0]) < _NEAR_M:
                _cover_by_vehicle(x, y, ways, reach, elevations, around.vehicles[k], lit)


@numba.njit(error_model="numpy")
@no_type_check
def _fill_walls(x, y, c, s, elevations, around, light):
    """Fill in the sky, and below it the wall that ends the view; return its distance."""
    ends = around.ends
    reach = ((ends[1] if c > 0 else ends[0]) - x) / c if abs(c) > 1e-4 else 1e4
    reach = reach if reach > 0 else 60.0
    height, red, green, blue = _END_HEIGHT_M, ends[3], ends[4], ends[5]
    to_front = ((ends[2] if s > 0 else -ends[2]) - y) / s if abs(s) > 1e-4 else 1e4
    if 0 < to_front < reach:
        row = around.left if s > 0 else around.right
        met = x + to_front * c
        if len(row) and row[0, 0] <= met < row[-1, 1]:
            k = 0
            while k < len(row) - 1 and met >= row[k, 1]:
                k += 1
            reach, height, red, green, blue = to_front, row[k, 2], row[k, 3], row[k, 4], row[k, 5]
    top, fronts = atan2(height, reach), around.fronts
    side, cell, is_front = 0, 0, False
    if fronts.shape[1]:
        along = floor((x + reach * c - around.start_x_m) / _FRONT_CELL_M)
        is_front = 0 <= along < fronts.shape[1]
        cell = int(max(0.0, min(fronts.shape[1] - 1.0, along)))
        side = 1 if y + reach * s < 0 else 0
        red, green, blue = _END_LIGHT
    for e in range(len(elevations)):
        if is_front:
            row_of_cells = int(max(0.0, min(_FRONT_ROWS - 1.0, reach * elevations[e, 1] / _FRONT_CELL_M)))
            red, green, blue = (
                fronts[side, cell, row_of_cells, 0],
                fronts[side, cell, row_of_cells, 1],
                fronts[side, cell, row_of_cells, 2],
            )
        covered = min(1.0, max(0.0, (top - elevations[e, 0]) / _SOFT_WALL + 0.5))
        light[0, e] = around.sky[e, 0] + covered * (red - around.sky[e, 0])
        light[1, e] = around.sky[e, 1] + covered * (green - around.sky[e, 1])
        light[2, e] = around.sky[e, 2] + covered * (blue - around.sky[e, 2])
    return reach


@numba.njit(error_model="numpy")
@no_type_check
def _cover_by_crown(x, y, ways, reach, elevations, crown, light):
    """Cover what is behind a crown, an ellipsoid."""
    u, v, radius = crown[0] - x, crown[1] - y, crown[2]
    for a in range(len(ways)):
        along, aside = u * ways[a, 0] + v * ways[a, 1], u * ways[a, 1] - v * ways[a, 0]
        if 0.3 < along < reach[a] and abs(aside) < radius:
            h = crown[4] * sqrt(1 - (aside / radius) * (aside / radius))
            low, high = atan2(crown[3] - h, along), atan2(crown[3] + h, along)
            for e in range(len(elevations)):
                inside = min(1.0, max(0.0, (elevations[e, 0] - low) / _SOFT_CROWN + 0.5))
                inside *= min(1.0, max(0.0, (high - elevations[e, 0]) / _SOFT_CROWN + 0.5))
                if inside <= 0:
                    continue
                for c in range(3):
                    light[c, a, e] += _CROWN_COVER * inside * (crown[5 + c] - light[c, a, e])


@numba.njit(error_model="numpy")
@no_type_check
def _cover_by_vehicle(x, y, ways, reach, elevations, vehicle, light):
    """Cover what is behind a box."""
    u, v, half_length, half_width = vehicle[0] - x, vehicle[1] - y, vehicle[2], vehicle[3]
    radius = sqrt(half_length * half_length + half_width * half_width)
    for a in range(len(ways)):
        c, s = ways[a, 0], ways[a, 1]
        if abs(u * s - v * c) > radius or u * c + v * s < -radius:
            continue
        c, s = c if c != 0 else 1e-20, s if s != 0 else 1e-20
        first, last = (u - half_length) / c, (u + half_length) / c
        enter, leave = min(first, last), max(first, last)
        first, last = (v - half_width) / s, (v + half_width) / s
        enter, leave = max(enter, min(first, last)), min(leave, max(first, last))
        if leave > max(0.0, enter) and enter < reach[a]:
            top = atan2(vehicle[4], max(0.05, enter))
            for e in range(len(elevations)):
                inside = min(1.0, max(0.0, (top - elevations[e, 0]) / _SOFT_VEHICLE + 0.5))
                if inside <= 0:  # nor at those above
                    break
                for k in range(3):
                    light[k, a, e] += _VEHICLE_COVER * inside * (vehicle[5 + k] - light[k, a, e])


def _lit(albedo: Color, light: float) -> Float32[np.ndarray, "3"]:
    return np.float32(light * 7 / 9 * OVERCAST_ZENITH) * np.array(albedo, np.float32)


def _wall_light(houses: tuple[House, ...]) -> Float32[np.ndarray, "3"]:
    colors = np.mean([wet_albedo(np.array(house.color)) for house in houses], axis=0)
    light: Color = (float(colors[0]), float(colors[1]), float(colors[2]))
    return np.float32(0.8) * _lit(light, _WALL_LIGHT) + np.float32(_GLASS * OVERCAST_ZENITH * 0.4)


def _vehicles(layout: StreetLayout) -> Iterator[tuple[float, float, float, float, float, Color]]:
    """Boxes of parked vehicles: middle, half length and width, height (m), and paint."""
    for car in layout.cars:
        form = CAR_FORMS[car.shape]
        yield car.x, car.y, 0.5 * form.length, 0.5 * form.width, form.height, car.paint
    for truck in layout.trucks:
        yield truck.x, truck.y, 0.5 * TRUCK_FORM.length, 0.5 * TRUCK_FORM.width, TRUCK_FORM.height, truck.body
    for bus in layout.buses:
        yield bus.x, bus.y, 0.5 * BUS_FORM.length, 0.5 * BUS_FORM.width, BUS_FORM.height, bus.paint


def _front_light(light: Illumination) -> Float32[np.ndarray, "2 nx nz 3"]:
    """Light of the house fronts on both sides by night: that of walls of each house's color, and of its rooms."""
    layout, windows = light.layout, light.windows
    assert layout is not None and windows is not None
    a = layout.parameters
    count = int(np.ceil(a.length_m / _FRONT_CELL_M))
    x, z = a.start_x_m + _FRONT_CELL_M * np.arange(count + 1), _FRONT_CELL_M * np.arange(_FRONT_ROWS + 1)
    cells = np.zeros((2, count, _FRONT_ROWS, 3))
    for k, (row, side) in enumerate(((layout.left, 1), (layout.right, -1))):
        wall = panel((0, side * a.front_y_m, 0), (1, 0, 0), (0, 0, 1), x, z, 1.0, Label.BUILDING)
        wall = replace(wall, normals=np.full_like(wall.normals, [0, -side, 0]))
        house = np.clip(np.searchsorted(_starts(row, side), wall.centers[:, 0], side="right") - 1, 0, len(row) - 1)
        albedo = np.array([wet_albedo(np.array(each.color)) for each in row])[house]
        lit = 0.85 * albedo * light.light_on(wall, wall.centers)
        cells[k] = lit.reshape(count, _FRONT_ROWS, 3)
        own = np.flatnonzero(side * windows.centers[:, 1] > a.front_y_m - 0.5)
        own = own[np.abs(windows.normals[own, 1]) > 0.5]
        i = np.clip(((windows.centers[own, 0] - a.start_x_m) / _FRONT_CELL_M).astype(int), 1, count - 2)
        j = np.clip((windows.centers[own, 2] / _FRONT_CELL_M).astype(int), 1, _FRONT_ROWS - 2)
        for di in (-1, 0, 1):  # over 2.25 m, about the size of a shop window
            for dj in (-1, 0, 1):
                np.add.at(cells[k], (i + di, j + dj), windows.intensities[own] / (9 * _FRONT_CELL_M**2))
    return cells.astype(np.float32)
