"""Edits of a scene's lamps: add, change, remove; lamps of moved and renamed members."""

from dataclasses import replace
from typing import TypedDict, Unpack

import numpy as np
from jaxtyping import Float64
from msgspec import structs, to_builtins

from ...safe_io.errors import convert_checked
from ...scene.lamps import Lamp, Vector
from ...scene.scene import Scene


class LampFields(TypedDict, total=False):
    """Fields of a `Lamp`."""

    name: str
    position: Vector
    direction: Vector
    color: Vector
    intensity_m2: float
    inner_deg: float
    outer_deg: float
    mount: str


def add_lamp(scene: Scene, lamp: Lamp) -> Scene:
    """Add a lamp after the others."""
    return replace(scene, lamps=(*scene.lamps, lamp))


def change_lamp(scene: Scene, number: int, **fields: Unpack[LampFields]) -> Scene:
    """Change fields of a lamp, which counts from 0; the cone stays in order."""
    lamp = _lamp(scene, number)
    if "inner_deg" in fields and "outer_deg" not in fields:
        fields["outer_deg"] = max(fields["inner_deg"], lamp.outer_deg)
    if "outer_deg" in fields and "inner_deg" not in fields:
        fields["inner_deg"] = min(fields["outer_deg"], lamp.inner_deg)
    changed: Lamp = convert_checked(to_builtins(lamp) | dict(fields), Lamp)
    return with_lamp(scene, number, changed)


def remove_lamp(scene: Scene, number: int) -> Scene:
    """Remove a lamp, which counts from 0."""
    _lamp(scene, number)
    return replace(scene, lamps=scene.lamps[:number] + scene.lamps[number + 1 :])


def with_lamp(scene: Scene, number: int, lamp: Lamp) -> Scene:
    """Replace a lamp."""
    return replace(scene, lamps=(*scene.lamps[:number], lamp, *scene.lamps[number + 1 :]))


def _lamp(scene: Scene, number: int) -> Lamp:
    if not 0 <= number < len(scene.lamps):
        raise ValueError(f"There is no lamp {number}; the scene has {len(scene.lamps)}, which count from 0.")
    return scene.lamps[number]


def lamp_at(scene: Scene, point_m: Float64[np.ndarray, "3"], name: str = "lamp") -> Lamp:
    """Lamp without a cone at a point of the world (m), mounted on the scene."""
    to_scene = np.linalg.inv(scene.scene_to_world)
    x, y, z = (to_scene[:3, :3] @ point_m + to_scene[:3, 3]).tolist()
    return Lamp(name=name, position=(x, y, z), direction=down(scene), intensity_m2=NEW_INTENSITY_M2)


NEW_INTENSITY_M2 = 50.0  # 500 cd if 31 lx on a white wall are display white: a lantern


def down(scene: Scene) -> Vector:
    """Downward direction in the axes of a scene."""
    x, y, z = scene.up
    return -x + 0.0, -y + 0.0, -z + 0.0


def moved_lamps(lamps: tuple[Lamp, ...], similarity: Float64[np.ndarray, "4 4"]) -> tuple[Lamp, ...]:
    """Transform the lamps that are mounted on a scene by a similarity of it; those of vehicles move with these."""

    def moved(lamp: Lamp) -> Lamp:
        if lamp.mount != "scene":
            return lamp
        x, y, z = (similarity[:3, :3] @ lamp.position + similarity[:3, 3]).tolist()
        turned = similarity[:3, :3] @ lamp.direction
        a, b, c = (turned / np.cbrt(np.linalg.det(similarity[:3, :3]))).tolist()
        return structs.replace(lamp, position=(x, y, z), direction=(a, b, c))

    return tuple(moved(lamp) for lamp in lamps)


def remounted(lamps: tuple[Lamp, ...], mount: str, other: str, scale: float = 1.0) -> tuple[Lamp, ...]:
    """Mount the lamps of an actor on another one, which is `scale` times as large."""

    def mounted(lamp: Lamp) -> Lamp:
        x, y, z = lamp.position
        return structs.replace(lamp, mount=other, position=(scale * x, scale * y, scale * z))

    return tuple(mounted(lamp) if lamp.mount == mount else lamp for lamp in lamps)
