"""Lamps of the street by night, and their light on its surfaces."""

import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.scene.geometry import rotation_about_z
from gsrain_engine.scene.lamps import (
    LANTERN_COLOR,
    LANTERN_INNER_DEG,
    LANTERN_M2,
    LANTERN_OUTER_DEG,
    SIGNAL_M2,
    Lamp,
)

from .buses import headlight_places
from .cars import CAR_FORMS, TRUCK_FORM
from .layout import CarShape, StreetLayout
from .mesh import Quads
from .signals import SIGNAL_COLOR, signal_heads
from .trucks import HEAD_LAMP, TAIL_LAMP
from .vegetation import CURB_HEIGHT_M, build_lantern, lantern_position

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


# Light on vehicles that move


def light_on_traffic(
    normals: Float64[np.ndarray, "n 3"], access: Float[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3"]:
    """Mean light of lanterns along the street on a vehicle that moves, and of the ego's headlights on its rear."""
    above = 0.26 + 0.55 * np.maximum(normals[:, 2], 0)
    behind = 0.32 * np.maximum(-normals[:, 0], 0)
    light = above[:, None] * np.array(LANTERN_COLOR) + behind[:, None] * np.array(_HEADLIGHT_COLOR)
    return light * access[:, None].astype(np.float64)
