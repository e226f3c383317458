"""A scenario: where the drive begins, who else is on the road, what the weather is, and when it ends."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from gsrain_engine.rain.rain import Rain

from ..rollouts.rollout import BACKGROUND
from ..traffic.behaviours import BehaviourSettings
from ..traffic.ego_user import EGO
from ..vehicle.controller_settings import ControllerSettings
from ..vehicle.vehicle import Vehicle

_Side = Annotated[float, Meta(gt=0, le=100)]
_TAKEN = (EGO, BACKGROUND)
"""Ids by which roll-outs mean something else."""


class ScenarioUser(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A road user that a scenario puts on the road; its place is measured along the ego vehicle's route."""

    id: Annotated[str, Meta(min_length=1, title="Name")]
    model: Annotated[
        str,
        Meta(
            title="Model",
            description="What it looks like: hatchback, saloon, estate, van or truck, with a paint if wanted "
            "(van/red); actor:ID (one of the scene); or a file of Gaussians (metres, x forward, y left, z up).",
        ),
    ] = "saloon"
    class_name: Annotated[str, Meta(title="Class")] = "car"
    size_lwh_m: Annotated[
        tuple[_Side, _Side, _Side] | None,
        Meta(title="Size", description="Length, width and height; none takes the model's.", extra={"unit": "m"}),
    ] = None
    placed: Annotated[
        Literal["along-route", "straight"],
        Meta(title="Measured", description="Along the ego vehicle's route, or straight from where it starts and as "
             "it is turned there."),
    ] = "along-route"  # fmt: skip
    ahead_m: Annotated[
        float,
        Meta(ge=-500, le=500, title="Ahead", description="From the ego vehicle's middle to its middle, at the start.",
             extra={"unit": "m"}),
    ] = 0.0  # fmt: skip
    left_m: Annotated[
        float,
        Meta(ge=-100, le=100, title="Left", description="Of the ego vehicle's route; straight: of itself.",
             extra={"unit": "m"}),
    ] = 0.0  # fmt: skip
    turned_deg: Annotated[
        float,
        Meta(ge=-180, le=180, title="Turned", description="To the left, from the route's direction; straight: from "
             "the ego vehicle's.", extra={"unit": "deg"}),
    ] = 0.0  # fmt: skip
    speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Speed", extra={"unit": "m/s"})] = 0.0
    behaviour: BehaviourSettings


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One closed-loop test. Times are seconds since it began unless they say otherwise."""

    name: Annotated[str, Meta(min_length=1, title="Name")]
    description: str = ""
    scene: Annotated[str, Meta(title="Scene", description="Scene file or folder, or street (the built-in one).")] = (
        "street"
    )
    rig: Annotated[str | None, Meta(title="Rig", description="Of the scene's; none takes its first.")] = None
    picture_width_px: Annotated[
        int, Meta(ge=64, le=4096, multiple_of=2, title="Picture width", extra={"unit": "px"})
    ] = 800
    start_s: Annotated[
        float,
        Meta(title="Start", description="Scene time at which it begins: the ego vehicle starts where it then was.",
             extra={"unit": "s"}),
    ] = 0.0  # fmt: skip
    ahead_m: Annotated[
        float, Meta(ge=-500, le=500, title="Ahead of there", description="Along the route.", extra={"unit": "m"})
    ] = 0.0
    left_m: Annotated[float, Meta(ge=-20, le=20, title="Left of the route", extra={"unit": "m"})] = 0.0
    turned_deg: Annotated[
        float,
        Meta(ge=-180, le=180, title="Turned", description="From the route's direction, to the left.",
             extra={"unit": "deg"}),
    ] = 0.0  # fmt: skip
    speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Initial speed", extra={"unit": "m/s"})] = 10.0
    keep: Annotated[
        tuple[str, ...] | Literal["all"],
        Meta(title="Actors that stay", description="Of the scene's own actors, which follow their tracks."),
    ] = ()
    road_users: tuple[ScenarioUser, ...] = ()
    rain: Rain = Rain()
    vehicle: Vehicle = Vehicle()
    controller: ControllerSettings = ControllerSettings()
    step_s: Annotated[float, Meta(gt=0, le=1, title="Step", description="HUGSIM's is 0.25 s.", extra={"unit": "s"})] = (
        0.25
    )
    duration_s: Annotated[float, Meta(gt=0, le=600, title="Longest duration", extra={"unit": "s"})] = 15.0
    leave_m: Annotated[
        float,
        Meta(gt=0, le=1000, title="Off the route", description="Farther from the route ends it.", extra={"unit": "m"}),
    ] = 10.0

    def __post_init__(self) -> None:
        ids = [user.id for user in self.road_users]
        doubled = next((each for each in ids if ids.count(each) > 1), None)
        if doubled is not None:
            raise ValueError(f"two road users are called {doubled!r}")
        taken = next((each for each in ids if each in _TAKEN), None)
        if taken is not None:
            raise ValueError(f"a road user can't be called {taken!r}: roll-outs mean something else by it")
