"""Parameters and layout of the built-in street."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from gsrain_engine.scene.skies import TimeOfDay
from gsrain_engine.settings import Settings

LeadVehicle = Literal["saloon", "truck"]


class StreetParameters(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Size and contents of the street. It runs along +x, with the ego lane on the right (y < 0) and z upwards."""

    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, title="Seed")] = 7
    """Random seed of the street: the same seed gives the same bytes."""
    length_m: Annotated[float, Meta(ge=120, le=1200, title="Length", extra={"unit": "m"})] = 180.0
    """From the cross street behind the start to the one ahead."""
    behind_m: Annotated[float, Meta(ge=20, le=60, title="Behind the start", extra={"unit": "m"})] = 30.0
    """Part of the length behind x = 0."""
    detail: Annotated[float, Meta(ge=0.4, le=1, title="Detail")] = 1.0
    """Factor on the size of the cells of houses and on that of leaves, which become more as they become smaller."""
    edge_px: Annotated[float, Meta(ge=0.5, le=16, title="Cells at edges", extra={"unit": "px"})] = 1.5
    """Size of the cells at color edges and outlines where the ego passes closest, in pixels of its front camera at a
    width of 960: the smaller, the sharper, and the more Gaussians (1: 1.42 million, 1.5: 1.08, 2: 0.88)."""
    lane_width_m: Annotated[float, Meta(ge=2.8, le=4.0, title="Lane width", extra={"unit": "m"})] = 3.4
    """One lane each way."""
    parking_width_m: Annotated[float, Meta(ge=2.0, le=2.6, title="Parking lane width", extra={"unit": "m"})] = 2.2
    """One parking lane on each side."""
    pavement_width_m: Annotated[float, Meta(ge=2.5, le=5.0, title="Pavement width", extra={"unit": "m"})] = 3.5
    """From curb to house fronts."""
    tree_spacing_m: Annotated[float, Meta(ge=8, le=60, title="Tree spacing", extra={"unit": "m"})] = 15.0
    """Along each sidewalk."""
    parked_share: Annotated[float, Meta(ge=0, le=1, title="Parked cars")] = 0.46
    """Fraction of occupied parking bays."""
    sun_azimuth_deg: Annotated[float, Meta(ge=0, le=180, title="Sun azimuth", extra={"unit": "deg"})] = 128.0
    """Counter-clockwise from the driving direction: 90 is from the left, 180 from behind."""
    sun_elevation_deg: Annotated[float, Meta(ge=25, le=75, title="Sun elevation", extra={"unit": "deg"})] = 47.0
    """Above the horizon."""
    ego_speed_m_s: Annotated[float, Meta(ge=0, le=20, title="Ego speed", extra={"unit": "m/s"})] = 10.0
    """The ego vehicle's constant speed."""
    time_of_day: Annotated[TimeOfDay, Meta(title="Time of day")] = "day"
    """overcast: by day under clouds, also when it is dry. At dusk and by night lanterns, windows and vehicles' lamps
    are lit."""
    lead: Annotated[LeadVehicle, Meta(title="Lead vehicle")] = "saloon"
    """Vehicle ahead of the ego."""
    lead_gap_m: Annotated[float, Meta(ge=6, le=60, title="Gap to the lead car", extra={"unit": "m"})] = 18.0
    """From the ego's origin to the middle of the lead vehicle at the start."""

    @property
    def start_x_m(self) -> float:
        """Start of the rows of houses."""
        return -self.behind_m

    @property
    def end_x_m(self) -> float:
        return self.length_m - self.behind_m

    @property
    def curb_y_m(self) -> float:
        """Half the width between the curbs."""
        return self.lane_width_m + self.parking_width_m

    @property
    def front_y_m(self) -> float:
        """Half the width between the house fronts."""
        return self.curb_y_m + self.pavement_width_m

    @property
    def drive_seconds(self) -> float:
        """Duration of the ego's drive: until 30 m before the end, or 15 s if it does not move."""
        if self.ego_speed_m_s <= 0:
            return 15.0
        return min(60.0, (self.end_x_m - 30.0) / self.ego_speed_m_s)


