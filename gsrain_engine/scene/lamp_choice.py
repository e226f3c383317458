"""Lamps that a picture has: the scene's own, those of a file, found ones, headlights and tail lights, or none."""

from dataclasses import dataclass
from pathlib import Path

from ..choices import FOUND_LAMPS, HEADLIGHTS, LAMP_WORDS, NO_LAMPS
from ..safe_io.errors import convert_checked
from ..safe_io.text_files import read_whole, yaml_values
from .find_lamps import find_lamps
from .lamps import Lamp
from .scene import Scene
from .vehicle_lamps import VehicleLamps

MAX_LISTED = 10_000  # lamps of a file; those that light a picture are far fewer


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
    """`none`, `auto`, `headlights`, or a file; None for the scene's own."""
    listed: tuple[Lamp | VehicleLamps, ...] = ()
    """Contents of the file."""

    def of(self, scene: Scene) -> tuple[Lamp, ...]:
        """Lamps of a scene."""
        if self.name is None:
            return scene.lamps
        if self.name == NO_LAMPS:
            return ()
        if self.name == FOUND_LAMPS:
            return find_lamps(scene)
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
