"""Lamps of the street by night, and their light on its surfaces."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64

from gsrain_engine.scene.geometry import rotation_about_z
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.lamps import (
    LAMP_REACH_M,
    LANTERN_COLOR,
    LANTERN_INNER_DEG,
    LANTERN_M2,
    LANTERN_OUTER_DEG,
    SIGNAL_M2,
    Lamp,
    facing_share,
)

from .buses import headlight_places
from .cars import CAR_FORMS, TRUCK_FORM
from .layout import CarShape, StreetLayout
from .mesh import Quads
from .shadows import PointsAlong, vehicle_occluders
from .signals import SIGNAL_COLOR, signal_heads
from .trucks import HEAD_LAMP, TAIL_LAMP
from .vegetation import CURB_HEIGHT_M, build_lantern, crown_middle, lantern_position

# Lamps of the scene

_GLASS_BELOW_M = 0.085  # a lantern's head
_HEADLIGHT_M2, _HEADLIGHT_COLOR = 400.0, (1.0, 0.95, 0.87)
_POSITION_LAMP_M2 = 4.0  # 40 cd: those of a bus at its stop, which does not dazzle
_TAIL_LIGHT_M2, _TAIL_LIGHT_COLOR = 1.0, (1.0, 0.03, 0.02)
_LOW_BEAM = (0.998, 0.0, -0.06)  # direction: half a degree below what dazzles, and down to the road 12 m ahead
_EGO_LAMPS = (
    ("left", (2.1, 0.62, -0.85)),
    ("right", (2.1, -0.62, -0.85)),
)  # in the ego frame


def lanterns(layout: StreetLayout) -> tuple[Lamp, ...]:
    """Street lanterns of a layout, in the order of their feet."""
    return tuple(
        Lamp(
            name=f"lantern-{k:02d}", position=_below(lantern_position(x, y)), color=LANTERN_COLOR,
            intensity_m2=LANTERN_M2, inner_deg=LANTERN_INNER_DEG, outer_deg=LANTERN_OUTER_DEG,
        )
        for k, (x, y) in enumerate(layout.lamps)
    )  # fmt: skip


def lantern_at_origin() -> Quads:
    """Build a lantern whose lamp hangs `LANTERN_HEIGHT_M` above the origin, with its mast at the right of x."""
    arm_m = lantern_position(0.0, -1.0)[1] + 1.0
    return build_lantern(0.0, -arm_m).placed((0.0, 0.0, -CURB_HEIGHT_M))


def _below(head: tuple[float, float, float]) -> tuple[float, float, float]:
    """Middle of the glass below a lantern's head."""
    return head[0], head[1], head[2] - _GLASS_BELOW_M


def vehicle_lamps(actor_id: str, shape: CarShape) -> tuple[Lamp, ...]:
    """Head and tail lamps of a car that moves, mounted on its actor."""
    form = CAR_FORMS[shape]
    half, front, rear = 0.5 * form.width, 0.5 * form.length, -0.5 * form.length
    lamps: list[Lamp] = []
    for side, name in ((1, "left"), (-1, "right")):
        lamps.append(_headlight(f"{actor_id} {name} headlight", (front, side * 0.62 * half, form.hood[0] - 0.09),
                                actor_id))  # fmt: skip
        lamps.append(_tail_light(actor_id, name, (rear, side * 0.73 * half, form.tail[0] - 0.1)))
    return tuple(lamps)


def signal_lamps(layout: StreetLayout) -> tuple[Lamp, ...]:
    """Lit lenses of the traffic lights for vehicles."""
    return tuple(
        Lamp(
            name=f"signal-{k:02d}", position=head.lamp_position, direction=head.direction, color=SIGNAL_COLOR[head.lit],
            intensity_m2=SIGNAL_M2, inner_deg=10.0, outer_deg=60.0,
        )
        for k, head in enumerate(head for head in signal_heads(layout) if head.lamps == 3)
    )  # fmt: skip


def bus_lamps(layout: StreetLayout) -> tuple[Lamp, ...]:
    """Front position lamps of buses at their stops."""
    lamps: list[Lamp] = []
    for k, bus in enumerate(layout.buses):
        turn = rotation_about_z(bus.turn_deg)
        ahead_x, ahead_y, _ = turn[:, 0].tolist()
        for place, name in zip(headlight_places(), ("left", "right"), strict=True):
            x, y, z = (turn @ np.array(place)).tolist()
            lamps.append(
                Lamp(
                    name=f"bus-{k:02d} {name} headlight", position=(bus.x + x, bus.y + y, z),
                    direction=(ahead_x, ahead_y, -0.03), color=_HEADLIGHT_COLOR, intensity_m2=_POSITION_LAMP_M2,
                    inner_deg=20.0, outer_deg=80.0,
                )
            )  # fmt: skip
    return tuple(lamps)