STREETS = {
    "street": StreetParameters(),
    "street:overcast": StreetParameters(time_of_day="overcast"),
    "street:dusk": StreetParameters(
        time_of_day="dusk", lead="truck", length_m=220.0, ego_speed_m_s=16.0, lead_gap_m=20.0
    ),
    "street:night": StreetParameters(time_of_day="night"),
    "street:long": StreetParameters(length_m=1200.0, edge_px=1.8, ego_speed_m_s=20.0),
}
"""Built-in streets by name. Overcast, it is the same street under the clouds that it has in rain; by night it is lit by
its lamps, as at dusk, where the ego follows a truck at 58 km/h; the long one, of 1.2 km and about
5 million Gaussians, tests large scenes."""

# Layout
# Positions of houses, trees, cars and lamps, from which everything else is built.

CURB_HEIGHT_M = 0.12
HOUSE_DEPTH_M = 10.0
CROSS_ROAD_M = 8.0
"""Width between the curbs of the two streets that cross at the ends."""

CROSS_SIDEWALK_M = 2.6
CROSS_LENGTH_M = 36.0
"""Extent of the cross streets to each side of the axis."""

Wall = Literal["plaster", "brick", "stone"]

_WALLS: tuple[tuple[Wall, tuple[float, float, float]], ...] = (
    ("plaster", (0.56, 0.47, 0.33)),  # ochre
    ("plaster", (0.60, 0.56, 0.48)),  # cream
    ("brick", (0.30, 0.125, 0.085)),  # red brick
    ("plaster", (0.46, 0.27, 0.20)),  # terracotta
    ("plaster", (0.40, 0.45, 0.44)),  # gray green
    ("stone", (0.43, 0.39, 0.32)),  # sandstone
    ("plaster", (0.52, 0.40, 0.35)),  # old rose
    ("brick", (0.36, 0.22, 0.14)),  # yellow brown brick
    ("plaster", (0.35, 0.42, 0.50)),  # pale blue
    ("plaster", (0.62, 0.60, 0.57)),  # white
)

_ROOFS = ((0.26, 0.10, 0.065), (0.20, 0.085, 0.06), (0.10, 0.105, 0.12), (0.14, 0.12, 0.11), (0.29, 0.14, 0.09))
_SIGNS = ((0.06, 0.13, 0.10), (0.22, 0.03, 0.03), (0.03, 0.06, 0.16), (0.05, 0.05, 0.055), (0.30, 0.20, 0.05))
_DOORS = ((0.10, 0.045, 0.02), (0.02, 0.06, 0.045), (0.02, 0.035, 0.07), (0.13, 0.02, 0.02), (0.05, 0.05, 0.05))


@dataclass(frozen=True, slots=True)
class House:
    """A house in its own frame: x along the front, y into the house, z up, origin at the front's first foot."""

    origin: tuple[float, float, float]
    turn_deg: float
    width: float
    floors: int
    """Floors above the ground floor."""
    ground_height: float
    floor_height: float
    wall: Wall
    color: tuple[float, float, float]
    roof_color: tuple[float, float, float]
    accent: tuple[float, float, float]
    """Shop sign and awning."""
    door_color: tuple[float, float, float]
    shop: bool
    dormers: bool
    balconies: bool
    pitch_deg: float
    detail: float
    """Cell size: 1 near the ego's path, larger farther away."""
    seed: int

    @property
    def eaves(self) -> float:
        return self.ground_height + self.floors * self.floor_height + 0.35

    @property
    def ridge(self) -> float:
        """Height of the roof's ridge, above the middle of the house."""
        return self.eaves + 0.5 * HOUSE_DEPTH_M * float(np.tan(np.radians(self.pitch_deg)))


