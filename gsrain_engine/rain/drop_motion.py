"""Drop motion: fall and drift of each diameter class, integrated over time in float64."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from .air import AirScales, Wind, blended, follows
from .calibration import Calibration
from .keyframes import KeyframeCurve, RainKeyframes
from .properties import DropClassTable
from .settings import RainSettings


@dataclass(frozen=True, eq=False)
class DropMotion:
    """Displacement of each class since t = 0: its value at `since_s` and the motion from then on.

    With constant settings it is a closed form of t. `changed` starts a new segment at the displacement that each class
    has reached, so that no drop jumps when settings change.
    """

    wind: Wind
    fall_speed_m_s: Float64[np.ndarray, " classes"]
    """Downward speed of each class."""
    since_s: float = 0.0
    drifted_m: Float64[np.ndarray, "2"] | float = 0.0
    """Drift of all drops up to `since_s`."""
    fallen_m: Float64[np.ndarray, " classes"] | float = 0.0
    """Fall of each class up to `since_s`."""
    before: AirScales | None = None
    """Scales of the drops' offsets up to `since_s`; None if they are those of the wind from the start."""

    def without_drift(self) -> "DropMotion":
        return replace(self, wind=Wind(), drifted_m=0.0, before=None)

    def drift(self, time_s: float) -> Float64[np.ndarray, "2"]:
        """Drift of all drops by the wind along x and y, in meters."""
        return self.wind.drift_m_s * (time_s - self.since_s) + self.drifted_m

    def fallen(self, time_s: float) -> Float64[np.ndarray, " classes"]:
        """Fall of each class in meters."""
        return self.fall_speed_m_s * (time_s - self.since_s) + self.fallen_m

    def scales(self, time_s: float) -> AirScales:
        """Scales of the drops' offsets at a time."""
        return blended(self.before, self.since_s, self._scales, time_s)

    @cached_property
    def _scales(self) -> AirScales:
        """Scales of the wind's own offsets."""
        return self.wind.scales(self.fall_speed_m_s)

    @cached_property
    def turbulence_m_s(self) -> Float64[np.ndarray, " classes"]:
        """Standard deviation of the velocities that turbulence gives to drops, on each horizontal axis."""
        return self.wind.turbulence_m_s * follows(self.fall_speed_m_s)

    def changed(self, time_s: float, wind: Wind, fall_speed_m_s: Float64[np.ndarray, " classes"]) -> "DropMotion":
        """Continue from the displacement at a time with another wind and other speeds."""
        drifted, fallen = self.drift(time_s), self.fallen(time_s)
        return DropMotion(wind, fall_speed_m_s, time_s, drifted, fallen, self.scales(time_s))


# Drop motion with keyframes


