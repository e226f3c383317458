"""The ego vehicle: its size and what it can do."""

from typing import Annotated

import msgspec
from msgspec import Meta


class Vehicle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A car as its driver's model sees it. Frame: x forward, y left, z up, origin on the ground below the rear axle.

    The defaults are a middle-class car; the wheelbase, the steering and the acceleration that a driver may ask for are
    those of HUGSIM's controller.
    """

    length_m: Annotated[float, Meta(gt=0, le=30, title="Length", extra={"unit": "m"})] = 4.6
    width_m: Annotated[float, Meta(gt=0, le=5, title="Width", extra={"unit": "m"})] = 1.85
    height_m: Annotated[float, Meta(gt=0, le=5, title="Height", extra={"unit": "m"})] = 1.5
    wheelbase_m: Annotated[float, Meta(gt=0, le=10, title="Wheelbase", extra={"unit": "m"})] = 2.7
    rear_overhang_m: Annotated[
        float,
        Meta(ge=0, le=10, title="Rear overhang", description="From the rear bumper to the rear axle.",
             extra={"unit": "m"}),
    ] = 1.0  # fmt: skip
    most_acceleration_m_s2: Annotated[
        float, Meta(gt=0, le=20, title="Most acceleration", extra={"unit": "m/s2"})
    ] = 3.0  # fmt: skip
    most_braking_m_s2: Annotated[
        float, Meta(gt=0, le=20, title="Most braking", description="On a dry road.", extra={"unit": "m/s2"})
    ] = 8.0  # fmt: skip
    most_steer_rad: Annotated[
        float, Meta(gt=0, le=1.5, title="Most steering", description="Of the front wheels.", extra={"unit": "rad"})
    ] = 1.0471975511965976  # fmt: skip
    most_steer_rate_rad_s: Annotated[
        float, Meta(gt=0, le=5, title="Most steering rate", extra={"unit": "rad/s"})
    ] = 0.4  # fmt: skip
    top_speed_m_s: Annotated[float, Meta(gt=0, le=100, title="Top speed", extra={"unit": "m/s"})] = 50.0

    @property
    def middle_m(self) -> float:
        """From the rear axle forward to the middle of the body."""
        return self.length_m / 2 - self.rear_overhang_m

    @property
    def front_m(self) -> float:
        """From the rear axle forward to the front bumper."""
        return self.length_m - self.rear_overhang_m


HUGSIM_VEHICLE = Vehicle(length_m=3.0, width_m=1.6, height_m=1.5, wheelbase_m=2.7, rear_overhang_m=1.5)
"""HUGSIM's ego: its box (w 1.6, h 1.5, l 3.0) stands around the point that it steers, a front camera."""
