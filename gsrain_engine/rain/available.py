"""Settings of the rain that a kind of source can't draw, or that do nothing without another: refused by name."""

from collections.abc import Mapping
from typing import Any, Literal

from ..fields import option_names
from .settings import RainSettings

Source = Literal["scene", "plan", "photographs", "Gaussians", "Gaussians with scene", "page", "lidar", "disdrometer"]
"""Sources of pictures: a scene; one by an orthographic camera; photographs; files of its Gaussians, which are no
pictures; a web page; a lidar; a virtual disdrometer."""

_SURFACES = "photographs have no surfaces for it; gsrain reconstruct makes a scene of them, for --scene"
_PHOTOGRAPHS = "only photographs have a light of their own to keep; --wetness sets that of a scene"
_FILE = "a file of Gaussians holds streaks and haze only; gsrain render draws it"
_PAGE = "a page has none; gsrain render draws it"
PLAN_SHOWS = "an orthographic picture has the light and the wet ground of rain, without drops, haze, glass and sensor"
_LIDAR = "a lidar has none of it: drops return echoes, and their air takes light away"
_COUNTED = "a disdrometer counts drops, and draws nothing; gsrain render does"
_GLASS_DETAILS = "wiper", "glass_wet_s", "glass_dirt", "contact_angle_deg", "glass_distance_m"

_PICTURES = "lamps", "lamp_gain", "mirror", "splashes", "spray", "glass", "sensor", "visibility_m", *_GLASS_DETAILS

UNAVAILABLE: dict[Source, dict[str, str]] = {
    "scene": {"keep_light": _PHOTOGRAPHS},
    "plan": dict.fromkeys(
        ("exposure_s", "seed", "streaks", "haze", "visibility_m", "roofs", "wind_speed_m_s", "wind_from_deg",
         "gust_m_s", "turbulence_m_s", "calibration", "closure", "diameter_scale", "haze_gain", "streak_gain",
         "splashes", "spray", "glass", "sensor", *_GLASS_DETAILS), PLAN_SHOWS
    ) | {"keep_light": _PHOTOGRAPHS},
    "photographs": dict.fromkeys(
        ("roofs", "lamps", "lamp_gain", "wetness", "mirror", "splashes", "spray"), _SURFACES
    ) | {"sensor": "a photograph has been through its camera's sensor; --exposure sets the shutter of the drops"},
    "Gaussians": dict.fromkeys((*_PICTURES, "wetness", "keep_light"), _FILE),
    "Gaussians with scene": dict.fromkeys(_PICTURES, _FILE) | {"keep_light": _PHOTOGRAPHS},
    "page": dict.fromkeys(("lamps", "lamp_gain", "spray", "glass", "sensor", *_GLASS_DETAILS), _PAGE)
    | {"keep_light": _PHOTOGRAPHS},
    "lidar": dict.fromkeys(
        ("exposure_s", "streaks", "haze", "roofs", "streak_gain", "sensor", "glass", "lamps", "lamp_gain", "mirror",
         "splashes", *_GLASS_DETAILS), _LIDAR
    ) | {"keep_light": _PHOTOGRAPHS},
    "disdrometer": dict.fromkeys(
        ("exposure_s", "streaks", "haze", "haze_gain", "streak_gain", "wetness", "keep_light", *_PICTURES), _COUNTED
    ),
}  # fmt: skip
"""Reasons by field of the rain."""

_OFF: dict[str, Any] = {
    "roofs": False, "lamps": "none", "wetness": 0.0, "mirror": False, "splashes": False, "spray": False,
    "glass": "none", "keep_light": False,
}  # fmt: skip
"""Values with which a setting asks for nothing."""

_NEEDS: dict[str, tuple[str, tuple[Any, ...], str]] = {
    **dict.fromkeys(_GLASS_DETAILS, ("glass", ("windshield", "lens"), "there is no glass; --glass sets one")),
    "wiper": ("glass", ("windshield",), "only a windshield has one (--glass windshield)"),
    "streak_gain": ("streaks", (True,), "no streaks are drawn"),
}
"""Setting, another one and its values with which it does something, and the reason."""


def check_available(
    changes: Mapping[str, Any], rain: RainSettings, source: Source = "scene", names: Mapping[str, str] | None = None
) -> None:
    """Raise `ValueError` for a changed setting that has no effect; it names the setting, the reason and what to do.

    `changes` are the settings that somebody chose by name, those of a preset aside; `rain` is the whole.
    `names` are those of the settings for their reader, by default the options of the command line.
    """
    names = option_names(RainSettings) if names is None else names
    for field, value in changes.items():
        reason = UNAVAILABLE[source].get(field)
        if reason is not None and value != _OFF.get(field, RainSettings):
            raise ValueError(f"{names[field]}: {reason}")
        if field in _NEEDS:
            other, values, why = _NEEDS[field]
            if getattr(rain, other) not in values:
                raise ValueError(f"{names[field]}: {why}")
