"""Assembly of the street: surfaces, baked daylight, Gaussians, tracks, camera rigs and parked vehicles."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64

from ..camera import DEFAULT_EXPOSURE_S
from ..gaussians import SH_C0, Gaussians
from ..geometry import linear_to_srgb, quaternions_from_matrices
from ..scene import Actor, Layer, PoseTrack, RigCamera, Scene
from .buildings import build_houses
from .cars import CAR_FORMS, TRUCK_FORM, build_car, build_parked_cars, car_shadow
from .ground import build_road, build_sidewalks, build_surroundings
from .layout import STREETS, CarShape, Label, StreetLayout, StreetParameters, plan_street
from .mesh import Quads, geometric_normals, rotation_about_z
from .shadows import ground_occlusion, sun_visibility
from .trucks import build_parked_trucks
from .vegetation import build_furniture, build_sky, build_trees, sky_display

LEAD_ID = "lead"
_LEAD_SHAPE: CarShape = "saloon"
_LEAD_PAINT = (0.014, 0.034, 0.075)
_TRACK_STEP_S = 0.1

# Daylight
# One sun with shadows, the sky's ambient light, and light reflected by the ground.


@dataclass(frozen=True, slots=True)
class Daylight:
    """Direction of the sun, and the layout that occludes it; without a layout nothing does."""

    sun: Float64[np.ndarray, "3"]
    """Unit vector towards the sun."""
    layout: StreetLayout | None = None
    seed: int = 0

    @classmethod
    def over(cls, parameters: StreetParameters, layout: StreetLayout | None = None) -> "Daylight":
        azimuth, elevation = np.radians(parameters.sun_azimuth_deg), np.radians(parameters.sun_elevation_deg)
        sun = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        return cls(sun, layout, parameters.seed)

    def display_colors(self, quads: Quads, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        """Matte display color (0..1) of each quad, lit as at `points` (its center, or one of its corners).

        A long street is lit in sections, each with the trees and vehicles that can shade it.
        """
        if self.layout is not None and self.layout.parameters.length_m > _SECTION_M:
            colors = np.empty((len(quads), 3), np.float32)
            section = np.floor(points[:, 0] / _SECTION_M).astype(np.int64)
            for number in np.unique(section).tolist():
                own, around = np.flatnonzero(section == number), self._lighting(number * _SECTION_M)
                colors[own] = around._display_colors(quads.take(own), points[own])
            return colors
        return self._display_colors(quads, points)

    def _lighting(self, start_m: float) -> "Daylight":
        """Light on the section of a long street that begins at x = `start_m`."""
        assert self.layout is not None
        low, high = start_m - _SHADE_M, start_m + _SECTION_M + _SHADE_M
        trees = tuple(each for each in self.layout.trees if low < each.x < high)
        cars = tuple(each for each in self.layout.cars if low < each.x < high)
        trucks = tuple(each for each in self.layout.trucks if low < each.x < high)
        return replace(self, layout=replace(self.layout, trees=trees, cars=cars, trucks=trucks))

    def _display_colors(self, quads: Quads, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        if len(quads) and quads.labels[0] == Label.SKY:
            return self._sky(points)
        normals = quads.normals.astype(np.float64)
        facing = np.maximum(normals @ self.sun, 0)
        leaf = quads.labels == Label.VEGETATION  # light transmitted by leaves
        facing = np.where(leaf, 0.30 + 0.62 * facing, facing)
        visible = quads.sun_access.astype(np.float64)
        ambient = quads.sky_access.astype(np.float64)
        if self.layout is not None:
            lit = (facing * visible) > 1e-3
            visible[lit] *= sun_visibility(self.layout, self.sun, points[lit], leaf[lit])
            ambient = ambient * ground_occlusion(self.layout, points, normals)
        up = 0.5 + 0.5 * normals[:, 2]
        light = (facing * visible)[:, None] * _SUN_LIGHT
        light += ambient[:, None] * (up[:, None] * _SKY_LIGHT + (1 - up)[:, None] * _GROUND_LIGHT)
        radiance = 1 - np.exp(-_EXPOSURE * light * quads.albedo)
        return self._hazy(linear_to_srgb(radiance), points)

    def gloss_of(
        self, normals: Float[np.ndarray, "n 3"]
    ) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "n 3 3"]]:
        """Mirror reflection added to the display color: a constant, and a linear form of the viewing direction.

        The mirrored direction d - 2 (d.n) n is linear in d, and so is the reflection of a smooth sky: these are
        spherical harmonics of degree 1. The form has shape (n, direction, color).
        """
        n = normals.astype(np.float64)
        flip = np.eye(3) - 2 * n[:, :, None] * n[:, None, :]
        return _MIRRORED, flip[:, :, 2:] * _MIRRORED_UP + (flip @ self.sun)[:, :, None] * _MIRRORED_SUN

    def _sky(self, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        p = None if self.layout is None else self.layout.parameters
        away = points - np.array([0.0 if p is None else 0.5 * (p.start_x_m + p.end_x_m), 0, 0])
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
        return sky_display(away, self.sun, self.seed).astype(np.float32)

    def _hazy(self, colors: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        """Blend distant surfaces into haze; only the hills are far enough to show it."""
        if self.layout is None:
            return colors.astype(np.float32)
        p = self.layout.parameters
        x = np.clip(points[:, 0], p.start_x_m, p.end_x_m)
        far = np.hypot(points[:, 0] - x, points[:, 1])
        part = 1 - np.exp(-np.maximum(far - 60, 0) / (0.45 * _HAZE_LENGTH_M))
        return (colors + (_HAZE - colors) * part[:, None]).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class StreetSurfaces:
    """All surfaces of the street as quads, from which its Gaussians and its mesh are made."""

    layout: StreetLayout
    layers: Mapping[str, Quads]
    """By layer name, in world axes; Gaussian i of a layer is quad i here."""
    lead: Quads
    """The lead car and its shadow, in the object frame."""

    @property
    def light(self) -> Daylight:
        return Daylight.over(self.layout.parameters, self.layout)

    @property
    def lead_light(self) -> Daylight:
        """Light on the lead car: the same sun without occlusion, as the car drives in and out of shadows."""
        return Daylight.over(self.layout.parameters)


def street_surfaces(parameters: StreetParameters | None = None) -> StreetSurfaces:
    layout = plan_street(parameters or StreetParameters())
    sun = Daylight.over(layout.parameters).sun
    layers = {
        "road": build_road(layout),
        "pavements": build_sidewalks(layout),
        "houses": build_houses(layout),
        "trees": build_trees(layout, sun),
        PARKED_CARS: build_parked_cars(layout),
        PARKED_TRUCKS: build_parked_trucks(layout),
        "furniture": build_furniture(layout),
        "surroundings": build_surroundings(layout),
        "sky": build_sky(layout),
    }
    return StreetSurfaces(layout, layers, Quads.joined([car_shadow(_LEAD_SHAPE), build_car(_LEAD_SHAPE, _LEAD_PAINT)]))


def build_street(parameters: StreetParameters | None = None) -> Scene:
    """Build the street as a scene: named layers, the lead car as an actor, rigs and the ego track."""
    return scene_of(street_surfaces(parameters))


def street_name(parameters: StreetParameters) -> str:
    """Name of the built-in street with these parameters; "street" for any other."""
    return next((name for name, each in STREETS.items() if each == parameters), "street")


def scene_of(surfaces: StreetSurfaces) -> Scene:
    light = surfaces.light
    layers = tuple(
        Layer(name, quads_to_gaussians(quads, light), kind="sky" if name == "sky" else "background")
        for name, quads in surfaces.layers.items()
    )
    form = CAR_FORMS[_LEAD_SHAPE]
    p = surfaces.layout.parameters
    gaussians = quads_to_gaussians(surfaces.lead, surfaces.lead_light)
    lead = Actor(LEAD_ID, "car", (form.length, form.width, form.height), gaussians, lead_track(p))
    return Scene(name=street_name(p), layers=layers, actors=(lead,), ground_m=0.0, rigs=street_rigs(), ego=ego_track(p))


def ego_track(p: StreetParameters) -> PoseTrack:
    """Ego track: down the right-hand lane at constant speed, from x = 0."""
    times = _times(p)
    return _straight(times, p.ego_speed_m_s * times, -0.5 * p.lane_width_m, SENSOR_HEIGHT_M)


def lead_track(p: StreetParameters) -> PoseTrack:
    """Lead car's track: the ego's speed on average, 6 % faster and slower with a period of 8 s."""
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


def quads_to_gaussians(quads: Quads, light: Daylight) -> Gaussians:
    """Convert quads to Gaussians, in order. Glossy sets get spherical harmonics of degree 1, matte ones degree 0."""
    if len(quads) > _CHUNK:  # in float64, millions take gigabytes
        chunks = (slice(first, first + _CHUNK) for first in range(0, len(quads), _CHUNK))
        return Gaussians.concatenate([quads_to_gaussians(quads.take(chunk), light) for chunk in chunks])
    scales, quaternions = _ellipses(quads)
    colors = light.display_colors(quads, quads.centers)
    return Gaussians(quads.centers, scales, quaternions, quads.opacity, _harmonics(quads, colors, light))


def displayed_colors(
    quads: Quads, light: Daylight, matte: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
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
    longer = np.where((np.sum(u * u, axis=1) >= np.sum(v * v, axis=1))[:, None], u, v)
    first = longer - np.sum(longer * normal, axis=1, keepdims=True) * normal
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = np.cross(normal, first)
    u1, u2, v1, v2 = (np.sum(a * b, axis=1) for a in (u, v) for b in (first, second))
    xx, xy, yy = u1 * u1 + v1 * v1, u1 * u2 + v1 * v2, u2 * u2 + v2 * v2
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    middle, swing = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    large, small = np.sqrt(middle + swing), np.sqrt(np.maximum(middle - swing, 1e-8))
    cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
    rotation = np.stack([cosine * first + sine * second, cosine * second - sine * first, normal], axis=2)
    scales = np.stack([large, small, np.maximum(_THICKNESS * small, 5e-4)], axis=1)
    return scales.astype(np.float32), quaternions_from_matrices(rotation).astype(np.float32)


def _harmonics(quads: Quads, colors: Float32[np.ndarray, "n 3"], light: Daylight) -> Float32[np.ndarray, "n k 3"]:
    if not np.any(quads.gloss > 0):
        return ((colors - np.float32(0.5)) / np.float32(SH_C0))[:, None, :]
    constant, linear = light.gloss_of(quads.normals)
    sh = np.zeros((len(quads), 4, 3))
    sh[:, 0] = (colors + quads.gloss[:, None] * constant - 0.5) / SH_C0
    sh[:, 1:] = quads.gloss[:, None, None] * linear[:, [1, 2, 0]] * np.array([[-1.0], [1.0], [-1.0]]) / SH_C1
    return sh.astype(np.float32)


_SECTION_M = 260.0  # maximum length of a street that is lit in one piece
_SHADE_M = 30.0  # maximum distance of a shadow from the tree or vehicle that casts it
_SUN_LIGHT = np.array([3.05, 2.72, 2.18])
_SKY_LIGHT = np.array([0.50, 0.62, 0.82])
_GROUND_LIGHT = np.array([0.30, 0.27, 0.22])
_EXPOSURE = 1.18
_MIRRORED = np.array([0.36, 0.40, 0.45])  # display color of a mirror that reflects the horizon
_MIRRORED_UP = np.array([0.30, 0.37, 0.48])  # added for a reflection of the zenith, subtracted for one of the road
_MIRRORED_SUN = np.array([0.16, 0.15, 0.12])
_HAZE = np.array([0.70, 0.78, 0.86])
_HAZE_LENGTH_M = 1400.0

# Camera rigs
# The rigs of the two large driving data sets, in the ego frame (x forward, y left, z up, 1.5 m above the road).

SENSOR_HEIGHT_M = 1.5
"""Height of the ego frame's origin above the road."""

