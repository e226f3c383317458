"""People: bodies of standing and riding figures with clothes, hair, bags and shoes.

The object frame has x forward, y left, z up, and its origin on the ground below the middle of the figure.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.geometry import rotation_about_z
from gsrain_engine.scene.labels import Label

from .layout import CURB_HEIGHT_M, Color, StreetLayout
from .mesh import Quads
from .solids import Point, Section, Solid, SolidMesh, cut, ellipsoid, loft, mesh_solids, round_box, round_cone

Arms = Literal["hanging", "pockets", "phone", "folded", "strap", "handlebar"]
Hair = Literal["short", "long", "bun", "bald", "hood", "helmet"]

_BODY_CELL_M, _HEAD_CELL_M = 0.032, 0.0165
_SPREAD = 0.55
"""Standard deviation of their Gaussians in cell widths: narrower than in flat surfaces, for a crisp outline."""


@dataclass(frozen=True, slots=True)
class Clothes:
    """Linear albedo of what a person wears."""

    top: Color
    trousers: Color
    shoes: Color = (0.02, 0.018, 0.017)
    hem_m: float = 0.86
    """Lower edge of jacket or coat, at a height of 1.75 m."""
    shirt: Color = (0.45, 0.45, 0.44)
    """Inside the open collar."""
    skirt_m: float | None = None
    """Lower edge of a skirt of the color of the trousers; legs below it are of the color of tights."""
    tights: Color = (0.02, 0.02, 0.022)
    bag: Literal["none", "backpack", "shoulder"] = "none"
    bag_color: Color = (0.03, 0.03, 0.035)
    helmet: Color = (0.5, 0.03, 0.02)


@dataclass(frozen=True, slots=True)
class Figure:
    """A person's build, posture and clothes."""

    height_m: float
    girth: float
    """1 for slim; factor on widths."""
    skin: Color
    hair: Hair
    hair_color: Color
    arms: tuple[Arms, Arms]
    """Left, right."""
    clothes: Clothes
    stance: Literal["left", "right", "even", "riding", "stopped"] = "left"
    """The leg that bears the weight, or the posture on a bicycle; stopped: the right foot is on a curb."""
    look_deg: float = 0.0
    """Turn of the head to the left."""


class _Leg(NamedTuple):
    hip: Point
    knee: Point
    ankle: Point
    toe: Point


_SKIN, _HAIR, _TOP, _TROUSERS, _SHOES, _SHIRT, _TIGHTS, _BAG, _HELMET, _LIPS = range(10)
_STATURE_M = 1.75  # of the body that is described here; others are scaled

FIGURES: tuple[Figure, ...] = (
    Figure(1.80, 1.04, (0.46, 0.27, 0.19), "short", (0.035, 0.022, 0.014), ("pockets", "pockets"),
           Clothes((0.022, 0.030, 0.055), (0.055, 0.075, 0.13), hem_m=0.84), "left", 18.0),
    Figure(1.68, 0.94, (0.52, 0.32, 0.24), "long", (0.10, 0.05, 0.022), ("strap", "hanging"),
           Clothes((0.36, 0.045, 0.035), (0.020, 0.021, 0.026), hem_m=0.60, bag="shoulder",
                   bag_color=(0.13, 0.065, 0.03), shoes=(0.05, 0.03, 0.02)), "right", -12.0),
    Figure(1.76, 0.98, (0.20, 0.10, 0.062), "short", (0.010, 0.009, 0.008), ("phone", "pockets"),
           Clothes((0.46, 0.37, 0.10), (0.028, 0.030, 0.034), hem_m=0.88, bag="backpack",
                   bag_color=(0.035, 0.055, 0.05), shoes=(0.6, 0.6, 0.58)), "right", 4.0),
    Figure(1.63, 1.10, (0.50, 0.30, 0.22), "bun", (0.28, 0.27, 0.26), ("folded", "folded"),
           Clothes((0.13, 0.17, 0.15), (0.055, 0.045, 0.05), hem_m=0.72, skirt_m=0.42), "even", 25.0),
    Figure(1.84, 1.12, (0.44, 0.26, 0.19), "bald", (0.06, 0.05, 0.045), ("hanging", "phone"),
           Clothes((0.24, 0.24, 0.235), (0.12, 0.10, 0.075), hem_m=0.80, shirt=(0.05, 0.07, 0.13)), "left", -20.0),
    Figure(1.71, 0.96, (0.40, 0.22, 0.15), "hood", (0.012, 0.010, 0.010), ("pockets", "pockets"),
           Clothes((0.018, 0.080, 0.062), (0.016, 0.016, 0.018), hem_m=0.85, shoes=(0.42, 0.42, 0.41)), "right", 0.0),
)  # fmt: skip
"""Pedestrians of the street."""