@dataclass(frozen=True, eq=False)
class KeyframedDropMotion:
    """Displacement of each class since t = 0 under keyframes, as a function of t alone.

    A class falls with v_c(R) = sum_j h_j(R) v_c(R_j), h_j the hat functions of tabulated intensities R_j. So its fall
    is sum_j v_c(R_j) W_j(t), W_j the integral of h_j(R(t')) over time: exact for an R that is piecewise linear.
    """

    intensity: KeyframeCurve
    mean_wind: KeyframeCurve
    air: Wind
    """Gusts and turbulence, without a mean."""
    table: DropClassTable
    weights_s: Float64[np.ndarray, "n nodes"]
    """W_j from the first knot of the intensity to each knot."""
    drifted_m: Float64[np.ndarray, "2"] | float = 0.0
    """Offset added to the drift. It makes drops continue from their positions when settings change."""
    fallen_m: Float64[np.ndarray, " classes"] | float = 0.0
    """Offset added to the fall of each class."""
    changed_s: float = 0.0
    before: AirScales | None = None
    """Scales of the drops' offsets up to `changed_s`; None if they are those of the keyframes from the start."""
    _base: dict[tuple[int, int], Float64[np.ndarray, " classes"]] = field(default_factory=dict, init=False)
    """Cache of the fall up to the latest (knot, interval): consecutive frames usually share it."""

    @classmethod
    def of(cls, rain: RainSettings, weather: RainKeyframes, calibration: Calibration) -> "KeyframedDropMotion":
        """Precompute the motion of a rain and its keyframes."""
        curves, paper = weather.curves, rain.is_paper  # the paper's drops fall straight down
        intensity = curves.get("intensity_mm_h") or _still(rain.intensity_mm_h)
        wind = curves.get("wind_m_s") or _still(*rain.wind_vector_m_s)
        table = DropClassTable.between(float(intensity.values.min()), float(intensity.values.max()), rain, calibration)
        mean_wind, air = (_still(0.0, 0.0), Wind()) if paper else (wind, replace(wind_of(rain), mean_m_s=(0.0, 0.0)))
        rates = intensity.values[:, 0]
        steps = table.mean_shares(rates[:-1], rates[1:])
        steps *= np.diff(intensity.times_s)[:, None]
        weights = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
        return cls(intensity, mean_wind, air, table, weights)

    def diameters_mm(self, time_s: float) -> Float64[np.ndarray, " classes"]:
        return self.table.at(self.table.diameters_mm, self._rate(time_s))

    def motion(self, time_s: float) -> DropMotion:
        """Motion and displacement of drops at a time."""
        x, y = self.mean_wind.at(time_s)
        speeds = self.table.at(self.table.fall_speed_m_s, self._rate(time_s))
        wind = replace(self.air, mean_m_s=(float(x), float(y)))
        scales = blended(self.before, self.changed_s, wind.scales(speeds), time_s)
        return DropMotion(wind, speeds, time_s, self.drift(time_s), self.fallen(time_s), scales)

    def drift(self, time_s: float) -> Float64[np.ndarray, "2"]:
        return self.air.drift_share * self.mean_wind.integral(time_s) + self.drifted_m

    def fallen(self, time_s: float) -> Float64[np.ndarray, " classes"]:
        return self._since_first_knot(time_s) - self._since_first_knot_at_zero + self.fallen_m

    def going_on_from(self, motion: DropMotion) -> "KeyframedDropMotion":
        """Return a copy with offsets that match the motion's displacement at its `since_s`."""
        time_s = motion.since_s
        bare = replace(self, drifted_m=0.0, fallen_m=0.0)
        drifted, fallen = motion.drift(time_s) - bare.drift(time_s), motion.fallen(time_s) - bare.fallen(time_s)
        scales = motion.scales(time_s)
        return replace(bare, drifted_m=drifted, fallen_m=fallen, changed_s=time_s, before=scales)

    def _rate(self, time_s: float) -> float:
        return float(self.intensity.at(time_s)[0])

    @cached_property
    def _since_first_knot_at_zero(self) -> Float64[np.ndarray, " classes"]:
        return self._since_first_knot(0.0)

    def _since_first_knot(self, time_s: float) -> Float64[np.ndarray, " classes"]:
        """Fall since the first knot: up to the last knot or crossed table node, plus the rest."""
        table, times, rate = self.table, self.intensity.times_s, self._rate(time_s)
        knot = max(self.intensity.before(time_s), 0)
        interval, start_s = table.interval(rate), float(times[knot])
        start = float(self.intensity.values[knot, 0])
        before = start
        if table.interval(start) != interval:
            node = float(table.nodes_mm_h[interval if rate > start else interval + 1])
            share = (node - start) / (float(self.intensity.values[knot + 1, 0]) - start)
            start, start_s = node, start_s + share * (float(times[knot + 1]) - start_s)
        base = self._base.get((knot, interval))
        if base is None:
            passed = table.mean_shares(np.array([before]), np.array([start]))[0] * (start_s - float(times[knot]))
            base = table.mix(table.fall_speed_m_s, self.weights_s[knot] + passed)
            self._base.clear()
            self._base[knot, interval] = base
        # Between two nodes the speed is linear in R: its mean is the speed at the mean R.
        return base + table.at(table.fall_speed_m_s, 0.5 * (start + rate)) * (time_s - start_s)


def wind_of(rain: RainSettings) -> Wind:
    """Wind of a rain without keyframes."""
    return Wind(rain.wind_vector_m_s, rain.gust_m_s, rain.turbulence_m_s, rain.roughness_m, rain.seed)


def _still(*values: float) -> KeyframeCurve:
    return KeyframeCurve(np.zeros(1), np.array([values], np.float64))
