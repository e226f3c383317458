"""Settings of a fit of a calibration to measured spectra."""

from typing import Annotated

from msgspec import Meta

from ..rain.settings import LARGEST_MM
from ..settings import Settings


class FitOptions(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a fit from minutes to calibration rows."""

    intensities_mm_h: Annotated[
        tuple[Annotated[float, Meta(gt=0)], ...],
        Meta(
            min_length=2,
            title="Intensities",
            description="Middles of the bins; a row for each with enough drops.",
            extra={"unit": "mm/h", "commands": "calibrate"},
        ),
    ] = (0.3, 0.5, 0.8, 1.2, 1.8, 2.7, 4.0, 5.8, 8.5, 12.0, 18.0, 27.0, 40.0, 60.0, 90.0)
    half_width: Annotated[
        float,
        Meta(
            gt=0,
            lt=1,
            title="Half width",
            description="Minutes within this share of a bin's middle belong to it.",
            extra={"commands": "calibrate"},
        ),
    ] = 0.2
    smallest_mm: Annotated[
        float,
        Meta(
            ge=0,
            lt=LARGEST_MM,
            title="Smallest drop",
            description="Classes that begin below aren't fitted; 0 takes all.",
            extra={"option": "smallest-mm", "commands": "calibrate"},
        ),
    ] = 0.0
    resamples: Annotated[
        int,
        Meta(
            ge=0,
            le=100_000,
            title="Resamples",
            description="Bootstrap draws behind each interval; 0: none.",
            extra={"commands": "calibrate"},
        ),
    ] = 400
    seed: Annotated[int, Meta(ge=0, title="Seed", description="Of the bootstrap.", extra={"commands": "calibrate"})] = 0