@dataclass(frozen=True, slots=True)
class Tree:
    """A tree on the sidewalk."""

    x: float
    y: float
    crown_base: float
    height: float
    radius: float
    detail: float
    """Factor on the size of its leaves."""
    seed: int


# Parked vehicles

CarShape = Literal["hatchback", "saloon", "estate", "van"]
Color = tuple[float, float, float]
"""Linear albedo."""


@dataclass(frozen=True, slots=True)
class ParkedCar:
    """A car at the curb; heading +x or -x."""

    x: float
    y: float
    turn_deg: float
    shape: CarShape
    paint: Color


@dataclass(frozen=True, slots=True)
class ParkedTruck:
    """A box truck at the curb; heading +x or -x."""

    x: float
    y: float
    turn_deg: float
    cab: Color
    body: Color
    sign: Color


@dataclass(frozen=True, slots=True)
class ParkedBus:
    """A bus at its stop; heading +x or -x."""

    x: float
    y: float
    turn_deg: float
    paint: Color


@dataclass(frozen=True, slots=True)
class Pedestrian:
    """A person who stands on a sidewalk."""

    x: float
    y: float
    turn_deg: float
    """0 looks along +x."""
    figure: int
    """Index in `people.FIGURES`."""


@dataclass(frozen=True, slots=True)
class WaitingCyclist:
    """A cyclist on the road with a foot on the curb; heading +x or -x."""

    x: float
    y: float
    turn_deg: float
    paint: Color


@dataclass(frozen=True, slots=True)
class StreetLayout:
    """Positions and attributes of everything on the street."""

    parameters: StreetParameters
    left: tuple[House, ...]
    right: tuple[House, ...]
    ends: tuple[House, ...]
    trees: tuple[Tree, ...]
    cars: tuple[ParkedCar, ...]
    trucks: tuple[ParkedTruck, ...]
    buses: tuple[ParkedBus, ...]
    pedestrians: tuple[Pedestrian, ...]
    cyclists: tuple[WaitingCyclist, ...]
    lamps: tuple[tuple[float, float], ...]
    """Feet (x, y) of the street lamps."""
    crossings: tuple[float, ...]
    """Start of the zebra crossings, x."""
    signals: tuple[float, ...]
    """Those of them with traffic lights."""


def plan_street(parameters: StreetParameters) -> StreetLayout:
    """Create the layout; the same parameters give the same layout."""
    p = parameters
    crossings = tuple(float(x) for x in np.arange(34.0, p.end_x_m, 72.0) if x + 12.0 < p.end_x_m)
    left, right = (_row(p, side, np.random.default_rng([p.seed, 1, side])) for side in (0, 1))
    trees = _trees(p, crossings, np.random.default_rng([p.seed, 2]))
    cars = plan_cars(p, crossings, np.random.default_rng([p.seed, 4]))
    signals = crossings[::2]
    buses = plan_buses(p, signals, cars)
    trees = tuple(tree for tree in trees if not any(_overhangs(tree, bus) for bus in buses))
    trucks = plan_trucks(p, crossings, [(tree.x, tree.y, tree.radius) for tree in trees], cars, buses)
    return StreetLayout(
        parameters=p,
        left=left,
        right=right,
        ends=_ends(p, np.random.default_rng([p.seed, 3])),
        trees=trees,
        cars=cars_clear_of(cars, trucks, buses),
        trucks=trucks,
        buses=buses,
        pedestrians=plan_pedestrians(p, signals, buses, trees),
        cyclists=tuple(
            WaitingCyclist(c + CROSSING_LENGTH_M + 4.2, -(p.curb_y_m - 0.27), 0.0, _FRAMES[k % len(_FRAMES)])
            for k, c in enumerate(signals)
        ),
        lamps=tuple(
            (float(x), (p.curb_y_m + 0.45) * (-1) ** k)
            for k, x in enumerate(np.arange(p.start_x_m + 9.5, p.end_x_m - 4, 22.0))
        ),
        crossings=crossings,
        signals=signals,
    )