CYCLIST = Figure(1.78, 1.0, (0.45, 0.27, 0.19), "helmet", (0.05, 0.03, 0.02), ("handlebar", "handlebar"),
                 Clothes((0.055, 0.17, 0.34), (0.022, 0.022, 0.026), hem_m=0.90, helmet=(0.58, 0.57, 0.55)),
                 "riding")  # fmt: skip


def build_people(layout: StreetLayout, sun: Float64[np.ndarray, "3"]) -> Quads:
    """Build all people of the street, in the world, in the order of `people_of`."""
    parts: list[Quads] = []
    for figure, (x, y, z), turn_deg in people_of(layout):
        to_street = rotation_about_z(turn_deg)
        parts.append(build_person(figure, to_street.T @ sun).placed((x, y, z), turn_deg))
    return Quads.joined(parts)


def people_of(layout: StreetLayout) -> list[tuple[Figure, Point, float]]:
    """People of the street with their places and turns (deg): pedestrians, then those on bicycles."""
    waiting = replace(CYCLIST, stance="stopped")
    standing = [(FIGURES[each.figure], (each.x, each.y, CURB_HEIGHT_M), each.turn_deg) for each in layout.pedestrians]
    return [*standing, *((waiting, (each.x, each.y, 0.0), each.turn_deg) for each in layout.cyclists)]


def person_size(figure: Figure) -> tuple[float, float, float]:
    """Length, width and height in meters."""
    if figure.stance in ("riding", "stopped"):
        return 0.80, 0.66, figure.height_m / _STATURE_M * 1.79
    bag = 0.12 if figure.clothes.bag == "backpack" else 0.0
    return 0.48 + bag, 0.66 * figure.girth, figure.height_m / _STATURE_M * 1.78


def build_person(figure: Figure, sun: Float64[np.ndarray, "3"] | None = None) -> Quads:
    """Build a person in the object frame; `sun` is the direction of the light that the body shades itself from."""
    return Quads.joined(_quads(part, figure, sun) for part in _meshes(figure))


@lru_cache(maxsize=16)
def _meshes(figure: Figure) -> tuple[SolidMesh, SolidMesh]:
    return mesh_solids(_body(figure), _BODY_CELL_M), mesh_solids(_head(figure), _HEAD_CELL_M)


def _quads(mesh: SolidMesh, figure: Figure, sun: Float64[np.ndarray, "3"] | None) -> Quads:
    scale = figure.height_m / _STATURE_M
    clothes, at = figure.clothes, mesh.centers
    palette = np.array(
        [figure.skin, figure.hair_color, clothes.top, clothes.trousers, clothes.shoes, clothes.shirt, clothes.tights,
         clothes.bag_color, clothes.helmet, np.array(figure.skin) * [0.85, 0.55, 0.55]]
    )  # fmt: skip
    albedo = palette[mesh.materials] * _details(mesh, figure)[:, None]
    near_ground = 0.55 + 0.45 * np.clip(at[:, 2] / 0.35, 0, 1)
    lit = np.ones(len(at)) if sun is None else mesh.field.lit(at + 0.01 * mesh.normals, sun)
    shine = np.select([mesh.materials == _HAIR, mesh.materials == _SHOES, mesh.materials == _HELMET], [0.03, 0.04, 0.1])
    return Quads.of(
        scale * mesh.corners, albedo, Label.PERSON, normals=mesh.normals, gloss=shine, sun_access=lit,
        sky_access=(0.15 + 0.85 * mesh.sky_access) * near_ground, spread=_SPREAD,
    )  # fmt: skip


def _details(mesh: SolidMesh, figure: Figure) -> Float64[np.ndarray, " n"]:
    """Shade of eyes and brows, seams, and the weave of cloth."""
    x, y, z = mesh.centers.T
    shade = np.ones(len(x))
    cloth = np.isin(mesh.materials, (_TOP, _TROUSERS))
    shade = np.where(cloth, 1 + 0.09 * np.sin(23 * z + 9 * y) * np.sin(31 * y - 13 * z + 5 * x), shade)
    front = (mesh.materials == _TOP) & (mesh.normals[:, 0] > 0.6)
    shade = np.where(front & (np.abs(y) < 0.014) & (z < 1.40), 0.55, shade)
    face = (mesh.materials == _SKIN) & (z > 1.5)
    turn = np.radians(figure.look_deg)
    ahead, aside = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    seen = face & (ahead > 0.055)
    eyes = seen & (np.abs(np.abs(aside) - 0.033) < 0.0135) & (np.abs(z - 1.649) < 0.0085)
    brows = seen & (np.abs(np.abs(aside) - 0.034) < 0.021) & (np.abs(z - 1.672) < 0.006)
    return np.where(eyes, 0.16, np.where(brows, 0.42, shade))


