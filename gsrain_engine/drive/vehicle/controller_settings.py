"""Which controller steers, and how hard it may."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta


class ControllerSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What turns plans into controls."""

    kind: Annotated[
        Literal["ilqr", "pure-pursuit"],
        Meta(title="Controller", description="nuPlan's tracker, as HUGSIM uses it, or the plain geometric one."),
    ] = "ilqr"
    heading_reference: Annotated[
        Literal["tangent", "hugsim"],
        Meta(
            title="Heading reference",
            description="Heading that the tracker wants: the plan's own, or HUGSIM's published arctan2 of swapped "
            "arguments, with all else as published too, to reproduce its numbers.",
        ),
    ] = "tangent"
    iterations: Annotated[int, Meta(ge=1, le=1000, title="Iterations")] = 100
    most_acceleration_m_s2: Annotated[
        float,
        Meta(gt=0, le=20, title="Most acceleration", description="That the tracker asks for; nuPlan's.",
             extra={"unit": "m/s2"}),
    ] = 3.0  # fmt: skip
    most_braking_m_s2: Annotated[
        float,
        Meta(
            gt=0,
            le=20,
            title="Most braking",
            description="That the tracker asks for, whatever the vehicle could do; nuPlan's and HUGSIM's is 3.",
            extra={"unit": "m/s2"},
        ),
    ] = 3.0
