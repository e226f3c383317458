"""Rain: what is asked for, and what the virtual disdrometer measures of it."""

from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.rain.settings import load_preset

from .arguments import RAIN_FIELDS, checked, checked_settings

if TYPE_CHECKING:
    from gsrain_engine.disdrometer.measurement import DisdrometerMeasurement


class Rain(ABC):  # noqa: B024  abstract, so that `RainSettings` counts as a subclass
    """Makes rain settings: `gr.Rain(intensity=8.5, wind=(2, 0), seed=1)`.

    What it returns is a `RainSettings` value, which counts as an instance of `Rain`. It has units in the names of its
    fields: `rain.intensity_mm_h`, `rain.wind_speed_m_s`. The same settings and time give the same drops.
    """

    @checked
    def __new__(
        cls,
        intensity: float = 0.0,
        *,
        wind: tuple[float, float] | None = None,
        gusts: float | None = None,
        turbulence: float | None = None,
        exposure: float | None = None,
        seed: int = 0,
        **settings: Any,
    ) -> RainSettings:
        """Return settings, checked.

        Args:
            intensity: Rainfall intensity R in mm/h, 0..149; calibrated up to 13.
            wind: Wind at 10 m above the ground, along the world's x (east) and y (north) in m/s; None is a light breeze
                from west-southwest. `wind_speed_m_s` and `wind_from_deg` set the same.
            gusts: Amplitude of the wind's variation over seconds and meters, in m/s.
            turbulence: RMS velocity in m/s of eddies that move drops one by one.
            exposure: Shutter time in s; None takes that of a `sensor`, or the camera's own (4 ms by day).
            seed: Seed of the drops, 0..2^32 - 1.
            settings: Further fields of `RainSettings` by their names, such as `wetness=1.0`, `haze="none"`, or
                `sensor="automotive"` (a shipped sensor or a file: `gsrain schema sensors`).

        Raises:
            ValueError: For an unknown or wrong setting, with what is allowed.
        """
        values = {
            "intensity_mm_h": intensity,
            "exposure_s": exposure,
            "seed": seed,
        }
        air = {"wind_m_s": wind, "gust_m_s": gusts, "turbulence_m_s": turbulence}
        values |= {name: value for name, value in air.items() if value is not None}
        return checked_settings(msgspec.to_builtins(RainSettings()) | values | settings, RainSettings, RAIN_FIELDS)

    @classmethod
    @checked
    def preset(cls, name: Path | str) -> RainSettings:
        """Load a shipped preset ("clear", "1.2", "8.5", "12.0", "paper") by name, or a preset file by path.

        Raises `ValueError` with the file, the field and what is allowed.
        """
        return load_preset(str(name))

    @classmethod
    @checked
    def from_disdrometer(
        cls,
        files: Path | str | Sequence[Path | str],
        *,
        intensity: float | None = None,
        save_to: Path | str | None = None,
    ) -> RainSettings:
        """Fit a calibration to measured drops, and return rain that falls by it.

        Args:
            files: A file of a disdrometer, or several of one instrument: Parsivel, Thies LNM, Joss-Waldvogel, 2DVD,
                netCDF.
            intensity: Intensity in mm/h; None takes the mean over the minutes with rain.
            save_to: YAML file for the calibration; None keeps it in the cache folder.

        Raises:
            ValueError: When a file can't be read, has too little rain, or contradicts itself.
        """
        from gsrain_engine.disdrometer.fit import rain_as_measured

        paths = [files] if isinstance(files, str | Path) else files
        rain = rain_as_measured(paths, intensity, save_to=save_to)
        return checked_settings(rain, RainSettings, RAIN_FIELDS)


Rain.register(RainSettings)


@dataclass(frozen=True)
class RainMeasurement:
    """Result of the virtual disdrometer."""

    counted: "DisdrometerMeasurement"
    """Counts by drop class; `counted.spectra` is the output of a real instrument."""

    @property
    def rate(self) -> float:
        """Rain rate in mm/h."""
        return self.counted.rate_mm_h

    @property
    def standard_error(self) -> float:
        """Standard error of the rate in mm/h, from the number of drops."""
        return self.counted.standard_error_mm_h

    @property
    def drops(self) -> int:
        """Number of drops that were counted."""
        return self.counted.drops

    @property
    def mean_diameter(self) -> float | None:
        """Mean diameter of the drops in the air in mm; None without drops."""
        return self.counted.mean_diameter_mm

    def __str__(self) -> str:
        return f"{self.rate:.2f} +- {self.standard_error:.2f} mm/h"

    def __repr__(self) -> str:
        return f"<gsrain.RainMeasurement {self}, {self.drops:,} drops>"


@checked
def measure_rain(rain: RainSettings, seconds: float = 60.0, *, area: float = 0.5) -> RainMeasurement:
    """Count the simulated drops that fall through a horizontal square, as a disdrometer would.

    Args:
        rain: The rain.
        seconds: Simulated time in s.
        area: Area of the square in square meters.

    Raises:
        ValueError: For a time that is not above 0, or an area on which the drop field would repeat.
    """
    from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
    from gsrain_engine.rain.simulation import RainSimulation

    if not seconds > 0:
        raise ValueError(f"seconds {seconds:g}: must be above 0")
    return RainMeasurement(VirtualDisdrometer(RainSimulation.start(rain), area).measure(np.array([0.0, seconds])))
