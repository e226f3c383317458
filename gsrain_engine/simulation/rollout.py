"""Roll-out of a closed-loop drive, step by step, as plain values."""

from dataclasses import dataclass
from typing import Any

import msgspec

from .vehicle import Vehicle

BACKGROUND = "background"
"""Value of `RolloutStep.collision` for a hit that is not a road user."""


class EgoRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Ego state at one step: center of the rear axle on the ground. World frame."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float
    steer_rad: float
    acceleration_m_s2: float
    steer_rate_rad_s: float  # acceleration and steering rate are those over the previous step
    yaw_rate_rad_s: float  # computed from speed, steering and wheelbase


class UserRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Road user state at one step: center of the bottom face. World frame."""

    id: str
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float


class RolloutStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One time step with the agent's plan. Times count from the start of the scenario."""

    step: int
    time_s: float
    ego: EgoRecord
    road_users: tuple[UserRecord, ...]
    plan: tuple[tuple[float, float], ...] = ()
    """Points of the current plan in the vehicle's current frame (x forward, y left, meters), `spacing_s` apart.

    Empty at the end of a drive.
    """
    route_left_m: float  # distance of the rear axle from the route, left positive
    route_completion: float  # driven share of the route ahead of the start, 0..1
    collision: str | None = None  # id of the road user hit, or "background" for anything else in the scene
    notes: dict[str, Any] = {}


class UserModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Constant properties of a road user."""

    class_name: str
    size_lwh_m: tuple[float, float, float]


class Rollout(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A finished drive. Deterministic: independent of the machine's speed and the date."""

    version: int = 1
    scenario: dict[str, Any]
    """The `Scenario` as plain values."""
    scene: str
    scene_hash: str = ""
    """Hash of the scene's visible and solid content."""
    agent: str
    seed: int
    step_s: float
    spacing_s: float
    users: dict[str, UserModel]
    """All road users that ever appeared, by id."""
    end: str
    """Reason of the end: "collision", "completed", "off route", "time", "agent", "stopped"."""
    steps: tuple[RolloutStep, ...]
    """The first is the start; the last has no plan."""
    software: dict[str, str] = {}


def driven_vehicle(rollout: Rollout) -> Vehicle:
    """Return the vehicle of a roll-out, or the default one; raises ValueError if it can't be read."""
    try:
        return msgspec.convert(rollout.scenario.get("vehicle", {}), Vehicle)
    except msgspec.ValidationError as error:
        raise ValueError(f"the roll-out's scenario.vehicle: {error}") from None


@dataclass(frozen=True, slots=True)
class RunSetting:
    """The parts of a scenario that metrics and tables need."""

    scenario: str
    intensity_mm_h: float
    vehicle: Vehicle


def run_setting(rollout: Rollout) -> RunSetting:
    """Read the settings from a roll-out; missing ones default to no rain and the default vehicle.

    Raises ValueError for a vehicle that can't be read.
    """
    plain, vehicle = rollout.scenario, driven_vehicle(rollout)
    intensity = float(plain.get("rain", {}).get("intensity_mm_h", 0.0))
    return RunSetting(str(plain.get("name", "")), intensity, vehicle)


def planned_frames(rollout: Rollout) -> tuple[RolloutStep, ...]:
    """Return the steps with a plan: the paper's F frames."""
    return tuple(each for each in rollout.steps if each.plan)