# Body


def _body(figure: Figure) -> list[Solid]:
    g, clothes = figure.girth, figure.clothes
    riding = figure.stance in ("riding", "stopped")
    lean = 0.0 if not riding else 0.30  # m that the shoulders are before the hips
    solids: list[Solid] = []
    for side, leg in zip((1, -1), _legs(figure), strict=True):
        solids += _leg(leg, side, g, clothes)
    hem = max(clothes.hem_m, 0.86) if riding else clothes.hem_m
    solids += _trunk(figure, hem, lean)
    for side, arm in zip((1, -1), figure.arms, strict=True):
        solids += _arm(arm, side, g, lean)
    if clothes.bag == "backpack":
        solids.append(round_box((-0.195, 0.0, 1.245), (0.15, 0.29, 0.42), 0.06, _BAG))
        for side in (-1, 1):
            solids.append(round_cone((-0.09, side * 0.12, 1.46), (0.075, side * 0.13, 1.40), 0.022, 0.02, _BAG, 0.005))
            solids.append(round_cone((0.075, side * 0.13, 1.40), (0.07, side * 0.155, 1.16), 0.02, 0.016, _BAG, 0.005))
    elif clothes.bag == "shoulder":
        solids.append(round_box((-0.01, 0.265, 0.93), (0.30, 0.09, 0.24), 0.04, _BAG))
        solids.append(round_cone((-0.02, 0.262, 1.03), (-0.02, 0.165, 1.46), 0.014, 0.014, _BAG, 0.005))
    return solids


def _legs(figure: Figure) -> tuple[_Leg, _Leg]:
    """Left, right."""
    if figure.stance == "riding":
        return (
            _Leg((-0.125, 0.085, 0.965), (0.26, 0.12, 0.86), (0.07, 0.105, 0.49), (0.22, 0.115, 0.45)),
            _Leg((-0.125, -0.085, 0.965), (0.13, -0.115, 0.66), (-0.07, -0.105, 0.27), (0.08, -0.11, 0.21)),
        )
    if figure.stance == "stopped":
        return (
            _Leg((-0.125, 0.085, 0.965), (0.22, 0.12, 0.82), (0.10, 0.105, 0.42), (0.25, 0.115, 0.39)),
            _Leg((-0.125, -0.085, 0.965), (0.06, -0.19, 0.60), (0.03, -0.30, 0.22), (0.17, -0.33, 0.155)),
        )
    straight, relaxed = ((0.0, 0.088, 0.92), (0.015, 0.098, 0.50), (-0.015, 0.088, 0.085), (0.14, 0.112, 0.035)), (
        (0.0, 0.092, 0.90), (0.085, 0.135, 0.50), (0.035, 0.150, 0.085), (0.175, 0.205, 0.035)
    )  # fmt: skip
    left, right = {
        "left": (straight, relaxed), "right": (relaxed, straight), "even": (straight, straight),
    }[figure.stance]  # fmt: skip

    def mirrored(points: tuple[Point, ...]) -> tuple[Point, ...]:
        return tuple((x, -y, z) for x, y, z in points)

    return _Leg(*left), _Leg(*mirrored(right))


def _leg(leg: _Leg, side: int, g: float, clothes: Clothes) -> list[Solid]:
    cloth = _TIGHTS if clothes.skirt_m is not None else _TROUSERS
    slim = 0.86 if clothes.skirt_m is not None else 1.0
    hip, knee, ankle, toe = (np.array(each) for each in leg)
    calf = knee + 0.35 * (ankle - knee) + [-0.012, 0.0, 0.0]
    heel = ankle + 0.35 * (ankle - toe) + [0, 0, -0.3 * (ankle[2] - toe[2])]
    cuff = ankle + 0.10 * (knee - ankle)

    def joint(value: Float64[np.ndarray, "3"]) -> Point:
        x, y, z = value.tolist()
        return x, y, z

    return [
        round_cone(joint(hip), joint(knee), 0.086 * g * slim, 0.064 * g * slim, cloth, 0.05),
        round_cone(joint(knee), joint(calf), 0.062 * g * slim, 0.060 * g * slim, cloth, 0.03),
        round_cone(joint(calf), joint(cuff), 0.060 * g * slim, 0.047 * g * slim, cloth, 0.03),
        round_cone(joint(ankle), joint(heel), 0.046, 0.040, _SHOES, 0.015),
        round_cone(joint(heel), joint(toe), 0.038, 0.036, _SHOES, 0.03),
        round_cone(joint(0.45 * toe + 0.55 * heel), joint(toe + [0, side * 0.006, 0]), 0.043, 0.038, _SHOES, 0.03),
    ]


