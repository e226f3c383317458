"""What a person can choose about a fit."""

from typing import Annotated

import msgspec
from msgspec import Meta

from ..calibration import Positive
from ..drop_sizes import LARGEST_MM


class FitOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How minutes become rows of a calibration."""

    intensities_mm_h: Annotated[
        tuple[Positive, ...],
        Meta(min_length=2, title="Intensities", description="Middles of the bins; a row for each with enough drops."),
    ] = (0.3, 0.5, 0.8, 1.2, 1.8, 2.7, 4.0, 5.8, 8.5, 12.0, 18.0, 27.0, 40.0, 60.0, 90.0)
    half_width: Annotated[
        float,
        Meta(gt=0, lt=1, title="Half width", description="Minutes within this share of a bin's middle belong to it."),
    ] = 0.2
    smallest_mm: Annotated[
        float,
        Meta(
            ge=0,
            lt=LARGEST_MM,
            title="Smallest drop",
            description="Classes that begin below aren't fitted; 0 takes all.",
        ),
    ] = 0.0
    resamples: Annotated[
        int, Meta(ge=0, le=100_000, title="Resamples", description="Bootstrap draws behind each interval; 0: none.")
    ] = 400
    seed: Annotated[int, Meta(ge=0, title="Seed", description="Of the bootstrap.")] = 0