def truck_lamps(actor_id: str) -> tuple[Lamp, ...]:
    """Head and tail lamps of a truck that moves, mounted on its actor."""
    front, rear = 0.5 * TRUCK_FORM.length, TRUCK_FORM.body_back
    lamps: list[Lamp] = []
    for side, name in ((1, "left"), (-1, "right")):
        head, tail = (front, side * HEAD_LAMP[0], HEAD_LAMP[1]), (rear, side * TAIL_LAMP[0], TAIL_LAMP[1])
        lamps += [_headlight(f"{actor_id} {name} headlight", head, actor_id), _tail_light(actor_id, name, tail)]
    return tuple(lamps)


def ego_lamps() -> tuple[Lamp, ...]:
    """Low beams of the ego vehicle."""
    return tuple(_headlight(f"ego {name} headlight", place, "ego") for name, place in _EGO_LAMPS)


def _headlight(name: str, position: tuple[float, float, float], mount: str) -> Lamp:
    return Lamp(
        name=name, position=position, direction=_LOW_BEAM, color=_HEADLIGHT_COLOR, intensity_m2=_HEADLIGHT_M2,
        inner_deg=4.0, outer_deg=26.0, mount=mount,
    )  # fmt: skip


def _tail_light(actor_id: str, side: str, position: tuple[float, float, float]) -> Lamp:
    return Lamp(
        name=f"{actor_id} {side} tail light", position=position, direction=(-1.0, 0.0, 0.0), color=_TAIL_LIGHT_COLOR,
        intensity_m2=_TAIL_LIGHT_M2, inner_deg=30.0, outer_deg=85.0, mount=actor_id,
    )  # fmt: skip


# Light on surfaces

_WINDOW_REACH_M = 14.0
_CROWN_PER_M = 0.75  # extinction of light in a crown
_BOUNCE_M2 = 34.0  # light of the ground below a lantern, upwards: a tenth of what falls on it, over pi
_BOUNCE_RADIUS_M = 4.5
_BEHIND_FRONT_M = 1.3  # light enters houses up to the lining behind their fronts


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
    along = PointsAlong.of(points.astype(np.float64))
    quads = quads.take(along.order)
    p, normals = points[along.order].astype(np.float64), quads.normals.T.astype(np.float64)
    columns = np.ascontiguousarray(p.T)
    leaf = quads.labels == Label.VEGETATION
    own = np.where(leaf, 1.0, np.minimum(quads.sun_access, 0.25 + quads.sky_access)).astype(np.float64)
    total = np.zeros((3, len(p)))

    def around(place: Float64[np.ndarray, "3"], reach_m: float) -> tuple[Int64[np.ndarray, " m"], _Away]:
        first, end = along.span(float(place[0]), reach_m)
        away = place[:, None] - columns[:, first:end]
        near = np.flatnonzero(_dot(away, away) < reach_m**2)
        return near + first, away[:, near]

    for lamp in lanterns(layout):
        place = np.array(lamp.position)
        near, away = around(place, LAMP_REACH_M)
        squared = np.maximum(_dot(away, away), 0.05)
        distance = np.sqrt(squared)
        facing = facing_share(_dot(away, normals[:, near]) / distance, leaf[near])
        share = cone_share(away[2] / distance, lamp.inner_deg, lamp.outer_deg) * facing
        lit = np.flatnonzero(share * lamp.intensity_m2 / squared > 1e-3)
        share = own[near[lit]] * share[lit] * _unobstructed(layout, place, p[near[lit]]) / squared[lit]
        color = np.array(lamp.color) * lamp.intensity_m2 / np.pi
        total[:, near[lit]] += color[:, None] * share
        bounced = _bounced(place[2], away, normals[:, near], leaf[near], quads.sky_access[near])
        total[:, near] += (np.array(lamp.color) * _BOUNCE_M2 / np.pi)[:, None] * bounced
    for center, normal, intensity, area in zip(
        windows.centers, windows.normals, windows.intensities, windows.areas_m2, strict=True
    ):
        near, away = around(center, _WINDOW_REACH_M)
        squared = _dot(away, away)
        distance = np.sqrt(np.maximum(squared, 1e-6))
        facing = facing_share(_dot(away, normals[:, near]) / distance, leaf[near])
        ahead = np.maximum(-(normal @ away), 0) / distance
        share = own[near] * ahead * facing / (squared + area / np.pi)
        total[:, near] += (intensity / np.pi)[:, None] * share
    light = np.empty((len(p), 3))
    light[along.order] = total.T
    return light


_Away = Float64[np.ndarray, "3 m"]


def _dot(a: _Away, b: _Away) -> Float64[np.ndarray, " m"]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cone_share(cosine: Float[np.ndarray, " n"], inner_deg: float, outer_deg: float) -> Float64[np.ndarray, " n"]:
    """Share of a lamp's intensity by the cosine of the angle from its axis: a smoothstep, as in rain."""
    inner, outer = np.cos(np.radians([inner_deg, outer_deg]))
    part = np.clip((cosine - outer) / (inner - outer), 0, 1).astype(np.float64)
    return part * part * (3 - 2 * part)


