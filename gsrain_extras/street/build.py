"""Assembly of the street: surfaces, baked daylight, Gaussians, tracks, camera rigs and parked vehicles."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsrain_engine.scene.built_in import SceneBox
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.geometry import quaternions_from_matrices, rotation_about_z
from gsrain_engine.scene.rigs import SENSOR_HEIGHT_M, driving_rigs
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from gsrain_engine.scene.skies import LIGHTINGS, LightingName
from gsrain_engine.threads import usable_cores

from .bicycles import BICYCLE_SIZE_M, build_waiting_bicycles
from .buildings import build_houses
from .buses import BUS_SIZE_M, build_parked_buses
from .cars import CAR_FORMS, TRUCK_FORM, build_car, build_parked_cars, car_shadow, vehicle_shadow
from .ground import build_road, build_sidewalks, build_surroundings
from .lamp_light import Windows
from .layout import (
    STREETS,
    CarShape,
    ParkedBus,
    ParkedCar,
    ParkedTruck,
    StreetLayout,
    StreetParameters,
    WaitingCyclist,
    plan_street,
)
from .lighting import LIGHT_OF, Illumination
from .mesh import NEAREST_FIRST, Quads, geometric_normals
from .night import bus_lamps, ego_lamps, lanterns, signal_lamps, truck_lamps, vehicle_lamps
from .people import build_people, people_of, person_size
from .refinement import ego_camera_line, refined, refined_vehicle, split_at_shadows
from .sharpness import color_factors, sharpened
from .signals import build_signals, signal_heads
from .trucks import build_parked_trucks, build_truck
from .vegetation import build_furniture, build_sky, build_trees
from .water_map import street_water
from .wet_surfaces import GROUND_COEFFICIENTS, reflecting, wet_harmonics, wet_materials

LEAD_ID = "lead"
_LEAD_SHAPE: CarShape = "saloon"
_LEAD_PAINT = (0.014, 0.034, 0.075)
_LEAD_TRUCK = ParkedTruck(0.0, 0.0, 0.0, (0.42, 0.025, 0.02), (0.62, 0.62, 0.60), (0.42, 0.025, 0.02))
_TRACK_STEP_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class StreetSurfaces:
    """All surfaces of the street as quads, from which its Gaussians and its mesh are made."""

    layout: StreetLayout
    layers: Mapping[str, Quads]
    """By layer name, in world axes; Gaussian i of a layer is quad i here."""
    lead: Quads
    """The lead vehicle and its shadow, in the object frame."""

    def light(self, name: LightingName | None = None) -> Illumination:
        """Light of a name on the street; by default that of dry weather."""
        lighting = LIGHTINGS[name or LIGHT_OF[self.layout.parameters.time_of_day][0]]
        windows = Windows.of(self.layers["houses"]) if lighting.lamps else None
        return Illumination.over(self.layout.parameters, self.layout, lighting, windows)

    def lead_light(self, name: LightingName | None = None) -> Illumination:
        """Light on the lead vehicle: the same sky without occlusion, as the car drives in and out of shadows."""
        return Illumination.over(
            self.layout.parameters, lighting=LIGHTINGS[name or LIGHT_OF[self.layout.parameters.time_of_day][0]]
        )


def street_surfaces(parameters: StreetParameters | None = None) -> StreetSurfaces:
    layout = plan_street(parameters or StreetParameters())
    light = Illumination.over(layout.parameters, layout)
    line, edge_px = ego_camera_line(layout.parameters), layout.parameters.edge_px
    coarse: dict[str, Callable[[], Quads]] = {
        "road": lambda: build_road(layout),
        "pavements": lambda: build_sidewalks(layout),
        "houses": lambda: build_houses(layout),
        "trees": lambda: build_trees(layout, light.sun),
        PARKED_CARS: lambda: build_parked_cars(layout),
        PARKED_TRUCKS: lambda: build_parked_trucks(layout),
        PARKED_BUSES: lambda: build_parked_buses(layout),
        PEDESTRIANS: lambda: build_people(layout, light.sun),
        BICYCLES: lambda: build_waiting_bicycles(layout),
        TRAFFIC_LIGHTS: lambda: build_signals(layout),
        "furniture": lambda: build_furniture(layout),
        "surroundings": lambda: build_surroundings(layout),
        "sky": lambda: build_sky(layout),
    }

    def fine(name: str, quads: Quads) -> Quads:
        return quads if name == "sky" else refined(split_at_shadows(quads, line, light, edge_px), line, edge_px)

    with ThreadPoolExecutor(usable_cores()) as pool:  # most of a layer's time is in functions of NumPy
        refining = {name: pool.submit(fine, name, build()) for name, build in coarse.items()}
    made = {name: each.result() for name, each in refining.items()}
    return StreetSurfaces(layout, made, build_lead(layout.parameters))


def build_lead(parameters: StreetParameters) -> Quads:
    """Build the lead vehicle with its shadow, in the object frame."""
    if parameters.lead == "saloon":
        return Quads.joined([car_shadow(_LEAD_SHAPE), refined_vehicle(build_car(_LEAD_SHAPE, _LEAD_PAINT))])
    shadow = vehicle_shadow(TRUCK_FORM.length, TRUCK_FORM.width)
    return Quads.joined([shadow, refined_vehicle(build_truck(_LEAD_TRUCK))])


def build_street(parameters: StreetParameters | None = None) -> Scene:
    """Build the street as a scene: named layers, the lead vehicle as an actor, rigs and the ego track."""
    return scene_of(street_surfaces(parameters))


def street_name(parameters: StreetParameters) -> str:
    """Name of the built-in street with these parameters; "street" for any other."""
    return next((name for name, each in STREETS.items() if each == parameters), "street")


def scene_of(surfaces: StreetSurfaces, *, sharp: bool = True) -> Scene:
    """Street of Gaussians; unless `sharp` they have the colors of its surfaces."""
    _, rainy = LIGHT_OF[surfaces.layout.parameters.time_of_day]
    light, clouds = surfaces.light(), surfaces.light(rainy)
    p = surfaces.layout.parameters
    factors = color_factors(p) if sharp else {}
    with ThreadPoolExecutor(usable_cores()) as pool:
        made = [pool.submit(_layer, *each, light, clouds, factors.get(each[0])) for each in surfaces.layers.items()]
    layers = tuple(each.result() for each in made)
    is_truck = p.lead == "truck"
    form = TRUCK_FORM if is_truck else CAR_FORMS[_LEAD_SHAPE]
    gaussians = quads_to_gaussians(surfaces.lead, surfaces.lead_light())
    wet_sh = sharpened(wet_colors(surfaces.lead, surfaces.lead_light(rainy)), factors.get(LEAD_ID))
    lead = Actor(
        LEAD_ID,
        "truck" if is_truck else "car",
        (form.length, form.width, form.height),
        replace(gaussians, sh=sharpened(gaussians.sh, factors.get(LEAD_ID))),
        lead_track(p),
        wet_sh=wet_sh,
    )
    of_lead = truck_lamps(LEAD_ID) if is_truck else vehicle_lamps(LEAD_ID, _LEAD_SHAPE)
    layout = surfaces.layout
    lamps = (*lanterns(layout), *of_lead, *ego_lamps(), *signal_lamps(layout), *bus_lamps(layout))
    return Scene(
        name=street_name(p), layers=layers, actors=(lead,), ground_m=0.0, rigs=driving_rigs(), ego=ego_track(p),
        lamps=lamps if light.lighting.lamps else (), water=street_water(surfaces.layout),
    )  # fmt: skip


def _layer(
    name: str, quads: Quads, light: Illumination, clouds: Illumination, factors: Float32[np.ndarray, " n"] | None
) -> Layer:
    dry = arriving_light(quads, light)
    wet = dry if clouds.lighting is light.lighting else arriving_light(quads, clouds)
    kind = "sky" if name == "sky" else "background"
    gaussians, wet_sh = quads_to_gaussians(quads, light, dry), wet_colors(quads, clouds, wet)
    sharp = replace(gaussians, sh=sharpened(gaussians.sh, factors))
    return Layer(name, sharp, kind=kind, wet_sh=sharpened(wet_sh, factors))


def ego_track(p: StreetParameters) -> PoseTrack:
    """Ego track: down the right-hand lane at constant speed, from x = 0."""
    times = _times(p)
    return _straight(times, p.ego_speed_m_s * times, -0.5 * p.lane_width_m, SENSOR_HEIGHT_M)


def lead_track(p: StreetParameters) -> PoseTrack:
    """Lead vehicle's track: the ego's speed on average, 6 % faster and slower with a period of 8 s."""
    times = _times(p)
    swing = 2 * np.pi / 8.0
    x = p.lead_gap_m + p.ego_speed_m_s * (times + 0.06 / swing * np.sin(swing * times))
    return _straight(times, x, -0.5 * p.lane_width_m, 0.0)


def _times(p: StreetParameters) -> np.ndarray:
    return np.arange(round(p.drive_seconds / _TRACK_STEP_S) + 1) * _TRACK_STEP_S


def _straight(times: np.ndarray, x: np.ndarray, y: float, z: float) -> PoseTrack:
    n = len(times)
    positions = np.stack([x, np.full(n, y), np.full(n, z)], axis=1)
    return PoseTrack(times, positions, np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.ones(n, bool))


# Quads to Gaussians

_CHUNK = 1 << 19  # maximum number of quads converted at a time

SH_C1 = 0.4886025119029199
"""Spherical harmonics of degree 1, sqrt(3/(4 pi)), in the sign of 3DGS: -y, z, -x."""

_THICKNESS = 0.02  # standard deviation across a surface, as a fraction of the smaller one within it


def arriving_light(quads: Quads, light: Illumination) -> Float64[np.ndarray, "n 3"]:
    """Light on each quad, which is the same for its dry and its wet colors."""
    return np.concatenate([light.light_on(part, part.centers) for part in _chunks(quads)])


def quads_to_gaussians(
    quads: Quads, light: Illumination, arriving: Float64[np.ndarray, "n 3"] | None = None
) -> Gaussians:
    """Convert quads to Gaussians, in order, with their dry colors under a light; `arriving` is known light on them.

    Glossy sets get spherical harmonics of degree 1, those with level ground degree 3 for their wet colors, matte ones
    degree 0.
    """
    coefficients = _coefficients(quads)

    def converted(part: Quads, lit: Float64[np.ndarray, "m 3"]) -> Gaussians:
        colors = light.display_colors(part, part.centers, lit)
        return Gaussians(
            means_of(part), *_ellipses(part), _opacities(part), _harmonics(part, colors, light, coefficients),
            antialiased=True,
        )  # fmt: skip

    known = arriving_light(quads, light) if arriving is None else arriving
    return Gaussians.concatenate([converted(part, known[rows]) for rows, part in _numbered_chunks(quads)])


def _opacities(quads: Quads) -> Float32[np.ndarray, " n"]:
    """Largest alpha of each Gaussian. Where surfaces are translucent, overlapping ones together have theirs."""
    overlap = np.maximum(2 * np.pi * quads.spread.prod(axis=1, dtype=np.float64), 1)
    less = -np.expm1(np.log1p(-np.minimum(quads.opacity, 0.999)) / overlap)
    return np.where(quads.opacity < 0.9, less, quads.opacity).astype(np.float32)


def means_of(quads: Quads) -> Float32[np.ndarray, "n 3"]:
    """Centers of the Gaussians of quads: those of the cells, shifted within them, and by a little nearer or farther.

    Without that, the order of Gaussians at equal distances would be by chance.
    """
    c = quads.corners
    u, v = c[:, 1] + c[:, 2] - c[:, 0] - c[:, 3], c[:, 2] + c[:, 3] - c[:, 0] - c[:, 1]
    means = quads.centers + np.float32(0.5) * (u * quads.shift[:, :1] + v * quads.shift[:, 1:])
    means[:, 0] += means[:, 1:] @ NEAREST_FIRST[1:].astype(np.float32)
    return means


def wet_colors(
    quads: Quads, light: Illumination, arriving: Float64[np.ndarray, "n 3"] | None = None
) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics of the Gaussians of quads when soaked, under a light; `arriving` is known light on them."""
    coefficients = _coefficients(quads)

    def converted(part: Quads, lit: Float64[np.ndarray, "m 3"]) -> Float32[np.ndarray, "n k 3"]:
        wet = wet_materials(part, with_lamps=light.layout is None and not light.lighting.lamps)
        matte = _harmonics(wet, light.display_colors(wet, wet.centers, lit), light, coefficients)
        return wet_harmonics(wet, light, coefficients, matte, lit)

    known = arriving_light(quads, light) if arriving is None else arriving
    return np.concatenate([converted(part, known[rows]) for rows, part in _numbered_chunks(quads)])