def _house(
    p: StreetParameters,
    rng: np.random.Generator,
    origin: tuple[float, float, float],
    turn: float,
    width: float,
    kind: int,
) -> House:
    """Choose the appearance of one house at random; `kind` steps through the palette so that neighbors differ."""
    wall, color = _WALLS[kind % len(_WALLS)]
    vary = rng.uniform(0.9, 1.08)
    return House(
        origin=origin,
        turn_deg=turn,
        width=width,
        floors=int(rng.choice([2, 3, 3, 4])),
        ground_height=float(rng.uniform(3.5, 3.9)),
        floor_height=float(rng.uniform(2.95, 3.25)),
        wall=wall,
        color=(color[0] * vary, color[1] * vary, color[2] * vary),
        roof_color=_ROOFS[int(rng.integers(len(_ROOFS)))],
        accent=_SIGNS[int(rng.integers(len(_SIGNS)))],
        door_color=_DOORS[int(rng.integers(len(_DOORS)))],
        shop=bool(rng.random() < 0.45),
        dormers=bool(rng.random() < 0.5),
        balconies=bool(rng.random() < 0.4),
        pitch_deg=float(rng.uniform(36, 46)),
        detail=p.detail,
        seed=int(rng.integers(2**31)),
    )


def _widths(rng: np.random.Generator, length: float) -> list[float]:
    count = max(1, round(length / 10.8))
    widths = rng.uniform(0.78, 1.22, count)
    return [float(w) for w in widths * length / widths.sum()]


def _row(p: StreetParameters, side: int, rng: np.random.Generator) -> tuple[House, ...]:
    """One side of the street, from the start to the end; side 0 is on the left (y > 0)."""
    houses: list[House] = []
    x, kind = p.start_x_m, int(rng.integers(10))
    for width in _widths(rng, p.length_m):
        front = p.front_y_m
        origin = (x, front, CURB_HEIGHT_M) if side == 0 else (x + width, -front, CURB_HEIGHT_M)
        house = _house(p, rng, origin, 0.0 if side == 0 else 180.0, width, kind)
        # The left row is farther from the ego lane.
        far = x + width < -6 or x > p.end_x_m - 25
        houses.append(replace(house, detail=p.detail * (1.5 if far else (1.3 if side == 0 else 1.0))))
        x += width
        kind += int(rng.choice([1, 3, 7]))
    return tuple(houses)


def _ends(p: StreetParameters, rng: np.random.Generator) -> tuple[House, ...]:
    """Rows of houses that close the view at both ends."""
    houses: list[House] = []
    offset = CROSS_ROAD_M + 2 * CROSS_SIDEWALK_M
    for at, turn, detail in ((p.end_x_m + offset, -90.0, 1.5), (p.start_x_m - offset, 90.0, 2.2)):
        y, kind = -CROSS_LENGTH_M, int(rng.integers(10))
        for width in _widths(rng, 2 * CROSS_LENGTH_M):
            origin = (at, y + width if turn < 0 else y, CURB_HEIGHT_M)
            away = abs(y + width / 2) > 16
            houses.append(replace(_house(p, rng, origin, turn, width, kind), detail=2.4 if away else detail))
            y += width
            kind += int(rng.choice([1, 3, 7]))
    return tuple(houses)


def _trees(p: StreetParameters, crossings: tuple[float, ...], rng: np.random.Generator) -> tuple[Tree, ...]:
    trees: list[Tree] = []
    for side in (1, -1):
        first = p.start_x_m + (6.0 if side > 0 else 0.55 * p.tree_spacing_m + 6.0)
        for x in np.arange(first, p.end_x_m - 3, p.tree_spacing_m):
            x = round(2 * float(x + rng.uniform(-1.5, 1.5))) / 2  # on the joints of the slabs
            draws = rng.uniform(size=3)
            if any(c - 3.5 < x < c + CROSSING_LENGTH_M + 3.5 for c in crossings):
                continue
            height = 6.6 + 2.0 * draws[0]
            trees.append(
                Tree(x, side * (p.curb_y_m + 0.15 + 0.75), 2.5 + 0.5 * draws[1], height, 1.9 + 0.5 * draws[2], p.detail,
                     int(rng.integers(2**31)))
            )  # fmt: skip
    return tuple(trees)


