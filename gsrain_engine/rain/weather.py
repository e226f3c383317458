"""How the rain changes over time: keys on a timeline and what stands between them, saved with a scene."""

import math
from bisect import bisect_left
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float64
from msgspec import Meta

from .rain import Rain
from .weather_curve import WeatherCurve

Keyed = Literal["intensity_mm_h", "wind_m_s", "exposure_s"]

KEYED: tuple[Keyed, ...] = ("intensity_mm_h", "wind_m_s", "exposure_s")
"""Fields of the rain that can have keys."""

HEAVIEST_MM_H = 100.0
"""Nothing rains harder here: measured series are cut off there."""

LONGEST_S = 1e7
"""The last time that a key can have; the first is as long before 0."""


class WeatherKey(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """What is set at one time. None is not set there: that field goes on from its own keys."""

    time_s: Annotated[float, Meta(title="Time", description="In the scene's time.", extra={"unit": "s"})]
    intensity_mm_h: float | None = None
    wind_m_s: tuple[float, float] | None = None
    exposure_s: float | None = None

    def __post_init__(self) -> None:
        intensity, wind, exposure = self.intensity_mm_h, self.wind_m_s, self.exposure_s
        if not -LONGEST_S <= self.time_s <= LONGEST_S:
            raise ValueError(f"time_s must be within -1e7..1e7 s, got {self.time_s}")
        if intensity is not None and not 0 <= intensity <= HEAVIEST_MM_H:
            raise ValueError(f"intensity_mm_h must be within 0..100 mm/h, got {intensity}")
        if wind is not None and not (-40 <= wind[0] <= 40 and -40 <= wind[1] <= 40):
            raise ValueError(f"wind_m_s must be within -40..40 m/s on each axis, got {wind}")
        if exposure is not None and not 1e-5 <= exposure <= 1:
            raise ValueError(f"exposure_s must be within 0.00001..1 s, got {exposure}")

    @property
    def is_empty(self) -> bool:
        return self.intensity_mm_h is None and self.wind_m_s is None and self.exposure_s is None


class Weather(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True, dict=True):
    """Keys of the rain in order of time, each time once. Before a field's first key and after its last its value stays.

    Raises `ValueError` for keys that are out of order.
    """

    keys: tuple[WeatherKey, ...] = ()
    between: Annotated[
        Literal["linear", "smooth"],
        Meta(
            title="Between keys", description="linear: straight. smooth: rounded, never beyond the keys on either side."
        ),
    ] = "linear"

    def __post_init__(self) -> None:
        for before, after in pairwise(self.keys):
            if before.time_s >= after.time_s:
                raise ValueError(f"keys must rise in time, got {before.time_s} s before {after.time_s} s")

    @cached_property
    def curves(self) -> dict[Keyed, WeatherCurve]:
        found: dict[Keyed, WeatherCurve] = {}
        for name in KEYED:
            set_there = [key for key in self.keys if getattr(key, name) is not None]
            if set_there:
                times = self.key_times[name]
                values = np.array([getattr(key, name) for key in set_there], np.float64).reshape(len(times), -1)
                found[name] = WeatherCurve.through(times, values, smooth=self.between == "smooth")
        return found

    @cached_property
    def times_s(self) -> Float64[np.ndarray, " n"]:
        return np.array([key.time_s for key in self.keys], np.float64)

    def is_keyed(self, name: str) -> bool:
        """Whether a field of the rain has a key at any time."""
        return name in self.curves

    def key_at(self, time_s: float) -> WeatherKey | None:
        """Return the key of a time; None where there is none."""
        at = bisect_left(self.keys, time_s, key=_time)
        return self.keys[at] if at < len(self.keys) and self.keys[at].time_s == time_s else None

    def rain_at(self, rain: Rain, time_s: float) -> Rain:
        """Return the rain of a time: what is keyed from the curves, the rest as it is."""
        if not self.keys:
            return rain
        changes = {name: _plain(curve.at(time_s)) for name, curve in self.curves.items()}
        return msgspec.structs.replace(rain, **changes)

    def heaviest_mm_h(self, rain: Rain) -> float:
        """Highest intensity that is reached at any time."""
        curve = self.curves.get("intensity_mm_h")
        return rain.intensity_mm_h if curve is None else float(curve.values.max())

    def with_key(self, time_s: float, **fields: Any) -> "Weather":
        """Return the weather with fields set at a time, beside what is set there already."""
        present = self.key_at(time_s)
        key = WeatherKey(time_s=time_s, **fields) if present is None else msgspec.structs.replace(present, **fields)
        return self._with(*(each for each in self.keys if each is not present), key)

    def without_key(self, time_s: float, name: Keyed | None = None) -> "Weather":
        """Return the weather without the key of a time, or without one field of it."""
        present = self.key_at(time_s)
        if present is None:
            return self
        kept = [each for each in self.keys if each is not present]
        if name is not None:
            kept.append(msgspec.structs.replace(present, **{name: None}))
        return self._with(*(each for each in kept if not each.is_empty))

    def without(self, name: Keyed) -> "Weather":
        """Return the weather without any key of a field."""
        bare = (msgspec.structs.replace(key, **{name: None}) for key in self.keys)
        return self._with(*(key for key in bare if not key.is_empty))

    def moved_key(self, time_s: float, to_s: float, name: Keyed, **fields: Any) -> "Weather":
        """Return the weather with one field's key at another time, and changed; a key it meets there gives way."""
        key = self.key_at(time_s)
        if key is None or getattr(key, name) is None:
            return self
        value = fields.get(name, getattr(key, name))
        return self.without_key(time_s, name).with_key(to_s, **{name: value})

    @cached_property
    def key_times(self) -> dict[Keyed, Float64[np.ndarray, " n"]]:
        """Times of each field's keys, rising; empty where it has none."""
        return {
            name: np.array([key.time_s for key in self.keys if getattr(key, name) is not None], np.float64)
            for name in KEYED
        }

    def _with(self, *keys: WeatherKey) -> "Weather":
        return Weather(keys=tuple(sorted(keys, key=_time)), between=self.between)


WITHOUT_CHANGE = Weather()
"""Without keys: the rain stays as it is set."""


def from_series(times_s: Float64[np.ndarray, " n"], rates_mm_h: Float64[np.ndarray, " n"]) -> Weather:
    """Return the weather of a series of rates; what is above 100 mm/h is cut off there.

    Raises `ValueError` for times that don't rise, or numbers that are no rain rates.
    """
    if not np.all(np.isfinite(rates_mm_h)) or np.any(rates_mm_h < 0):
        raise ValueError("rain rates must be 0 mm/h or more")
    pairs = zip(times_s.tolist(), np.minimum(rates_mm_h, HEAVIEST_MM_H).tolist(), strict=True)
    return Weather(keys=tuple(WeatherKey(time_s=time, intensity_mm_h=rate) for time, rate in pairs))


def passing_shower(
    start_s: float = 0.0, *, duration_s: float = 60.0, peak_mm_h: float = 12.0, steps: int = 6
) -> Weather:
    """Return a shower that comes, is heaviest in the middle and goes: R = R_max sin^2(pi t / T)."""
    keys = (
        WeatherKey(
            time_s=start_s + duration_s * k / steps,
            intensity_mm_h=round(peak_mm_h * math.sin(math.pi * k / steps) ** 2, 6),
        )
        for k in range(steps + 1)
    )
    return Weather(keys=tuple(keys), between="smooth")


def _time(key: WeatherKey) -> float:
    return key.time_s


def _plain(value: Float64[np.ndarray, " k"]) -> float | tuple[float, ...]:
    numbers = [float(each) for each in value]
    return numbers[0] if len(numbers) == 1 else tuple(numbers)
