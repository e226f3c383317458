"""Light of lanterns and lit windows on the surfaces of the street, with the shade of houses, crowns and vehicles."""

from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.kernels import kernel, range_of
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.lamps import LAMP_REACH_M, LANTERN_INNER_DEG, LANTERN_OUTER_DEG, LEAF_SHARES

from .layout import StreetLayout
from .mesh import Quads
from .night import lanterns
from .shadows import vehicle_occluders
from .vegetation import crown_middle

_WINDOW_REACH_M = 14.0
_CROWN_REACH_M, _VEHICLE_REACH_M = 35.0, 40.0
"""Maximum distances along the street of a lantern from the crowns and vehicles that shade its light."""
_CROWN_PER_M = 0.75  # extinction of light in a crown
_BOUNCE_M2 = 34.0  # light of the ground below a lantern, upwards: a tenth of what falls on it, over pi
_BOUNCE_RADIUS_M = 4.5
_BEHIND_FRONT_M = 1.3  # light enters houses up to the lining behind their fronts
_LEAST = 1e-3  # irradiance of a lantern below which its light is left out
_COS_INNER, _COS_OUTER = (float(each) for each in np.cos(np.radians([LANTERN_INNER_DEG, LANTERN_OUTER_DEG])))


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Lit windows of a street, each as one small area that shines forward."""

    centers: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    intensities: Float64[np.ndarray, "n 3"]
    """Light times area, in m2: the irradiance at a distance d on the axis is this over d^2."""
    areas_m2: Float64[np.ndarray, " n"]

    @classmethod
    def of(cls, houses: Quads) -> "Windows":
        """Group the lit quads of houses by cells of 2.4 m along the street and 3 m of height."""
        lit = houses.take((houses.labels == Label.BUILDING) & (houses.emission.sum(axis=1) > 0))
        c = lit.corners.astype(np.float64)
        areas = 0.5 * np.linalg.norm(np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 1]), axis=1)
        middles = c.mean(axis=1)
        along = np.where(np.abs(lit.normals[:, 1]) > 0.5, middles[:, 0], middles[:, 1])
        facing = np.round(2 * lit.normals[:, 0]) * 3 + np.round(2 * lit.normals[:, 1])
        keys = np.stack([facing, np.floor(along / 2.4), np.floor((middles[:, 2] - 0.3) / 3.0)], axis=1)
        _, group = np.unique(keys, axis=0, return_inverse=True)
        group, count = group.reshape(-1), int(group.max(initial=-1)) + 1

        def summed(values: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 3"]:
            return np.stack([np.bincount(group, values[:, k], count) for k in range(3)], axis=1).astype(np.float64)

        area = np.bincount(group, areas, count).astype(np.float64)
        normals = summed(areas[:, None] * lit.normals.astype(np.float64))
        return cls(
            summed(areas[:, None] * middles) / area[:, None],
            normals / np.linalg.norm(normals, axis=1, keepdims=True),
            summed(areas[:, None] * lit.emission.astype(np.float64)),
            area,
        )


def light_of_lamps(
    layout: StreetLayout, windows: Windows, quads: Quads, points: Float[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Light of lanterns and lit windows on quads at `points`: irradiance over pi.

    By the inverse square of the distance, the cosine, the lantern's cone, and what crowns, vehicles and houses leave;
    and the light that the ground below each lantern returns.
    """
    a, leaf = layout.parameters, quads.labels == Label.VEGETATION
    own = np.where(leaf, 1.0, np.minimum(quads.sun_access, 0.25 + quads.sky_access)).astype(np.float64)
    order = np.argsort(windows.centers[:, 0], kind="stable")
    from_windows = (windows.centers, windows.normals, windows.intensities / np.pi, windows.areas_m2[:, None] / np.pi)
    light = np.zeros((len(quads), 3))
    _add_windows(
        points.astype(np.float64), quads.normals, leaf, own, np.concatenate(from_windows, axis=1)[order], light
    )
    lamps = [(*each.position, *each.color, each.intensity_m2) for each in lanterns(layout)]
    crowns = [(tree.x, tree.y, *crown_middle(tree), tree.radius) for tree in layout.trees]
    vehicles = vehicle_occluders(layout)
    numbers = [(v.x, v.y, v.way, v.length, v.width, v.height, v.shades_itself, len(v.boxes)) for v in vehicles]
    boxes = np.zeros((len(vehicles), max((len(v.boxes) for v in vehicles), default=0), 6))
    for row, vehicle in zip(boxes, vehicles, strict=True):
        row[: len(vehicle.boxes)] = np.array(vehicle.boxes).reshape(-1, 6)
    _add_lanterns(
        points.astype(np.float64), quads.normals, leaf, own, quads.sky_access, np.array(lamps).reshape(-1, 7),
        np.array(crowns).reshape(-1, 5), np.array(numbers, np.float64).reshape(-1, 8), boxes,
        (a.start_x_m, a.end_x_m, a.front_y_m), light,
    )  # fmt: skip
    return light


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _add_windows(portion, points, normals, leaf, own, windows, light):
    """Add the light of windows: center, normal, light times area, and area over pi; in the order of x."""
    for i in range_of(portion, len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        first = np.searchsorted(windows[:, 0], x - _WINDOW_REACH_M)
        red, green, blue = 0.0, 0.0, 0.0
        for k in range(first, len(windows)):
            u = windows[k, 0] - x
            if u >= _WINDOW_REACH_M:
                break
            v, w = windows[k, 1] - y, windows[k, 2] - z
            ahead = -(windows[k, 3] * u + windows[k, 4] * v + windows[k, 5] * w)
            squared = u * u + v * v + w * w
            if not (ahead > 0 and squared < _WINDOW_REACH_M * _WINDOW_REACH_M):
                continue
            cosine = u * normals[i, 0] + v * normals[i, 1] + w * normals[i, 2]
            if not (leaf[i] or cosine > 0):
                continue
            distance = sqrt(max(1e-6, squared))
            share = ahead / distance * _share_facing(cosine / distance, leaf[i]) / (squared + windows[k, 9])
            red += windows[k, 6] * share
            green += windows[k, 7] * share
            blue += windows[k, 8] * share
        light[i, 0] += own[i] * red
        light[i, 1] += own[i] * green
        light[i, 2] += own[i] * blue


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _add_lanterns(portion, points, normals, leaf, own, access, lamps, crowns, vehicles, boxes, ends, light):
    """Add the light of lanterns: place, color and intensity; and of the ground below each."""
    near = np.empty(len(vehicles), np.int64)
    for i in range_of(portion, len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        count = _vehicles_around(x, y, z, vehicles, near)
        for k in range(len(lamps)):
            u, v, w = lamps[k, 0] - x, lamps[k, 1] - y, lamps[k, 2] - z
            squared = u * u + v * v + w * w
            if not squared < LAMP_REACH_M * LAMP_REACH_M:
                continue
            squared = max(0.05, squared)
            distance = sqrt(squared)
            cosine = (u * normals[i, 0] + v * normals[i, 1] + w * normals[i, 2]) / distance
            part = min(1.0, max(0.0, (w / distance - _COS_OUTER) / (_COS_INNER - _COS_OUTER)))
            share = part * part * (3 - 2 * part) * _share_facing(cosine, leaf[i]) * lamps[k, 6] / squared
            share = own[i] * share / pi if share > _LEAST else 0.0
            if share > 0:
                share *= _past_houses(lamps[k], x, y, ends)
            if share > 0:
                share *= _through_crowns(lamps[k], u, v, w, crowns) * _past_vehicles(
                    lamps[k], x, y, z, vehicles, boxes, near[:count]
                )
            share += _BOUNCE_M2 / pi * access[i] * _bounced(u, v, z, normals[i], leaf[i])
            for c in range(3):
                light[i, c] += lamps[k, 3 + c] * share


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _share_facing(cosine, is_leaf):
    """Return `facing_share` of one point."""
    if is_leaf:
        return LEAF_SHARES[0] + LEAF_SHARES[1] * max(0.0, cosine) + LEAF_SHARES[2] * max(0.0, -cosine)
    return max(0.0, cosine)


@numba.njit(error_model="numpy")
@no_type_check
def _bounced(u, v, z, normal, is_leaf):
    """Light of the disc of ground below a lantern, (u, v) away from a point at height z, relative to its intensity."""
    squared = u * u + v * v + z * z
    distance = sqrt(squared + 0.1)
    facing = _share_facing((u * normal[0] + v * normal[1] - z * normal[2]) / distance, is_leaf)
    return max(0.0, z) / distance * facing / (squared + _BOUNCE_RADIUS_M * _BOUNCE_RADIUS_M)


@numba.njit(error_model="numpy")
@no_type_check
def _past_houses(lamp, x, y, ends):
    """Share of a lamp's light that comes past the houses to a point."""
    start_x, end_x, front_y = ends
    if start_x < x < end_x:
        return min(1.0, max(0.0, 0.5 - (abs(y) - front_y - _BEHIND_FRONT_M) / 0.3))
    beyond = x - lamp[0]
    t = ((end_x if beyond > 0 else start_x) - lamp[0]) / beyond if abs(beyond) > 1e-6 else 2.0
    return min(1.0, max(0.0, 0.5 - (abs(lamp[1] + t * (y - lamp[1])) - front_y) / 0.4))


@numba.njit(error_model="numpy")
@no_type_check
def _through_crowns(lamp, u, v, w, crowns):
    """Share of a lamp's light that crowns, ellipsoids, leave on its way (u, v, w) back from a point."""
    path = 0.0
    for k in range(len(crowns)):
        p = lamp[0] - crowns[k, 0]
        if not abs(p) < _CROWN_REACH_M:
            continue
        across, up = 1 / (0.9 * crowns[k, 4]), 1 / (0.9 * crowns[k, 3])
        p, q, r = p * across, (lamp[1] - crowns[k, 1]) * across, (lamp[2] - crowns[k, 2]) * up
        s, t, o = u * across, v * across, w * up
        a = max(1e-12, s * s + t * t + o * o)
        b = -(s * p + t * q + o * r)
        inside = b * b - a * (p * p + q * q + r * r - 1)
        if inside > 0:
            root = sqrt(inside)
            path += min(1.0, max(0.0, (root - b) / a)) - min(1.0, max(0.0, (-root - b) / a))
    return exp(-_CROWN_PER_M * path * sqrt(u * u + v * v + w * w)) if path > 0 else 1.0


@numba.njit(error_model="numpy")
@no_type_check
def _vehicles_around(x, y, z, vehicles, near):
    """List the vehicles and people that can shade a point, and return their number."""
    count = 0
    for k in range(len(vehicles)):
        reach = 0.5 * vehicles[k, 3] + 0.6 * _VEHICLE_REACH_M + 4
        if z < vehicles[k, 5] and abs(y - vehicles[k, 1]) < 6 and abs(x - vehicles[k, 0]) < reach:
            near[count] = k
            count += 1
    return count


@numba.njit(error_model="numpy")
@no_type_check
def _past_vehicles(lamp, x, y, z, vehicles, boxes, near):
    """Share of a lamp's light that boxes of vehicles and people leave at a point."""
    share = 1.0
    for k in near:
        from_lamp = abs(lamp[0] - vehicles[k, 0])
        if from_lamp > _VEHICLE_REACH_M or abs(x - vehicles[k, 0]) >= 0.5 * vehicles[k, 3] + 0.6 * from_lamp + 4:
            continue
        way = vehicles[k, 2]
        p, q = (x - vehicles[k, 0]) * way, (y - vehicles[k, 1]) * way
        is_own = abs(p) <= 0.5 * vehicles[k, 3] and abs(q) <= 0.5 * vehicles[k, 4] and z >= 0.16
        if is_own and not vehicles[k, 6]:  # only normals light its own surfaces
            continue
        s, t = (lamp[0] - vehicles[k, 0]) * way, (lamp[1] - vehicles[k, 1]) * way
        for j in range(int(vehicles[k, 7])):
            enter, leave = _span(s, p - s, boxes[k, j, 0], boxes[k, j, 3], 0.0, 1.0)
            enter, leave = _span(t, q - t, boxes[k, j, 1], boxes[k, j, 4], enter, leave)
            enter, leave = _span(lamp[2], z - lamp[2], boxes[k, j, 2], boxes[k, j, 5], enter, leave)
            if leave > enter:
                length = sqrt((p - s) * (p - s) + (q - t) * (q - t) + (z - lamp[2]) * (z - lamp[2]))
                share *= 1 - min(1.0, (leave - enter) * length / 0.22)
        if share <= 0:
            break
    return share


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _span(start, along, low, high, enter, leave):
    """Part of a line inside a slab, within another part."""
    step = along if abs(along) > 1e-9 else 1e-9
    first, last = (low - start) / step, (high - start) / step
    return max(enter, min(first, last)), min(leave, max(first, last))