CROSSING_LENGTH_M = 3.0
TRUCK_LENGTH_M, TRUCK_WIDTH_M = 7.2, 2.2
BUS_LENGTH_M, BUS_WIDTH_M = 12.0, 2.5

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

_TRUCKS: tuple[tuple[int, float, Color, Color, Color], ...] = (
    (1, 58.0, (0.60, 0.60, 0.59), (0.62, 0.62, 0.60), (0.03, 0.10, 0.30)),
    (1, 86.5, (0.42, 0.025, 0.02), (0.62, 0.62, 0.60), (0.42, 0.025, 0.02)),
    (-1, 67.0, (0.03, 0.09, 0.27), (0.64, 0.64, 0.63), (0.03, 0.09, 0.27)),
    (-1, 97.5, (0.62, 0.62, 0.61), (0.035, 0.11, 0.26), (0.62, 0.62, 0.60)),
)
"""Side of the street (1: left), approximate x in m, colors of cab, box and sign."""

_TRUCKS_PERIOD_M = 180.0  # a longer street repeats them

_CAR_LENGTH_M, _GAP_M = 4.7, 0.5
_MAX_SHIFT_M = 5.0  # maximum shift of a truck to a free position; without one it is omitted


def plan_cars(p: StreetParameters, crossings: Sequence[float], rng: np.random.Generator) -> tuple[ParkedCar, ...]:
    """Choose the occupied bays and their cars at random."""
    cars: list[ParkedCar] = []
    shapes: tuple[CarShape, ...] = ("hatchback", "saloon", "estate", "hatchback", "van", "saloon")
    for side in (1, -1):
        for x in np.arange(p.start_x_m + 6, p.end_x_m - 5, 6.1):
            draws = rng.uniform(size=4)
            x = float(x) + 1.0 * (draws[0] - 0.5)
            near_crossing = any(c - 6.5 < x < c + CROSSING_LENGTH_M + 6.5 for c in crossings)
            if draws[1] > p.parked_share or near_crossing:
                continue
            y = side * (p.curb_y_m - 0.5 * p.parking_width_m - 0.05 + 0.16 * (draws[2] - 0.5))
            shape = shapes[int(rng.integers(len(shapes)))]
            paint = _PAINTS[int(rng.integers(len(_PAINTS)))]
            cars.append(ParkedCar(x, y, (180.0 if side > 0 else 0.0) + 1.6 * (draws[3] - 0.5), shape, paint))
    return tuple(cars)


def plan_trucks(
    p: StreetParameters,
    crossings: Sequence[float],
    crowns: Sequence[tuple[float, float, float]],
    cars: Sequence[ParkedCar],
    buses: Sequence[ParkedBus] = (),
) -> tuple[ParkedTruck, ...]:
    """Place trucks close to the curb, clear of crowns (x, y, radius), crossings and buses.

    Empty without parking lanes.
    """
    trucks: list[ParkedTruck] = []
    rounds = range(int(p.length_m / _TRUCKS_PERIOD_M) + 1) if cars else ()
    for side, x, cab, body, sign in (
        (side, x + k * _TRUCKS_PERIOD_M, *colors) for k in rounds for side, x, *colors in _TRUCKS
    ):
        taken = [(at - radius, at + radius) for at, y, radius in crowns if y * side > 0]
        taken += [(c - 5.0, c + CROSSING_LENGTH_M + 5.0) for c in crossings]
        taken += [(b.x - 0.5 * BUS_LENGTH_M - 1.5, b.x + 0.5 * BUS_LENGTH_M + 1.5) for b in buses if b.y * side > 0]
        taken += [(-np.inf, p.start_x_m + 2.0), (p.end_x_m - 2.0, np.inf)]
        shifts = sorted(np.arange(-_MAX_SHIFT_M, _MAX_SHIFT_M + 0.1, 0.25), key=abs)
        reach = 0.5 * TRUCK_LENGTH_M
        free = [x + s for s in shifts if all(x + s + reach < low or x + s - reach > high for low, high in taken)]
        if free:
            y = side * (p.curb_y_m - 0.03 - 0.5 * TRUCK_WIDTH_M)
            trucks.append(ParkedTruck(float(free[0]), y, 180.0 if side > 0 else 0.0, cab, body, sign))
    return tuple(trucks)