# name, yaw (deg, to the left), x, y, height above the road (m), fx (px), cx, cy (px)
_WAYMO = (
    ("FRONT", 0.0, 1.54, -0.02, 2.12, 2059.0, 957.0, 640.0),
    ("FRONT_LEFT", 45.0, 1.49, 0.10, 2.12, 2059.0, 960.0, 640.0),
    ("FRONT_RIGHT", -45.0, 1.49, -0.10, 2.12, 2059.0, 963.0, 640.0),
)

# Calibration of the sample log of 2018-07-24, positions to a centimeter and angles to half a degree.
_NUSCENES = (
    ("CAM_FRONT", 0.0, 1.70, 0.02, 1.51, 1266.4, 816.3, 491.5),
    ("CAM_FRONT_RIGHT", -56.0, 1.55, -0.49, 1.50, 1260.8, 808.0, 495.3),
    ("CAM_FRONT_LEFT", 55.0, 1.52, 0.50, 1.51, 1272.6, 826.6, 479.8),
    ("CAM_BACK", 180.0, 0.03, 0.00, 1.58, 809.2, 829.2, 481.8),
    ("CAM_BACK_LEFT", 108.5, 1.04, 0.48, 1.59, 1256.7, 792.1, 492.8),
    ("CAM_BACK_RIGHT", -110.5, 1.02, -0.48, 1.56, 1259.5, 807.3, 501.2),
)

