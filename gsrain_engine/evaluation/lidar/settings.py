"""Settings of an evaluation of a lidar, for the command line and Python."""

from typing import Annotated, Literal

from msgspec import Meta

from ...rain.settings import HEAVIEST_MM_H
from ...settings import Settings

_COMMANDS = "evaluate lidar"
Answer = Literal["strongest", "first", "last"]


class LidarSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Conditions of an evaluation of a lidar."""

    intensities_mm_h: Annotated[
        tuple[Annotated[float, Meta(ge=0, le=HEAVIEST_MM_H)], ...],
        Meta(min_length=1, title="Intensities", description="Rainfall intensities.",
             extra={"unit": "mm/h", "option": "rain intensity", "commands": _COMMANDS}),
    ] = (0.0, 1.2, 8.5, 12.0)  # fmt: skip
    seeds: Annotated[
        int,
        Meta(ge=1, le=1000, title="Seeds", description="Number of rains of each intensity: seeds 0 to N-1.",
             extra={"commands": _COMMANDS}),
    ] = 5  # fmt: skip
    sweeps: Annotated[
        int,
        Meta(ge=1, le=1000, title="Turns", description="Number of lidar turns, evenly over the capture or the drive.",
             extra={"commands": _COMMANDS}),
    ] = 1  # fmt: skip
    answer: Annotated[
        Answer, Meta(title="Answer", description="Reported echo of a beam.", extra={"commands": _COMMANDS})
    ] = "strongest"
    wet_road: Annotated[
        bool,
        Meta(title="Wet road", description="Water on the road reflects grazing beams away.",
             extra={"commands": _COMMANDS}),
    ] = True  # fmt: skip
    full_intensity: Annotated[
        Annotated[float, Meta(gt=0, le=1e6)] | None,
        Meta(title="Full intensity", description="A capture's intensity of white; default: 1, or 100 if values exceed "
             "1.", extra={"commands": _COMMANDS}),
    ] = None  # fmt: skip
    reflectance: Annotated[
        float,
        Meta(gt=0, le=1, title="Reflectance", description="Near-infrared reflectance of all surfaces of a scene.",
             extra={"commands": _COMMANDS}),
    ] = 0.2  # fmt: skip


SENSOR_NAMES = ("32", "64", "128", "1550")
"""Generic sensor classes of `sensor.SENSORS`: number of beams, or wavelength in nm."""


class SensorSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields of a lidar, without its computations."""

    name: str
    elevations_deg: Annotated[tuple[Annotated[float, Meta(ge=-60, le=60)], ...], Meta(min_length=1, title="Elevations")]
    """Of each ring of beams, upward; required for virtual scans."""
    azimuth_step_deg: Annotated[float, Meta(ge=0.02, le=10, title="Azimuth step", extra={"unit": "deg"})] = 0.2
    azimuth_limit_deg: Annotated[float, Meta(gt=0, le=180, title="Azimuth to either side", extra={"unit": "deg"})] = 180
    wavelength_nm: Annotated[Literal[905, 1550], Meta(title="Wavelength", extra={"unit": "nm"})] = 905
    range_m: Annotated[float, Meta(
        ge=1, le=1000, title="Range at 10 %",
        extra={"unit": "m", "option": "range-10", "commands": "evaluate lidar"},
        description="Range at which 10 % reflectance is just detected, without rain.")] = 100.0  # fmt: skip
    farthest_m: Annotated[float, Meta(ge=1, le=2000, title="Longest range", extra={"unit": "m"})] = 250.0
    """Maximum range of the receiver."""
    blind_m: Annotated[float, Meta(ge=0, le=50, title="Blind up to", extra={"unit": "m"})] = 0.9
    """Range below which the receiver sees nothing of the beam. Up to `clear_m` its overlap rises linearly to 1."""
    clear_m: Annotated[float, Meta(gt=0, le=50, title="Sees all from", extra={"unit": "m"})] = 1.0
    least_reflectance: Annotated[float, Meta(
        ge=0, le=0.1, title="Least reflectance", extra={"option": "min-reflectance", "commands": "evaluate lidar"},
        description="Detection limit at any distance: receivers reduce their gain for near echoes. "
        "0 is a constant gain.")] = 3e-4  # fmt: skip
    """Makers don't state it, and the number of false returns depends on it: near drops return 1e-5 to 1e-3 of a beam.
    At a constant gain one in twelve returns of RainSense's sensor at 9.2 mm/h would be a drop, but there are none: its
    limit is 1e-4 or more."""
    beam_mm: Annotated[float, Meta(ge=8, le=100, title="Beam at the window", extra={"unit": "mm"})] = 12.0
    """Diameter; at least the largest drop's."""
    divergence_mrad: Annotated[float, Meta(ge=0, le=20, title="Divergence", extra={"unit": "mrad"})] = 3.0
    """Full angle."""
    pulse_m: Annotated[float, Meta(gt=0, le=5, title="Pulse", extra={"unit": "m"})] = 0.75
    """Half the pulse's length: closer echoes merge. 5 ns."""
    range_sigma_m: Annotated[float, Meta(ge=0, le=1, title="Range noise", extra={"unit": "m"})] = 0.05
    """Standard deviation of the range of an echo at the detection threshold."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.clear_m < self.blind_m:
            raise ValueError(f"clear_m must be at least blind_m, got {self.clear_m} and {self.blind_m}")