def _bounced(
    height_m: float, away: _Away, normals: _Away, leaf: Bool[np.ndarray, " m"], access: Float[np.ndarray, " m"]
) -> Float64[np.ndarray, " m"]:
    """Light of the disc of ground below a lantern, `away` from points and above, relative to its intensity."""
    below = away - np.array([[0.0], [0.0], [height_m]])
    squared = _dot(below, below)
    distance = np.sqrt(squared + 0.1)
    facing = facing_share(_dot(below, normals) / distance, leaf)
    return np.maximum(-below[2], 0) / distance * facing * access / (squared + _BOUNCE_RADIUS_M**2)


def _unobstructed(
    layout: StreetLayout, lamp: Float64[np.ndarray, "3"], p: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Share of a lamp's light that houses, crowns and parked vehicles leave at points."""
    a = layout.parameters
    inside = (p[:, 0] > a.start_x_m) & (p[:, 0] < a.end_x_m)
    depth = np.where(inside, np.abs(p[:, 1]) - a.front_y_m - _BEHIND_FRONT_M, -1.0)
    end = np.where(p[:, 0] > lamp[0], a.end_x_m, a.start_x_m)
    beyond = p[:, 0] - lamp[0]
    t = np.where(np.abs(beyond) > 1e-6, (end - lamp[0]) / np.where(np.abs(beyond) > 1e-6, beyond, 1.0), 2.0)
    at_corner = np.abs(lamp[1] + t * (p[:, 1] - lamp[1])) - a.front_y_m
    share = np.clip(0.5 - depth / 0.3, 0, 1) * np.where(inside, 1.0, np.clip(0.5 - at_corner / 0.4, 0, 1))
    for middle, radii in _crowns(layout, lamp):
        share *= np.exp(-_CROWN_PER_M * path_in_ellipsoid(lamp, p, middle, radii))
    along = PointsAlong.of(p)
    for each in vehicle_occluders(layout):
        if abs(lamp[0] - each.x) > 40.0:
            continue
        rows = along.within(each.x, 0.5 * each.length + 0.6 * abs(lamp[0] - each.x) + 4.0)
        near = rows[(np.abs(p[rows, 1] - each.y) < 6.0) & (p[rows, 2] < each.height)]
        frame = np.array([each.way, each.way, 1.0])
        local, source = (p[near] - [each.x, each.y, 0.0]) * frame, (lamp - [each.x, each.y, 0.0]) * frame
        lit_by_itself = each.is_lit_by_itself(local)
        for low, high in each.boxes:
            path = _path_in_box(source, local, np.array(low), np.array(high))
            share[near] *= np.where(lit_by_itself, 1.0, 1 - np.clip(path / 0.22, 0, 1))
    return share


def _crowns(
    layout: StreetLayout, lamp: Float64[np.ndarray, "3"]
) -> Iterator[tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]]:
    """Middle and radii of crowns near a lamp."""
    for tree in layout.trees:
        if abs(tree.x - lamp[0]) < 35.0:
            height, half = crown_middle(tree)
            yield np.array([tree.x, tree.y, height]), 0.9 * np.array([tree.radius, tree.radius, half])


def path_in_ellipsoid(
    start: Float64[np.ndarray, "3"],
    ends: Float64[np.ndarray, "n 3"],
    middle: Float64[np.ndarray, "3"],
    radii: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, " n"]:
    """Meters of the lines from a point to others inside an ellipsoid."""
    from_middle = (start - middle) / radii
    lines = ends - start
    along = lines / radii
    a = np.maximum(np.einsum("nd,nd->n", along, along), 1e-12)
    b = along @ from_middle
    root = np.sqrt(np.maximum(b * b - a * (from_middle @ from_middle - 1), 0))
    part = np.clip((root - b) / a, 0, 1) - np.clip((-root - b) / a, 0, 1)
    return part * np.sqrt(np.einsum("nd,nd->n", lines, lines))


def _path_in_box(
    start: Float64[np.ndarray, "3"],
    ends: Float64[np.ndarray, "n 3"],
    low: Float64[np.ndarray, "3"],
    high: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, " n"]:
    along = ends - start
    along = np.where(np.abs(along) < 1e-9, 1e-9, along)
    low_t, high_t = (low - start) / along, (high - start) / along
    enter, leave = np.minimum(low_t, high_t).max(axis=1), np.maximum(low_t, high_t).min(axis=1)
    part = np.clip(np.minimum(leave, 1) - np.maximum(enter, 0), 0, None)
    return part * np.linalg.norm(along, axis=1)


def light_on_traffic(
    normals: Float64[np.ndarray, "n 3"], access: Float[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3"]:
    """Mean light of lanterns along the street on a vehicle that moves, and of the ego's headlights on its rear."""
    above = 0.26 + 0.55 * np.maximum(normals[:, 2], 0)
    behind = 0.32 * np.maximum(-normals[:, 0], 0)
    light = above[:, None] * np.array(LANTERN_COLOR) + behind[:, None] * np.array(_HEADLIGHT_COLOR)
    return light * access[:, None].astype(np.float64)
