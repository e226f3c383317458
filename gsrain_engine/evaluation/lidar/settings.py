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
