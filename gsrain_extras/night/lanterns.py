"""Lamps of a night without any: lanterns along a drive, or one lamp beside an object; and what is seen of lamps."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.appearance.wet_look.ground_plane import GroundHeights
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.lamps import (
    LANTERN_COLOR,
    LANTERN_HEIGHT_M,
    LANTERN_INNER_DEG,
    LANTERN_M2,
    LANTERN_OUTER_DEG,
    Lamp,
    lit_lamps,
)
from gsrain_engine.scene.models import lantern_bodies
from gsrain_engine.scene.scene import Layer, Scene, SceneCore, ahead_of
from gsrain_engine.scene.skies import NIGHT
from gsrain_engine.scene.vehicle_lamps import VehicleLamps

SPACING_M = 30.0
"""Distance of lanterns along a drive: 4.6 mounting heights."""
RIGHT_M = 2.75
"""Lanterns hang this far right of the path of the ego vehicle; their masts stand 1.75 m farther."""
_FIRST_M, _BEFORE_M, _BEYOND_M = 14.0, 46.0, 106.0
"""First lantern ahead of the start; how far they go on straight before the start and beyond the end of a drive."""
MIN_DRIVE_M = 0.5  # a shorter one has no direction of its own: the vehicle's counts

OBJECT_IRRADIANCE = 5.0
"""Of each lamp at an object: 50 lx where 10 cd are 1 m2; white paper that faces it has 0.87 of display white."""
_OBJECT_LAMPS = (("front lamp", 52.0, 38.0), ("back lamp", -143.0, 26.0))
"""Lamps around an object: degrees to the left of the direction from which it is first seen, and above it. Rain throws
light forward, so that it is seen in that of the second one."""
_RADII, _NEAREST_M = 3.0, 1.5
"""Distance of these lamps in radii of the object, and in meters at least."""
_LAMP_COLOR = (1.0, 0.80, 0.55)  # of a bulb of 2700 K


def default_lamps(
    scene: Scene, core: SceneCore, heights: GroundHeights | None
) -> tuple[tuple[Lamp, ...], Layer | None]:
    """Lamps for a scene without any, and a layer with their bodies.

    Where an ego vehicle drives, or a camera path leads over ground, those are lanterns at its right side and the lamps
    of other vehicles; elsewhere two lamps above an object, one before it and one behind it, as it is first seen.
    """
    course = _course(scene, heights)
    if course is None:
        return _lamps_of_object(scene, core), None
    places, turns_deg = _stations(course)
    if heights is not None:
        places[:, 2] = heights.sampled(heights.smooth_m, places)
    to_scene = np.linalg.inv(scene.scene_to_world)
    found: list[Lamp] = []
    for number, place in enumerate(places, 1):
        x, y, z = (to_scene[:3, :3] @ (place + [0, 0, LANTERN_HEIGHT_M]) + to_scene[:3, 3]).tolist()
        found.append(
            Lamp(
                name=f"lantern {number}", position=(x, y, z), direction=_down(scene), color=LANTERN_COLOR,
                intensity_m2=LANTERN_M2, inner_deg=LANTERN_INNER_DEG, outer_deg=LANTERN_OUTER_DEG,
            )
        )  # fmt: skip
    built = lantern_bodies(places, turns_deg)
    bodies = None if built is None else Layer("lanterns", replace(built, antialiased=False), to_scene=to_scene)
    others = [lamp for lamp in VehicleLamps(mount="vehicles").of(scene) if lamp.mount != "ego"]
    return (*found, *others), bodies


def _course(scene: Scene, heights: GroundHeights | None) -> Float64[np.ndarray, "n 3"] | None:
    """Places of a drive in the world, at least two; None without one."""
    to_world = scene.scene_to_world
    if scene.ego is not None and scene.ego.valid.any():
        places = scene.ego.positions[scene.ego.valid] @ to_world[:3, :3].T + to_world[:3, 3]
        if np.linalg.norm(np.ptp(places[:, :2], axis=0)) < MIN_DRIVE_M:
            pose = scene.ego_to_world(float(scene.ego.times[scene.ego.valid][0]))
            assert pose is not None
            places = places[:1] + np.array([[0.0], [1.0]]) * pose[:3, 0]
    elif scene.path is not None and heights is not None and not scene.path.loop:
        places = scene.path.positions @ to_world[:3, :3].T + to_world[:3, 3]
        if np.linalg.norm(places[-1, :2] - places[0, :2]) < MIN_DRIVE_M:
            return None
    else:
        return None
    if scene.ground_m is not None:
        places = np.column_stack([places[:, :2], np.full(len(places), scene.ground_m)])
    return places


def _stations(course: Float64[np.ndarray, "n 3"]) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, " m"]]:
    """Places below lanterns at the right of a course, and the turn of each (deg): x along the course."""
    steps = np.linalg.norm(np.diff(course[:, :2], axis=0), axis=1)
    course = course[np.concatenate([[True], steps > 1e-3])]
    before, beyond = course[0] - course[1], course[-1] - course[-2]
    ends = (
        course[0] + _BEFORE_M * before / np.linalg.norm(before[:2]),
        course[-1] + _BEYOND_M * beyond / np.linalg.norm(beyond[:2]),
    )
    line = np.concatenate([ends[:1], course, ends[1:]])
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1))])
    first = (_BEFORE_M + _FIRST_M) % SPACING_M
    where = np.arange(first, at[-1], SPACING_M)
    places = np.stack([np.interp(where, at, line[:, k]) for k in range(3)], axis=1)
    ahead, behind = (np.stack([np.interp(where + s, at, line[:, k]) for k in range(2)], axis=1) for s in (2.0, -2.0))
    along = (ahead - behind) / np.linalg.norm(ahead - behind, axis=1, keepdims=True)
    places[:, :2] += RIGHT_M * np.stack([along[:, 1], -along[:, 0]], axis=1)
    return places, np.degrees(np.arctan2(along[:, 1], along[:, 0]))


def _lamps_of_object(scene: Scene, core: SceneCore) -> tuple[Lamp, ...]:
    ahead, to_scene = ahead_of(scene), np.linalg.inv(scene.scene_to_world)
    left, distance = np.array([-ahead[1], ahead[0], 0.0]), max(_RADII * core.radius_m, _NEAREST_M)
    found: list[Lamp] = []
    for name, *angles in _OBJECT_LAMPS:
        aside, above = np.radians(angles)
        level = np.cos(above) * (np.sin(aside) * left - np.cos(aside) * ahead)
        place = core.middle + distance * (level + [0, 0, np.sin(above)])
        x, y, z = (to_scene[:3, :3] @ place + to_scene[:3, 3]).tolist()
        found.append(
            Lamp(
                name=name, position=(x, y, z), direction=_down(scene), color=_LAMP_COLOR,
                intensity_m2=OBJECT_IRRADIANCE * distance**2,
            )
        )  # fmt: skip
    return tuple(found)


def _down(scene: Scene) -> tuple[float, float, float]:
    x, y, z = scene.up
    return -x + 0.0, -y + 0.0, -z + 0.0


# What is seen of lamps

_BULB_M = 0.035  # standard deviation
_BULB_LIGHT = 5.0  # linear, relative to white, of the brightest channel


def bulbs(scene: Scene, lamps: Sequence[Lamp]) -> Layer | None:
    """Layer with a small bright Gaussian for each lamp that is mounted on the scene; None without any."""
    fixed = [lamp for lamp in lamps if lamp.mount == "scene" and lamp.intensity_m2 > 0 and max(lamp.color) > 0]
    if not fixed:
        return None
    lit = lit_lamps([(lamp, scene.scene_to_world) for lamp in fixed])
    n = len(fixed)
    colors = NIGHT.display(_BULB_LIGHT * lit.intensities / lit.intensities.max(axis=1, keepdims=True))
    gaussians = Gaussians(
        lit.positions_m.astype(np.float32), np.full((n, 3), _BULB_M, np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)), np.full(n, 0.98, np.float32),
        sh_from_color(colors.astype(np.float32)),
    )  # fmt: skip
    return Layer("lamps", gaussians, to_scene=np.linalg.inv(scene.scene_to_world))
