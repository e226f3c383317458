"""What a data set's own words say of the weather and the light in a picture."""

from collections.abc import Mapping
from typing import Literal

from gsrain_engine.datasets.rainsense.reader import RAIN

Weather = Literal["clear", "rainy", "other"]

_WEATHERS: Mapping[str, Weather] = {
    "clear": "clear", "partly cloudy": "clear", "overcast": "clear", "rainy": "rainy",
    "snowy": "other", "foggy": "other",
}  # fmt: skip
"""Words of BDD-100K; beside them it has "undefined"."""

_DARK = ("night", "dawn/dusk")


def weather_of(attributes: Mapping[str, str]) -> Weather | None:
    """Weather by RainSense's intensity or the labels of BDD-100K; None where nothing is said."""
    if RAIN in attributes:
        return "rainy" if float(attributes[RAIN]) > 0 else "clear"
    return _WEATHERS.get(attributes.get("weather", ""))


def is_daylight(attributes: Mapping[str, str]) -> bool:
    """Whether nothing says that it was dark."""
    return attributes.get("timeofday") not in _DARK
