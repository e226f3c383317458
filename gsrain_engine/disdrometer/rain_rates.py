"""Rain keyframes from a disdrometer's time series of rain rates."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from ..rain.keyframes import LONGEST_S, RainKeyframes, keyframes_from_series
from ..rain.settings import HEAVIEST_MM_H
from .spectra import DisdrometerReading


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasuredKeyframes:
    """Rain keyframes from a file, with statistics of the conversion."""

    weather: RainKeyframes
    records: int
    """Number of records used."""
    left_out: int
    """Number of records without a time or a rate."""
    cut_off: int
    """Number of records above 149 mm/h, clipped to 149."""
    duration_s: float
    """Time from the first keyframe to the last."""

    @property
    def summary(self) -> str:
        words = [f"{self.records:,} records over {self.duration_s:,.0f} s"]
        if self.left_out:
            words.append(f"{self.left_out:,} left out, without a time or a rate")
        if self.cut_off:
            words.append(f"{self.cut_off:,} cut off at {HEAVIEST_MM_H:g} mm/h")
        return "; ".join(words)


def keyframes_from_spectra(
    reading: DisdrometerReading, *, speed_up: float = 1.0, start_s: float = 0.0
) -> MeasuredKeyframes:
    """Return the rates of a disdrometer's records as intensity keyframes, each in the middle of its record.

    The rate is the instrument's own, otherwise that of the counted drops. The first keyframe is at `start_s`; time runs
    `speed_up` times as fast as measured. A file with one rate and no time, as RainSense's, gives one keyframe. Rates
    above 149 mm/h are clipped. Raises `ValueError` if no record has a time and a rate, if the speed-up is not above 0,
    or if the series exceeds the maximum duration of keyframes.
    """
    if not (np.isfinite(speed_up) and speed_up > 0):
        raise ValueError(f"speed-up {speed_up:g}: must be above 0")
    spectra = reading.spectra
    rates = np.where(np.isfinite(spectra.reported_mm_h), spectra.reported_mm_h, spectra.rate_mm_h)
    if len(spectra) == 1 and np.isnat(spectra.times[0]) and np.isfinite(rates[0]):
        weather = keyframes_from_series(np.array([start_s]), rates)
        return MeasuredKeyframes(
            weather=weather, records=1, left_out=0, cut_off=int(rates[0] > HEAVIEST_MM_H), duration_s=0.0
        )
    usable = ~np.isnat(spectra.times) & np.isfinite(rates) & (rates >= 0)
    if not usable.any():
        raise ValueError(f"{spectra.instrument}: no record has a time and a rain rate")
    first = spectra.times[usable][0]
    times = (spectra.times - first) / np.timedelta64(1, "s") - spectra.seconds / 2
    usable[usable] = _rising(times[usable])
    times, rates = times[usable], rates[usable]
    times = start_s + (times - times[0]) / speed_up
    if times[-1] > LONGEST_S:
        raise ValueError(
            f"{spectra.instrument}: records over {times[-1]:.3g} s, a weather lasts {LONGEST_S:g} s at most: one "
            "of them has a wrong time, or the file is to be split"
        )
    return MeasuredKeyframes(
        weather=keyframes_from_series(times, rates),
        records=len(times),
        left_out=len(spectra) - len(times),
        cut_off=int(np.sum(rates > HEAVIEST_MM_H)),
        duration_s=float(times[-1] - times[0]),
    )


def _rising(times: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Mask of times later than all before them: a clock that was set back repeats some."""
    latest = np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]])
    return times > latest