def _trunk(figure: Figure, hem: float, lean: float) -> list[Solid]:
    """Trousers' seat or skirt, then jacket or coat, collar and shirt."""
    g, clothes = figure.girth, figure.clothes
    back = -0.16 if lean else 0.0

    def forward(z: float) -> float:
        return back + lean * float(np.clip((z - 0.95) / 0.5, 0, 1.1))

    sway = {"left": 0.018, "right": -0.018}.get(figure.stance, 0.0)
    seat = [Section(0.83, 0.112 * g, 0.160 * g, forward(0.83) - 0.01, sway),
            Section(0.93, 0.125 * g, 0.168 * g, forward(0.93) - 0.012, sway),
            Section(1.02, 0.100 * g, 0.140 * g, forward(1.02) + 0.01)]  # fmt: skip
    if clothes.skirt_m is not None:
        seat.insert(0, Section(clothes.skirt_m, 0.155 * g, 0.20 * g, 0.0, sway))
    flare = 0.05 * np.clip((0.9 - hem) / 0.3, 0, 1)
    jacket = [
        Section(hem, (0.148 + flare) * g, (0.200 + flare) * g, forward(hem) - 0.005, sway),
        Section(1.00, 0.144 * g, 0.190 * g, forward(1.00) - 0.005, 0.6 * sway),
        Section(1.12, 0.126 * g, 0.166 * g, forward(1.12) + 0.003, 0.0),
        Section(1.26, 0.134 * g, 0.180 * g, forward(1.26) + 0.008, 0.0),
        Section(1.34, 0.126 * g, 0.180 * g, forward(1.34), 0.0),
        Section(1.40, 0.102 * g, 0.150 * g, forward(1.40) - 0.008, 0.0),
        Section(1.445, 0.078, 0.100, forward(1.445) - 0.012, 0.0),
        Section(1.475, 0.066, 0.072, forward(1.475) - 0.012, 0.0),
    ]
    neck = forward(1.48)
    return [
        loft(seat, _TROUSERS, folds=0.0 if clothes.skirt_m is None else 0.008, blend=0.05),
        loft([each for k, each in enumerate(jacket) if k == 0 or each.z > hem + 0.03], _TOP, folds=0.004, blend=0.012),
        round_cone((neck - 0.014, 0.0, 1.45), (neck - 0.004, 0.0, 1.49), 0.066, 0.060, _TOP, 0.02),
        round_cone((neck + 0.035, 0.0, 1.42), (neck + 0.025, 0.0, 1.48), 0.045, 0.045, _SHIRT, 0.008),
    ]


_ARMS: dict[Arms, tuple[Point, Point, Point]] = {
    "hanging": ((-0.035, 0.262, 1.14), (0.055, 0.285, 0.90), (0.075, 0.275, 0.80)),
    "pockets": ((-0.085, 0.295, 1.15), (0.065, 0.225, 0.985), (0.085, 0.19, 0.95)),
    "phone": ((-0.005, 0.250, 1.15), (0.225, 0.125, 1.235), (0.275, 0.07, 1.275)),
    "folded": ((0.015, 0.262, 1.155), (0.165, 0.03, 1.17), (0.165, -0.08, 1.185)),
    "strap": ((-0.07, 0.29, 1.17), (0.11, 0.215, 1.29), (0.10, 0.165, 1.345)),
    "handlebar": ((0.235, 0.305, 1.20), (0.40, 0.275, 1.085), (0.45, 0.27, 1.075)),
}
"""Left elbow, wrist and fingers; shoulders are at (-0.01, 0.165, 1.37)."""


def _arm(arm: Arms, side: int, g: float, lean: float) -> list[Solid]:
    shoulder: Point = (-0.012 + (lean - 0.16 if lean else 0.0) * 0.95, side * (0.165 * g), 1.372)
    shift = 0.03 if arm == "folded" and side < 0 else 0.0  # one forearm below the other

    def own(point: Point) -> Point:
        return point[0], side * point[1], point[2] - shift

    elbow, wrist, fingers = (own(each) for each in _ARMS[arm])
    hand = [] if arm == "pockets" else [round_cone(wrist, fingers, 0.036, 0.030, _SKIN, 0.012)]
    phone = [round_box((fingers[0] + 0.02, fingers[1], fingers[2] + 0.03), (0.02, 0.075, 0.14), 0.008, _BAG)]
    return [
        round_cone(shoulder, elbow, 0.062 * g, 0.047 * g, _TOP, 0.06),
        round_cone(elbow, wrist, 0.051 * g, 0.041 * g, _TOP, 0.03),
        *hand,
        *(phone if arm == "phone" else []),
    ]


