"""Rain keyframes: intensity, wind and exposure over time, saved with a scene."""

import logging
import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import msgspec
import numpy as np
import scipy
from jaxtyping import Float64
from msgspec import Meta

from ..safe_io.errors import convert_checked
from ..safe_io.files import whole_file
from ..safe_io.text_files import read_whole, yaml_values
from ..scene.easing import KeyEasing, eased_share
from ..scene.scene import Scene
from ..settings import Settings
from .settings import HEAVIEST_MM_H, MAX_LAMP_GAIN, ExposureSeconds, RainSettings, Share, WindComponent

Keyed = Literal["intensity_mm_h", "wind_m_s", "exposure_s", "wetness", "lamp_gain"]
KEYED: tuple[Keyed, ...] = get_args(Keyed)  # fields of the rain that can have keyframes
LONGEST_S = 1e7  # maximum absolute time of a keyframe
_PIECES = 16  # number of straight pieces per smooth stretch between two keyframes: off by at most 1/300 of its height
_MAX_KNOTS = 200_000
_HOLD_STEP_S = 1e-6  # duration of the step at the end of a held value
_TIME = attrgetter("time_s")


class RainKeyframe(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Values at one time. None leaves a field to its other keyframes."""

    # fmt: off
    time_s: Annotated[float, Meta(
        ge=-LONGEST_S, le=LONGEST_S, title="Time", extra={"unit": "s"}, description="In the scene's time.")]
    intensity_mm_h: Annotated[
        Annotated[float, Meta(ge=0, le=HEAVIEST_MM_H)] | None, Meta(extra={"unit": "mm/h"})] = None
    wind_m_s: Annotated[tuple[WindComponent, WindComponent] | None, Meta(extra={"unit": "m/s"})] = None
    exposure_s: Annotated[ExposureSeconds | None, Meta(extra={"unit": "s"})] = None
    wetness: Share | None = None
    lamp_gain: Annotated[float, Meta(ge=0, le=MAX_LAMP_GAIN)] | None = None
    # fmt: on
    easing: dict[Keyed, KeyEasing] = msgspec.field(default_factory=dict)
    """Easing of a field from here to its next keyframe; others follow `RainKeyframes.between`."""

    def without(self, name: Keyed) -> "RainKeyframe":
        """Return a copy without a field and its easing."""
        easing = {each: value for each, value in self.easing.items() if each != name}
        return msgspec.structs.replace(self, **{name: None}, easing=easing)

    def easing_of(self, name: Keyed) -> dict[Keyed, KeyEasing]:
        """Return the easing of a field alone."""
        return {name: self.easing[name]} if name in self.easing else {}

    @property
    def is_empty(self) -> bool:
        return all(getattr(self, name) is None for name in KEYED)


@dataclass(frozen=True, eq=False)
class KeyframeCurve:
    """Piecewise linear function of time with k components and exact integrals; constant beyond its end knots."""

    times_s: Float64[np.ndarray, " n"]
    """Rising."""
    values: Float64[np.ndarray, "n k"]

    @classmethod
    def through(
        cls,
        times_s: Float64[np.ndarray, " n"],
        values: Float64[np.ndarray, "n k"],
        *,
        smooth: bool = False,
        easings: Sequence[KeyEasing | None] = (),
    ) -> "KeyframeCurve":
        """Join keyframes; `smooth` rounds corners with a cubic without overshoot (Fritsch and Carlson, 1980).

        `easings` replaces the course from a keyframe to the next one, where it is not None.
        """
        if any(easings[:-1]):
            return cls.through(times_s, values, smooth=smooth)._with_easings(times_s, values, easings)
        pieces = min(_PIECES, _MAX_KNOTS // len(times_s))
        if not smooth or len(times_s) < 2 or pieces < 2:
            return cls(times_s, values)
        # One more keyframe at each end with the end's value gives the curve a slope of 0 there.
        reach = times_s[-1] - times_s[0]
        along = np.concatenate([[times_s[0] - reach], times_s, [times_s[-1] + reach]])
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # slopes between keyframes 1e-200 s apart
            rounded = scipy.interpolate.PchipInterpolator(along, np.concatenate([values[:1], values, values[-1:]]))
        shares = np.arange(pieces) / pieces
        inner = (times_s[:-1, None] + shares * np.diff(times_s)[:, None]).ravel()
        knots = np.append(inner, times_s[-1])
        drawn = rounded(knots)
        straight = (values[:-1, None] + shares[:, None] * np.diff(values, axis=0)[:, None]).reshape(-1, values.shape[1])
        drawn = np.where(np.isfinite(drawn), drawn, np.concatenate([straight, values[-1:]]))
        drawn[::pieces] = values  # bit-exact
        return cls(knots, np.clip(drawn, values.min(axis=0), values.max(axis=0)))

    def _with_easings(
        self,
        keys_s: Float64[np.ndarray, " m"],
        values: Float64[np.ndarray, "m k"],
        easings: Sequence[KeyEasing | None],
    ) -> "KeyframeCurve":
        """Replace the stretches after keyframes with an easing by pieces of their own."""
        pieces = min(_PIECES, max(2, _MAX_KNOTS // len(keys_s)))
        times, drawn = list[Float64[np.ndarray, " n"]](), list[Float64[np.ndarray, "n k"]]()
        for key, easing in enumerate(easings[: len(keys_s) - 1]):
            start, end = keys_s[key], keys_s[key + 1]
            if easing is None:
                inside = (self.times_s >= start) & (self.times_s < end)
                times.append(self.times_s[inside])
                drawn.append(self.values[inside])
                continue
            step_s = min(_HOLD_STEP_S, 0.5 * (end - start))
            shares = {"hold": np.array([0.0, 1 - step_s / (end - start)]), "linear": np.zeros(1)}.get(
                easing, np.arange(pieces) / pieces
            )
            times.append(start + shares * (end - start))
            drawn.append(values[key] + eased_share(easing, shares).shares[:, None] * (values[key + 1] - values[key]))
        return KeyframeCurve(np.append(np.concatenate(times), keys_s[-1]), np.concatenate([*drawn, values[-1:]]))

    def at(self, time_s: float) -> Float64[np.ndarray, " k"]:
        before = self.before(time_s)
        if before < 0:
            return self.values[0]
        if before == len(self.times_s) - 1:
            return self.values[-1]
        share = (time_s - self.times_s[before]) / (self.times_s[before + 1] - self.times_s[before])
        return self.values[before] + share * (self.values[before + 1] - self.values[before])

    def integral(self, time_s: float) -> Float64[np.ndarray, " k"]:
        """Integral from 0 to a time."""
        return self._from_first(time_s) - self._from_first(0.0)

    def before(self, time_s: float) -> int:
        """Index of the last knot that is not later than a time; -1 before the first."""
        return int(np.searchsorted(self.times_s, time_s, side="right")) - 1

    @cached_property
    def _sums(self) -> Float64[np.ndarray, "n k"]:
        steps = 0.5 * (self.values[1:] + self.values[:-1]) * np.diff(self.times_s)[:, None]
        return np.concatenate([np.zeros((1, self.values.shape[1])), np.cumsum(steps, axis=0)])

    def _from_first(self, time_s: float) -> Float64[np.ndarray, " k"]:
        knot = max(self.before(time_s), 0)
        mean = 0.5 * (self.values[knot] + self.at(time_s))
        return self._sums[knot] + mean * (time_s - self.times_s[knot])


class RainKeyframes(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True, dict=True
):
    """Keyframes of the rain in order of time, with unique times.

    A field is constant before its first and after its last keyframe. Raises `ValueError` for keyframes out of order.
    """

    keys: tuple[RainKeyframe, ...] = ()
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
    def curves(self) -> dict[Keyed, KeyframeCurve]:
        found: dict[Keyed, KeyframeCurve] = {}
        for name, times in self.key_times.items():
            if len(times):
                keys = [key for key in self.keys if getattr(key, name) is not None]
                rows = np.array([getattr(key, name) for key in keys], np.float64).reshape(len(times), -1)
                easings: list[KeyEasing | None] = [key.easing.get(name) for key in keys]
                found[name] = KeyframeCurve.through(times, rows, smooth=self.between == "smooth", easings=easings)
        return found

    @cached_property
    def times_s(self) -> Float64[np.ndarray, " n"]:
        return np.array([key.time_s for key in self.keys], np.float64)

    def is_keyed(self, name: str) -> bool:
        return name in self.curves

    def key_at(self, time_s: float) -> RainKeyframe | None:
        """Return the keyframe at a time; None without one."""
        at = bisect_left(self.keys, time_s, key=_TIME)
        return self.keys[at] if at < len(self.keys) and self.keys[at].time_s == time_s else None

    def rain_at(self, rain: RainSettings, time_s: float) -> RainSettings:
        """Return the rain at a time: fields with keyframes from the curves, the others unchanged."""
        if not self.keys:
            return rain
        values = {name: curve.at(time_s).tolist() for name, curve in self.curves.items()}
        changes = {name: each[0] if len(each) == 1 else tuple(each) for name, each in values.items()}
        return msgspec.structs.replace(rain, **changes)

    def heaviest_mm_h(self, rain: RainSettings) -> float:
        curve = self.curves.get("intensity_mm_h")
        return rain.intensity_mm_h if curve is None else float(curve.values.max())

    def with_key(self, time_s: float, **fields: Any) -> "RainKeyframes":
        """Return a copy with fields set at a time, in addition to those already set there."""
        present = self.key_at(time_s)
        if present is not None and "easing" in fields:
            fields["easing"] = present.easing | fields["easing"]
        key = RainKeyframe(time_s=time_s, **fields) if present is None else msgspec.structs.replace(present, **fields)
        return self._with(*(each for each in self.keys if each is not present), key)

    def without_key(self, time_s: float, name: Keyed | None = None) -> "RainKeyframes":
        """Return a copy without the keyframe at a time, or without one field of it."""
        present = self.key_at(time_s)
        if present is None:
            return self
        keys = [each for each in self.keys if each is not present]
        if name is not None:
            keys.append(present.without(name))
        return self._with(*(key for key in keys if not key.is_empty))

    def without(self, name: Keyed) -> "RainKeyframes":
        """Return a copy without any keyframe of a field."""
        bare = (key.without(name) for key in self.keys)
        return self._with(*(key for key in bare if not key.is_empty))

    def moved_key(self, time_s: float, to_s: float, name: Keyed, **fields: Any) -> "RainKeyframes":
        """Return a copy with one field's keyframe moved to another time, optionally with a new value.

        It replaces a keyframe of that field at the new time.
        """
        key = self.key_at(time_s)
        if key is None or getattr(key, name) is None:
            return self
        value = fields.get(name, getattr(key, name))
        return self.without_key(time_s, name).with_key(to_s, **{name: value}, easing=key.easing_of(name))

    @cached_property
    def key_times(self) -> dict[Keyed, Float64[np.ndarray, " n"]]:
        """Times of each field's keyframes, rising; empty for fields without any."""
        return {
            name: np.array([key.time_s for key in self.keys if getattr(key, name) is not None], np.float64)
            for name in KEYED
        }

    def _with(self, *keys: RainKeyframe) -> "RainKeyframes":
        return RainKeyframes(keys=tuple(sorted(keys, key=_TIME)), between=self.between)


NO_KEYFRAMES = RainKeyframes()  # no keyframes: the rain is constant


def keyframes_from_series(times_s: Float64[np.ndarray, " n"], rates_mm_h: Float64[np.ndarray, " n"]) -> RainKeyframes:
    """Return the keyframes of a series of rain rates, clipped to 149 mm/h.

    Raises `ValueError` for times that don't rise, or negative or non-finite rates.
    """
    if not np.all(np.isfinite(rates_mm_h)) or np.any(rates_mm_h < 0):
        raise ValueError("rain rates must be 0 mm/h or more")
    pairs = zip(times_s.tolist(), np.minimum(rates_mm_h, HEAVIEST_MM_H).tolist(), strict=True)
    return RainKeyframes(keys=tuple(RainKeyframe(time_s=time, intensity_mm_h=rate) for time, rate in pairs))


def shower_keyframes(
    start_s: float = 0.0, *, duration_s: float = 60.0, peak_mm_h: float = 12.0, steps: int = 6
) -> RainKeyframes:
    """Return a shower with its peak in the middle: R = R_max sin^2(pi t / T)."""
    rates = [round(peak_mm_h * math.sin(math.pi * k / steps) ** 2, 6) for k in range(steps + 1)]
    keys = (RainKeyframe(time_s=start_s + duration_s * k / steps, intensity_mm_h=rate) for k, rate in enumerate(rates))
    return RainKeyframes(keys=tuple(keys), between="smooth")


# Files


def read_keyframes(path: Path) -> RainKeyframes:
    """Read rain keyframes from a YAML or JSON file. Raises `ValueError`, which names the field, and `OSError`."""
    try:
        return convert_checked(yaml_values(read_whole(path)), RainKeyframes)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def write_keyframes(path: Path, keyframes: RainKeyframes) -> None:
    """Write rain keyframes to a YAML file, for `gsrain render --rain-keyframes`. Raises `OSError`."""
    with whole_file(path) as file:
        file.write_bytes(msgspec.yaml.encode(keyframes))


# Rain saved with a scene

logger = logging.getLogger("gsrain")
Saved = TypeVar("Saved", RainSettings, RainKeyframes)


def rain_of(scene: Scene) -> RainSettings | None:
    """Return the rain saved with a scene; None if absent, or invalid, which is logged."""
    return _read(scene, "rain", saved_rain(scene), RainSettings)


def saved_rain(scene: Scene) -> dict[str, Any] | None:
    """Return the values of the rain saved with a scene; those of older scene.json files by their present names."""
    if scene.rain is None:
        return None
    values = {name: value for name, value in scene.rain.items() if name not in _SWITCHES}
    if isinstance(values.get("haze"), bool):
        values["haze"] = "medium" if values["haze"] else "none"
    is_paper = any(scene.rain.get(name, value) != value for name, value in _SWITCHES.items())
    return values | {"model": "paper"} if is_paper else values


_SWITCHES = {
    "streak_frame": "camera", "rain_light": "linear", "far_drops": "haze", "streak_reset": "lattice",
    "haze_reset": "fade",
}  # fmt: skip
"""Settings of older files that are parts of `model` today, with their values in the physical one."""


def keyframes_of(scene: Scene) -> RainKeyframes | None:
    """Return the keyframes saved with a scene; None if absent, or invalid, which is logged."""
    return _read(scene, "weather", scene.weather, RainKeyframes)


def _read(scene: Scene, what: str, values: Mapping[str, Any] | None, kind: type[Saved]) -> Saved | None:
    try:
        return None if values is None else convert_checked(values, kind)
    except msgspec.ValidationError as error:
        logger.error("%s: the scene's %s can't be used: %s", scene.name, what, error)
        return None