def cars_clear_of(
    cars: Sequence[ParkedCar], trucks: Sequence[ParkedTruck], buses: Sequence[ParkedBus]
) -> tuple[ParkedCar, ...]:
    """Cars that touch no truck, and leave the bus stops free."""
    long = [(t.x, t.y, TRUCK_LENGTH_M) for t in trucks] + [(b.x, b.y, BUS_LENGTH_M + 2.0) for b in buses]
    return tuple(
        car
        for car in cars
        if all(car.y * y < 0 or abs(car.x - x) > 0.5 * (length + _CAR_LENGTH_M) + _GAP_M for x, y, length in long)
    )


# Buses, pedestrians and cyclists, around the crossings with traffic lights

_BUS_PAINTS: tuple[Color, ...] = ((0.74, 0.43, 0.012), (0.42, 0.030, 0.026))
_FRAMES: tuple[Color, ...] = ((0.030, 0.085, 0.065), (0.30, 0.022, 0.016))
_FIGURES = 6  # of `people.FIGURES`
_STOP_BEFORE_M = 7.0  # between a crossing and the bus stop before it, on the left


def plan_buses(p: StreetParameters, signals: Sequence[float], cars: Sequence[ParkedCar]) -> tuple[ParkedBus, ...]:
    """Place a bus at the stop before each crossing, for those who drive along -x; empty without parking lanes."""
    if not cars or p.parking_width_m < 2.2:
        return ()
    reach = 0.5 * BUS_LENGTH_M
    places = [c + CROSSING_LENGTH_M + _STOP_BEFORE_M + reach for c in signals]
    y = p.curb_y_m - 0.03 - 0.5 * BUS_WIDTH_M
    return tuple(
        ParkedBus(x, y, 180.0, _BUS_PAINTS[k % len(_BUS_PAINTS)])
        for k, x in enumerate(places)
        if x + reach < p.end_x_m - 2.0
    )


def _overhangs(tree: Tree, bus: ParkedBus) -> bool:
    return bool(tree.y * bus.y > 0 and abs(tree.x - bus.x) < 0.5 * BUS_LENGTH_M + tree.radius + 0.4)


def plan_pedestrians(
    p: StreetParameters, signals: Sequence[float], buses: Sequence[ParkedBus], trees: Sequence[Tree]
) -> tuple[Pedestrian, ...]:
    """Let people wait at crossings and bus stops, and stand at houses, clear of trees."""
    curb, front = p.curb_y_m, p.front_y_m
    places: list[tuple[float, float, float]] = []
    for c in signals:
        places += [(c + 0.85, -(curb + 0.95), 84.0), (c + 2.15, -(curb + 1.25), 97.0), (c + 1.5, curb + 1.05, -93.0),
                   (c - 17.5, -(front - 0.75), 70.0), (c + 37.0, -(front - 0.9), 130.0)]  # fmt: skip
    for bus in buses:
        places += [(bus.x - 4.8, curb + 0.95, -70.0), (bus.x - 3.3, curb + 1.45, -120.0)]
    free = [at for at in places if all(np.hypot(at[0] - t.x, at[1] - t.y) > 0.8 for t in trees)]
    return tuple(Pedestrian(*at, figure=k % _FIGURES) for k, at in enumerate(free) if at[0] < p.end_x_m - 2.0)
