"""Settings of the ego vehicle and of its controller, and the reserved ids of road users."""

from typing import Annotated, Literal

from msgspec import Meta

from ..settings import Settings

EGO = "ego"
"""Id of the ego vehicle."""

BACKGROUND = "background"
"""Value of `RolloutStep.collision` for a hit that is not a road user."""


class Vehicle(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Dimensions and limits of a car. Frame: x forward, y left, z up, origin on the ground below the rear axle.

    The defaults are a mid-size car; wheelbase, steering and acceleration limits are those of HUGSIM's controller.
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
        float, Meta(gt=0, le=20, title="Max. acceleration", extra={"unit": "m/s\u00b2"})
    ] = 3.0  # fmt: skip
    most_braking_m_s2: Annotated[
        float, Meta(gt=0, le=20, title="Max. braking", description="On a dry road.", extra={"unit": "m/s\u00b2"})
    ] = 8.0  # fmt: skip
    most_steer_rad: Annotated[
        float, Meta(gt=0, le=1.5, title="Max. steering", description="Of the front wheels.", extra={"unit": "rad"})
    ] = 1.0471975511965976  # fmt: skip
    most_steer_rate_rad_s: Annotated[
        float, Meta(gt=0, le=5, title="Max. steering rate", extra={"unit": "rad/s"})
    ] = 0.4  # fmt: skip
    top_speed_m_s: Annotated[float, Meta(gt=0, le=100, title="Top speed", extra={"unit": "m/s"})] = 50.0

    @property
    def middle_m(self) -> float:
        """Distance from the rear axle forward to the center of the body."""
        return self.length_m / 2 - self.rear_overhang_m

    @property
    def front_m(self) -> float:
        """Distance from the rear axle forward to the front bumper."""
        return self.length_m - self.rear_overhang_m


HeadingReference = Literal["tangent", "hugsim"]


class ControllerSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Choice of a controller and its limits."""

    kind: Annotated[
        Literal["ilqr", "pure-pursuit"],
        Meta(title="Path tracker", description="nuPlan's tracker, as HUGSIM uses it, or the plain geometric one."),
    ] = "ilqr"
    heading_reference: Annotated[
        HeadingReference,
        Meta(
            title="Tracker target heading",
            description="Heading that the tracker wants: the plan's own, or HUGSIM's published arctan2 of swapped "
            "arguments, with all else as published too, to reproduce its numbers.",
        ),
    ] = "tangent"
    iterations: Annotated[int, Meta(ge=1, le=1000, title="Iterations")] = 100
    most_acceleration_m_s2: Annotated[
        float,
        Meta(gt=0, le=20, title="Max. acceleration", description="That the tracker asks for; nuPlan's.",
             extra={"unit": "m/s\u00b2"}),
    ] = 3.0  # fmt: skip
    most_braking_m_s2: Annotated[
        float,
        Meta(
            gt=0,
            le=20,
            title="Max. braking",
            description="That the tracker asks for, whatever the vehicle could do; nuPlan's and HUGSIM's is 3.",
            extra={"unit": "m/s\u00b2"},
        ),
    ] = 3.0
