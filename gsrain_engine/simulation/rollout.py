"""What happened in a drive, moment by moment, as plain values."""

from dataclasses import dataclass
from typing import Any

import msgspec

from .vehicle import Vehicle

BACKGROUND = "background"
"""What was hit where it is no road user."""


class EgoRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ego vehicle at a moment: the middle of its rear axle, on the ground. World frame."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float
    steer_rad: float
    acceleration_m_s2: float
    """Over the step before."""
    steer_rate_rad_s: float
    """Over the step before."""
    yaw_rate_rad_s: float
    """From speed, steering and wheelbase."""


class UserRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A road user at a moment: its bottom centre. World frame."""

    id: str
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float


class RolloutStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A moment, with what was planned in it."""

    step: int
    time_s: float
    """Since the scenario began."""
    ego: EgoRecord
    road_users: tuple[UserRecord, ...]
    plan: tuple[tuple[float, float], ...] = ()
    """Points of the plan made now, in the vehicle's present frame (x forward, y left, metres), `spacing_s` apart; empty
    at the end of a drive."""
    route_left_m: float
    """Distance of the rear axle from the route, left positive."""
    route_completion: float
    """Share of the route ahead of the start that is behind the vehicle now, 0..1."""
    collision: str | None = None
    """Id of the road user that is touched, "background" for anything else in the scene."""
    notes: dict[str, Any] = {}
    """What the agent wants on record."""


class UserModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What does not change about a road user."""

    class_name: str
    size_lwh_m: tuple[float, float, float]


class Rollout(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A finished drive. Deterministic: nothing of it depends on the machine's speed or the date."""

    version: int = 1
    scenario: dict[str, Any]
    """As it was run, plain values (`Scenario`)."""
    scene: str
    """Name of the scene."""
    scene_hash: str = ""
    """Of what there is in it to be seen and driven into."""
    agent: str
    seed: int
    step_s: float
    spacing_s: float
    """Time between the points of a plan."""
    users: dict[str, UserModel]
    """By id: everybody who was ever there."""
    end: str
    """Why it ended: "collision", "completed", "off route", "time", "agent", "stopped"."""
    steps: tuple[RolloutStep, ...]
    """The start first; the last has no plan."""
    software: dict[str, str] = {}
    """Versions of what ran."""


# § The ego vehicle of a finished drive.


def driven_vehicle(rollout: Rollout) -> Vehicle:
    """Return the vehicle that a roll-out states, the default one where it states none.

    Raises ValueError for one that can't be read.
    """
    try:
        return msgspec.convert(rollout.scenario.get("vehicle", {}), Vehicle)
    except msgspec.ValidationError as error:
        raise ValueError(f"the roll-out's scenario.vehicle: {error}") from None


# § What a roll-out says about the test that it is of: scenario, weather, vehicle.


@dataclass(frozen=True, slots=True)
class RunSetting:
    """The parts of a scenario that metrics and tables need."""

    scenario: str
    """Its name."""
    description: str
    intensity_mm_h: float
    vehicle: Vehicle


def run_setting(rollout: Rollout) -> RunSetting:
    """Read them from a roll-out; what it does not state has its default, no rain and the default vehicle.

    Raises ValueError for a vehicle that can't be read.
    """
    plain, vehicle = rollout.scenario, driven_vehicle(rollout)
    intensity = float(plain.get("rain", {}).get("intensity_mm_h", 0.0))
    name, description = str(plain.get("name", "")), str(plain.get("description", ""))
    return RunSetting(name, description, intensity, vehicle)


def planned_frames(rollout: Rollout) -> tuple[RolloutStep, ...]:
    """Return the moments in which a plan was made: the paper's F frames."""
    return tuple(each for each in rollout.steps if each.plan)