def _chunks(quads: Quads) -> list[Quads]:
    return [part for _, part in _numbered_chunks(quads)]


def _numbered_chunks(quads: Quads) -> list[tuple[slice, Quads]]:
    """Split quads for conversion: in float64, millions take gigabytes."""
    slices = [slice(first, first + _CHUNK) for first in range(0, max(len(quads), 1), _CHUNK)]
    return [(rows, quads.take(rows)) for rows in slices]


def _coefficients(quads: Quads) -> int:
    if np.any(reflecting(quads)):
        return GROUND_COEFFICIENTS
    return 4 if np.any(quads.gloss > 0) else 1


def displayed_colors(
    quads: Quads, light: Illumination, matte: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 3"]:
    """Display color of quads viewed along unit directions (eye to quad), as in their Gaussians."""
    constant, linear = light.gloss_of(quads.normals)
    mirrored = constant + np.einsum("nd,ndc->nc", directions, linear)
    return np.clip(matte + quads.gloss[:, None] * mirrored, 0, 1).astype(np.float32)


def _ellipses(quads: Quads) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 4"]]:
    """Scales and quaternions of the cells: axes of a parallelogram's covariance, scaled by the cell's spread."""
    c = quads.corners.astype(np.float64)
    u = 0.5 * (c[:, 1] + c[:, 2] - c[:, 0] - c[:, 3]) * quads.spread[:, :1]
    v = 0.5 * (c[:, 2] + c[:, 3] - c[:, 0] - c[:, 1]) * quads.spread[:, 1:]
    normal = geometric_normals(c)
    longer = np.where((_dot(u, u) >= _dot(v, v))[:, None], u, v)
    first = longer - _dot(longer, normal)[:, None] * normal
    first /= np.maximum(np.sqrt(_dot(first, first)), 1e-12)[:, None]
    second = np.cross(normal, first)
    u1, u2, v1, v2 = (_dot(a, b) for a in (u, v) for b in (first, second))
    xx, xy, yy = u1 * u1 + v1 * v1, u1 * u2 + v1 * v2, u2 * u2 + v2 * v2
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    middle, swing = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    large, small = np.sqrt(middle + swing), np.sqrt(np.maximum(middle - swing, 1e-8))
    cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
    rotation = np.stack([cosine * first + sine * second, cosine * second - sine * first, normal], axis=2)
    scales = np.stack([large, small, np.maximum(_THICKNESS * small, 1e-4)], axis=1)
    return scales.astype(np.float32), quaternions_from_matrices(rotation).astype(np.float32)


def _dot(a: Float64[np.ndarray, "n 3"], b: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def _harmonics(
    quads: Quads, colors: Float32[np.ndarray, "n 3"], light: Illumination, coefficients: int
) -> Float32[np.ndarray, "n k 3"]:
    sh = np.zeros((len(quads), coefficients, 3), np.float32)
    sh[:, 0] = (colors - np.float32(0.5)) / np.float32(SH_C0)
    if np.any(quads.gloss > 0):
        constant, linear = light.gloss_of(quads.normals)
        sh[:, 0] = (colors + quads.gloss[:, None] * constant - 0.5) / SH_C0
        sh[:, 1:4] = quads.gloss[:, None, None] * linear[:, [1, 2, 0]] * np.array([[-1.0], [1.0], [-1.0]]) / SH_C1
    return sh


# Objects with a class

PARKED_CARS, PARKED_TRUCKS, PARKED_BUSES = "parked cars", "parked trucks", "parked buses"
PEDESTRIANS, BICYCLES, TRAFFIC_LIGHTS = "pedestrians", "bicycles", "traffic lights"
OBJECT_LAYERS = PARKED_CARS, PARKED_TRUCKS, PARKED_BUSES, PEDESTRIANS, BICYCLES, TRAFFIC_LIGHTS


def street_boxes(parameters: StreetParameters | None = None) -> list[SceneBox]:
    """Boxes of what has a class on a street, in the order of its plan.

    Cars, trucks, buses, people, bicycles, traffic lights.
    """
    layout = plan_street(parameters or StreetParameters())

    def on_road(size: _Size, each: ParkedCar | ParkedTruck | ParkedBus | WaitingCyclist) -> tuple[_Size, _Size, float]:
        return size, (each.x, each.y, 0.0), each.turn_deg

    car_sizes = {name: (form.length, form.width, form.height) for name, form in CAR_FORMS.items()}
    truck_size = TRUCK_FORM.length, TRUCK_FORM.width, TRUCK_FORM.height
    people = [(person_size(figure), place, turn_deg) for figure, place, turn_deg in people_of(layout)]
    heads = [(head.size_lwh, head.foot, head.turn_deg) for head in signal_heads(layout)]
    return [
        *_boxes("parked", "car", PARKED_CARS, [on_road(car_sizes[each.shape], each) for each in layout.cars]),
        *_boxes("truck", "truck", PARKED_TRUCKS, [on_road(truck_size, each) for each in layout.trucks]),
        *_boxes("bus", "bus", PARKED_BUSES, [on_road(BUS_SIZE_M, each) for each in layout.buses]),
        *_boxes("person", "person", PEDESTRIANS, people),
        *_boxes("bicycle", "bicycle", BICYCLES, [on_road(BICYCLE_SIZE_M, each) for each in layout.cyclists]),
        *_boxes("traffic-light", "traffic light", TRAFFIC_LIGHTS, heads),
    ]


_Size = tuple[float, float, float]


def _boxes(prefix: str, class_name: str, layer: str, placed: Sequence[tuple[_Size, _Size, float]]) -> list[SceneBox]:
    """Boxes from sizes, feet and turns."""
    boxes: list[SceneBox] = []
    for number, (size, foot, turn_deg) in enumerate(placed):
        pose = np.eye(4)
        pose[:3, :3] = rotation_about_z(turn_deg)
        pose[:3, 3] = foot
        boxes.append(SceneBox(f"{prefix}-{number:02d}", class_name, layer, size, pose))
    return boxes