_CAMERA_TO_FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""OpenCV axes to ego axes for a camera that points straight ahead."""


def street_rigs() -> dict[str, tuple[RigCamera, ...]]:
    """Rigs by name: `waymo_front3` (three cameras ahead) and `nuscenes` (six, all around)."""
    return {
        "waymo_front3": tuple(_camera(row, 1920, 1280) for row in _WAYMO),
        "nuscenes": tuple(_camera(row, 1600, 900) for row in _NUSCENES),
    }


def _camera(row: tuple[str, float, float, float, float, float, float, float], width: int, height: int) -> RigCamera:
    name, yaw_deg, x, y, above_road, f, cx, cy = row
    pose = np.eye(4)
    pose[:3, :3] = rotation_about_z(yaw_deg) @ _CAMERA_TO_FORWARD
    pose[:3, 3] = x, y, above_road - SENSOR_HEIGHT_M
    return RigCamera(name, width, height, f, f, cx, cy, pose, DEFAULT_EXPOSURE_S)


# Parked vehicles

PARKED_CARS, PARKED_TRUCKS = "parked cars", "parked trucks"


class ParkedBox(NamedTuple):
    """A parked vehicle as a box."""

    id: str
    class_name: str
    """Car or truck."""
    layer: str
    """Name of the vehicle's layer."""
    size_lwh: tuple[float, float, float]
    """Meters."""
    to_street: Float64[np.ndarray, "4 4"]
    """From the vehicle's frame (x forward, y left, z up, origin at the bottom center) to the street's."""


def parked_boxes(parameters: StreetParameters | None = None) -> list[ParkedBox]:
    """Parked vehicles of a street, in the order of its plan: cars, then trucks."""
    layout = plan_street(parameters or StreetParameters())
    cars = [(f"parked-{k:02d}", "car", PARKED_CARS, CAR_FORMS[car.shape], car) for k, car in enumerate(layout.cars)]
    trucks = [(f"truck-{k:02d}", "truck", PARKED_TRUCKS, TRUCK_FORM, truck) for k, truck in enumerate(layout.trucks)]
    boxes: list[ParkedBox] = []
    for name, class_name, layer, form, vehicle in (*cars, *trucks):
        pose = np.eye(4)
        pose[:3, :3] = rotation_about_z(vehicle.turn_deg)
        pose[:2, 3] = vehicle.x, vehicle.y
        boxes.append(ParkedBox(name, class_name, layer, (form.length, form.width, form.height), pose))
    return boxes
