"""Lamps that a picture has: the scene's own, those of a file, headlights and tail lights of vehicles, or none."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from ..safe_io.errors import convert_checked
from ..safe_io.text_files import read_whole, yaml_values
from .lamps import Lamp
from .objects import is_vehicle
from .scene import Scene

NO_LAMPS, HEADLIGHTS = "none", "headlights"
LAMP_WORDS = (NO_LAMPS, HEADLIGHTS)
"""Choices that are no files."""

MAX_LISTED = 10_000  # lamps of a file; those that light a picture are far fewer


class VehicleLamps(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Headlights and tail lights of the ego vehicle and of all actors that are motor vehicles.

    The defaults are a low beam of 4000 cd within a few degrees and a tail light of 10 cd (UNECE R 48, R 7), in pictures
    exposed so that 10 cd are 1 m2: 31 lx on a white wall are display white.
    """

    mount: Literal["vehicles"]
    headlight_m2: Annotated[float, Meta(ge=0, le=1e9)] = 400.0
    """Intensity of each headlight, as `Lamp.intensity_m2`."""
    tail_light_m2: Annotated[float, Meta(ge=0, le=1e9)] = 1.0
    """Intensity of each tail light."""

    def of(self, scene: Scene) -> list[Lamp]:
        """Lamps of the vehicles of a scene, each mounted on its own."""
        lamps: list[Lamp] = []
        if scene.ego is not None:
            lamps += self._pair("ego", EGO_SIZE_LWH_M, (_EGO_MIDDLE_M, 0.0, -_rig_height_m(scene)), 1.0)
        for actor in scene.actors:
            if is_vehicle(actor.class_name):
                lamps += self._pair(actor.id, actor.size_lwh, (0.0, 0.0, 0.0), 1 / scene.metres_per_unit)
        return lamps

    def _pair(
        self, mount: str, size_lwh: tuple[float, float, float], foot: tuple[float, float, float], unit: float
    ) -> list[Lamp]:
        """Lamps at the ends of a box whose bottom center is `foot`; `unit` is a meter in the units of both."""
        length, width, height = size_lwh
        x, y, z = foot
        front, back = min(0.45 * height, 0.75 * unit), min(0.6 * height, 0.95 * unit)
        sides = (("left", 0.38 * width), ("right", -0.38 * width)) if width > _NARROW_M * unit else (("", 0.0),)
        found: list[Lamp] = []
        for side, across in sides:
            found += [
                Lamp(
                    name=" ".join(filter(None, (mount, side, "headlight"))), mount=mount,
                    position=(x + length / 2, y + across, z + front), direction=(1.0, 0.0, -0.03),
                    color=_HEADLIGHT_COLOR, intensity_m2=self.headlight_m2, inner_deg=4.0, outer_deg=28.0,
                ),
                Lamp(
                    name=" ".join(filter(None, (mount, side, "tail light"))), mount=mount,
                    position=(x - length / 2, y + across, z + back), direction=(-1.0, 0.0, 0.0),
                    color=_TAIL_LIGHT_COLOR, intensity_m2=self.tail_light_m2, inner_deg=45.0, outer_deg=90.0,
                ),
            ]  # fmt: skip
        return found


EGO_SIZE_LWH_M = (4.6, 1.85, 1.5)
"""Size of an ego vehicle; scenes don't have one. The origin of its rig is above the rear axle."""

_EGO_MIDDLE_M = EGO_SIZE_LWH_M[0] / 2 - 1.0  # from the rear axle forward to the center of the body
_RIG_HEIGHT_M = 1.5
_NARROW_M = 1.2  # narrower vehicles have one lamp at each end
_HEADLIGHT_COLOR = (1.0, 0.93, 0.82)
_TAIL_LIGHT_COLOR = (1.0, 0.03, 0.02)


def _rig_height_m(scene: Scene) -> float:
    """Height of the ego's frame above the ground; 1.5 m if the scene does not tell it."""
    if scene.ego is None or scene.ground_m is None or not len(scene.ego.times):
        return _RIG_HEIGHT_M
    ego = scene.ego_to_world(float(scene.ego.times[0]))
    height_m = _RIG_HEIGHT_M if ego is None else float(ego[2, 3]) - scene.ground_m
    return height_m if 0.3 <= height_m <= 4 else _RIG_HEIGHT_M


# Files


def load_lamps(path: str | Path) -> tuple[Lamp | VehicleLamps, ...]:
    """Read a list of lamps (JSON or YAML).

    Raises ValueError with the file, the lamp, counted from 1, and its field; OSError if it can't be read.
    """
    try:
        values = yaml_values(read_whole(Path(path)))
        if not isinstance(values, list):
            raise ValueError("expected a list of lamps, such as `- position: [0, 0, 6]`")
        if len(values) > MAX_LISTED:
            raise ValueError(f"{len(values):,} lamps; at most {MAX_LISTED:,} are read")
        return tuple(_lamp(number, each) for number, each in enumerate(values, 1))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _lamp(number: int, values: object) -> Lamp | VehicleLamps:
    is_all = isinstance(values, dict) and values.get("mount") == "vehicles"
    try:
        return convert_checked(values, VehicleLamps if is_all else Lamp)
    except ValueError as error:
        raise ValueError(f"lamp {number}: {error}") from None


# Choices


@dataclass(frozen=True, slots=True)
class LampChoice:
    """Lamps in place of a scene's own."""

    name: str | None = None
    """`none`, `headlights`, or a file; None for the scene's own."""
    listed: tuple[Lamp | VehicleLamps, ...] = ()
    """Contents of the file."""

    def of(self, scene: Scene) -> tuple[Lamp, ...]:
        """Lamps of a scene."""
        if self.name is None:
            return scene.lamps
        if self.name == NO_LAMPS:
            return ()
        if self.name == HEADLIGHTS:
            fixed = [lamp for lamp in scene.lamps if lamp.mount == "scene"]
            return (*fixed, *VehicleLamps(mount="vehicles").of(scene))
        return tuple(lamp for each in self.listed for lamp in ([each] if isinstance(each, Lamp) else each.of(scene)))


OWN_LAMPS = LampChoice()


def lamp_choice(name: str | None) -> LampChoice:
    """Choice of a name; reads its file. Raises ValueError and OSError as `load_lamps` does."""
    if name is None:
        return OWN_LAMPS
    if name in LAMP_WORDS:
        return LampChoice(name)
    if not Path(name).exists():
        raise ValueError(f"lamps {name}: no such file, and none of {', '.join(LAMP_WORDS)}")
    return LampChoice(name, load_lamps(name))
