"""Choice of the rainy light: whether a scene shows its wet colors, for all commands and the window."""

import msgspec

from ..scene.scene import Scene
from .settings import RainSettings
from .wetness import OVERCAST_FROM_MM_H


def with_wet_choice(rain: RainSettings, wet: bool | None) -> RainSettings:
    """Return the rain with a choice of `--wet/--no-wet`.

    None follows the rain, where a scene has wet colors: overcast above 0.3 mm/h. False is as lit at any intensity. True
    follows the rain even if its preset is as lit.
    """
    if wet is False:
        return msgspec.structs.replace(rain, wetness=0.0)
    return msgspec.structs.replace(rain, wetness=None) if wet and rain.wetness == 0 else rain


def missing_wet_colors(scene: Scene, rain: RainSettings, heaviest_mm_h: float) -> str | None:
    """Return a line on how to get wet colors, if it rains on a scene that has none and is not to stay as lit."""
    if rain.wetness is not None or heaviest_mm_h <= OVERCAST_FROM_MM_H or scene.has_rainy_light:
        return None
    return f"{scene.name} has no wet colors and stays as it is lit; --wet makes them first, --no-wet hides this line"