# Head


def _head(figure: Figure) -> list[Solid]:
    """Skull, jaw, nose, ears, neck and hair, turned to where the person looks."""
    riding = figure.stance in ("riding", "stopped")
    forward = 0.165 if riding else 0.0
    turn = np.radians(figure.look_deg)

    def at(x: float, y: float, z: float) -> Point:
        return (
            forward + float(x * np.cos(turn) - y * np.sin(turn)), float(x * np.sin(turn) + y * np.cos(turn)), z
        )  # fmt: skip

    ahead: Point = (float(np.cos(turn)), float(np.sin(turn)), 0.0)
    solids = [
        round_cone((forward - 0.022, 0.0, 1.47), at(-0.012, 0, 1.575), 0.056, 0.053, _SKIN),
        ellipsoid(at(-0.004, 0, 1.655), (0.092, 0.080, 0.100), _SKIN, 0.02),
        ellipsoid(at(0.026, 0, 1.590), (0.066, 0.060, 0.070), _SKIN, 0.04),
        round_cone(at(0.088, 0, 1.655), at(0.105, 0, 1.620), 0.010, 0.015, _SKIN, 0.014),
        ellipsoid(at(0.088, 0, 1.578), (0.012, 0.024, 0.010), _LIPS, 0.006),
        ellipsoid(at(0.070, 0, 1.535), (0.022, 0.026, 0.020), _SKIN, 0.03),
    ]
    for side in (-1, 1):
        solids.append(ellipsoid(at(-0.010, side * 0.080, 1.635), (0.020, 0.012, 0.031), _SKIN, 0.008))
    return [*solids, *_hair(figure, at, ahead, forward)]


def _hair(figure: Figure, at: Callable[[float, float, float], Point], ahead: Point, forward: float) -> list[Solid]:
    cap = ellipsoid(at(-0.014, 0, 1.672), (0.101, 0.090, 0.105), _HAIR, 0.006)
    # The hairline slopes from the forehead to the neck behind the ears.
    line = np.array([0.62 * ahead[0], 0.62 * ahead[1], -0.785])
    line /= np.linalg.norm(line)
    bound = float(line @ np.array(at(0.070, 0.0, 1.718)))
    slope: Point = (float(line[0]), float(line[1]), float(line[2]))
    short = cut(cap, slope, bound)
    match figure.hair:
        case "bald":
            return []
        case "short":
            return [short]
        case "bun":
            return [short, ellipsoid(at(-0.115, 0, 1.715), (0.042, 0.045, 0.040), _HAIR, 0.01)]
        case "long":
            fall = loft([Section(1.40, 0.045, 0.085, at(-0.072, 0, 0)[0], at(-0.072, 0, 0)[1]),
                         Section(1.52, 0.060, 0.098, at(-0.055, 0, 0)[0], at(-0.055, 0, 0)[1]),
                         Section(1.66, 0.075, 0.094, at(-0.035, 0, 0)[0], at(-0.035, 0, 0)[1]),
                         Section(1.72, 0.060, 0.080, at(-0.030, 0, 0)[0], at(-0.030, 0, 0)[1])],
                        _HAIR, folds=0.004, blend=0.02)  # fmt: skip
            return [short, fall]
        case "hood":
            hood = ellipsoid(at(-0.022, 0, 1.655), (0.122, 0.108, 0.135), _TOP, 0.01)
            open_face = cut(hood, (ahead[0], ahead[1], 0.0), float(np.dot(ahead, at(0.048, 0, 0))))
            return [short, open_face, ellipsoid(at(-0.06, 0, 1.50), (0.10, 0.11, 0.07), _TOP, 0.03)]
        case "helmet":
            shell = ellipsoid(at(-0.012, 0, 1.690), (0.136, 0.108, 0.100), _HELMET, 0.004)
            strap = [
                round_cone(at(0.0, side * 0.082, 1.66), at(0.035, side * 0.05, 1.545), 0.009, 0.009, _BAG, 0.004)
                for side in (-1, 1)
            ]
            return [short, cut(shell, (0.0, 0.0, -1.0), -1.682), *strap]
