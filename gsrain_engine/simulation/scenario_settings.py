"""Settings of a scenario: start, road users, weather, vehicle and end."""

from typing import Annotated, Literal

from msgspec import Meta

from ..choices import Friction
from ..rain.settings import RainSettings
from ..settings import Settings
from .traffic.settings import BehaviorSettings
from .vehicle_settings import BACKGROUND, EGO, ControllerSettings, Vehicle

_Side = Annotated[float, Meta(gt=0, le=100)]


class ScenarioUser(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A road user of a scenario; its place is measured along the ego vehicle's route."""

    id: Annotated[str, Meta(min_length=1, title="Name")]
    model: Annotated[
        str,
        Meta(
            title="Model",
            description="What it looks like: hatchback, saloon, estate, van or truck, with a paint if wanted "
            "(van/red); actor:ID (one of the scene); a file of Gaussians (meters, x forward, y left, z up); or the "
            "folder of a 3DRealCar vehicle (gs.pth, wlh.json).",
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
        Meta(ge=-500, le=500, title="Ahead", description="Center to center, from the ego vehicle, at the start.",
             extra={"unit": "m"}),
    ] = 0.0  # fmt: skip
    left_m: Annotated[
        float,
        Meta(ge=-100, le=100, title="Left", description="Of the ego vehicle's route; straight: of itself.",
             extra={"unit": "m"}),
    ] = 0.0  # fmt: skip
    turned_deg: Annotated[
        float,
        Meta(ge=-180, le=180, title="Heading offset", description="To the left, from the route's direction; "
             "straight: from the ego vehicle's.", extra={"unit": "deg"}),
    ] = 0.0  # fmt: skip
    speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Speed", extra={"unit": "m/s"})] = 0.0
    behaviour: BehaviorSettings


class Scenario(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One closed-loop test. Times are seconds since its start unless stated otherwise."""

    name: Annotated[str, Meta(min_length=1, title="Name")]
    description: str = ""
    scene: Annotated[str, Meta(
        title="Scene", extra={"commands": "drive"},
        description="Scene file or folder, or street (the built-in one).")] = "street"  # fmt: skip
    rig: Annotated[str | None, Meta(
        title="Rig", extra={"commands": "drive*"},
        description="Camera rig of the scene; none takes its first.")] = None  # fmt: skip
    picture_width_px: Annotated[int, Meta(
        ge=64, le=4096, multiple_of=2, title="Picture width",
        extra={"unit": "px", "option": "width", "commands": "drive"},
        description="Width of the images, an even number.")] = 800  # fmt: skip
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
        Meta(ge=-180, le=180, title="Heading offset", description="From the route's direction, to the left.",
             extra={"unit": "deg"}),
    ] = 0.0  # fmt: skip
    speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Initial speed", extra={"unit": "m/s"})] = 10.0
    keep: Annotated[
        tuple[str, ...] | Literal["all"],
        Meta(title="Actors that stay", description="Of the scene's own actors, which follow their tracks."),
    ] = ()
    road_users: tuple[ScenarioUser, ...] = ()
    rain: RainSettings = RainSettings()
    friction: Annotated[Friction, Meta(
        title="Road surface", extra={"commands": "drive"},
        description="Friction of the road under all vehicles. dry: each has its own limits. wet: less, by speed and "
        "water, which agents don't know.")] = "dry"  # fmt: skip
    vehicle: Vehicle = Vehicle()
    controller: ControllerSettings = ControllerSettings()
    step_s: Annotated[
        float, Meta(gt=0, le=1, title="Time step", description="HUGSIM's is 0.25 s.", extra={"unit": "s"})
    ] = 0.25
    duration_s: Annotated[float, Meta(
        gt=0, le=600, title="Max. duration", extra={"unit": "s", "commands": "drive"},
        description="The drive ends then at the latest.")] = 15.0  # fmt: skip
    leave_m: Annotated[
        float,
        Meta(gt=0, le=1000, title="Off the route", description="Farther from the route ends it.", extra={"unit": "m"}),
    ] = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        ids = [user.id for user in self.road_users]
        for each in ids:
            if ids.count(each) > 1:
                raise ValueError(f"two road users are called {each!r}")
        for each in ids:
            if each in (EGO, BACKGROUND):
                raise ValueError(f"a road user can't be called {each!r}: roll-outs mean something else by it")
